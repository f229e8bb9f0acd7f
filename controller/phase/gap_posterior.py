"""Where the gap of a gear lies, by all measurements of its tooth in mesh: Bayes' rule on a grid.

In mesh a tooth is somewhere in its gap, most of the time at one of the two flanks, whichever the
torque presses it to. On a driveline that swings it changes flanks again and again and never lies
still for long, but the measurements of it pile up at two phases one backlash apart. The density of
a measurement at phase phi from the middle of the gap, b the backlash:

    p(phi) = (1 - e) (f/2 N(phi - b/2) + f/2 N(phi + b/2) + (1 - f) U(|phi| < b/2) * N) + e / pitch

N is a measurement's own error, f the share of measurements at a flank, and e that of measurements
gone astray by an impact. Measurements at one flank alone leave two middles alike, so they decide
nothing.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

CELLS: Final = 300
"""Middles of the gap that are compared, over a pitch."""
MEASUREMENT_SHARES: Final = (0.1, 0.12, 0.14, 0.17, 0.2, 0.24, 0.28)
"""Standard deviations of measurements, in backlashes; one counts with the next larger of them, and
with none it is too vague."""
AT_FLANK: Final = 0.6
ASTRAY: Final = 0.02
INDEPENDENT: Final = 0.25
"""Weight of one measurement: they follow each other every 10 ms, sooner than a tooth moves on, so
that only one in four adds something of its own."""
NEAR_SHARE: Final = 0.3
"""Middles within this of the likeliest one, in backlashes, are the same."""
CERTAIN: Final = 0.97
"""The middle is known where this much of the probability lies at the likeliest one."""
BEYOND_SD: Final = 1.2
"""A measurement lies outside the gap when it is further from a flank than this, in its standard
deviations."""
MOST_OUTSIDE: Final = 0.1
"""Where more than this share of the measurements lie outside, the gap cannot be there. Of
measurements at a flank 12 % do by chance."""


class GapMiddle(NamedTuple):
    """The middle of a gear's gap."""

    raw_rad: float
    """Its raw phase, within a pitch."""
    sd_rad: float


def _distances_rad(pitch_rad: float) -> Vector:
    """Distance of each cell from the first, at most half a pitch."""
    away = pitch_rad / CELLS * np.arange(CELLS)
    return away - pitch_rad * (away > pitch_rad / 2.0)


@lru_cache(maxsize=8)
def log_densities(pitch_rad: float, backlash_rad: float) -> list[Vector]:
    """For measurements of each standard deviation, what one adds to the logarithm of a middle in
    each cell. Kept, as it takes some milliseconds and is the same for all gears of a gearbox."""
    phases, tables = _distances_rad(pitch_rad).tolist(), []
    for share in MEASUREMENT_SHARES:
        sd = share * backlash_rad
        density = [_density(phase, sd, backlash_rad, pitch_rad) for phase in phases]
        tables.append(INDEPENDENT * np.log(density))
    return tables


def _density(phase: float, sd: float, b: float, pitch_rad: float) -> float:
    flanks = sum(math.exp(-0.5 * ((phase - side * b / 2.0) / sd) ** 2) for side in (-1.0, 1.0)) / (
        2.0 * sd * math.sqrt(2.0 * math.pi)
    )
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

    def measure(self, raw_rad: float, sd_rad: float) -> None:
        """One measurement at the gear in mesh: its raw phase and standard deviation."""
        share = sd_rad / self._backlash_rad
        if share > MEASUREMENT_SHARES[-1]:
            return
        kind = next(k for k, largest in enumerate(MEASUREMENT_SHARES) if share <= largest)
        cell = round(raw_rad / self._pitch_rad * CELLS) % CELLS
        self._measurements[kind, cell] += 1.0
        # A middle in cell k explains the measurement by the density of its distance from there; the
        # density is the same on either side.
        densities = log_densities(self._pitch_rad, self._backlash_rad)
        self._log += np.roll(densities[kind], cell)

    def middle(self) -> GapMiddle | None:
        """The middle of the gap; None while it is not certain."""
        weight = np.exp(self._log - self._log.max())
        weight /= weight.sum()
        best = int(weight.argmax())
        away = np.roll(_distances_rad(self._pitch_rad), best)
        near = np.abs(away) < NEAR_SHARE * self._backlash_rad
        share = float(weight[near].sum())
        if share < CERTAIN or self._outside(away) > MOST_OUTSIDE * self._measurements.sum():
            return None
        off = float((weight * away)[near].sum()) / share
        variance = float((weight * (away - off) ** 2)[near].sum()) / share
        return GapMiddle(best * self._pitch_rad / CELLS + off, math.sqrt(variance))

    def _outside(self, away: Vector) -> float:
        """How many measurements lie outside a gap from whose middle the cells are so far away."""
        reach = self._backlash_rad * (0.5 + BEYOND_SD * np.array(MEASUREMENT_SHARES))
        return float(self._measurements[np.abs(away) > reach[:, np.newaxis]].sum())
