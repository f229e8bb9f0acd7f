"""Where the plates of the clutch touch: the kink in the engine's speed as the clutch closes.

Before the touch the engine's acceleration changes slowly; from it on the plates' torque grows with
the travel: w = w_0 + a t + k (t - t_k)^2 for t > t_k, until the plates have the same speed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.identify.log_reader import Closing
from meshpoint.kernels.records import Vector
from meshpoint.units import US

BEFORE_S, AFTER_S = 0.05, 0.035
"""The engine's speed is used from so long before the looked-for touch to so long after it."""
STEP: Final = 0.0025
LEAST_BEND_RAD_S: Final = 0.5
"""By the end of that time the plates must have changed the speed by so much beyond its
trajectory."""
MOST_REST_SHARE: Final = 0.12
"""RMS of what is left over the bend."""


def touch_of(closing: Closing, sheet: GearboxSheet) -> float | None:
    """The share of the travel, from open, at which the plates touched; None where the engine's
    speed does not show it."""
    clutch = sheet.clutch
    reach = 2.0 * clutch.kiss_tolerance
    low, high = max(0.0, clutch.kiss_share - reach), min(1.0, clutch.kiss_share + reach)
    best: tuple[float, float, float] | None = None
    for share in np.arange(low, high, STEP):
        found = _bend(closing, float(share))
        if found is not None and (best is None or found[0] < best[0]):
            best = (*found, float(share))
    if best is None:
        return None
    rest, bend, share = best
    if bend < LEAST_BEND_RAD_S or rest > MOST_REST_SHARE * bend:
        return None
    return share if low < share < high - STEP else None


def _bend(closing: Closing, share: float) -> tuple[float, float] | None:
    """RMS of what a kink at this share leaves, and how far it bends the speed (rad/s)."""
    closed = closing.closed
    after = np.flatnonzero(closed >= share)
    if not after.size or after[0] == 0:
        return None
    k = int(after[0])
    part = (share - closed[k - 1]) / (closed[k] - closed[k - 1])
    touch_us = closing.time_us[k - 1] + part * (closing.time_us[k] - closing.time_us[k - 1])
    since = (closing.engine_us - touch_us) * US
    near = (since > -BEFORE_S) & (since < AFTER_S)
    if near.sum() < 7 or (since[near] > 0.0).sum() < 3:
        return None
    at, speed = since[near], closing.engine_rad_s[near]
    bent, rest = kink(at, speed, 0.0)
    bend = abs(bent) * float(at.max()) ** 2
    return float(np.sqrt(np.sum(rest**2) / (at.size - 3))), bend


def kink(at: Vector, speed: Vector, touch: float) -> tuple[float, Vector]:
    """By least squares a line, and from the touch on a parabola above it: the parabola's
    coefficient, and what is left of the speeds."""
    basis = np.stack((np.ones(at.size), at, np.maximum(at - touch, 0.0) ** 2), axis=1)
    solved, *_ = np.linalg.lstsq(basis, speed, rcond=None)
    return float(solved[2]), speed - basis @ solved


def touches(closings: Iterable[Closing], sheet: GearboxSheet) -> Vector:
    """Of all closings that show it."""
    found = (touch_of(closing, sheet) for closing in closings)
    return np.array([share for share in found if share is not None])
