"""The brake pressure sensor's offset, learned while the brake's chamber is empty.

With the valve off for long enough the chamber is at the pressure of the air around, so whatever the
sensor shows above that is its offset. Every shift ends with seconds of it.
"""

from __future__ import annotations

import math
from typing import Final

REST_TIME_CONSTANTS: Final = 8.0
"""A chamber has emptied this many time constants after its valve went off: to 1 / 3000 of its
pressure."""
FORGET: Final = 0.998
"""Weight of the past with each new sample: 5 s at 10 ms, in which an offset changes little."""
LEAST_SAMPLES: Final = 10.0
MOST_PA: Final = 1.5e5
"""No sensor is off by more than this: more is pressure, of a valve that is stuck."""


class PressureZero:
    """What the sensor shows of an empty chamber."""

    def __init__(self, time_constant_s: float) -> None:
        self._wait_us = 1e6 * REST_TIME_CONSTANTS * time_constant_s
        self._driven_us = -math.inf
        self._weight = self._mean_pa = 0.0

    def take(self, time_us: float, gauge_pa: float, driven: bool) -> float:
        """One sample, gauge; driven: the valve is on, or will be. Returns the pressure with the
        offset taken out."""
        if driven:
            self._driven_us = time_us
        elif time_us - self._driven_us > self._wait_us and abs(gauge_pa) <= MOST_PA:
            self._weight = FORGET * self._weight + 1.0
            self._mean_pa += (gauge_pa - self._mean_pa) / self._weight
        return gauge_pa - self.offset_pa

    @property
    def offset_pa(self) -> float:
        """The sensor's offset; 0 before some samples have shown it."""
        return self._mean_pa if self._weight >= LEAST_SAMPLES else 0.0
