"""The valves by name: which push the main sleeves, and what the valve side says of each."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from meshpoint.dbc.messages import ValveStatus
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import DogGear, SplitGear


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

DOG_VALVE: Final[dict[DogGear, ValveName]] = dict(SLEEVE_VALVE) | {
    SplitGear.LOW_SPLIT: ValveName.SPLIT_LOW,
    SplitGear.HIGH_SPLIT: ValveName.SPLIT_HIGH,
}
DOG_OPPOSITE: Final[dict[DogGear, ValveName]] = dict(OPPOSITE) | {
    SplitGear.LOW_SPLIT: ValveName.SPLIT_HIGH,
    SplitGear.HIGH_SPLIT: ValveName.SPLIT_LOW,
}
"""The same of all gears that may have dog teeth."""

Driven = tuple[bool, ...]
"""A flag of each valve, in the order of `ValveName`."""
NONE_DRIVEN: Final[Driven] = (False,) * len(ValveName)
_COILS: Final = 1
_SLOTS: Final = _COILS + len(ValveName)
_AFTER: Final = _SLOTS + len(ValveName)
"""From where on a ValveStatus says what is driven, and what is pending."""


def energised(status: ValveStatus) -> list[ValveName]:
    """The valves whose coils the valve side reports as driven."""
    return [valve for valve in ValveName if status[_COILS + valve]]


def driven_or_pending(status: ValveStatus | None) -> Driven:
    """Whether the valve side reports a valve's coil as driven, or its activation as pending: none,
    before its first frame."""
    if status is None:
        return NONE_DRIVEN
    reported = zip(status[_COILS:_SLOTS], status[_SLOTS:_AFTER], strict=True)
    return tuple([bool(driven or pending) for driven, pending in reported])
