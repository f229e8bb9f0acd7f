"""The outlook of a shift: slip and phase of the target gear at times to come.

Layshaft by zero-order hold over the brake commands, main shaft at constant speed (4.16).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from controller.brake_input import BrakeInput
from controller.kernels import US, Vector
from controller.kinematics import slip_rad_s
from controller.predictor import LayshaftState, predict_hold
from controller.reference import PhaseReferences
from controller.shafts import ShaftState
from gearbox import MainGear

BISECTIONS = 24
"""Halvings of at most a second: down to a tenth of a microsecond."""


@dataclass(frozen=True)
class Outlook:
    """Predictions for one target gear from the estimates of this step."""

    gear: MainGear
    i_gear: float
    layshaft: LayshaftState
    main: ShaftState
    brake: BrakeInput
    model: Vector
    references: PhaseReferences

    def slip_rad_s(self, time_us: float, release_us: int | None = None) -> float:
        """Slip at a time with the brake as commanded, or released at `release_us`."""
        return self._slip(self._layshaft_at(time_us, release_us))

    def _slip(self, state: LayshaftState) -> float:
        return slip_rad_s(self.i_gear, state.omega_rad_s, self.main.omega_rad_s)

    def phase_and_slip(self, time_us: float) -> tuple[float, float]:
        """Unwrapped phase and slip at a time. KeyError while the reference is unknown."""
        state = self._layshaft_at(time_us, None)
        theta_main = self.main.theta_at(time_us)
        phase = self.references.phase_rad(self.gear, state.theta_rad, theta_main)
        return phase, self._slip(state)

    def _layshaft_at(self, time_us: float, release_us: int | None) -> LayshaftState:
        brake = self.brake
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        return predict_hold(self.layshaft, time_us, switches, self.model)

    def phase_sd_rad(self, time_us: float, delay_sd_s: float) -> float:
        """Standard deviation of the phase at contact: angles, speeds over the horizon, and delay."""
        horizon_s = (time_us - self.layshaft.time_us) * US
        layshaft = math.hypot(
            self.layshaft.theta_sd_rad, self.layshaft.omega_sd_rad_s * horizon_s
        )
        main = math.hypot(self.main.theta_sd_rad, self.main.omega_sd_rad_s * horizon_s)
        slip = self.slip_rad_s(time_us)
        return math.hypot(self.i_gear * layshaft, main, slip * delay_sd_s)

    def release_time_us(
        self, earliest_us: int, latest_us: int, slip_left_rad_s: float, settle_us: float
    ) -> int:
        """When to release the brake so that `slip_left` remains `settle_us` later.

        Slip after release falls the later the release comes, so bisection finds it; `earliest`
        where it is late already, `latest` where it is far off."""
        left = self.slip_rad_s
        if left(earliest_us + settle_us, earliest_us) <= slip_left_rad_s:
            return earliest_us
        if left(latest_us + settle_us, latest_us) >= slip_left_rad_s:
            return latest_us
        low, high = earliest_us, latest_us
        for _ in range(BISECTIONS):
            middle = (low + high) // 2
            if left(middle + settle_us, middle) > slip_left_rad_s:
                low = middle
            else:
                high = middle
            if high - low <= 1:
                break
        return high
