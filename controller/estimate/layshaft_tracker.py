"""The layshaft by the crossing-time filter, with teeth learned while it moves freely.

It has two models: its own while clutch and main box leave it free (thesis 4.13), and one with an
unknown acceleration while a gear is in mesh. The filter's state and the learned teeth are kept when
the model changes.

What a free run teaches of brake, scatter and friction takes longer than a tick, and nothing of it
is needed before the next request: it is learned in parts, one a step, while a gear is in mesh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import ClassVar, Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.estimate.crossing_filter import NO_PRESSURES
from meshpoint.controller.estimate.figures import Search, prior
from meshpoint.controller.estimate.free_run import EDGE_TIME, MEMORY, TORQUE, FreeMotion, FreeRun
from meshpoint.controller.estimate.wheel_tracker import NOISE_ADAPTATION, STRUCK_RAD_S, WheelTracker
from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import (
    WALK_RAD_S2,
    BrakeInput,
    Disturbance,
    LayshaftState,
    MotionModel,
    diagonal,
    following_motion,
    following_start,
)
from meshpoint.controller.models.layshaft_kernels import (
    DISTURBANCE,
    DRAG,
    GAIN,
    OMEGA,
    PRESSURE,
    THETA,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.records import Vector

VISCOUS_FACTOR: Final = 3.0
"""A gearbox's viscous friction is its sheet's within this factor, one standard deviation: oil,
temperature and load change it."""
VISCOUS_NMS: Final = (1e-3, 2.0)
"""Least and greatest viscous friction that is learned (Nms)."""
VISCOUS_SD: Final = 0.1
"""The viscous friction's logarithm is never known better than this, one standard deviation."""
LEAST_FREE_EDGES: Final = 100
"""With fewer edges of free motion, gain and drag are not taken over from the filter."""


class LayshaftModels(NamedTuple):
    """The free layshaft for one step of the splitter."""

    motion: MotionModel
    thesis: Vector
    """A `kernels.Linear`: the thesis's linear model with the data sheet's values."""
    inertia_kgm2: float


class Part(Enum):
    """What is learned next of a free run that has ended."""

    BRAKE = auto()
    TOUCH_AND_LAG = auto()
    NOISE = auto()
    FRICTION = auto()
    NOTHING = auto()


@dataclass
class LearningTask:
    """A free run that has ended, and what of it is still to be learned."""

    run: FreeRun
    brake: BrakeInput
    """The brake's switches in it."""
    model: MotionModel
    inertia_kgm2: float
    steady_rad_s: float | None
    """The speed at which the drag was seen before; None in the first run."""
    part: Part = Part.BRAKE
    noise: Search | None = None


