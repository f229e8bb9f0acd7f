"""The law of the main sleeves by a log: what a controller would have learned from its samples and
switches, by the controller's own law."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.estimation.figure import Estimate
from meshpoint.controller.sleeve.law_figures import LawFigures
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS, SLEEVE_OF_MAIN
from meshpoint.testbench.identify.identified import Figure, Identified, untold
from meshpoint.testbench.identify.log_reader import LogContent
from meshpoint.units import BAR, MM, MS

SHOWN: Final = 0.9
"""A log shows a figure whose deviation is less than this share of the data sheet's."""
SDS: Final = 1.96
"""Of a 95 % interval."""
UNITS: Final = {
    "on_delay_s": ("sleeve valve {} on delay", "ms", MS),
    "off_delay_s": ("sleeve valve {} off delay", "ms", MS),
    "contact_s": ("sleeve delay {}, actuator model", "ms", MS),
    "contact_s_per_pa": ("sleeve delay {} per bar of supply", "ms/bar", MS / BAR),
    "detent_n": ("sleeve detent {}", "N", 1.0),
    "stopping_m": ("sleeve stopping distance {}", "mm", MM),
}
"""Of each figure of the law: its name, its unit, and that in SI."""


LAW_FIGURES: Final = frozenset(
    name.format(gear.name.lower()) for gear in MAIN_GEARS for name, _, _ in UNITS.values()
)


def sleeve_law(found: Identified, content: LogContent, sheet: GearboxSheet) -> None:
    """Reports the law of each gear's sleeve, or why not."""
    unlearned = Sleeves(sheet)
    for gear in MAIN_GEARS:
        law, of_sheet = (
            (content.sleeves or unlearned).law_figures(gear),
            unlearned.law_figures(gear),
        )
        why = _why_none(content, gear, law)
        for key, (name, unit, in_si) in UNITS.items():
            before, known = getattr(of_sheet, key), getattr(law, key)
            by_sheet = None if before is None else before.value / in_si
            named = (name.format(gear.name.lower()), unit, by_sheet)
            if known is None:
                untold(found, why or "it cannot be stopped in flight", named)
            elif why or not _is_shown(key, known, before):
                untold(found, why or "no movement in the log shows it", named)
            else:
                value, half = known.value / in_si, SDS * known.sd / in_si
                ends = value - half, value + half
                found.figures.append(Figure(*named[:2], value, *ends, by_sheet, law.movements))
    untold(
        found,
        "temperature is not modelled; re-learned each stroke",
        ("sleeve delay by temperature", "ms/K", None),
    )


def _is_shown(key: str, known: Estimate, before: Estimate | None) -> bool:
    """Whether the log makes a figure surer than the data sheet. A stopping distance is that of the
    latest abort, which comes later the more is known: there, as a share of the distance."""
    if before is None:
        return True
    sheet_sd = before.sd * known.value / before.value if key == "stopping_m" else before.sd
    return known.sd <= SHOWN * sheet_sd


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
