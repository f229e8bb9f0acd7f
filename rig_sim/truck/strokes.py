"""How a sleeve moves along its axis: by force against mass and damping, or as a cylinder has it.

In the gap a sleeve of mass m is pushed on by its net force F against damping B (the throttled
exhaust):

    m dv/dt = F - B v:   x = x_0 + v_e t + (v_0 - v_e) (m/B) (1 - exp(-B t / m)),  v_e = F / B

and x_0 + v_0 t + F t^2 / 2m without damping: from rest 1 mm at 1 kN and 3 kg takes 2.45 ms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from meshpoint.rig_sim.records import Floats
from meshpoint.units import SECOND_US

SLOWEST_M_S: Final = 1e-3
STROKE_ROOT_S: Final = 1e-10


@dataclass(frozen=True)
class Push:
    """What moves the sleeve: force, mass, damping, and the speed it starts with."""

    force_n: float
    mass_kg: float
    damping_nsm: float
    speed_m_s: float

    def way_m(self, t: float) -> float:
        """Distance after a time t, s."""
        if self.damping_nsm <= 0.0:
            return (self.speed_m_s + 0.5 * self.force_n / self.mass_kg * t) * t
        settle_s = self.mass_kg / self.damping_nsm
        end_m_s = self.force_n / self.damping_nsm
        share = -math.expm1(-t / settle_s)
        return end_m_s * t + (self.speed_m_s - end_m_s) * settle_s * share

    def time_s(self, way_m: float) -> float:
        """When a distance has been gone; never, where the push is too weak."""
        if way_m <= 0.0:
            return 0.0
        if max(self.force_n, 0.0) == 0.0 and self.damping_nsm > 0.0:
            return math.inf
        if self.force_n <= 0.0 and self.speed_m_s < SLOWEST_M_S:
            return math.inf
        low, high = 0.0, 1e-3
        while self.way_m(high) < way_m:
            low, high = high, 2.0 * high
            if high > 10.0:
                return math.inf
        while high - low > STROKE_ROOT_S:
            middle = 0.5 * (low + high)
            if self.way_m(middle) < way_m:
                low = middle
            else:
                high = middle
        return high


@dataclass(frozen=True)
class PushedStroke:
    """A movement by force, up to its end position."""

    since_us: float
    end_us: float
    from_m: float
    to_m: float
    push: Push

    def at(self, time_us: float) -> float:
        """Distance from neutral, m."""
        if time_us >= self.end_us:
            return self.to_m
        t = max(time_us - self.since_us, 0.0) / SECOND_US
        return min(self.from_m + self.push.way_m(t), self.to_m)


@dataclass(frozen=True)
class SampledStroke:
    """A movement given by samples, as the cylinder's equations produce it."""

    since_us: float
    end_us: float
    to_m: float
    step_us: float
    samples_m: Floats

    def at(self, time_us: float) -> float:
        """Distance from neutral, m."""
        if time_us >= self.end_us:
            return self.to_m
        place = max(time_us - self.since_us, 0.0) / self.step_us
        index = min(int(place), len(self.samples_m) - 2)
        share = min(place - index, 1.0)
        return float(
            self.samples_m[index] + share * (self.samples_m[index + 1] - self.samples_m[index])
        )
