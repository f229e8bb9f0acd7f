"""How long a sleeve takes from its valve's activation to its gear's teeth, stroke by stroke: as the
controller's law takes it from neutral at the data sheet's supply pressure, and what the law leaves
of each contact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from meshpoint.controller.sleeve.stroke import FAR_S
from meshpoint.gearbox.gears import MAIN_GEARS, SPLIT_GEARS, DogGear
from meshpoint.identify.log_reader import LogContent
from meshpoint.units import US

LEAST_CORRELATION, MOST_CORRELATION = 0.3, 0.8
"""A sleeve's strokes go together, by seals, grease and warmth that change slowly."""


@dataclass(frozen=True)
class SleeveFit:
    """Delays of the strokes by gear."""

    delays_s: dict[DogGear, np.ndarray]
    by_law_sd_s: dict[DogGear, float]
    """Deviation of the law's own delay."""
    errors_s: np.ndarray
    """By how much each contact was later than what was expected before its sleeve moved."""
    after_s: np.ndarray
    """And after its firing."""

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the spread within gears."""
        return sum(delays.size - 1 for delays in self.delays_s.values())

    @property
    def effective_freedom(self) -> float:
        """The same for strokes that go together."""
        square = self.correlation**2
        return max(1.0, self.freedom * (1.0 - square) / (1.0 + square))

    @property
    def spread_s(self) -> float:
        """Standard deviation within gears. Strokes that go together scatter less about their own
        mean than about the true one: that is made good for."""
        if self.freedom < 1:
            return math.nan
        squares = sum(float(np.sum((d - d.mean()) ** 2)) for d in self.delays_s.values())
        expected = sum(_squares_expected(d.size, self.correlation) for d in self.delays_s.values())
        return math.sqrt(squares / expected)

    @property
    def correlation(self) -> float:
        """Of a stroke's deviation with that of the gear's stroke before; a log of few strokes
        cannot show that there is none."""
        pairs = [(d - d.mean()) for d in self.delays_s.values() if d.size > 2]
        squares = sum(float(np.sum(one**2)) for one in pairs)
        strokes = sum(one.size for one in pairs)
        if squares == 0.0:
            return LEAST_CORRELATION
        found = sum(float(np.sum(one[1:] * one[:-1])) for one in pairs) / squares
        # Deviations from a mean of n are correlated by -1 / n of themselves.
        own = float(found + len(pairs) / strokes)
        return min(max(own, LEAST_CORRELATION), MOST_CORRELATION)


def _squares_expected(count: int, correlation: float) -> float:
    """Expected sum of squares about their mean, of this many values of variance 1."""
    lags = np.arange(1, count)
    return float(count - 1 - 2.0 * np.sum((1.0 - lags / count) * correlation**lags))


def sleeve_fit(content: LogContent) -> SleeveFit | None:
    """None without a contact."""
    contacts = [
        (gear, one)
        for gear, one in content.contacts
        if abs(one.measured_us - one.expected_us) * US < FAR_S
    ]
    if content.sleeves is None or not contacts:
        return None
    delays, sds = {}, {}
    for gear in (*MAIN_GEARS, *SPLIT_GEARS):
        left_us = [one.measured_us - one.usual_us for at, one in contacts if at is gear]
        if left_us:
            by_law = content.sleeves.law_figures(gear).contact_s
            delays[gear], sds[gear] = by_law.value + US * np.array(left_us), by_law.sd
    errors_us = np.array([one.measured_us - one.expected_us for _, one in contacts])
    after_us = np.array([one.measured_us - one.fired_us for _, one in contacts])
    return SleeveFit(delays, sds, US * errors_us, US * after_us)
