"""What is left of the contacts of one gear when the law has said when they come: its bias and its
scatter from stroke to stroke.

A normal law with unknown mean and variance (normal-inverse-gamma). Where the law explains a stroke,
the bias is what it leaves of the contact; where it does not, all of the difference is.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.sleeve.tracked import Contact
from meshpoint.gearbox.sheet import SleeveActuator
from meshpoint.units import US

PRIOR_SAMPLES: Final = 0.5
"""Weight of no bias, in contacts."""
PRIOR_SCATTER_SAMPLES: Final = 4.0
"""Weight of the data sheet's scatter, in contacts."""
SHARE_OF_SCATTER: Final = 0.6
"""Scatter within one gear of one gearbox, as a share of the data sheet's scatter."""
LEAST_SCATTER_S: Final = 1e-4
MOST_SAMPLES: Final = 60.0
"""Largest weight of past contacts: older ones are forgotten, so that a slow drift is followed."""
FAR_S: Final = 0.02
"""A contact this far from what is expected is not learned: something else held the sleeve up."""


class ContactChance:
    """Bias and scatter of the contacts with one gear."""

    def __init__(self, sleeve: SleeveActuator) -> None:
        scatter_s = max(SHARE_OF_SCATTER * sleeve.delay_sd_s, LEAST_SCATTER_S)
        self.bias_s = 0.0
        """By how much contacts come later than the law says."""
        self.weight = PRIOR_SAMPLES
        self.freedom = PRIOR_SCATTER_SAMPLES
        """From how many contacts the scatter is known: degrees of freedom of the next contact."""
        self._squares_s2 = PRIOR_SCATTER_SAMPLES * scatter_s**2

    @property
    def scatter_s(self) -> float:
        """Standard deviation from stroke to stroke."""
        return math.sqrt(self._squares_s2 / self.freedom)

    @property
    def samples(self) -> int:
        """How many contacts have been seen."""
        return round(self.weight - PRIOR_SAMPLES)

    def set(self, bias_s: float, weight: float, scatter_s: float, freedom: float) -> None:
        """Goes on from these."""
        self.bias_s, self.weight, self.freedom = bias_s, weight, freedom
        self._squares_s2 = scatter_s**2 * freedom

    def learn(self, contact: Contact, expected_sd_s: float) -> bool:
        """One contact. expected_sd_s: of what was expected, without the chance of a stroke. False
        where it is too far from that."""
        error_s = (contact.measured_us - contact.expected_us) * US - self.bias_s
        if abs(error_s) > FAR_S:
            return False
        explained_us = contact.usual_us if contact.fitted_us is None else contact.fitted_us
        left_s = (contact.measured_us - explained_us) * US
        scatter2 = self.scatter_s**2
        share = scatter2 / (scatter2 + expected_sd_s**2)
        if contact.fitted_us is None:
            share *= self.weight / (self.weight + 1.0)
        self._squares_s2 += share * error_s**2
        self.freedom += 1.0
        self.bias_s += (left_s - self.bias_s) / (self.weight + 1.0)
        self.weight += 1.0
        if self.weight > MOST_SAMPLES:
            fade = MOST_SAMPLES / self.weight
            self.weight *= fade
            self.freedom *= fade
            self._squares_s2 *= fade
        return True
