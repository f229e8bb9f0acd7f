"""Where the plates of the clutch touch, by the input shaft that they take along.

The input shaft, released, slows evenly. From the touch on the plates' torque grows with the travel,
so its speed is w = w_0 + a t + k (t - t_k)^2 for t > t_k, until it is near the engine's. It has a
small part of the engine's inertia: it shows the touch where the engine's speed does not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from meshpoint.identify.clutch_fit import kink
from meshpoint.kernels.records import Vector
from meshpoint.units import TURN, US

BEFORE_US: Final = 80_000
LEAST_RISE_RAD_S: Final = 15.0
"""An input shaft that is taken along by less shows no touch."""
USED_RISE: Final = 0.6
"""This share of the rise is used: after it the plates have nearly one speed."""
STEP: Final = 0.004
ENDS: Final = (0.05, 0.85)
LEAST_SAMPLES: Final = 12
LEAST_AFTER: Final = 4


def kiss_points(
    closings: Iterable[Sequence[tuple[int, float]]], edges_us: Sequence[int], teeth: int
) -> Vector:
    """The share of the travel, from open, at which the plates touched, of each closing that shows
    it. closings: samples of the clutch (us, share); edges_us: rising edges of the input wheel."""
    times = np.array(edges_us, dtype=np.float64)
    middles, gaps = 0.5 * (times[1:] + times[:-1]), np.diff(times)
    speeds = TURN / teeth / (gaps * US)
    found = []
    for closing in closings:
        at_us, closed = np.array(closing, dtype=np.float64).T
        near = (middles > at_us[0] - BEFORE_US) & (middles < at_us[-1])
        share = _kiss(at_us, closed, middles[near], speeds[near])
        if share is not None:
            found.append(share)
    return np.array(found)


def _kiss(at_us: Vector, closed: Vector, edge_us: Vector, speed: Vector) -> float | None:
    if speed.size < LEAST_SAMPLES:
        return None
    rate, offset = np.polyfit(at_us - at_us[0], closed, 1)
    share = offset + rate * (edge_us - at_us[0])
    smooth = np.convolve(speed, np.ones(5) / 5.0, "same")[2:-2]
    least = int(np.argmin(smooth)) + 2
    rise = float(np.median(speed[-8:])) - smooth[least - 2]
    if rise < LEAST_RISE_RAD_S or least < LEAST_AFTER:
        return None
    over = np.flatnonzero(smooth[least - 2 :] > smooth[least - 2] + USED_RISE * rise)
    end = least + (int(over[0]) if over.size else smooth.size)
    x, w = share[:end], speed[:end]
    best: tuple[float, float] | None = None
    for kiss in np.arange(*ENDS, STEP):
        if np.count_nonzero(x > kiss) < LEAST_AFTER:
            break
        bent, left = kink(x, w, float(kiss))
        rest = float(np.sum(left**2))
        if bent > 0.0 and (best is None or rest < best[0]):
            best = rest, float(kiss)
    return None if best is None else best[1]
