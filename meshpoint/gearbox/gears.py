"""How the gears of a 12+2-speed box are numbered and which sleeve makes each.

A 12+2-speed range-splitter box has a main box of four gears (crawl, 1, 2, 3), a two-step splitter
in front of it and a two-step range behind it. Gears 1..12 run through split, then main, then range:

    number   1  2   3  4   5  6   7  8   9 10  11 12    13  14
    main     1  1   2  2   3  3   1  1   2  2   3  3     C   C
    split    L  H   L  H   L  H   L  H   L  H   L  H     L   H
    range    L  L   L  L   L  L   H  H   H  H   H  H     L   L

so a change of the main box alone is 8 -> 10, 7 -> 9, 1 -> 3 ... 13 and 14 are the two crawl gears;
they are the lowest gears, numbered last because they are used only to move off. 0 is neutral.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final


class MainGear(IntEnum):
    """Gears of the main box; the values are those of the DBC's table MainGear."""

    NEUTRAL = 0
    CRAWL = 1
    FIRST = 2
    SECOND = 3
    THIRD = 4


class Split(IntEnum):
    """Splitter step between input shaft and layshaft."""

    LOW = 0
    HIGH = 1


class SplitGear(IntEnum):
    """The two gears of the splitter, loose on the input shaft, where its sleeve has dog teeth and
    no cones. The values go on after those of `MainGear`: both are keys of the same tables."""

    LOW_SPLIT = 5
    HIGH_SPLIT = 6

    @property
    def split(self) -> Split:
        """The step that it makes."""
        return Split.LOW if self is SplitGear.LOW_SPLIT else Split.HIGH


DogGear = MainGear | SplitGear
"""A gear that a sleeve engages by dog teeth alone."""


class Range(IntEnum):
    """Range step between main shaft and propeller shaft."""

    LOW = 0
    HIGH = 1


class Sleeve(IntEnum):
    """The four coupling sleeves; the two main sleeves ride on the main shaft (thesis 2.1)."""

    FIRST_SECOND = 0
    CRAWL_THIRD = 1
    SPLITTER = 2
    RANGE = 3


MAIN_SLEEVES: Final = (Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD)


@dataclass(frozen=True)
class SleeveSide:
    """A sleeve and the direction it moves in to engage, -1 or +1 along its axis."""

    sleeve: Sleeve
    direction: int


SLEEVE_OF_MAIN: Final[dict[MainGear, SleeveSide]] = {
    MainGear.FIRST: SleeveSide(Sleeve.FIRST_SECOND, -1),
    MainGear.SECOND: SleeveSide(Sleeve.FIRST_SECOND, +1),
    MainGear.CRAWL: SleeveSide(Sleeve.CRAWL_THIRD, -1),
    MainGear.THIRD: SleeveSide(Sleeve.CRAWL_THIRD, +1),
}
SPLIT_GEARS: Final = (SplitGear.LOW_SPLIT, SplitGear.HIGH_SPLIT)
SPLIT_GEAR: Final = {gear.split: gear for gear in SPLIT_GEARS}
SIDE_OF: Final[dict[DogGear, SleeveSide]] = dict(SLEEVE_OF_MAIN) | {
    SplitGear.LOW_SPLIT: SleeveSide(Sleeve.SPLITTER, -1),
    SplitGear.HIGH_SPLIT: SleeveSide(Sleeve.SPLITTER, +1),
}
"""The same of all that may have dog teeth."""
MAIN_GEARS: Final = (MainGear.CRAWL, MainGear.FIRST, MainGear.SECOND, MainGear.THIRD)


@dataclass(frozen=True)
class DriveGear:
    """One of the 14 gears: what the three boxes stand in."""

    number: int
    main: MainGear
    split: Split
    range_: Range

    @property
    def name(self) -> str:
        """`8`, or `C1`/`C2` for the crawl gears."""
        return f"C{self.number - 12}" if self.main is MainGear.CRAWL else str(self.number)


def _number_gears() -> dict[int, DriveGear]:
    gears = {}
    for number in range(1, 13):
        half, step = divmod(number - 1, 6)
        main = (MainGear.FIRST, MainGear.SECOND, MainGear.THIRD)[step // 2]
        gears[number] = DriveGear(number, main, Split(step % 2), Range(half))
    for split in Split:
        gears[13 + split] = DriveGear(13 + split, MainGear.CRAWL, split, Range.LOW)
    return gears


DRIVE_GEARS: Final[dict[int, DriveGear]] = _number_gears()
DRIVE_GEAR_WITH: Final[dict[tuple[MainGear | None, Split | None, Range | None], DriveGear]] = {
    (gear.main, gear.split, gear.range_): gear for gear in DRIVE_GEARS.values()
}
"""By what the three boxes stand in; None, for a box between two, is of no gear."""


def drive_gear(number: int) -> DriveGear:
    """The gear with this number. KeyError for neutral and anything else outside 1..14."""
    return DRIVE_GEARS[number]


def main_box_only(from_number: int, to_number: int) -> bool:
    """Whether a shift between two gears moves the main box and neither splitter nor range."""
    a, b = DRIVE_GEARS[from_number], DRIVE_GEARS[to_number]
    return a.main is not b.main and a.split is b.split and a.range_ is b.range_
