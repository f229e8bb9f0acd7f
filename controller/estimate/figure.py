"""What is known of a quantity: a value and its deviation, and how they change when more is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple


class Estimate(NamedTuple):
    """A value and its standard deviation, in the unit that the name of the field says."""

    value: float
    sd: float


@dataclass(frozen=True)
class Figure:
    """A positive quantity that is learned: the mean and standard deviation of its logarithm, its
    range, and how little and how much may be known of it."""

    log: float
    sd: float
    least_log: float
    most_log: float
    prior_sd: float
    """Before anything was learned."""
    least_sd: float
    """It is never known better than this: a few shifts do not tell what the next will be like."""

    @property
    def value(self) -> float:
        """The quantity itself."""
        return math.exp(self.log)

    def after(self, log: float, sd: float) -> Figure:
        """What is known after a measurement of its logarithm with this standard deviation."""
        gain = self.sd**2 / (self.sd**2 + sd**2)
        after = self.log + gain * (log - self.log)
        after_sd = max(self.sd * math.sqrt(1.0 - gain), self.least_sd)
        return replace(self, log=self._within(after), sd=after_sd)

    def restored(self, value: float, sd: float) -> Figure:
        """As an earlier run learned it; within its range, and no surer than it may be."""
        log, sd = self._within(math.log(value)), min(max(sd, self.least_sd), self.prior_sd)
        return replace(self, log=log, sd=sd)

    def _within(self, log: float) -> float:
        return min(max(log, self.least_log), self.most_log)


def prior(typical: float, factor: float, range_: tuple[float, float], least_sd: float) -> Figure:
    """A quantity that lies within `factor` of a typical one, one standard deviation, and always in
    its range."""
    sd = math.log(factor)
    return Figure(math.log(typical), sd, math.log(range_[0]), math.log(range_[1]), sd, least_sd)
