"""Figure 6.10: what an error of the layshaft's speed costs, by gear."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.studies.start_error import StartError, start_error_study
from meshpoint.gearbox.tables import count, quantity
from meshpoint.units import RPM

THESIS_SPEED = (4.32, 4.0, 18.0)
"""RMS speed error of table 6.1 (mean of the two shifts), and its cost by section 7.4."""


@dataclass(frozen=True)
class Settings:
    """The largest error drawn."""

    widest_rad_s: float = quantity("widest_rpm", 0.1, 500.0, RPM)
    points: int = count("points", 2, 1000)


STUDY = start_error_study(
    "start_speed", "Sensitivity: initial speed", "figure 6.10", Settings,
    StartError("omega_rad_s", "widest_rad_s", "rpm", RPM, THESIS_SPEED),
)  # fmt: skip
