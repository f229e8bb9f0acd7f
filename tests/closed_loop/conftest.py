"""Runs that several statements look at, each made once; makes the helper importable."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from loop_bench import Loop

from meshpoint.controller.settings.settings import ControllerSettings


@pytest.fixture(scope="session")
def six_shifts() -> Loop:
    """8 -> 10, 10 -> 12 three times, with the rig withdrawn in between."""
    return Loop(shifts=6, seed=2).run(40_000_000)


@pytest.fixture(scope="session")
def one_shift() -> Loop:
    """8 -> 10 by request, from power-up; then the gear it is in and what it cannot do."""
    requests = [(250_000, 8), (300_000, 10), (1_500_000, 10), (1_600_000, 0), (1_700_000, 15)]
    requests += [(1_800_000, 4), (1_900_000, 14)]
    return Loop(requests).run(2_200_000)


@pytest.fixture(scope="session")
def immediate_shift() -> Loop:
    """The same with hardware that cannot schedule."""
    settings = ControllerSettings(valve_timing="immediate")
    return Loop([(300_000, 10)], settings=settings).run(1_500_000)
