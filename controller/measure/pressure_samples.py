"""What a pressure sensor with a lag says of the pressure itself.

A sensor with its filter is a first-order lag, tau m' = p - m, so with Taylor's series

    m(t) = m(t - tau) + tau m'(t - tau) + tau^2 / 2 m'' + ... = p(t - tau) + tau^2 / 2 m'' + ...

A sample is therefore the pressure one lag earlier, but for its curvature, which is known from the
two samples before. For 5 ms, samples each 10 ms and a chamber that empties within 60 ms it is 0.04
bar, and its noise adds 5 % to a sample's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

LONGEST_US: Final = 30_000
"""Between two samples; beyond that nothing is said of the way there."""


class PressureSamples(NamedTuple):
    """Samples of a pressure, rising in time."""

    time_us: Vector
    pressure_pa: Vector
    """As measured, gauge."""
    curvature_pa_s2: Vector
    """Second derivative, by the two samples before; 0 where there are none."""

    def before_the_lag(self, lag_s: float) -> tuple[Vector, Vector]:
        """Times (us) and pressures (Pa) in front of a sensor's lag."""
        bent_pa = 0.5 * lag_s * lag_s * self.curvature_pa_s2
        return self.time_us - lag_s * SECOND_US, self.pressure_pa - bent_pa


NO_SAMPLES: Final = PressureSamples(*(np.empty(0) for _ in PressureSamples._fields))


def together(parts: Sequence[PressureSamples]) -> PressureSamples:
    """Samples that follow one another."""
    return PressureSamples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class PressureSampler:
    """Keeps the newest samples, for the curvature at the next."""

    def __init__(self) -> None:
        self._newest: tuple[int, float] | None = None
        self._newest_slope: tuple[int, float] | None = None
        """Over how long, and the slope (Pa/s)."""

    def take(self, samples: Sequence[tuple[int, float]]) -> PressureSamples:
        """One step's samples: time (us) and pressure (Pa)."""
        times_us = [time_us for time_us, _ in samples]
        pressures_pa = [pressure_pa for _, pressure_pa in samples]
        curvatures = [self._curvature(*sample) for sample in samples]
        return PressureSamples(*np.array((times_us, pressures_pa, curvatures), dtype=np.float64))

    def _curvature(self, time_us: int, pressure_pa: float) -> float:
        before, self._newest = self._newest, (time_us, pressure_pa)
        slope_before, self._newest_slope = self._newest_slope, None
        if before is None or not 0 < time_us - before[0] <= LONGEST_US:
            return 0.0
        since_us = time_us - before[0]
        slope = (pressure_pa - before[1]) / (since_us * US)
        self._newest_slope = since_us, slope
        if slope_before is None:
            return 0.0
        return 2.0 * (slope - slope_before[1]) / ((since_us + slope_before[0]) * US)
