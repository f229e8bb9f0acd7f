"""What identification finds: figures with intervals, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from meshpoint.identify.held_out import HeldOut
from meshpoint.identify.log_reader import LogContent
from meshpoint.identify.tooth_fit import ToothFit

LEAST_RUNS: Final = 5


@dataclass(frozen=True)
class Figure:
    """One quantity. All values in `unit`; None where the log does not show it."""

    name: str
    unit: str
    value: float | None
    low: float | None
    high: float | None
    """Ends of the 95 % interval."""
    sheet: float | None
    """What the data sheet says; None where it says nothing."""
    samples: int
    """Runs, strokes or closings that it comes from."""
    why: str = ""
    """Why it is not reported."""


@dataclass
class Identified:
    """The result."""

    figures: list[Figure] = field(default_factory=list)
    held_out: list[HeldOut] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    omega_ref_rad_s: float = 0.0
    """Layshaft speed at which torque and drag are reported."""
    supply_pa: float = 0.0
    """Mean absolute supply pressure at which the sleeves' delays are reported."""
    refused: str = ""
    """Why brake, drag and inertias are not reported although there are runs enough: no equations of
    motion fit them. Empty: they fit."""
    teeth: dict[str, ToothFit] = field(default_factory=dict)

    def figure(self, name: str) -> Figure:
        """By its name. KeyError where there is none."""
        for figure in self.figures:
            if figure.name == name:
                return figure
        raise KeyError(name)

    def value(self, name: str) -> float | None:
        """Its value; None where it is not reported."""
        return self.figure(name).value


def untold(found: Identified, why: str, *names_units: tuple[str, str, float | None]) -> None:
    """Names figures that the log does not show, and why."""
    for name, unit, of_sheet in names_units:
        found.figures.append(Figure(name, unit, None, None, None, of_sheet, 0, why))


def why_no_runs(content: LogContent) -> str:
    """What was missing for runs in neutral."""
    messages = content.messages
    for name, why in (
        ("EdgesLayshaftRise", "no layshaft edges in the log"),
        ("SleevesMain", "no sleeve positions in the log"),
        ("SleevesAux", "no positions of splitter and range in the log"),
        ("GearboxSensors", "no clutch position and pressures in the log"),
    ):
        if not messages[name]:
            return why
    return f"{len(content.runs)} runs in neutral with an open clutch, {LEAST_RUNS} are needed"
