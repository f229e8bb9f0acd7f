"""Which shifts a run cycles through, by name or as a list."""

from __future__ import annotations

import argparse
from typing import Final

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, main_box_only
from meshpoint.gearbox.tables import TableError
from meshpoint.rig_sim.settings import Preset

Pairs = tuple[tuple[int, int], ...]

UPSHIFTS: Final[Pairs] = ((8, 10), (10, 12))
MAIN_BOX: Final[Pairs] = tuple(
    (from_, to) for from_ in DRIVE_GEARS for to in DRIVE_GEARS if main_box_only(from_, to)
)
"""Every change of the main box alone, up and down, in both halves of the range."""
MIXED: Final[Pairs] = (
    (8, 10),
    (10, 8),
    (7, 8),
    (12, 11),
    (8, 9),
    (9, 8),
    (10, 12),
    (6, 7),
    (7, 6),
    (12, 10),
    (3, 5),
    (5, 3),
    (2, 4),
    (4, 1),
)
"""Up and down by main box, splitter and range, as in driving."""
SCHEDULES: Final[dict[str, Pairs]] = {"upshifts": UPSHIFTS, "main-box": MAIN_BOX, "mixed": MIXED}


def pairs(text: str) -> Pairs:
    """An argparse type: a name, or a list as `8-10,10-8,7-8`."""
    if text in SCHEDULES:
        return SCHEDULES[text]
    parsed = []
    for item in text.split(","):
        before, _, after = item.partition("-")
        try:
            from_, to = int(before), int(after)
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"{item!r}, allowed is FROM-TO, as 8-10, or one of {', '.join(SCHEDULES)}"
            ) from None
        if from_ not in DRIVE_GEARS or to not in DRIVE_GEARS or from_ == to:
            raise argparse.ArgumentTypeError(f"{item!r}, allowed are two different gears of 1..14")
        parsed.append((from_, to))
    return tuple(parsed)


def check_preset(chosen: Pairs, sheet: GearboxSheet, preset: Preset) -> None:
    """TableError where the rig cannot make a shift: the preset thesis has no engine, and its
    splitter and range do not follow their valves."""
    if preset is not Preset.THESIS:
        return
    for from_, to in chosen:
        up = sheet.overall_ratio(DRIVE_GEARS[to]) < sheet.overall_ratio(DRIVE_GEARS[from_])
        if not (up and main_box_only(from_, to)):
            raise TableError(
                f"--pairs {from_}-{to}: the preset thesis makes upshifts of the main box alone, "
                "as 8-10; --preset truck makes all"
            )