class CrossingTracker(WheelTracker[LearningTask]):
    """Angle, speed and brake pressure of the layshaft at any time near now."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        brake: BrakeInput,
        known: BrakeModel,
        teeth: int,
        missing: tuple[int, ...] = (),
        friction_nms: float = 0.0,
    ) -> None:
        """friction_nms: the sheet's viscous friction."""
        super().__init__(tuning, teeth, missing)
        self._brake = brake
        self._known = known
        self._following = following_motion(tuning.follow_rad_s2, tuning.follow_s, WALK_RAD_S2)
        self._model: MotionModel | None = None
        self._inertia_kgm2 = 1.0
        self._free_edges = 0
        self._run = FreeRun(tuning)
        self._is_of_shift = False
        """Whether the free run began in a shift. One that did not teaches nothing: on a stand or in
        a workshop the shafts are turned by others."""
        self.noise = [
            prior(tuning.edge_time_s, 2.0, (1e-6, 2e-4), 0.03),
            prior(tuning.torque_disturbance_nm, 3.0, (0.02, 100.0), 0.1),
            prior(tuning.disturbance_s, 2.0, (2e-3, 0.5), 0.1),
        ]
        """What is known of an edge's time (s), the disturbance's torque (Nm) and memory (s)."""
        self.noise_shifts = 0
        """From how many shifts that was learned."""
        self.friction = prior(
            max(friction_nms, VISCOUS_NMS[0]), VISCOUS_FACTOR, VISCOUS_NMS, VISCOUS_SD
        )
        """What is known of the viscous friction, Nms."""
        self._steady_rad_s: float | None = None
        """The speed at which the drag was seen last; None before the first shift."""

    def _first_state(self, omega_sd_rad_s: float) -> tuple[Vector, Vector]:
        theta_sd = 2.0 * self._tuning.tooth_error_rad
        return following_start(theta_sd, omega_sd_rad_s, self._tuning.follow_rad_s2)

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

    def drag_nm(self, omega_rad_s: float) -> float:
        """Torque that brakes the free layshaft at a speed: the sheet's friction, and the drag that
        was learned (Nm, positive)."""
        if self._model is None:
            return 0.0
        friction_nm = self._inertia_kgm2 * self._model.friction_per_s * abs(omega_rad_s)
        return max(0.0, friction_nm - self._known.drag_nm.value)

    @property
    def own_drag_nm(self) -> float:
        """The same at its newest speed, of the gearbox alone."""
        return self.drag_nm(float(self._filter.x[OMEGA]))

    @property
    def disturbance(self) -> Disturbance:
        """The torques that the model leaves out, as learned."""
        return Disturbance(self.noise[TORQUE].value, self.noise[MEMORY].value)

    def take_noise(
        self, shifts: int, noise: Sequence[tuple[float, float]], friction: tuple[float, float]
    ) -> None:
        """Sets what earlier runs learned of `noise` and `friction`, the latter unless it is 0:
        value and standard deviation of each."""
        self.noise_shifts = shifts
        self.noise = [one.restored(*given) for one, given in zip(self.noise, noise, strict=True)]
        self._filter.set_edge_time(self.noise[EDGE_TIME].value)
        if friction[0] > 0.0:
            self.friction = self.friction.restored(*friction)

    def set_models(self, models: LayshaftModels) -> None:
        """The splitter's step or the brake's law is new."""
        self._model, self._inertia_kgm2 = models.motion, models.inertia_kgm2

    def set_free(
        self,
        free: bool,
        time_us: float,  # noqa: ARG002
        events: list[str],
        is_shifting: bool = True,
    ) -> None:
        """The model begins or ceases to hold. It begins once there is a speed to begin with."""
        if free and not self._free and self._running:
            self._begin_free()
            self._is_of_shift = is_shifting
        elif not free and self._free:
            self._end_free(events)

    def lose_speed(self) -> None:
        """Starts anew with the edges to come; teeth keep their numbers."""
        super().lose_speed()
        self._free = False

    def edges(self, batch: EdgeBatch, pressures: PressureSamples) -> None:
        """Takes new edges and pressures."""
        switches = self._brake.arrays()
        if not self._free:
            self._take(batch, NO_PRESSURES, switches, self._following)
            self._in_gear.edges(batch)
            return
        self._run.add(batch, self.teeth.place(batch), pressures)
        self._take(batch, self._known.above_touch(pressures), switches, self.model)
        self._free_edges += batch.time_us.size

    def at(self, time_us: float) -> LayshaftState | None:
        """The state at a time; None without a speed, or without an edge for 60 ms."""
        if not self._fresh(time_us):
            return None
        model = self.model if self._free else self._following
        return self._filter.at(time_us, self._brake.arrays(), model)

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts. Valid only while `free`."""
        state = self._filter.latest()
        edge_time_s = self.noise[EDGE_TIME].value
        return state._replace(edge_rad2_s=self._edge_rad2_s(state.omega_rad_s, edge_time_s))

    def _begin_free(self) -> None:
        self._in_gear.pause()
        tuning, known, state = self._tuning, self._known, self._filter
        state.forget_past()
        state.noise_adaptation(0.0)
        gain_sd = math.hypot(known.gain.sd, tuning.gain_pause)
        drag_sd = math.hypot(known.drag_nm.sd, tuning.drag_pause_nm) / self._inertia_kgm2
        drag = known.drag_nm.value / self._inertia_kgm2
        torque_sd = self.disturbance.torque_nm / self._inertia_kgm2
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
        self.teeth.learner.set_edge_time(self.noise[EDGE_TIME].value)
        self._run.begin(state.time_us, state.x, state.p)
        self._free, self._free_edges = True, 0

    def _end_free(self, events: list[str]) -> None:
        self._free = False
        state, known = self._filter, self._known
        state.forget_past()
        self._learn_teeth("layshaft", events)
        x = state.x
        is_told = self._is_of_shift and self._free_edges >= LEAST_FREE_EDGES
        if is_told and np.isfinite(x).all():
            known.carry(x, state.p, self._inertia_kgm2)
            brake = BrakeInput(0)
            brake.follow(self._brake)
            self._lessons.append(
                LearningTask(self._run, brake, self.model, self._inertia_kgm2, self._steady_rad_s)
            )
            self._run = FreeRun(self._tuning)
            self._steady_rad_s = float(x[OMEGA])
        # From here on the torque on the layshaft is unknown.
        state.noise_adaptation(NOISE_ADAPTATION)
        follow = self._tuning.follow_rad_s2
        x[DISTURBANCE], x[DRAG] = 0.0, 0.0
        both = state.p[:2, :2].copy()
        state.p[:] = diagonal(0.0, 0.0, 1.0, follow, 1e-9, follow)
        state.p[:2, :2] = both
        # The flank's impact has changed the speed in a step, which the estimate did not follow.
        state.p[THETA, THETA] += self._half_pitch_rad**2
        state.p[OMEGA, OMEGA] += STRUCK_RAD_S**2

    def _learn_part(self, lesson: LearningTask) -> bool:
        lesson.part = self._LEARN[lesson.part](self, lesson)
        return lesson.part is Part.NOTHING

    def _free_motion(self, lesson: LearningTask) -> FreeMotion:
        """By what is known of the brake's delays and of the teeth now."""
        known = self._known
        lesson.brake.set_delays(known.off_delay_us, known.on_delay_us)
        edge_time_s, switches = self.noise[EDGE_TIME].value, lesson.brake.arrays()
        return FreeMotion(self.teeth, edge_time_s, switches, lesson.model, lesson.inertia_kgm2)

    def _learn_brake(self, lesson: LearningTask) -> Part:
        learned = self._known.learn(lesson.run.samples, *lesson.brake.commands)
        return Part.TOUCH_AND_LAG if learned and self.teeth.learned else Part.NOISE

    def _learn_touch_and_lag(self, lesson: LearningTask) -> Part:
        lesson.run.learn_touch_and_lag(self._known, self._free_motion(lesson))
        return Part.NOISE

    def _learn_noise(self, lesson: LearningTask) -> Part:
        """How much of what was not expected is the edges' own, and how much is torque."""
        if lesson.noise is None:
            motion = self._free_motion(lesson)
            lesson.noise = lesson.run.search_noise(self.noise, self._known, motion)
        lesson.noise.step()
        if not lesson.noise.is_over:
            return Part.NOISE
        self.noise = lesson.noise.found.figures
        self.noise_shifts += 1
        self._filter.set_edge_time(self.noise[EDGE_TIME].value)
        return Part.FRICTION

    def _learn_friction(self, lesson: LearningTask) -> Part:
        if self.teeth.learned and lesson.steady_rad_s is not None:
            self.friction = lesson.run.learn_friction(
                self.friction, lesson.steady_rad_s, self._known, self._free_motion(lesson)
            )
        return Part.NOTHING

    _LEARN: ClassVar = {
        Part.BRAKE: _learn_brake,
        Part.TOUCH_AND_LAG: _learn_touch_and_lag,
        Part.NOISE: _learn_noise,
        Part.FRICTION: _learn_friction,
    }
    """How each part is learned; what comes next."""
