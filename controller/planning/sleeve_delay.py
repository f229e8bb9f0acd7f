"""The sleeve's delay from activation to contact, learned for each gear (thesis 6.2).

The data sheet's mean and scatter are the prior of a normal law with unknown mean and variance
(normal-inverse-gamma); each contact seen by the position sensor is one sample. The part of the
delay in which the piston travels is proportional to the supply pressure to the power of -1/2.
Samples are converted to the data sheet's pressure, predictions to the present one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from meshpoint.controller.calibration.learned import SleeveRecord, SleeveRecords
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS

PRIOR_SAMPLES: Final = 0.5
"""Weight of the data sheet's mean, in samples."""
PRIOR_SCATTER_SAMPLES: Final = 4.0
"""Weight of the data sheet's scatter, in samples."""
SHARE_OF_SCATTER: Final = 0.6
"""Scatter within one gear of one gearbox, as a share of the data sheet's scatter."""
MOST_SAMPLES: Final = 60.0
"""Largest weight of past samples: older ones are forgotten, so that a slow drift is followed."""
PRESSURE_EXPONENT: Final = 0.5
FAR_S: Final = 0.02
"""A sample this far from the mean is not learned: the sleeve was held up by something else."""
LONGEST_S: Final = 0.5
"""No sleeve takes longer; a calibration file holds no more."""


@dataclass
class _GearDelay:
    mean_s: float
    samples: float
    squares_s2: float
    scatter_samples: float


class SleeveDelays:
    """Delay and scatter of each main gear's sleeve."""

    def __init__(self, sheet: GearboxSheet) -> None:
        sleeve = sheet.sleeve
        self._valve_s = sleeve.valve_delay_s
        self._sheet_pa = sheet.air.supply_gauge_pa
        self.supply_pa = self._sheet_pa
        """Present supply pressure, gauge."""
        scatter_s = SHARE_OF_SCATTER * sleeve.delay_sd_s
        self._learned = {
            gear: _GearDelay(
                sleeve.delay_s,
                PRIOR_SAMPLES,
                PRIOR_SCATTER_SAMPLES * scatter_s * scatter_s,
                PRIOR_SCATTER_SAMPLES,
            )
            for gear in MAIN_GEARS
        }

    def delay_us(self, gear: MainGear) -> int:
        """Expected time (us) from activation to contact at the present supply pressure."""
        travel_s = self._learned[gear].mean_s - self._valve_s
        return round(1e6 * (self._valve_s + travel_s / self._faster()))

    def delay_sd_s(self, gear: MainGear) -> float:
        """Standard deviation (s) of the next delay, the uncertainty of the mean included."""
        learned = self._learned[gear]
        variance = learned.squares_s2 / learned.scatter_samples
        return math.sqrt(variance * (1.0 + 1.0 / learned.samples))

    def scatter_samples(self, gear: MainGear) -> float:
        """From how many contacts the scatter is known, the data sheet's weight among them: degrees
        of freedom of the next delay's Student law."""
        return self._learned[gear].scatter_samples

    def samples(self, gear: MainGear) -> int:
        """How many contacts have been seen."""
        return round(self._learned[gear].samples - PRIOR_SAMPLES)

    def learn(self, gear: MainGear, delay_us: float) -> None:
        """One contact was seen `delay_us` after activation. A sleeve touches nothing before its
        valve can have opened: such a sample is not learned."""
        if not self._valve_s <= delay_us * 1e-6 <= LONGEST_S:
            return
        learned = self._learned[gear]
        travel_s = (delay_us * 1e-6 - self._valve_s) * self._faster()
        error = self._valve_s + travel_s - learned.mean_s
        if abs(error) > FAR_S:
            return
        share = 1.0 / (learned.samples + 1.0)
        learned.mean_s += share * error
        learned.squares_s2 += error * error * learned.samples * share
        learned.samples += 1.0
        learned.scatter_samples += 1.0
        if learned.samples > MOST_SAMPLES:
            fade = MOST_SAMPLES / learned.samples
            learned.samples *= fade
            learned.scatter_samples *= fade
            learned.squares_s2 *= fade

    def records(self) -> SleeveRecords:
        """What a calibration file keeps: the gears whose contacts have been seen."""
        return SleeveRecords(
            **{
                gear.name.lower(): SleeveRecord(
                    delay_s=learned.mean_s,
                    samples=learned.samples,
                    scatter_s=math.sqrt(learned.squares_s2 / learned.scatter_samples),
                    scatter_samples=learned.scatter_samples,
                )
                for gear, learned in self._learned.items()
                if self.samples(gear) > 0
            }
        )

    def restore(self, records: SleeveRecords) -> None:
        """Goes on from records; gears without one keep what the data sheet says."""
        for gear in MAIN_GEARS:
            record = records.of(gear)
            if record is not None:
                squares_s2 = record.scatter_s**2 * record.scatter_samples
                self._learned[gear] = _GearDelay(
                    record.delay_s, record.samples, squares_s2, record.scatter_samples
                )

    def _faster(self) -> float:
        ratio = max(self.supply_pa, 0.1 * self._sheet_pa) / self._sheet_pa
        return float(ratio**PRESSURE_EXPONENT)
