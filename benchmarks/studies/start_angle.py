"""Figure 6.9: what an error of the layshaft's angle costs, by gear."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.studies.start_error import StartError, start_error_study
from meshpoint.gearbox.tables import count, quantity
from meshpoint.units import DEG

THESIS_ANGLE = (0.53, 1.5, 7.0)
"""RMS angle error of tables 6.2 (mean of the two shifts), and its cost by section 7.4."""


@dataclass(frozen=True)
class Settings:
    """The largest error drawn."""

    widest_rad: float = quantity("widest_deg", 0.1, 90.0, DEG)
    points: int = count("points", 2, 1000)


STUDY = start_error_study(
    "start_angle", "Sensitivity: initial angle", "figure 6.9", Settings,
    StartError("theta_rad", "widest_rad", "deg", DEG, THESIS_ANGLE),
)  # fmt: skip
