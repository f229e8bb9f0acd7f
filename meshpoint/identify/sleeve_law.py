"""What a log says of the valves of sleeves with dog teeth: what a controller would have learned
from the sleeves' samples and switches, by the controller's own law, with intervals that allow for
what that law leaves out."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from meshpoint.controller.estimate.figures import Estimate
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.controller.sleeve.stroke import LawFigures
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import SIDE_OF, DogGear
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
    one.name.format(gear.name.lower()) for gear in SIDE_OF for one in VALVE_FIGURES
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

OF_A_DOG_SPLITTER: Final = (
    (
        "splitter tooth offset",
        "deg",
        "it is counted from a tooth of either sensor wheel, and each run counts them anew",
    ),
    (
        "splitter backlash",
        "deg",
        "a shaft that goes from flank to flank shows it in one with the play of the wheel pair",
    ),
)


def sleeve_law(found: Identified, content: LogContent, sheet: GearboxSheet) -> None:
    """Reports the delays of each gear's valve, or why not."""
    unlearned = Sleeves(sheet)
    for gear in sheet.dog_gears:
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
    for name, unit, why in (*NEVER_TOLD, *(OF_A_DOG_SPLITTER if sheet.has_dog_splitter else ())):
        untold(found, why, (name, unit, None))


def _why_none(content: LogContent, gear: DogGear, law: LawFigures) -> str:
    """Why the log shows nothing of a sleeve's law; empty where it does."""
    if not content.messages["ValveCommand"]:
        return "no valve commands in the log"
    if not content.moved:
        return "no main sleeve moved in the log"
    if SIDE_OF[gear].sleeve not in content.moved:
        return "this sleeve did not move in the log"
    if content.inexact:
        return "its valves were switched at once, not at a commanded time"
    return "" if law.movements else "none of its movements went by the law"
