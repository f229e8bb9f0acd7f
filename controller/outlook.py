"""The outlook of a shift: slip and phase of the target gear at times to come.

Layshaft by zero-order hold over the brake commands, main shaft with the acceleration it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controller.brake_input import BrakeInput
from controller.kernels import US, Vector
from controller.kinematics import slip_rad_s
from controller.motion import LayshaftState, MotionModel, predict, predict_spread
from controller.motion_kernels import DRAG, time_at_speed
from controller.plan_kernels import course
from controller.reference import PhaseReferences
from controller.shafts import ShaftState
from gearbox import MainGear

BISECTIONS = 24
"""Halvings of at most a second: down to a tenth of a microsecond."""
SECANT_STEPS = 8
PROBE_US = 200
"""A release moved by this much moves the phase at contact by about half a degree."""
CLOSE_RAD = 1e-4


class Course(NamedTuple):
    """Phase (unwrapped) and slip at equal steps of time."""

    first_us: float
    step_us: float
    phase_rad: Vector
    slip_rad_s: Vector


@dataclass(frozen=True)
class Outlook:
    """Predictions for one target gear from the estimates of this step."""

    gear: MainGear
    i_gear: float
    layshaft: LayshaftState
    main: ShaftState
    brake: BrakeInput
    model: MotionModel
    references: PhaseReferences
    delay_us: int
    """From a sleeve valve's activation to contact, expected."""
    delay_sd_s: float

    def slip_rad_s(self, time_us: float, release_us: int | None = None) -> float:
        """Slip at a time with the brake as commanded, or released at `release_us`."""
        return self._slip(self.layshaft_at(time_us, release_us))

    def _slip(self, state: LayshaftState) -> float:
        omega_main = self.main.omega_at(state.time_us)
        return slip_rad_s(self.i_gear, state.omega_rad_s, omega_main)

    def phase_and_slip(self, time_us: float) -> tuple[float, float]:
        """Unwrapped phase and slip at a time. KeyError while the reference is unknown."""
        state = self.layshaft_at(time_us, None)
        theta_main = self.main.theta_at(time_us)
        phase = self.references.phase_rad(self.gear, state.theta_rad, theta_main)
        return phase, self._slip(state)

    def layshaft_at(self, time_us: float, release_us: float | None) -> LayshaftState:
        """The layshaft at a time with the brake as commanded, or released at `release_us`."""
        brake = self.brake
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        return predict(self.layshaft, time_us, switches, self.model)

    def phase_sd_rad(self, time_us: float) -> float:
        """Standard deviation of the phase at contact: angles, speeds to then, and delay."""
        layshaft_sd = self._layshaft_sd_rad(time_us)
        slip = self.slip_rad_s(time_us)
        return math.hypot(
            self.i_gear * layshaft_sd, self._main_sd_rad(time_us), slip * self.delay_sd_s
        )

    def _layshaft_sd_rad(self, time_us: float) -> float:
        state = self.layshaft
        if state.covariance is not None:
            return predict_spread(state, time_us, self.brake.arrays(), self.model).theta_sd_rad
        horizon_s = (time_us - state.time_us) * US
        return math.hypot(state.theta_sd_rad, state.omega_sd_rad_s * horizon_s)

    def estimate_variance(self, time_us: float) -> float:
        """Variance of the phase at a time without what the delay adds, rad2."""
        sd = math.hypot(self.i_gear * self._layshaft_sd_rad(time_us), self._main_sd_rad(time_us))
        return sd * sd

    def _main_sd_rad(self, time_us: float) -> float:
        horizon_s = (time_us - self.main.time_us) * US
        return math.hypot(self.main.theta_sd_rad, self.main.omega_sd_rad_s * horizon_s)

    def course(
        self, first_us: float, step_us: float, count: int, release_us: float | None = None
    ) -> Course:
        """Phase and slip at `count` times from `first_us` on, the brake as commanded or released
        at `release_us`. KeyError while the reference is unknown."""
        main, state, brake = self.main, self.layshaft, self.brake
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        offset = -self.references.phase_rad(self.gear, 0.0, 0.0)
        mesh = np.array([self.i_gear, offset, *main[:3], main.acceleration_rad_s2])
        found = Course(first_us, step_us, np.empty(count), np.empty(count))
        model = self.model
        course(
            state.vector, state.time_us, first_us, step_us, *switches, model.motion, model.law,
            mesh, found.phase_rad, found.slip_rad_s,
        )  # fmt: skip
        return found

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

    def aimed_release_us(
        self, release_us: int, earliest_us: int, slip_rad_s: float, target_rad: float, pitch: float
    ) -> tuple[int, int] | None:
        """Release and contact times such that at contact both slip and phase are as wanted.

        For every release there is one moment at which the slip has fallen to `slip_rad_s`; the
        phase at that moment falls the later the release comes, a pitch in a few milliseconds. So
        the release nearest to `release_us`, not before `earliest_us`, is found by secant steps.
        None where no such release is found. KeyError while the reference is unknown."""
        first = self.contact(release_us, slip_rad_s)
        if first is None:
            return None
        wanted = target_rad + pitch * round((first[1] - target_rad) / pitch)
        for _ in range(2):
            solved = self._solve_release(release_us, slip_rad_s, wanted, first[1])
            if solved is not None and solved[0] >= earliest_us:
                return solved
            wanted -= pitch
        return None

    def _solve_release(
        self, release_us: int, slip_rad_s: float, wanted_rad: float, phase_rad: float
    ) -> tuple[int, int] | None:
        time_us, error = float(release_us), phase_rad - wanted_rad
        probe = self.contact(time_us + PROBE_US, slip_rad_s)
        if probe is None:
            return None
        slope = (probe[1] - phase_rad) / PROBE_US
        for _ in range(SECANT_STEPS):
            if slope >= 0.0:
                return None
            step_us = -error / slope
            found = self.contact(time_us + step_us, slip_rad_s)
            if found is None:
                return None
            slope = (found[1] - wanted_rad - error) / step_us if abs(step_us) > 1.0 else slope
            time_us, error = time_us + step_us, found[1] - wanted_rad
            if abs(error) < CLOSE_RAD:
                return round(time_us), round(found[0])
        return None

    def contact(self, release_us: float, slip_rad_s: float) -> tuple[float, float] | None:
        """Time and unwrapped phase at which the slip has fallen to a value after a release."""
        state, main = self.layshaft, self.main
        switch_us, switch_u = self.brake.with_release(release_us)
        # Seen from a main shaft of constant speed, its acceleration is a drag on the layshaft.
        omega = (main.omega_at(state.time_us) + slip_rad_s) / self.i_gear
        x = state.vector
        x[DRAG] -= main.acceleration_rad_s2 / self.i_gear
        time_us = time_at_speed(
            x, state.time_us, omega, switch_us, switch_u, self.model.motion, self.model.law
        )
        if math.isinf(time_us):
            return None
        span_s = (time_us - state.time_us) * US
        theta_main = main.theta_at(state.time_us) + main.omega_at(state.time_us) * span_s
        return time_us, self.references.phase_rad(self.gear, float(x[0]), theta_main)
