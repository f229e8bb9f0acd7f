"""How the phase runs away from its prediction, learned for each gear from shift to shift.

Between the firing and the contact nothing can be corrected any more: what the model of drag and
brake leaves out moves the gear meanwhile. Most of that is steady in one gearbox (oil, loose gears,
a brake whose torque fades), and it grows about linearly with the time predicted over, so one figure
a gear stands for it: a drift of the slip. Each contact shows it, as the phase estimated then less
the one that was predicted when the sleeve was fired; its mean is that of a normal law with a normal
prior about zero. What is left scatters by the share of the filter's own standard deviation that
has been seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from controller.calibration import DriftRecord, Drifts
from controller.kinematics import raw_phase_rad
from controller.outlook import Outlook
from gearbox import MainGear
from gearbox.gears import MAIN_GEARS

PRIOR_SHARE_SAMPLES: Final = 4.0
"""How many contacts the filter's own spread is worth."""
LEAST_SHARE: Final = 0.3
PRIOR_SAMPLES: Final = 0.3
"""What "no drift" is worth: single contacts scatter by half as much as gearboxes do (simulated)."""
MOST_SAMPLES: Final = 15.0
"""Older samples fade: oil warms up within some shifts."""
FAR_RAD_S: Final = 0.6
"""6 rpm: no drift is so large, the sleeve or a sensor was wrong."""
LEAST_S: Final = 0.02
"""Over less, a drift cannot be told from the error of an angle."""


@dataclass
class _Learned:
    mean_rad_s: float = 0.0
    samples: float = PRIOR_SAMPLES
    share_squares: float = PRIOR_SHARE_SAMPLES
    share_samples: float = PRIOR_SHARE_SAMPLES


class PhaseDrifts:
    """The drift of each main gear's slip against its prediction."""

    def __init__(self) -> None:
        self._learned = {gear: _Learned() for gear in MAIN_GEARS}

    def rad_s(self, gear: MainGear) -> float:
        """What the slip is expected to be above its prediction, on average until contact."""
        return self._learned[gear].mean_rad_s

    def spread_share(self, gear: MainGear) -> float:
        """What phases scatter by, drift left out, over the filter's standard deviation."""
        learned = self._learned[gear]
        return max(math.sqrt(learned.share_squares / learned.share_samples), LEAST_SHARE)

    def learn(self, fired: Outlook, seen: Outlook, contact_us: float) -> None:
        """Contact was at `contact_us`: `fired` is the outlook when the sleeve was fired, `seen`
        the last one before it entered its gear."""
        passed_s = (contact_us - fired.main.time_us) * 1e-6
        if passed_s < LEAST_S:
            return
        apart = _undrifted_rad(seen, contact_us) - _undrifted_rad(fired, contact_us)
        variance = fired.estimate_variance(contact_us) / fired.spread_share**2
        self._add(fired.gear, apart / passed_s, variance / passed_s**2)

    def _add(self, gear: MainGear, drift_rad_s: float, variance: float) -> None:
        if not math.isfinite(drift_rad_s) or abs(drift_rad_s) > FAR_RAD_S:
            return
        learned = self._learned[gear]
        off = drift_rad_s - learned.mean_rad_s
        # An outlook made of the truth has no variance that a scatter could be compared with.
        if learned.samples > PRIOR_SAMPLES and variance > 0.0:
            learned.share_squares += off * off / variance
            learned.share_samples += 1.0
        learned.samples = min(learned.samples + 1.0, MOST_SAMPLES)
        learned.mean_rad_s += off / learned.samples

    def records(self) -> Drifts:
        """What a calibration file keeps: the gears that have been engaged."""
        return Drifts(
            **{
                gear.name.lower(): DriftRecord(learned.mean_rad_s, learned.samples)
                for gear, learned in self._learned.items()
                if learned.samples > PRIOR_SAMPLES
            }
        )

    def restore(self, records: Drifts) -> None:
        """Goes on from records; gears without one start anew."""
        for gear in MAIN_GEARS:
            record = records.of(gear)
            if record is not None:
                self._learned[gear] = _Learned(record.slip_rad_s, record.samples)


def _undrifted_rad(outlook: Outlook, time_us: float) -> float:
    """Phase by the model alone, but for the gear's constant."""
    layshaft = outlook.layshaft_at(time_us, None)
    return raw_phase_rad(outlook.i_gear, layshaft.theta_rad, outlook.main.theta_at(time_us))
