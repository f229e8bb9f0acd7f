"""The firmware, built once for this machine; skipped with the reason where it cannot be built."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from firmware_bench import CommandBench, emulated_board
from shared_clock import TwoBoards

from meshpoint.base.errors import CommandError
from meshpoint.firmware.build import (
    CROSS_COMPILERS,
    IMAGES,
    compiler,
    cross_compiler,
    installed_cross_compiler,
    library,
    source_folder,
)
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.firmware.native_board import NativeBoard


@pytest.fixture(scope="session")
def folder() -> Path:
    """The sources; others where run_mutants.py says so."""
    try:
        compiler()
    except CommandError as error:
        pytest.skip(str(error))
    return Path(os.environ.get("MESHPOINT_FIRMWARE_SOURCES", source_folder()))


@pytest.fixture(scope="session")
def built(folder: Path) -> bytes:
    """Both images on one board, as a shared library."""
    return library(folder)


@pytest.fixture(scope="session")
def teeth_built(folder: Path) -> bytes:
    """The image `teeth`."""
    return library(folder, IMAGES["teeth"])


@pytest.fixture
def board(built: bytes) -> NativeBoard:
    return NativeBoard(built)


@pytest.fixture
def bench(board: NativeBoard) -> CommandBench:
    return CommandBench(board)


@pytest.fixture
def boards(folder: Path) -> TwoBoards:
    """A sensor board and a valve board that share its clock by a wire."""
    sensor, valve = (library(folder, IMAGES[name]) for name in ("sensor", "valve"))
    return TwoBoards(NativeBoard(sensor), NativeBoard(valve))


@pytest.fixture(params=CROSS_COMPILERS)
def cross(request: pytest.FixtureRequest) -> str:
    """Each compiler for the board; skipped with the reason where it, or unicorn, is absent."""
    pytest.importorskip("unicorn", reason="meshpoint[firmware] is not installed")
    try:
        cross_compiler(request.param)
    except CommandError as error:
        pytest.skip(str(error))
    return str(request.param)


@pytest.fixture
def emulated() -> EmulatedBoard:
    """The emulated board, by whichever compiler there is; skipped where there is none."""
    pytest.importorskip("unicorn", reason="meshpoint[firmware] is not installed")
    try:
        return emulated_board(installed_cross_compiler())
    except CommandError as error:
        pytest.skip(str(error))
