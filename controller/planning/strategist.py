"""When to fire the sleeve: three engagement strategies behind one name each.

`speed_window` is what is done today: fire as soon as the slip is inside the window; tooth meets gap
by luck. `speed_window_anticipating` knows how long the sleeve takes, and fires ahead so that at
contact the slip is the middle of the window; phase is luck all the same. `target_phase` asks
where the teeth will be when the sleeve arrives (thesis 6.2), and takes the release and the firing
whose contact costs least by expectation: time, the price of a miss, the energy of the flanks, over
the spread of the predicted phase (docs/strategy.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshpoint.controller.motion.kinematics import wrap_to_pitch
from meshpoint.controller.planning.outlook import Course, Outlook
from meshpoint.controller.planning.plan_kernels import CONTACTS, TERMS, cheapest, expected_least
from meshpoint.controller.records import Vector, filled
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import ShiftDecision, Strategy
from meshpoint.gearbox import GearboxSheet

US_PER_S = 1e6
LATEST_RELEASE_US = 1_000_000
COARSE_US, COURSE_STEPS = 2_000.0, 150
"""The course to come: 0.3 s, in which the slip falls out of its window; 2 ms are a quarter of a
degree at 20 rpm."""
FINE_US, FINE_STEPS = 100.0, 41
"""Around the best of these."""
AHEAD_US = 300_000
"""How far ahead a slip is looked for."""
GROWTH_US = 100_000.0
"""Over this the growth of the phase's variance is taken."""
NEAR_US = 50_000
"""A release further ahead is not aimed yet: the plan is made anew at every tick."""
EARLIER_US, LATER_US, RELEASE_STEP_US, RELEASE_FINE_US = 6_000, 8_000, 1_000, 200
"""Releases looked at around the unaimed one: 14 ms move the phase at contact by more than a pitch.
"""
EARLIEST_US = -35_000
"""The earliest firing, after the release: the sleeve is on its way for longer than that, and meets
the gear when the brake has been let go."""
SETTLED_SHARE = 0.1
"""What is left at firing of the variance that the phase has at the release."""
REFERENCE_SD_RAD = math.radians(0.1)
"""Of a learned phase reference."""


class Plan(NamedTuple):
    """A decision about firing: at which activation time, and what is expected at contact."""

    decision: ShiftDecision
    fire_us: int
    contact_us: int
    phase_rad: float
    phase_sd_rad: float
    slip_rad_s: float


