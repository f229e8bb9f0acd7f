"""What a strategy must have. Nothing here decides."""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from meshpoint.controller.planning.gear_predictor import GearPredictor
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import SECOND_US

LATEST_RELEASE_US: Final = 1_000_000
"""No release is planned further ahead than this."""


class ReleasePlan(NamedTuple):
    """When to let the brake go, and when contact is expected with that, in sensor time."""

    release_us: int
    contact_us: int


class EngagementStrategy(Protocol):
    """A way to choose the release of the brake and the contact of the sleeve.

    It is made anew whenever the settings change, from the data sheet and the settings. It commands
    nothing itself: the sequence turns its times into valve commands, and the guard judges those.
    """

    @property
    def aims(self) -> bool:
        """Whether it needs the phase of the teeth. While that is unknown `speed_window` acts."""

    @property
    def fire_slip_rad_s(self) -> float:
        """The slip to have when the sleeve is fired: where drag alone would take too long to bring
        the slip down to it, the brake helps."""

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:
        """When to let the brake go; asked at every step while it is on.

        Not before `earliest_us`, nor more than `LATEST_RELEASE_US` after it."""

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:
        """When the sleeve should meet its gear; None: wait, and be asked again at the next step.

        Not before `earliest_us + predictor.delay_us`: the sleeve is on its way for that long. The
        phase may be asked of the predictor only by a strategy that aims (else KeyError)."""


def release_for_slip(
    predictor: GearPredictor, earliest_us: int, slip_left_rad_s: float, settle_us: float
) -> int:
    """The release after which a slip is left when the brake has had `settle_us` to die away."""
    latest_us = earliest_us + LATEST_RELEASE_US
    return predictor.release_time_us(earliest_us, latest_us, slip_left_rad_s, settle_us)


def settle_time_us(sheet: GearboxSheet, time_constants: float) -> float:
    """From a release until so many time constants of the brake's pressure have passed."""
    brake = sheet.brake
    return SECOND_US * (brake.valve_delay_s + time_constants * brake.time_constant_s)
