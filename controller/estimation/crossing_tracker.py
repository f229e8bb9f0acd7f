"""Layshaft and main shaft by the crossing-time filter, with teeth learned while they move freely.

The layshaft has two models: its own while clutch and main box leave it free (thesis 4.13), and one
with an unknown acceleration while a gear is in mesh. The filter's state and the learned teeth are
kept when the model changes.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.estimation.brake_model import BrakeModel, Carried
from meshpoint.controller.estimation.crossing_filter import NO_PRESSURES, CrossingFilter, Pressures
from meshpoint.controller.estimation.cruise import ESTIMATE_STALE_US, ShaftState, WindowSpeed
from meshpoint.controller.estimation.free_run import FreeRun
from meshpoint.controller.estimation.geared_wheel import GearedWheel
from meshpoint.controller.estimation.layshaft import LayshaftModels
from meshpoint.controller.estimation.teeth import WheelTeeth
from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.kernels import (
    DISTURBANCE,
    DRAG,
    GAIN,
    OMEGA,
    PRESSURE,
    STATES,
    THETA,
)
from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.controller.motion.models import (
    LayshaftState,
    MotionModel,
    diagonal,
    following_motion,
)
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import CrossingFilterTuning

NO_SWITCHES: Final = np.empty((2, 0))
LEAST_FREE_EDGES: Final = 100
"""With fewer edges of free motion, gain and drag are not taken over from the filter."""

STRUCK_RAD_S: Final = 5.0
"""Standard deviation of the step that a flank's impact makes in the layshaft's speed (48 rpm)."""


class _Shaft:
    """A filter over a wheel's edges with its teeth: what layshaft and main shaft have in common."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        teeth: int,
        missing: tuple[int, ...],
        start_rad_s2: float,
        geared: GearedWheel | None,
    ) -> None:
        self._tuning = tuning
        self._start_rad_s2 = start_rad_s2
        self._filter = CrossingFilter(tuning)
        self.teeth = WheelTeeth(teeth, tuning, missing)
        self._half_pitch_rad = math.pi / teeth
        self._seed = WindowSpeed()
        self._running = False
        self._geared = geared
        self._own_us = 0.0
        self._start_p = np.zeros((STATES, STATES))
        """Covariance of the shaft's state at the start of a window in which teeth are learned."""
        side = tuning.mesh_side_rad**2 / tuning.mesh_side_s
        at_flank = tuning.mesh_walk_rad**2
        self._filter.set_mesh(at_flank, max(at_flank, side), tuning.mesh_side_s * 1e6)
        self._fuses = False

    def _fuse(self, free: bool) -> None:
        """The shaft becomes free, or ceases to be: the mesh of a geared wheel then lies at another
        flank. While a gear is in mesh it may change flanks at any time, and its edges would make
        the estimate worse (docs/estimation.md), so it is fused only while the shaft is free."""
        self._fuses = free and self._geared is not None
        if self._geared is not None:
            self._filter.lose_offset()

    def lose_speed(self) -> None:
        """Starts again with the next edges; teeth keep their numbers."""
        self._running = self._fuses = False
        self._seed.restart()
        self.teeth.learner.running = False
        if self._geared is not None:
            self._geared.teeth.learner.running = False

    def restart(self) -> None:
        """Tooth numbers were lost: starts again, and which tooth is which is no longer known."""
        self.lose_speed()
        self.teeth.lose_numbers()

    @property
    def newest_us(self) -> float:
        """Time of the newest edge used; 0 before there was one."""
        return self._filter.time_us

    def _take(
        self,
        batch: EdgeBatch,
        pressures: Pressures,
        switches: Vector,
        model: MotionModel,
    ) -> None:
        if not self._running:
            self._start(batch)
            return
        wheel, geared = self._geared, None
        if wheel is not None:
            geared = wheel.edges_for(self._filter) if self._fuses else None
            self._own_us = batch.time_us[-1] if batch.time_us.size else self._own_us
        if not batch.time_us.size and not pressures.time_us.size and geared is None:
            return
        teeth, place = self.teeth, self.teeth.place(batch)
        edges = teeth.edges(batch, place)
        self._filter.take(edges, teeth.sd_rad, pressures, switches, model, geared)
        if teeth.learner.running:
            if wheel is not None:
                wheel.learn(self._filter, self._start_p, pressures, switches, model)
            teeth.learner.take(batch, place, pressures, switches, model)
            if teeth.look():
                self._teeth_found()

    def _teeth_found(self) -> None:
        """The tooth errors have just become known, so the angles of edges change by up to the error
        of an unlearned tooth: the covariance is widened by it."""
        self._filter.forget_past()
        self._filter.p[THETA, THETA] += self._tuning.tooth_error_rad**2

    def _start(self, batch: EdgeBatch) -> None:
        self._seed.edges(batch)
        newest, omega = self._seed.newest, self._seed.omega_rad_s
        if omega is None or newest is None:
            return
        x = np.array([newest[1], omega, 0.0, 0.0, 1.0, 0.0])
        p = self._covariance(0.05 * abs(omega) + 1.0, self._start_rad_s2)
        self._filter.begin(newest[0], x, p)
        self._running, self._own_us = True, newest[0]

    def _covariance(self, omega_sd_rad_s: float, rad_s2: float) -> Vector:
        tuning = self._tuning
        theta_sd = 2.0 * tuning.tooth_error_rad
        return diagonal(theta_sd, omega_sd_rad_s, 1.0, rad_s2, 1e-9, rad_s2)

    def _fresh(self, time_us: float) -> bool:
        # Edges of a geared wheel must not hide that the shaft's own sensor has failed.
        newest_us = self._filter.time_us if self._geared is None else self._own_us
        return self._running and time_us - newest_us <= ESTIMATE_STALE_US


