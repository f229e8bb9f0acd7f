"""When to fire the sleeve: two engagement strategies behind one name each.

`speed_window` is what is done today: fire as soon as the slip is inside the window; tooth meets gap
by luck. `target_phase` fires so that the predicted phase at contact is the target: the sleeve needs
t_delay from activation to contact (thesis 6.2), so it asks where the teeth will be then.
"""

from __future__ import annotations

from typing import NamedTuple

from controller.kinematics import wrap_to_pitch
from controller.outlook import Outlook
from controller.settings import ControllerSettings
from dbc.messages import ShiftDecision
from gearbox import GearboxSheet

US_PER_S = 1e6
SCAN_US = 1000.0
"""Step of the look-ahead for the next gap; a gap takes 60 ms to come by at 20 rpm."""
HORIZON_US = 150_000
"""How far ahead a gap is looked for; past it the next step looks again."""
NEWTON_STEPS = 4
LATEST_RELEASE_US = 1_000_000


class Plan(NamedTuple):
    """A decision about firing: at which activation time, and what is expected at contact."""

    decision: ShiftDecision
    fire_us: int
    contact_us: int
    phase_rad: float
    phase_sd_rad: float
    slip_rad_s: float


class Strategist:
    """Both strategies over the same outlook."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        self._dog = sheet.dog
        self._window = settings.window
        half_gap = self._dog.backlash_rad / 2.0
        self._target_rad = settings.aim.target_rad_share * half_gap
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

    def target_phase(self, outlook: Outlook, earliest_us: int) -> Plan | None:
        """Fire so that the gap's target meets the tooth with the slip inside its window.

        None where no such moment lies within the horizon."""
        first_us = earliest_us + outlook.delay_us
        contact_us = self._next_contact(outlook, float(first_us), first_us + HORIZON_US)
        if contact_us is None:
            return None
        return self.plan_at(outlook, round(contact_us), ShiftDecision.FIRE)

    def release(self, outlook: Outlook, earliest_us: int, aimed: bool) -> tuple[int, int]:
        """When to let the brake go, and when contact would be.

        Unaimed, a set slip is left when the brake has died away. Aimed, release and contact are
        planned together, so that waiting for the gap costs no time; where that has no solution,
        or contact would come before a sleeve fired now, the unaimed release stands."""
        window = self._window
        slip, settle_us = window.release_slip_rad_s, self._settle_us
        if aimed:
            slip, settle_us = window.aim_slip_rad_s, self._aim_us
        latest_us = earliest_us + LATEST_RELEASE_US
        release_us = outlook.release_time_us(earliest_us, latest_us, slip, settle_us)
        if aimed and release_us < latest_us:
            pitch = self._dog.pitch_rad
            both = outlook.aimed_release_us(release_us, earliest_us, slip, self._target_rad, pitch)
            if both is not None and both[1] >= earliest_us + outlook.delay_us:
                return both
        return release_us, release_us + round(settle_us)

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

    def _next_contact(self, outlook: Outlook, time_us: float, until_us: float) -> float | None:
        """The next time the phase passes the target with the slip inside the window."""
        window = self._window
        phase, slip = outlook.phase_and_slip(time_us)
        while time_us < until_us and slip > window.contact_low_rad_s:
            pitch = self._dog.pitch_rad
            ahead = (self._target_rad - phase) % pitch
            found_us = self._solve(outlook, phase + ahead, time_us + ahead / slip * US_PER_S)
            if found_us is not None and found_us >= time_us:
                slip_there = outlook.slip_rad_s(found_us)
                if window.contact_low_rad_s <= slip_there <= window.contact_high_rad_s:
                    return found_us
                if slip_there < window.contact_low_rad_s:
                    return None
                time_us = found_us
            time_us += SCAN_US
            phase, slip = outlook.phase_and_slip(time_us)
        return None

    @staticmethod
    def _solve(outlook: Outlook, phase_rad: float, guess_us: float) -> float | None:
        """Newton's method on the phase; the slip is its derivative. None where it dies first."""
        time_us = guess_us
        for _ in range(NEWTON_STEPS):
            phase, slip = outlook.phase_and_slip(time_us)
            if slip <= 0.1:
                return None
            time_us += (phase_rad - phase) / slip * US_PER_S
        phase, _ = outlook.phase_and_slip(time_us)
        return time_us if abs(phase - phase_rad) < 1e-4 else None
