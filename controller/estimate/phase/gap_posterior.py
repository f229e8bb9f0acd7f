"""Where the gap of a gear lies, by all measurements of its tooth in mesh: Bayes' rule on a grid.

In mesh a tooth is somewhere in its gap, most of the time at one of the two flanks, whichever the
torque presses it to. On a driveline that swings it changes flanks again and again and never lies
still for long, but the measurements of it pile up at two phases one backlash apart. The density of
a measurement at phase phi from the middle of the gap, b the backlash:

    p(phi) = (1 - e) (f u N(phi - b/2) + f (1 - u) N(phi + b/2) + (1 - f) U(|phi| < b/2) * N) + e / pitch

N is a measurement's own error, f the share of measurements at a flank, u the share of those at the
upper one, and e that of measurements gone astray by an impact. Measurements at one flank alone leave
two middles alike. What decides then is that the slip at which tooth and flank met has carried the
tooth to the flank on its side: u is near 1 or 0 for the first measurements, and 1/2 for all others.
"""  # noqa: E501

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

CELLS: Final = 300
"""Middles of the gap that are compared, over a pitch."""
MEASUREMENT_SHARES: Final = (
    *(0.1, 0.12, 0.14, 0.17, 0.2, 0.24, 0.28, 0.34, 0.4, 0.48, 0.6),
    *(0.8, 1.1, 1.5, 2.0, 2.8, 4.0, 6.0),
)
"""Standard deviations of measurements, in backlashes; one counts with the next larger of them, and
with none it says nothing of a gap."""
AT_FLANK: Final = 0.6
ASTRAY: Final = 0.02
CARRIED: Final = 0.98
"""Share of first measurements at a flank that are at the one to which the slip carried the
tooth."""
INDEPENDENT: Final = 0.25
"""Weight of one measurement: they follow each other every 10 ms, sooner than a tooth moves on, so
that only one in four adds something of its own."""
NEAR_SHARE: Final = 0.3
"""Middles within this of the likeliest one, in backlashes, are the same."""
BEYOND_SD: Final = 2.5
"""Of measurements at a flank, one in 160 lies further beyond it by chance, in its standard
deviations; more do where the gap is wider than the sheet says, or elsewhere."""


class GapMiddle(NamedTuple):
    """The middle of a gear's gap."""

    raw_rad: float
    """Its raw phase, within a pitch."""
    sd_rad: float
    """Standard deviation: of all middles that are possible, and of what none of them explains."""


@lru_cache(maxsize=8)
def _distances_rad(pitch_rad: float) -> Vector:
    """Distance of each cell from the first, at most half a pitch. Kept, not to be changed."""
    away = pitch_rad / CELLS * np.arange(CELLS)
    return away - pitch_rad * (away > pitch_rad / 2.0)


@lru_cache(maxsize=8)
def log_densities(pitch_rad: float, backlash_rad: float) -> dict[tuple[int, int], Vector]:
    """What a measurement adds to the logarithm of a middle in each cell beyond its own: by the
    flank to which the slip carried the tooth (0: not known), and the index of its standard
    deviation. Kept, as it takes some milliseconds and is the same for all gears of a gearbox."""
    away, tables = _distances_rad(pitch_rad).tolist(), {}
    for flank, upper in ((0, 0.5), (1, CARRIED), (-1, 1.0 - CARRIED)):
        weight = INDEPENDENT if flank == 0 else 1.0
        for kind, share in enumerate(MEASUREMENT_SHARES):
            sd = share * backlash_rad
            density = [_density(-off, sd, backlash_rad, pitch_rad, upper) for off in away]
            tables[flank, kind] = weight * np.log(density)
    return tables


def _density(phase: float, sd: float, b: float, pitch_rad: float, upper: float) -> float:
    flanks = math.fsum(
        share * math.exp(-0.5 * ((phase - side * b / 2.0) / sd) ** 2)
        for side, share in ((-1.0, 1.0 - upper), (1.0, upper))
    ) / (sd * math.sqrt(2.0 * math.pi))
    ends = [math.erf((phase + side * b / 2.0) / (sd * math.sqrt(2.0))) for side in (1.0, -1.0)]
    between = 0.5 * (ends[0] - ends[1]) / b
    inside = AT_FLANK * flanks + (1.0 - AT_FLANK) * between
    return (1.0 - ASTRAY) * inside + ASTRAY / pitch_rad


class GapPosterior:
    """What the measurements at one gear show of the middle of its gap."""

    def __init__(self, pitch_rad: float, backlash_rad: float) -> None:
        self._pitch_rad, self._backlash_rad = pitch_rad, backlash_rad
        self._log: Vector = np.zeros(CELLS)
        self._measurements = np.zeros((len(MEASUREMENT_SHARES), CELLS))
        """How many measurements of each standard deviation there were in each cell."""
        self._beside_rad = 0.0
        """Sum of how far they lay from the middles of their cells."""

    def measure(self, raw_rad: float, sd_rad: float, flank: int = 0) -> bool:
        """One measurement at the gear in mesh: its raw phase and standard deviation. flank: +1 or
        -1, that to which the slip has just carried the tooth; 0: not known. Whether it counts: it
        is not too vague."""
        share = sd_rad / self._backlash_rad
        if share > MEASUREMENT_SHARES[-1]:
            return False
        kind = next(k for k, largest in enumerate(MEASUREMENT_SHARES) if share <= largest)
        nearest = round(raw_rad / self._pitch_rad * CELLS)
        cell = nearest % CELLS
        self._measurements[kind, cell] += 1.0
        self._beside_rad += raw_rad - nearest * self._pitch_rad / CELLS
        # A middle in cell k explains the measurement by the density of its distance from there.
        densities = log_densities(self._pitch_rad, self._backlash_rad)
        self._log += np.roll(densities[flank, kind], cell)
        return True

    def middle(self) -> GapMiddle | None:
        """The likeliest middle of the gap; None before the first measurement."""
        count = float(self._measurements.sum())
        if count == 0.0:
            return None
        weight = np.exp(self._log - self._log.max())
        weight /= weight.sum()
        best = int(weight.argmax())
        away = np.roll(_distances_rad(self._pitch_rad), best)
        near = np.abs(away) < NEAR_SHARE * self._backlash_rad
        off = float((weight * away)[near].sum()) / float(weight[near].sum())
        # Of all middles, not of those near the likeliest alone: another flank may be the right one.
        variance = float(weight @ (away - off) ** 2) + self._unexplained_rad2(away)
        off += self._beside_rad / count
        return GapMiddle(best * self._pitch_rad / CELLS + off, math.sqrt(variance))

    def _unexplained_rad2(self, away: Vector) -> float:
        """Mean square of how far measurements lie outside a gap from whose middle the cells are so
        far away, further from a flank than chance carries them."""
        reach = self._backlash_rad * (0.5 + BEYOND_SD * np.array(MEASUREMENT_SHARES))
        outside = np.maximum(0.0, np.abs(away) - reach[:, np.newaxis])
        return float((self._measurements * outside**2).sum() / self._measurements.sum())