class CrossingTracker(_Shaft):
    """Angle, speed and brake pressure of the layshaft at any time near now."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        brake: BrakeInput,
        known: BrakeModel,
        teeth: int,
        missing: tuple[int, ...] = (),
        geared: GearedWheel | None = None,
    ) -> None:
        super().__init__(tuning, teeth, missing, tuning.follow_rad_s2, geared)
        self._brake = brake
        self._known = known
        self._following = following_motion(tuning.follow_rad_s2, tuning.follow_s, 50.0)
        self._model: MotionModel | None = None
        self._inertia_kgm2 = 1.0
        self._free = False
        self._free_edges = 0
        self._run = FreeRun(tuning)
        self._one_pattern = True
        """Whether the tooth errors in use have stayed the same since the layshaft became free."""

    @property
    def free(self) -> bool:
        """Whether clutch and main box let the layshaft turn by itself, so that its model holds."""
        return self._free

    @property
    def model(self) -> MotionModel:
        """The model that holds while free. RuntimeError before it was set."""
        if self._model is None:
            raise RuntimeError("the layshaft's model has not been set")
        return self._model

    def set_models(self, models: LayshaftModels) -> None:
        """The splitter's step or the brake's law is new."""
        self._model, self._inertia_kgm2 = models.motion, models.inertia_kgm2

    def set_free(self, free: bool, time_us: float, events: list[str]) -> None:  # noqa: ARG002
        """The model begins or ceases to hold. It begins once there is a speed to begin with."""
        if free and not self._free and self._running:
            self._begin_free()
        elif not free and self._free:
            self._end_free(events)

    def lose_speed(self) -> None:
        """Starts anew with the edges to come; teeth keep their numbers."""
        super().lose_speed()
        self._free = False

    def edges(self, batch: EdgeBatch, pressures: Pressures) -> None:
        """Takes new edges and pressures."""
        switches = self._brake.arrays()
        if not self._free:
            self._take(batch, NO_PRESSURES, switches, self._following)
            return
        self._run.add(self.teeth.edges(batch, self.teeth.place(batch)), pressures)
        touch_pa = self._known.touch_pa.value
        above = Pressures(pressures.time_us, np.maximum(pressures.pressure_pa - touch_pa, 0.0))
        self._take(batch, above, switches, self.model)
        self._free_edges += batch.time_us.size

    def at(self, time_us: float) -> LayshaftState | None:
        """The state at a time; None without a speed, or without an edge for 60 ms."""
        if not self._fresh(time_us):
            return None
        model = self.model if self._free else self._following
        return self._filter.at(time_us, self._brake.arrays(), model)

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts. Valid only while `free`."""
        return self._filter.latest()

    def _teeth_found(self) -> None:
        super()._teeth_found()
        self._one_pattern = False

    def _begin_free(self) -> None:
        tuning, known, state = self._tuning, self._known, self._filter
        state.forget_past()
        gain_sd = math.hypot(known.gain.sd, tuning.gain_pause)
        drag_sd = math.hypot(known.drag_nm.sd, tuning.drag_pause_nm) / self._inertia_kgm2
        drag = known.drag_nm.value / self._inertia_kgm2
        torque_sd = tuning.torque_disturbance_nm / self._inertia_kgm2
        x, both = state.x, state.p[:2, :2].copy()
        x[PRESSURE], x[DISTURBANCE], x[GAIN], x[DRAG] = 0.0, 0.0, known.gain.value, drag
        pressure_sd = tuning.pressure_start_sd_pa
        state.p[:] = diagonal(0.0, 0.0, pressure_sd, torque_sd, gain_sd, drag_sd)
        state.p[:2, :2] = both
        if not self.teeth.learned:
            # The angle so far was estimated with unknown tooth errors.
            state.p[THETA, THETA] += tuning.tooth_error_rad**2
        p = diagonal(2.0 * tuning.tooth_error_rad, 1.0, pressure_sd, torque_sd, gain_sd, drag_sd)
        self.teeth.learner.begin(state.time_us, x, p)
        self._start_p = p
        self._fuse(True)
        self._run.begin(state.time_us, state.x, state.p)
        self._free, self._free_edges, self._one_pattern = True, 0, True

    def _end_free(self, events: list[str]) -> None:
        self._free = False
        state, known, inertia = self._filter, self._known, self._inertia_kgm2
        state.forget_past()
        line = self.teeth.end_window()
        if line is not None:
            events.append(f"layshaft {line}")
        if self._geared is not None:
            self._geared.end_window(events)
        self._fuse(False)
        x, sd = state.x, np.sqrt(np.maximum(np.diag(state.p), 0.0))
        if self._free_edges >= LEAST_FREE_EDGES and np.isfinite(x).all():
            known.gain = Carried(float(x[GAIN]), float(sd[GAIN]))
            known.drag_nm = Carried(float(x[DRAG]) * inertia, float(sd[DRAG]) * inertia)
            learned = known.learn(*self._run.pressures, *self._brake.commands)
            if learned and self.teeth.learned and self._one_pattern:
                sd_rad = self.teeth.sd_rad
                self._run.learn_touch(known, sd_rad, self._brake.arrays(), self.model)
        # From here on the torque on the layshaft is unknown.
        follow = self._tuning.follow_rad_s2
        x[DISTURBANCE], x[DRAG] = 0.0, 0.0
        both = state.p[:2, :2].copy()
        state.p[:] = diagonal(0.0, 0.0, 1.0, follow, 1e-9, follow)
        state.p[:2, :2] = both
        # The flank's impact has changed the speed in a step, which the estimate did not follow.
        state.p[THETA, THETA] += self._half_pitch_rad**2
        state.p[OMEGA, OMEGA] += STRUCK_RAD_S**2


