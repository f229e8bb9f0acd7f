"""What an error in the layshaft's state at the start costs: shared by figures 6.9 and 6.10."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.studies.by_gear import by_gear
from benchmarks.studies.record import Finding, Given, Study
from benchmarks.studies.sensitivity import Release


@dataclass(frozen=True)
class StartError:
    """An error in one quantity of the state."""

    of_state: str
    """Its field in the layshaft's state."""
    widest: str
    """The study's setting that holds the largest error drawn (SI)."""
    unit: str
    si: float
    """From the figure's unit to SI."""
    thesis: tuple[float, float, float]
    """The thesis's filter's RMS error, and what that costs in % of pitch for the easiest and the
    hardest gear."""


def start_error_study(
    name: str, title: str, figure: str, settings: type[Any], error: StartError
) -> Study[Any]:
    """The study of such an error."""

    def effect(release: Release, size: float) -> float:
        state = release.state
        wrong = getattr(state, error.of_state) + size * error.si
        return release.angle_error_pct(state=state._replace(**{error.of_state: wrong}))

    def conclude(given: Given[Any]) -> Finding:
        widest = getattr(given.own, error.widest) / error.si
        sizes = np.linspace(0.0, widest, given.own.points)
        return by_gear(given, name, error.unit, sizes, effect, error.thesis)

    return Study(name, title, (figure,), settings, conclude)
