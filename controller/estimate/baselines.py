"""The baselines: the thesis's filter, the production window speed, and constant-speed estimation.

The model of thesis 4.13 holds when the clutch is open and the main box in neutral (4.1). Then the
chosen estimator of the layshaft runs: `thesis` is the event-driven Kalman filter of 5.2 and 5.3,
`window` the production speed of the last 10 ms. With a gear engaged the layshaft turns with the
main shaft, and the constant-speed filter of thesis 4.16 follows it, as it follows the main shaft
itself; that is also where a gear's phase is learned.
"""

from __future__ import annotations

import math

import numpy as np

from meshpoint.controller.estimate.layshaft_tracker import LayshaftModels
from meshpoint.controller.estimate.wheel_tracker import ESTIMATE_STALE_US, WindowSpeed
from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import BrakeInput, LayshaftState, MotionModel, predict
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.models.thesis import (
    CRUISE_FILTER,
    THESIS_FILTER,
    cruise_filter,
    propagate,
    thesis_filter,
)
from meshpoint.controller.settings.filters import CruiseFilterTuning
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import Estimator
from meshpoint.kernels.records import RecordMemory
from meshpoint.units import US

START_SD_PRESSURE_PA = 2e4
"""Standard deviation of the pressure when the filter starts: the valve has been off for a while,
but not long enough for the pressure to be exactly zero."""


class _Memory(RecordMemory):
    """State and parameters of a filter; the window speed keeps its state in one too."""

    def _name_parts(self) -> None:
        self.time_us, self.x, self.p = self.part("time_us"), self.part("x"), self.part("p")


