"""The valves by name, and which of them push the sleeves of the main box."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from meshpoint.gearbox import MainGear


class ValveName(IntEnum):
    """The nine valves, in the order of the command frame."""

    BRAKE = 0
    SPLIT_LOW = 1
    SPLIT_HIGH = 2
    MAIN_FIRST = 3
    MAIN_SECOND = 4
    MAIN_CRAWL = 5
    MAIN_THIRD = 6
    RANGE_LOW = 7
    RANGE_HIGH = 8


SLEEVE_VALVE: Final = {
    MainGear.FIRST: ValveName.MAIN_FIRST,
    MainGear.SECOND: ValveName.MAIN_SECOND,
    MainGear.CRAWL: ValveName.MAIN_CRAWL,
    MainGear.THIRD: ValveName.MAIN_THIRD,
}
OPPOSITE: Final = {
    MainGear.FIRST: ValveName.MAIN_SECOND,
    MainGear.SECOND: ValveName.MAIN_FIRST,
    MainGear.CRAWL: ValveName.MAIN_THIRD,
    MainGear.THIRD: ValveName.MAIN_CRAWL,
}
"""The valve that pulls a gear out pushes toward the sleeve's other gear."""
