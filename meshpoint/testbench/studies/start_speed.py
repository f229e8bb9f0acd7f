"""Figure 6.10: what an error of the layshaft's speed costs, by gear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshpoint.gearbox.tables import count, quantity
from meshpoint.testbench.studies.by_gear import by_gear
from meshpoint.testbench.studies.record import Finding, Given, Study
from meshpoint.testbench.studies.sensitivity import Release
from meshpoint.testbench.studies.simulated import RPM

THESIS = (4.32, 4.0, 18.0)
"""RMS speed error of table 6.1 (mean of the two shifts), and its cost by section 7.4."""


@dataclass(frozen=True)
class Settings:
    """The largest error drawn."""

    widest_rad_s: float = quantity("widest_rpm", 0.1, 500.0, RPM)
    points: int = count("points", 2, 1000)


def _effect(release: Release, error_rpm: float) -> float:
    state = release.state
    return release.angle_error_pct(
        state=state._replace(omega_rad_s=state.omega_rad_s + error_rpm * RPM)
    )


def _conclude(given: Given[Settings]) -> Finding:
    errors = np.linspace(0.0, given.own.widest_rad_s / RPM, given.own.points)
    return by_gear(given, "start_speed", "rpm", errors, _effect, THESIS)


STUDY = Study("start_speed", "Sensitivity: initial speed", ("figure 6.10",), Settings, _conclude)
