"""Fired by the slip, whatever the phase: as soon as it is inside a window, as production does, or
ahead, by the time that the sleeve takes, so that it is small at contact."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.strategy import (
    ReleasePlan,
    Unaimed,
    release_for_slip,
    settle_time_us,
)
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet

SLIP_SEARCH_US: Final = 300_000
"""The slip is searched for up to this far ahead."""


class SpeedWindow(Unaimed):
    """`window.release_slip_rpm` is left by the brake; fired below `window.fire_slip_rpm`."""

    aims: Final = False

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        window = settings.window
        self.fire_slip_rad_s = window.fire_slip_rad_s
        self._left_rad_s = window.release_slip_rad_s
        self._settle_us = settle_time_us(sheet, window.settle_time_constants)

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:  # noqa: ARG002
        """Releases so that the set slip would remain when the brake's pressure has faded."""
        at_us = release_for_slip(predictor, earliest_us, self._left_rad_s, self._settle_us)
        return ReleasePlan(at_us, at_us + round(self._settle_us))

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:
        """At once when the slip is inside the window, or when drag is so strong that a sleeve fired
        later would meet the gear too slow; None while it is above."""
        contact_us = earliest_us + predictor.delay_us
        is_inside = predictor.slip_rad_s(now_us) <= self.fire_slip_rad_s
        return contact_us if is_inside or predictor.slip_rad_s(contact_us) <= 0.0 else None


class SpeedWindowAnticipating(SpeedWindow):
    """Contact at `window.anticipate_slip_rpm`; the brake leaves `window.anticipate_release_rpm`."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        super().__init__(sheet, settings)
        self.fire_slip_rad_s = settings.window.anticipate_slip_rad_s
        self._left_rad_s = settings.window.anticipate_release_rad_s

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:  # noqa: ARG002
        """When the slip has fallen to the one wanted, or the earliest time after that."""
        first_us = earliest_us + predictor.delay_us
        return predictor.slip_falls_to_us(self.fire_slip_rad_s, first_us, first_us + SLIP_SEARCH_US)
