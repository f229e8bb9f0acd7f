"""Figure 6.9: what an error of the layshaft's angle costs, by gear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshpoint.gearbox.tables import count, quantity
from meshpoint.testbench.studies.by_gear import by_gear
from meshpoint.testbench.studies.record import Finding, Given, Study
from meshpoint.testbench.studies.sensitivity import Release
from meshpoint.testbench.studies.simulated import DEG

THESIS = (0.53, 1.5, 7.0)
"""RMS angle error of tables 6.2 (mean of the two shifts), and its cost by section 7.4."""


@dataclass(frozen=True)
class Settings:
    """The largest error drawn."""

    widest_rad: float = quantity("widest_deg", 0.1, 90.0, DEG)
    points: int = count("points", 2, 1000)


def _effect(release: Release, error_deg: float) -> float:
    state = release.state
    return release.angle_error_pct(
        state=state._replace(theta_rad=state.theta_rad + error_deg * DEG)
    )


def _conclude(given: Given[Settings]) -> Finding:
    errors = np.linspace(0.0, given.own.widest_rad / DEG, given.own.points)
    return by_gear(given, "start_angle", "deg", errors, _effect, THESIS)


STUDY = Study("start_angle", "Sensitivity: initial angle", ("figure 6.9",), Settings, _conclude)
