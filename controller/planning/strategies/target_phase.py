"""Aiming: fire so that the teeth have the wanted phase when the sleeve arrives (thesis 6.2).

Release and contact are those of least expected cost under the uncertainty of the predicted phase:
time, the price of a miss, and the energy that the flanks take (docs/strategy.md).
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.planning.gear_predictor import GearPredictor, Trajectory
from meshpoint.controller.planning.plan_kernels import (
    CONTACT_SERIES,
    TERMS,
    cheapest,
    expected_least,
)
from meshpoint.controller.planning.strategies.base import (
    ReleasePlan,
    release_for_slip,
    settle_time_us,
)
from meshpoint.controller.records import Vector, filled
from meshpoint.controller.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import SECOND_US

COARSE_US: Final = 2_000.0
COARSE_STEPS: Final = 150
"""Contacts looked at: 0.3 s, in which the slip falls out of its window; 2 ms are a quarter of a
degree at 20 rpm."""
FINE_CONTACT_US: Final = 100.0
FINE_STEPS: Final = 41
"""Contacts looked at around the best of the coarse ones."""
NEAR_US: Final = 50_000
"""A release further ahead is not aimed yet, since it is planned again at every tick."""
EARLIER_US: Final = 6_000
LATER_US: Final = 8_000
RELEASE_STEP_US: Final = 1_000
RELEASE_FINE_US: Final = 200
"""Releases looked at around the unaimed one: 14 ms move the phase at contact by more than a pitch.
"""
EARLIEST_US: Final = -35_000
"""The earliest firing, after the release: the sleeve is on its way for longer than that, and meets
the gear when the brake has been let go."""
REFERENCE_SD_RAD: Final = math.radians(0.1)
"""Standard deviation of a learned phase reference."""


class TargetPhase:
    """Fires so that tooth meets gap."""

    aims: Final = True

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        window = settings.window
        self.fire_slip_rad_s = window.contact_high_rad_s
        self._dog = sheet.dog
        self._window, self._prices = window, settings.prices
        self._brake_nm_per_pa = sheet.brake_nm_per_pa
        self._speed_m_s = sheet.sleeve.speed_m_s
        self._reference_variance = REFERENCE_SD_RAD**2
        self._target_rad = settings.aim.target_rad_share * (sheet.dog.backlash_rad / 2.0)
        self._settle_us = settle_time_us(sheet, window.aim_time_constants)

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:
        """The contact of least expected cost that a sleeve not yet fired can still make."""
        first_us = float(earliest_us + predictor.delay_us)
        coarse = predictor.trajectory(first_us, COARSE_US, COARSE_STEPS)
        around_us = max(first_us, self._cheapest(predictor, now_us, coarse) - COARSE_US)
        fine = predictor.trajectory(around_us, FINE_CONTACT_US, FINE_STEPS)
        return round(self._cheapest(predictor, now_us, fine))

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:
        """Release and contact planned together: of the releases around the one that leaves
        `window.aim_slip_rpm`, the one of least expected cost."""
        slip, settle_us = self._window.aim_slip_rad_s, self._settle_us
        release_us = release_for_slip(predictor, earliest_us, slip, settle_us)
        if release_us > earliest_us + NEAR_US:
            return ReleasePlan(release_us, release_us + round(settle_us))
        first_us = max(earliest_us, release_us - EARLIER_US)
        steps = range(first_us, release_us + LATER_US + 1, RELEASE_STEP_US)
        best = self._best_release(predictor, now_us, earliest_us, steps).release_us
        around = range(
            max(earliest_us, best - RELEASE_STEP_US), best + RELEASE_STEP_US + 1, RELEASE_FINE_US
        )
        return self._best_release(predictor, now_us, earliest_us, around)

    def _best_release(
        self, predictor: GearPredictor, now_us: int, earliest_us: int, releases_us: range
    ) -> ReleasePlan:
        """The release of least expected cost, and the contact that goes with it."""
        terms = self._terms(predictor)
        least, best = math.inf, ReleasePlan(releases_us[0], releases_us[0])
        for release_us in releases_us:
            fire_us = max(release_us + EARLIEST_US, earliest_us)
            first_us = float(fire_us + predictor.delay_us)
            trajectory = predictor.trajectory(first_us, COARSE_US, COARSE_STEPS, release_us)
            if release_us == releases_us[0]:
                spread, settled = self._spread_at_release(predictor, trajectory, now_us)
            index, cost = expected_least(
                trajectory.phase_rad,
                trajectory.slip_rad_s,
                settled,
                _contacts(trajectory, now_us),
                terms,
                spread,
            )
            if cost < least:
                least = cost
                best = ReleasePlan(release_us, round(first_us + index * COARSE_US))
        return best

    def _cheapest(self, predictor: GearPredictor, now_us: int, trajectory: Trajectory) -> float:
        """Time of a trajectory's cheapest contact."""
        variances = self._variances(predictor, trajectory)
        phase, slip = trajectory.phase_rad, trajectory.slip_rad_s
        contacts, terms = _contacts(trajectory, now_us), self._terms(predictor)
        best, _ = cheapest(phase, slip, variances, contacts, terms, 0.0)
        return trajectory.first_us + best * trajectory.step_us

    def _variances(self, predictor: GearPredictor, trajectory: Trajectory) -> Vector:
        """Variance of the phase at each contact when its firing has to be decided."""
        first_us, step_us, phase, _ = trajectory
        return predictor.variances(first_us, step_us, phase.size) + self._reference_variance

    def _spread_at_release(
        self, predictor: GearPredictor, trajectory: Trajectory, now_us: int
    ) -> tuple[float, Vector]:
        """Standard deviation of the phase at the first contact as it is predicted now, and the
        variances that are left at firing."""
        firing_us = float(now_us + predictor.delay_us)
        settled = predictor.variances(firing_us, trajectory.step_us, trajectory.phase_rad.size)
        now = predictor.estimate_variance(trajectory.first_us) + self._reference_variance
        return math.sqrt(now), settled + self._reference_variance

    def _terms(self, predictor: GearPredictor) -> Vector:
        """The terms of `plan_kernels` for this gear."""
        window, prices, dog = self._window, self._prices, self._dog
        inertia = self._brake_nm_per_pa / predictor.model.brake_rad_s2_pa
        return filled(
            TERMS,
            pitch_rad=dog.pitch_rad,
            half_gap_rad=dog.backlash_rad / 2.0,
            target_rad=self._target_rad,
            overlap_s=prices.overlap_m / self._speed_m_s,
            delay_sd_s=predictor.delay_sd_s,
            miss_s=prices.miss_s,
            block_s=prices.block_s,
            block_slip_rad_s=prices.block_slip_rad_s,
            energy_s3_rad2=prices.energy_s_per_j * 0.5 * inertia / predictor.i_gear**2,
            aim_s=prices.aim_s,
            slip_low_rad_s=window.contact_low_rad_s,
            slip_high_rad_s=window.contact_high_rad_s,
        )


def _contacts(trajectory: Trajectory, now_us: int) -> Vector:
    """The contacts of a trajectory for `plan_kernels`."""
    return filled(
        CONTACT_SERIES,
        wait_s=(trajectory.first_us - now_us) / SECOND_US,
        step_s=trajectory.step_us / SECOND_US,
    )
