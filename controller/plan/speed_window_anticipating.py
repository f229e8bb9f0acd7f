"""Fire ahead, by the time that the sleeve takes, so that the slip is small at contact.

The phase of the teeth is not considered, as in `speed_window`.
"""

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


class SpeedWindowAnticipating(Unaimed):
    """Contact at `window.anticipate_slip_rpm`; the brake leaves `window.anticipate_release_rpm`."""

    aims: Final = False

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        window = settings.window
        self.fire_slip_rad_s = window.anticipate_slip_rad_s
        self._left_rad_s = window.anticipate_release_rad_s
        self._settle_us = settle_time_us(sheet, window.settle_time_constants)

    def release(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> ReleasePlan:  # noqa: ARG002
        """Releases so that the set slip would remain when the brake's pressure has faded."""
        at_us = release_for_slip(predictor, earliest_us, self._left_rad_s, self._settle_us)
        return ReleasePlan(at_us, at_us + round(self._settle_us))

    def contact(self, predictor: GearPredictor, now_us: int, earliest_us: int) -> int | None:  # noqa: ARG002
        """When the slip has fallen to the one wanted, or the earliest time after that."""
        first_us = earliest_us + predictor.delay_us
        return predictor.slip_falls_to_us(self.fire_slip_rad_s, first_us, first_us + SLIP_SEARCH_US)
