"""The firmware, built once for this machine; skipped with the reason where it cannot be built."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from firmware_bench import CommandBench
from shared_clock import TwoBoards

from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.firmware.build import IMAGES, compiler, library, source_folder
from meshpoint.testbench.firmware.native_board import NativeBoard


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
    """The shared library."""
    return library(folder)


@pytest.fixture
def board(built: bytes) -> NativeBoard:
    return NativeBoard(built)


@pytest.fixture
def boards(folder: Path) -> TwoBoards:
    """A sensor board and a valve board that share its clock by a wire."""
    sensor, valve = (library(folder, IMAGES[name]) for name in ("sensor", "valve"))
    return TwoBoards(NativeBoard(sensor), NativeBoard(valve))


@pytest.fixture
def bench(board: NativeBoard) -> CommandBench:
    return CommandBench(board)
