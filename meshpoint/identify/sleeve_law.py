"""What a log says of the main sleeves' valves: what a controller would have learned from the
sleeves' samples and switches, by the controller's own law, with intervals that allow for what that
law leaves out."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from meshpoint.controller.estimate.figures import Estimate
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.controller.sleeve.stroke import LawFigures
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS, SLEEVE_OF_MAIN
from meshpoint.identify.identified import Figure, Identified, untold
from meshpoint.identify.log_reader import LogContent
from meshpoint.units import MS

SHOWN: Final = 0.9
"""A log shows a figure whose deviation is less than this share of the data sheet's."""
SDS: Final = 1.96
"""Of a 95 % interval."""


class _Named(NamedTuple):
    """A figure of the law, in ms."""

    key: str
    name: str
    left_out_s: float
    """Standard deviation of what the law leaves out. However many movements there are, it stays:
    friction at rest, moving mass, reach of the detents and the pressure sensor's offset differ from
    the data sheet, and each makes a valve seem slower or faster. Measured against the rig: study
    `identify`."""


VALVE_FIGURES: Final = (
    _Named("on_delay_s", "sleeve valve {} on delay", 1.05 * MS),
    _Named("off_delay_s", "sleeve valve {} off delay", 0.65 * MS),
)
LAW_FIGURES: Final = frozenset(
    one.name.format(gear.name.lower()) for gear in MAIN_GEARS for one in VALVE_FIGURES
)
NEVER_TOLD: Final = (
    ("sleeve delay by temperature", "ms/K", "temperature is not modelled; re-learned each stroke"),
    (
        "sleeve delay per bar of supply",
        "ms/bar",
        "a governed supply hardly changes, and what the samples say of it is less sure than the "
        "data sheet",
    ),
    (
        "sleeve detent",
        "N",
        "position samples do not tell its force from its reach and from friction at rest",
    ),
)


def sleeve_law(found: Identified, content: LogContent, sheet: GearboxSheet) -> None:
    """Reports the delays of each gear's valve, or why not."""
    unlearned = Sleeves(sheet)
    for gear in MAIN_GEARS:
        law = (content.sleeves or unlearned).law_figures(gear)
        of_sheet = unlearned.law_figures(gear)
        why = _why_none(content, gear, law)
        for one in VALVE_FIGURES:
            before: Estimate = getattr(of_sheet, one.key)
            known: Estimate = getattr(law, one.key)
            sd_s = math.hypot(known.sd, one.left_out_s)
            named = one.name.format(gear.name.lower()), "ms", before.value / MS
            if why or sd_s > SHOWN * before.sd:
                untold(found, why or "no movement in the log shows it", named)
                continue
            value, half = known.value / MS, SDS * sd_s / MS
            ends = value - half, value + half
            found.figures.append(Figure(*named[:2], value, *ends, named[2], law.movements))
    for name, unit, why in NEVER_TOLD:
        untold(found, why, (name, unit, None))


def _why_none(content: LogContent, gear: MainGear, law: LawFigures) -> str:
    """Why the log shows nothing of a sleeve's law; empty where it does."""
    if not content.messages["ValveCommand"]:
        return "no valve commands in the log"
    if not content.moved:
        return "no main sleeve moved in the log"
    if SLEEVE_OF_MAIN[gear].sleeve not in content.moved:
        return "this sleeve did not move in the log"
    if content.inexact:
        return "its valves were switched at once, not at a commanded time"
    return "" if law.movements else "none of its movements went by the law"