class CruiseTracker:
    """Angle and speed of a shaft whose speed changes little, by a Kalman filter on its edges."""

    def __init__(self, tuning: CruiseFilterTuning, pitch_rad: float) -> None:
        self._tuning = tuning
        self._pitch_rad = pitch_rad
        self._filter = _Memory(CRUISE_FILTER)
        self._filter.put(acceleration_rad_s2=tuning.acceleration_rad_s2)
        self._filter.put(edge_time_s=tuning.edge_time_us * US)
        self._seed = WindowSpeed()
        self._running = False

    def lose_speed(self) -> None:
        """Starts anew with the edges to come; teeth keep their numbers."""
        self.restart()

    def restart(self) -> None:
        """Starts anew from the edges to come; after a jump in speed or lost teeth."""
        self._running = False
        self._seed.restart()

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges in order of time."""
        if not batch.time_us.size:
            return
        if not self._running:
            self._start(batch)
            return
        cruise_filter(self._filter.flat, batch.time_us, batch.theta_rad)

    def _start(self, batch: EdgeBatch) -> None:
        self._seed.edges(batch)
        newest = self._seed.newest
        if self._seed.omega_rad_s is None or newest is None:
            return
        memory = self._filter
        memory.time_us[0] = newest[0]
        memory.x[:] = newest[1], self._seed.omega_rad_s
        speed_sd = 0.05 * abs(self._seed.omega_rad_s) + 1.0
        memory.p[:] = np.diag([(0.1 * self._pitch_rad) ** 2, speed_sd**2])
        self._running = True

    def at(self, time_us: float) -> ShaftState | None:
        """The state at a time, speed held; None before enough edges, or without any for 60 ms."""
        memory = self._filter
        newest_us = memory.time_us.item()
        if not self._running or abs(time_us - newest_us) > ESTIMATE_STALE_US:
            return None
        dt = (time_us - newest_us) * US
        theta, omega = memory.x.tolist()
        (p00, p01), (_, p11) = memory.p.tolist()
        q = self._tuning.acceleration_rad_s2 * dt
        theta_var = p00 + dt * (2.0 * p01 + dt * p11) + 0.25 * (q * dt) ** 2
        return ShaftState(
            time_us,
            theta + omega * dt,
            omega,
            math.sqrt(max(0.0, theta_var)),
            math.sqrt(max(0.0, p11 + q * q)),
        )


class BaselineTracker:
    """Angle, speed and brake pressure of the layshaft at any time near now."""

    def __init__(
        self,
        estimator: Estimator,
        settings: ControllerSettings,
        brake: BrakeInput,
        pitch_rad: float,
    ) -> None:
        self._estimator = estimator
        tuning = settings.thesis_filter
        self._filter = memory = _Memory(THESIS_FILTER)
        memory.part("w")[:] = tuning.w_angle_rad_s, tuning.w_speed_rad_s2, tuning.w_pressure_pa_s
        memory.part("r_rad2")[0] = tuning.r_angle_rad**2
        self._brake = brake
        self._cruise = CruiseTracker(settings.cruise_filter, pitch_rad)
        self._window = WindowSpeed()
        self._model: MotionModel | None = None
        self._inertia_kgm2 = 1.0
        self._free = False

    @property
    def free(self) -> bool:
        """Whether the model holds and the chosen estimator runs."""
        return self._free

    @property
    def model(self) -> MotionModel:
        """The model that holds while free. RuntimeError before it was set."""
        if self._model is None:
            raise RuntimeError("the layshaft's model has not been set")
        return self._model

    def drag_nm(self, omega_rad_s: float) -> float:
        """The data sheet's friction at a speed (Nm)."""
        if self._model is None:
            return 0.0
        return self._inertia_kgm2 * self._model.friction_per_s * abs(omega_rad_s)

    def set_models(self, models: LayshaftModels) -> None:
        """The splitter's step is known."""
        self._model, self._inertia_kgm2 = models.motion, models.inertia_kgm2
        self._filter.part("model")[:] = models.thesis

    def set_free(
        self,
        free: bool,
        time_us: float,
        events: list[str],  # noqa: ARG002
        is_shifting: bool = True,  # noqa: ARG002
    ) -> None:
        """The model begins or ceases to hold. It begins once there is a speed to begin with."""
        if free and not self._free:
            self._free = self._start(time_us)
        elif not free and self._free:
            self._free = False
            self._cruise.restart()

    def restart(self) -> None:
        """Tooth numbers were lost: starts again."""
        self._free = False
        self._cruise.restart()
        self._window.restart()

    def lose_speed(self) -> None:
        """Edges are missing: a baseline then starts again."""
        self.restart()

    def edges(self, batch: EdgeBatch, pressures: PressureSamples) -> None:  # noqa: ARG002
        """Takes new edges in order of time; the baselines know no measured pressure."""
        if self._estimator is Estimator.WINDOW:
            self._window.edges(batch)
        if not self._free:
            self._cruise.edges(batch)
        elif self._estimator is Estimator.THESIS and batch.time_us.size:
            switches = self._brake.arrays()
            thesis_filter(self._filter.flat, batch.time_us, batch.theta_rad, switches)
        elif self._estimator is Estimator.WINDOW:
            self._hold_window()

    def at(self, time_us: float) -> LayshaftState | None:
        """The state at a time; None without a speed, or without an edge for 60 ms."""
        if not self._free:
            return self._cruising(time_us)
        if abs(time_us - self._filter.time_us.item()) > ESTIMATE_STALE_US:
            return None
        state = self.latest()
        if self._estimator is Estimator.WINDOW and time_us > state.time_us:
            return self._held(state, time_us)
        return predict(state, time_us, self._brake.arrays(), self.model)

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts. Valid only while `free`."""
        memory = self._filter
        theta, omega, pressure = memory.x.tolist()
        (p00, _, _), (_, p11, _), (_, _, p22) = memory.p.tolist()
        return LayshaftState(
            memory.time_us.item(),
            theta,
            omega,
            pressure,
            math.sqrt(max(p00, 0.0)),
            math.sqrt(max(p11, 0.0)),
            math.sqrt(max(p22, 0.0)),
        )

    def _cruising(self, time_us: float) -> LayshaftState | None:
        shaft = self._cruise.at(time_us)
        if shaft is None:
            return None
        return LayshaftState(
            time_us,
            shaft.theta_rad,
            shaft.omega_rad_s,
            0.0,
            shaft.theta_sd_rad,
            shaft.omega_sd_rad_s,
            START_SD_PRESSURE_PA,
        )

    def _start(self, time_us: float) -> bool:
        shaft = self._cruise.at(time_us)
        if shaft is None:
            return False
        memory = self._filter
        memory.time_us[0] = time_us
        memory.x[:] = shaft.theta_rad, shaft.omega_rad_s, 0.0
        variances = shaft.theta_sd_rad**2, shaft.omega_sd_rad_s**2, START_SD_PRESSURE_PA**2
        memory.p[:] = np.diag(variances)
        return True

    def _hold_window(self) -> None:
        """Production baseline: last edge's angle, window speed, pressure from commands alone."""
        newest, memory = self._window.newest, self._filter
        before_us = memory.time_us.item()
        if newest is None or self._window.omega_rad_s is None or newest[0] <= before_us:
            return
        x = np.array([0.0, 0.0, memory.x[2]])
        propagate(x, before_us, float(newest[0]), self._brake.arrays(), memory.part("model"))
        memory.time_us[0] = newest[0]
        memory.x[:] = newest[1], self._window.omega_rad_s, x[2]

    def _held(self, state: LayshaftState, time_us: float) -> LayshaftState:
        """Between edges the production speed is held, not predicted."""
        predicted = predict(state, time_us, self._brake.arrays(), self.model)
        theta = state.theta_rad + state.omega_rad_s * (time_us - state.time_us) * 1e-6
        return predicted._replace(theta_rad=theta, omega_rad_s=state.omega_rad_s)
