"""The drift of the phase from its prediction, learned for each gear from shift to shift.

After the firing nothing can be corrected, and effects that the model of drag and brake leaves out
move the gear until contact. Most of these are steady in one gearbox (oil, loose gears, a brake
whose torque fades) and grow about linearly with the predicted time, so they are described by one
figure for each gear: a drift of the slip, rad/s. Each aimed contact measures it, as the phase
estimated at contact less the one predicted at firing, over the time between. The drift is estimated
by a scalar Kalman filter with one step a shift. Its measurement noise is the standard deviation
that the filters of layshaft and main shaft claim for that prediction, times the ratio of real to
claimed scatter seen so far (the spread share). The same ratio scales the predicted spread of the
next shift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from meshpoint.controller.calibration.learned import DriftRecord, DriftRecords
from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.gearbox import GearboxSheet, MainGear, Split
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.kinematics import raw_phase_rad

WALK_SD_RAD_S: Final = 0.01
"""Standard deviation of the change of a drift from shift to shift: oil warms up."""
PRIOR_SHARE_SAMPLES: Final = 4.0
"""Weight of the filters' own standard deviation, in contacts."""
MOST_SHARE_SAMPLES: Final = 30.0
"""Largest weight of past contacts: older ones are forgotten."""
LEAST_SPREAD_SHARE: Final = 0.3
FAR_RAD_S: Final = 0.6
"""A drift above this (6 rpm) is an error of sleeve or sensor and is not learned."""
LEAST_S: Final = 0.02
"""Over a shorter time a drift cannot be distinguished from an error of the angles."""


@dataclass
class _GearDrift:
    variance: float
    mean_rad_s: float = 0.0
    share_squares: float = PRIOR_SHARE_SAMPLES
    share_samples: float = PRIOR_SHARE_SAMPLES

    @property
    def share(self) -> float:
        return max(math.sqrt(self.share_squares / self.share_samples), LEAST_SPREAD_SHARE)


class PhaseDrifts:
    """The drift of each main gear's slip against its prediction."""

    def __init__(self, sheet: GearboxSheet, drag_nm: float) -> None:
        """drag_nm: standard deviation of the drag that is not known at the start of a shift. What
        it changes of the gear's slip while the sleeve is on its way is the drift's, before one has
        been seen."""
        rad_s = drag_nm / sheet.inertia_kgm2(Split.HIGH) * sheet.sleeve.delay_s
        self._learned = {
            gear: _GearDrift((sheet.main_mesh(gear).ratio * rad_s) ** 2) for gear in MAIN_GEARS
        }

    def rad_s(self, gear: MainGear) -> float:
        """Expected slip less the model's prediction (rad/s), mean until contact."""
        return self._learned[gear].mean_rad_s

    def spread_share(self, gear: MainGear) -> float:
        """Ratio of the phases' scatter without drift to the filters' standard deviation."""
        return self._learned[gear].share

    def learn(self, fired: GearPredictor, seen: GearPredictor, contact_us: float) -> None:
        """An aimed contact was at `contact_us`: `fired` is the predictor when the sleeve was fired,
        `seen` the last one before it entered its gear. Where the main shaft may have met a flank
        meanwhile there is no telling a drift from that."""
        passed_s = (contact_us - fired.main.time_us) * 1e-6
        if passed_s < LEAST_S or fired.main.is_by_cloud:
            return
        apart = _undrifted_rad(seen, contact_us) - _undrifted_rad(fired, contact_us)
        variance = fired.estimate_variance(contact_us) / fired.spread_share**2
        self._add(self._learned[fired.gear], apart / passed_s, variance / passed_s**2)

    @staticmethod
    def _add(learned: _GearDrift, drift_rad_s: float, variance: float) -> None:
        """One contact's drift, and the variance that the filters claim for it."""
        if not (math.isfinite(drift_rad_s + variance) and abs(drift_rad_s) < FAR_RAD_S):
            return
        prior = learned.variance + WALK_SD_RAD_S**2
        off = drift_rad_s - learned.mean_rad_s
        noise = learned.share**2 * variance
        gain = prior / (prior + noise)
        # Its expectation is 1 if the share is right, however uncertain the drift itself is.
        surprise = off * off / (prior + noise)
        learned.mean_rad_s += gain * off
        learned.variance = (1.0 - gain) * prior
        fade = min(1.0, MOST_SHARE_SAMPLES / (learned.share_samples + 1.0))
        learned.share_squares = fade * (learned.share_squares + learned.share**2 * surprise)
        learned.share_samples = fade * (learned.share_samples + 1.0)

    def records(self) -> DriftRecords:
        """What a calibration file keeps: the gears that have been aimed at."""
        return DriftRecords(
            **{
                gear.name.lower(): DriftRecord(
                    learned.mean_rad_s,
                    math.sqrt(learned.variance),
                    math.sqrt(learned.share_squares / learned.share_samples),
                    learned.share_samples,
                )
                for gear, learned in self._learned.items()
                if learned.share_samples != PRIOR_SHARE_SAMPLES
            }
        )

    def restore(self, records: DriftRecords) -> None:
        """Goes on from records; gears without one start anew."""
        for gear in MAIN_GEARS:
            record = records.of(gear)
            if record is not None:
                self._learned[gear] = _GearDrift(
                    record.slip_sd_rad_s**2,
                    record.slip_rad_s,
                    record.spread_share**2 * record.samples,
                    record.samples,
                )


def _undrifted_rad(predictor: GearPredictor, time_us: float) -> float:
    """Phase (rad) by the model alone, without the gear's reference."""
    layshaft = predictor.layshaft_at(time_us, None)
    return raw_phase_rad(predictor.i_gear, layshaft.theta_rad, predictor.main.theta_at(time_us))