class MainTracker(_Shaft):
    """Angle, speed and acceleration of the main shaft."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        teeth: int,
        missing: tuple[int, ...] = (),
        geared: GearedWheel | None = None,
    ) -> None:
        super().__init__(tuning, teeth, missing, tuning.main_rad_s2, geared)
        self._model = following_motion(tuning.main_rad_s2, tuning.main_s, tuning.main_walk_rad_s2)

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges."""
        self._take(batch, NO_PRESSURES, NO_SWITCHES, self._model)

    def set_free(self, free: bool, events: list[str]) -> None:
        """Whether it turns with the vehicle alone; its teeth are learned then."""
        learner = self.teeth.learner
        if free and not learner.running and self._running:
            self._start_p = p = self._covariance(1.0, self._start_rad_s2)
            learner.begin(self._filter.time_us, self._filter.x, p)
            self._fuse(True)
        elif not free and learner.running:
            line = self.teeth.end_window()
            if line is not None:
                events.append(f"main shaft {line}")
            if self._geared is not None:
                self._geared.end_window(events)
            self._fuse(False)

    def at(self, time_us: float) -> ShaftState | None:
        """The state at a time; None before enough edges, or without any for 60 ms."""
        if not self._fresh(time_us):
            return None
        state = self._filter.at(time_us, NO_SWITCHES, self._model)
        return ShaftState(
            time_us,
            state.theta_rad,
            state.omega_rad_s,
            state.theta_sd_rad,
            state.omega_sd_rad_s,
            state.drag_rad_s2,
        )
