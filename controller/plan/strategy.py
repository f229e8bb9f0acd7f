"""The interface of a strategy, and helpers that several strategies use."""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from meshpoint.controller.plan.gear_predictor import GearPredictor, LastMeasurement
from meshpoint.controller.settings.settings import MS_IN_US, Timing
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import SECOND_US

LATEST_RELEASE_US: Final = 1_000_000
"""No release is planned further ahead than this."""
BUS_US: Final = 2 * MS_IN_US
"""A command that switches off arrives within this: the bus, and the node's own lateness."""
LATE_US: Final = 1 * MS_IN_US
"""A plan that counts on a step to come lets it be late by so much."""


class ReleasePlan(NamedTuple):
    """When to release the brake, and when contact is then expected; sensor time, us."""

    release_us: int
    contact_us: int


class EngagementStrategy(Protocol):
    """A way to choose the release of the brake and the contact of the sleeve.

    It is made anew whenever the settings change, from the data sheet and the settings. It commands
    nothing itself: the sequence turns its times into valve commands, and the guard judges those.
    """

    @property
    def aims(self) -> bool:
        """Whether it needs the phase of the teeth. While that is unknown, `speed_window` acts for
        it."""

    @property
    def fire_slip_rad_s(self) -> float:
        """The slip to have when the sleeve is fired: where drag alone would take too long to bring
        the slip down to it, the brake helps."""

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:
        """When to release the brake (us); called at every step while the brake is on.

        Not before `earliest_us`, nor more than `LATEST_RELEASE_US` after it."""

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:
        """When the sleeve should meet its gear (us); None to wait and be called at the next step.

        Not before `earliest_us + predictor.delay_us`, the time that the sleeve needs. Only a
        strategy that aims may use the predictor's phase (else KeyError)."""

    def is_to_go_back(
        self, predictor: GearPredictor, now_us: int, contact_us: int, earliest_us: int
    ) -> bool:
        """Whether a sleeve that was fired to meet its gear at `contact_us` should be stopped before
        it, to be fired anew at `earliest_us` or later: the predictor's `delay_us` is that of a
        sleeve fired from where it would stand.

        Asked only of a strategy that aims, and while the phase is known."""


class Unaimed:
    """What strategies have in common for which one contact is as good as another."""

    def is_to_go_back(self, *_asked: object) -> bool:
        """Never."""
        return False


def release_for_slip(
    predictor: GearPredictor, earliest_us: int, slip_left_rad_s: float, settle_us: float
) -> int:
    """The release time (us) after which `slip_left_rad_s` remains once `settle_us` have passed."""
    latest_us = earliest_us + LATEST_RELEASE_US
    return predictor.release_time_us(earliest_us, latest_us, slip_left_rad_s, settle_us)


def settle_time_us(sheet: GearboxSheet, time_constants: float) -> float:
    """From a release until this many time constants of the brake's pressure have passed."""
    brake = sheet.brake
    return SECOND_US * (brake.valve_delay_s + time_constants * brake.time_constant_s)


def known_until_stop_us(predictor: GearPredictor, timing: Timing) -> int:
    """How much later than the step that plans the earliest firing the last step with new
    measurements comes in which that sleeve can be stopped: the command's lead and what it flies
    till then, in whole times from one such step to the next."""
    flies_us = timing.lead_ms * MS_IN_US + predictor.delay_us - predictor.stop_us
    return max(0, flies_us - BUS_US) // timing.measured_us * timing.measured_us


def last_measurement(predictor: GearPredictor, timing: Timing) -> LastMeasurement:
    """When a sleeve on its way can last be stopped short of the teeth."""
    return LastMeasurement(predictor.stop_us + BUS_US + LATE_US, timing.measured_us)