class Strategist:
    """All strategies over the same outlook."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        self._dog = sheet.dog
        self._window, self._prices = settings.window, settings.prices
        self._brake_nm_per_pa = sheet.brake_nm_per_pa
        self._speed_m_s = sheet.sleeve.speed_m_s
        self._reference_variance = REFERENCE_SD_RAD**2
        half_gap = self._dog.backlash_rad / 2.0
        self._target_rad = settings.aim.target_rad_share * half_gap
        window = settings.window
        self._left = {
            Strategy.SPEED_WINDOW: window.release_slip_rad_s,
            Strategy.SPEED_WINDOW_ANTICIPATING: window.anticipate_release_rad_s,
            Strategy.TARGET_PHASE: window.aim_slip_rad_s,
        }
        brake = sheet.brake
        self._settle_us, self._aim_us = (
            US_PER_S * (brake.valve_delay_s + constants * brake.time_constant_s)
            for constants in (
                settings.window.settle_time_constants,
                settings.window.aim_time_constants,
            )
        )

    def speed_window(self, outlook: Outlook, now_us: int, earliest_us: int) -> Plan | None:
        """Fire at once when the slip is inside the window; None while it is above."""
        slip_now = outlook.slip_rad_s(now_us)
        if slip_now > self._window.fire_slip_rad_s:
            return None
        return self.plan_at(outlook, earliest_us + outlook.delay_us, ShiftDecision.FIRE)

    def anticipating(self, outlook: Outlook, earliest_us: int) -> Plan:
        """The contact at which the slip is the wanted one, or the earliest after it."""
        first_us = earliest_us + outlook.delay_us
        wanted = self._window.anticipate_slip_rad_s
        contact_us = outlook.slip_falls_to_us(wanted, first_us, first_us + AHEAD_US)
        return self.plan_at(outlook, contact_us, ShiftDecision.FIRE)

    def target_phase(self, outlook: Outlook, now_us: int, earliest_us: int) -> Plan:
        """The contact of least expected cost that a sleeve not yet fired can still make."""
        first_us = float(earliest_us + outlook.delay_us)
        best = self._cheapest(outlook, now_us, outlook.course(first_us, COARSE_US, COURSE_STEPS))
        around_us = max(first_us, best - COARSE_US)
        fine = outlook.course(around_us, FINE_US, FINE_STEPS)
        contact_us = self._cheapest(outlook, now_us, fine)
        return self.plan_at(outlook, round(contact_us), ShiftDecision.FIRE)

    def _cheapest(self, outlook: Outlook, now_us: int, course: Course) -> float:
        """Time of a course's cheapest contact."""
        contacts = _contacts(course, now_us, *self._variance(outlook, course))
        phase, slip = course.phase_rad, course.slip_rad_s
        best, _ = cheapest(phase, slip, contacts, self._terms(outlook), 0.0)
        return course.first_us + best * course.step_us

    def _variance(self, outlook: Outlook, course: Course) -> tuple[float, float]:
        """Variance of the phase at the course's first time, and its growth a second."""
        now = outlook.estimate_variance(course.first_us)
        later = outlook.estimate_variance(course.first_us + GROWTH_US)
        return now + self._reference_variance, (later - now) / GROWTH_US * US_PER_S

    def _terms(self, outlook: Outlook) -> Vector:
        """The terms of `plan_kernels` for this gear."""
        window, prices, dog = self._window, self._prices, self._dog
        inertia = self._brake_nm_per_pa / outlook.model.brake_rad_s2_pa
        return filled(
            TERMS,
            pitch_rad=dog.pitch_rad,
            half_gap_rad=dog.backlash_rad / 2.0,
            target_rad=self._target_rad,
            overlap_s=prices.overlap_m / self._speed_m_s,
            delay_sd_s=outlook.delay_sd_s,
            miss_s=prices.miss_s,
            block_s=prices.block_s,
            block_slip_rad_s=prices.block_slip_rad_s,
            energy_s3_rad2=prices.energy_s_per_j * 0.5 * inertia / outlook.i_gear**2,
            aim_s=prices.aim_s,
            slip_low_rad_s=window.contact_low_rad_s,
            slip_high_rad_s=window.contact_high_rad_s,
        )

    def release(
        self, outlook: Outlook, now_us: int, earliest_us: int, strategy: Strategy
    ) -> tuple[int, int]:
        """When to let the brake go, and when contact would be.

        Unaimed, a set slip is left when the brake has died away. Aimed, release and contact are
        planned together: of the releases around that one, the one of least expected cost."""
        aimed = strategy is Strategy.TARGET_PHASE
        slip, settle_us = self._left[strategy], self._aim_us if aimed else self._settle_us
        latest_us = earliest_us + LATEST_RELEASE_US
        release_us = outlook.release_time_us(earliest_us, latest_us, slip, settle_us)
        if not aimed or release_us > earliest_us + NEAR_US:
            return release_us, release_us + round(settle_us)
        first_us = max(earliest_us, release_us - EARLIER_US)
        steps = range(first_us, release_us + LATER_US + 1, RELEASE_STEP_US)
        best, _ = self._best_release(outlook, now_us, earliest_us, steps)
        around = range(
            max(earliest_us, best - RELEASE_STEP_US), best + RELEASE_STEP_US + 1, RELEASE_FINE_US
        )
        return self._best_release(outlook, now_us, earliest_us, around)

    def _best_release(
        self, outlook: Outlook, now_us: int, earliest_us: int, releases_us: range
    ) -> tuple[int, int]:
        """The release of least expected cost, and the contact that goes with it."""
        terms = self._terms(outlook)
        least, best = math.inf, (releases_us[0], releases_us[0])
        for release_us in releases_us:
            fire_us = max(release_us + EARLIEST_US, earliest_us)
            first_us = float(fire_us + outlook.delay_us)
            course = outlook.course(first_us, COARSE_US, COURSE_STEPS, release_us)
            if release_us == releases_us[0]:
                variance, growth = self._variance(outlook, course)
            contacts = _contacts(course, now_us, SETTLED_SHARE * variance, growth)
            spread = math.sqrt(variance)
            index, cost = expected_least(
                course.phase_rad, course.slip_rad_s, contacts, terms, spread
            )
            if cost < least:
                least = cost
                best = release_us, round(first_us + index * COARSE_US)
        return best

    def plan_at(self, outlook: Outlook, contact_us: int, decision: ShiftDecision) -> Plan:
        """What is expected of a contact at that time; phase 0 while the reference is unknown."""
        if outlook.references.known(outlook.gear):
            raw, slip = outlook.phase_and_slip(contact_us)
            phase = wrap_to_pitch(raw, self._dog.pitch_rad)
            phase_sd = outlook.phase_sd_rad(contact_us)
        else:
            phase, phase_sd, slip = 0.0, 0.0, outlook.slip_rad_s(contact_us)
        fire_us = contact_us - outlook.delay_us
        return Plan(decision, fire_us, contact_us, phase, phase_sd, slip)


def _contacts(course: Course, now_us: int, variance_rad2: float, growth_rad2_s: float) -> Vector:
    """The contacts of a course for `plan_kernels`."""
    return filled(
        CONTACTS,
        wait_s=(course.first_us - now_us) / US_PER_S,
        step_s=course.step_us / US_PER_S,
        variance_rad2=variance_rad2,
        growth_rad2_s=growth_rad2_s,
    )
