"""Angles and speeds between shafts, gears and sleeves, all in one sign convention.

i_split = omega_LS / omega_IS      (thesis 3.1 writes it the other way round)
i_gear  = omega_gear / omega_LS    (thesis 2.1)
slip    = omega_gear - omega_MS    (thesis 2.1: delta = -slip)
phase   = angle of a gear tooth from the middle of the sleeve's gap, d phase/dt = slip
"""

from __future__ import annotations

import math
from collections.abc import Sequence


def are_finite(numbers: Sequence[float]) -> bool:
    """Whether no number is NaN or infinite. Numbers so large that their sum overflows count as not
    finite, too: they come from an estimate that has diverged."""
    return math.isfinite(sum(numbers))


def wrap_to_pitch(angle_rad: float, pitch_rad: float) -> float:
    """The angle wrapped to [-pitch/2, pitch/2)."""
    return angle_rad - pitch_rad * math.floor(angle_rad / pitch_rad + 0.5)


def slip_rad_s(i_gear: float, omega_layshaft_rad_s: float, omega_main_rad_s: float) -> float:
    """Gear speed less sleeve speed; positive: the gear turns faster."""
    return i_gear * omega_layshaft_rad_s - omega_main_rad_s


def raw_phase_rad(i_gear: float, theta_layshaft_rad: float, theta_main_rad: float) -> float:
    """Gear angle less sleeve angle (rad) from the counted teeth; differs from the phase by a
    constant, the phase reference of the gear."""
    return i_gear * theta_layshaft_rad - theta_main_rad
