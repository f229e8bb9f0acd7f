"""The firmware, built once for this machine; skipped with the reason where it cannot be built."""

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from firmware_bench import CommandBench

from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.firmware.build import TEETH, compiler, library, source_folder
from meshpoint.testbench.firmware.native_board import NativeBoard


@pytest.fixture(scope="session")
def sources() -> Path:
    """The firmware's; others where run_mutants.py says so."""
    try:
        compiler()
    except CommandError as error:
        pytest.skip(str(error))
    return Path(os.environ.get("MESHPOINT_FIRMWARE_SOURCES", source_folder()))


@pytest.fixture(scope="session")
def built(sources: Path) -> bytes:
    """Both images on one board, as a shared library."""
    return library(sources)


@pytest.fixture(scope="session")
def teeth_built(sources: Path) -> bytes:
    """The image `teeth`."""
    return library(sources, TEETH)


@pytest.fixture
def board(built: bytes) -> NativeBoard:
    return NativeBoard(built)


@pytest.fixture
def bench(board: NativeBoard) -> CommandBench:
    return CommandBench(board)
