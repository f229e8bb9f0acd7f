"""What a shaft does next that swings with one frequency, from the guard's own speeds.

On shafts that twist and have no backlash the main shaft swings so in neutral, a time t after its
newest speed:

    v(t) = m + exp(-d t) (p cos w t + q sin w t)

Which frequency and which decay nobody knows. If by some the newest speeds are met, each to within
what a speed may be wrong by, the bound is what all swings do that are about as near to them. It
is narrower than how fast and how far the shaft has been, since a swing that has just turned round
is not taken to turn round again at once; and wider where a swing has begun that has not reached its
ends yet. A shaft that rattles in its backlash meets none of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.units import TURN

SPAN_US: Final = 85_000
"""The newest speeds are those of so long: about a period of the slowest swings that are wide."""
LEAST_SPEEDS: Final = 8
"""Fewer show no frequency."""
LEAST_US: Final = 60_000
"""Nor do those of a shorter time."""
LEAST_SQUARE: Final = 1e-6
"""Speeds at such times that sine and cosine go together to within this, of some units, do not show
which of them it is."""
SWINGS_RAD_S: Final = 2.0
"""Speeds that differ by less (19 rpm) show no swing that is worth a bound of its own."""
ERROR_RAD_S: Final = 0.4
"""A speed may be wrong by so much: pitch errors, and edges' times."""
ERROR_SHARE: Final = 0.06
"""And by this share of half of the way the swing makes: it is the mean over some teeth, and no
swing is quite of one frequency."""
MEASURED_OVER_S: Final = 0.02
"""A speed is the mean over so much at most (`own_speed.MEASURED_US` and a tooth): a swing is wider
than the speeds show."""
FREQUENCIES: Final = tuple(TURN * (5.0 + 0.5 * k) for k in range(41))
"""Swings of 5 to 25 Hz are tried (rad/s). Slower than the first a swing is as fast as it has been
for as long as it is asked for; of faster ones a cycle has too few speeds."""
DECAYS: Final = (0.0, 4.0, 9.0, 14.0)
"""Swings are tried from one that does not die away to one that is half as wide after 50 ms, 1/s."""
NEAR: Final = 1.5
"""Swings bound the shaft, too, whose distance from the speeds is this multiple of what these may be
wrong by: between two that are tried lie nearer ones."""
PARTS: Final = 5
"""The bound is looked for at this many times."""


class OneSwing(NamedTuple):
    """A swing that meets the speeds; times from the newest of them on."""

    frequency: float
    decay: float
    middle: float
    cosine: float
    sine: float

    def at(self, ahead_s: float) -> float:
        """The speed (rad/s) after so long; of its own, not the mean that is measured."""
        turned, half = self.frequency * ahead_s, 0.5 * self.frequency * MEASURED_OVER_S
        swing = self.cosine * math.cos(turned) + self.sine * math.sin(turned)
        return self.middle + math.exp(-self.decay * ahead_s) * swing * half / math.sin(half)


def between(
    speeds: Sequence[ShaftSpeed], from_us: float, until_us: float
) -> tuple[float, float] | None:
    """Least and greatest speed (rad/s) between two times; None where the shaft does not swing so,
    or has not for long enough. speeds: the newest last."""
    if not speeds:
        return None
    newest_us = speeds[-1].time_us
    recent = [speed for speed in speeds if speed.time_us >= newest_us - SPAN_US]
    if len(recent) < LEAST_SPEEDS or newest_us - recent[0].time_us < LEAST_US:
        return None
    omegas = [speed.omega_rad_s for speed in recent]
    way = max(omegas) - min(omegas)
    if way < SWINGS_RAD_S:
        return None
    error = ERROR_RAD_S + ERROR_SHARE * 0.5 * way
    times_s = [(speed.time_us - newest_us) * 1e-6 for speed in recent]
    first_s, last_s = (1e-6 * (time_us - newest_us) for time_us in (from_us, until_us))
    ahead_s = [first_s + (last_s - first_s) * k / (PARTS - 1) for k in range(PARTS)]
    met = [each.at(later_s) for each in _that_meet(times_s, omegas, error) for later_s in ahead_s]
    return (min(met) - error, max(met) + error) if met else None


def _that_meet(times_s: list[float], omegas: list[float], error: float) -> list[OneSwing]:
    """The swings that are near to the speeds; none where no one is nowhere further from them than
    the error."""
    found, is_met = [], False
    for decay in DECAYS:
        faded = [(t, math.exp(-decay * t), v) for t, v in zip(times_s, omegas, strict=True)]
        for frequency in FREQUENCIES:
            swing, off = _nearest(faded, frequency, decay)
            is_met = is_met or off <= error
            if off <= NEAR * error:
                found.append(swing)
    return found if is_met else []


def _nearest(
    faded: list[tuple[float, float, float]], frequency: float, decay: float
) -> tuple[OneSwing, float]:
    """The swing of a frequency and a decay that is nearest to the speeds by least squares, and how
    far it is from them at most. faded: of each speed its time (s), what the swing is over that at
    time 0, and the speed (rad/s)."""
    cosines, sines = [], []
    c = s = v = cc = ss = cs = cv = sv = 0.0
    for time_s, fade, omega in faded:
        turned = frequency * time_s
        x, y = fade * math.cos(turned), fade * math.sin(turned)
        cosines.append(x)
        sines.append(y)
        c, s, v = c + x, s + y, v + omega
        cc, ss, cs = cc + x * x, ss + y * y, cs + x * y
        cv, sv = cv + x * omega, sv + y * omega
    count = len(faded)
    c, s, v = c / count, s / count, v / count
    cc, ss, cs = cc - count * c * c, ss - count * s * s, cs - count * c * s
    cv, sv = cv - count * c * v, sv - count * s * v
    square = cc * ss - cs * cs
    if square < LEAST_SQUARE:
        return OneSwing(frequency, decay, v, 0.0, 0.0), math.inf
    p, q = (cv * ss - sv * cs) / square, (cc * sv - cs * cv) / square
    middle = v - p * c - q * s
    off = max(
        abs(middle + p * x + q * y - omega)
        for x, y, (_, _, omega) in zip(cosines, sines, faded, strict=True)
    )
    return OneSwing(frequency, decay, middle, p, q), off
