"""What an error costs over the sleeve's delay (thesis 6.4), at the end of the delay.

As in the thesis errors act from the moment at which the brake's signal is set to zero; the brake
goes on for the valve's delay and then dies away. Angles are of the layshaft unless a gear is named,
in per cent of a pitch of the dog teeth (the thesis's cog gap).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from benchmarks.studies.record import Given
from benchmarks.studies.simulated import simulate_shift
from benchmarks.studies.thesis_predictions import predict_hold
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.gearbox import GearboxSheet, MainGear, Split
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.kernels.records import Vector
from meshpoint.units import US

SAMPLE_US: Final = 1_000
PERCENT: Final = 100.0
CAP: Final = 100.0
"""Above a whole pitch nothing is aimed any more (thesis 6.4.2)."""


class Release:
    """The state at the release of the brake, and where the layshaft is after a time."""

    def __init__(self, given: Given[Any], split: Split = Split.HIGH) -> None:
        self.sheet: GearboxSheet = given.sheet
        self.split = split
        shift = simulate_shift(self.sheet, given.common.shift, SAMPLE_US, split)
        self.state: LayshaftState = shift.at(given.common.shift.off_ms)
        self.switches = np.array((shift.switch_us, shift.switch_u))
        self.delay_s = self.sheet.sleeve.delay_s

    def after(
        self,
        seconds: float,
        state: LayshaftState | None = None,
        sheet: GearboxSheet | None = None,
        model: Vector | None = None,
    ) -> LayshaftState:
        """The layshaft after a time, with an error in the state, the sheet, or the model."""
        start = self.state if state is None else state
        if model is None:
            model = layshaft_model(sheet or self.sheet, self.split)
        return predict_hold(start, start.time_us + seconds / US, self.switches, model)

    def angle_error_pct(
        self,
        state: LayshaftState | None = None,
        sheet: GearboxSheet | None = None,
        model: Vector | None = None,
    ) -> float:
        """Error of the layshaft's angle after the sleeve's delay, in % of pitch."""
        wrong = self.after(self.delay_s, state, sheet, model)
        right = self.after(self.delay_s)
        return PERCENT * (wrong.theta_rad - right.theta_rad) / self.sheet.dog.pitch_rad

    def gear_share(self, gear: MainGear) -> float:
        """Angle of a gear over that of the layshaft."""
        return self.sheet.main_mesh(gear).ratio


def capped(values: Vector) -> Vector:
    """As the thesis draws it: nothing above a pitch."""
    return np.minimum(np.abs(values), CAP)


def gear_name(gear: MainGear) -> str:
    """As the figures name it."""
    return gear.name.lower()


def easiest_first(values: dict[MainGear, float]) -> list[str]:
    """Names of the gears from the smallest error to the largest."""
    return [gear_name(gear) for gear in sorted(MAIN_GEARS, key=lambda gear: abs(values[gear]))]
