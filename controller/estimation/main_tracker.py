"""The main shaft by the crossing-time filter, on a driveline that swings.

It has two models: while the main box is in neutral and the clutch open it turns with the vehicle
alone, and swings with its driveline (`motion/swing_kernels`) as was learned from earlier shifts;
with a gear in mesh its acceleration is unknown.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.estimation.crossing_filter import NO_PRESSURES, CrossingFilter
from meshpoint.controller.estimation.driveline_swing import (
    SIDES,
    DrivelineSwing,
    EdgeRun,
    MainWindow,
)
from meshpoint.controller.estimation.geared_wheel import GearedWheel
from meshpoint.controller.estimation.likelihood import prior, restored
from meshpoint.controller.estimation.swing_filter import MAIN_FILTER
from meshpoint.controller.estimation.wheel_tracker import HEED, STRUCK_RAD_S, WheelTracker
from meshpoint.controller.motion.kernels import OMEGA, THETA
from meshpoint.controller.motion.swing import ModeRates, ShaftState, Swing, SwingMotion
from meshpoint.controller.motion.swing_kernels import MODES, STEADY, SWING_STATES
from meshpoint.controller.records import Vector
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.gearbox import Range
from meshpoint.units import US

NO_SWITCHES: Final = np.empty((2, 0))
STILL: Final = ModeRates(1.0, 0.5, 0.0)
"""A mode that does not swing."""

CLEAR: Final = 20.0
"""Of two flanks one is certain when its likelihood is greater by e to half of this;"""
MOST_COMPARED: Final = 120
"""and after so many edges both tell the same."""
RELEASED_SHARE: Final = 0.1
"""Standard deviation of the speed when a gear comes out, as a share of it."""

LEAST_RAD_S: Final = 1.0
"""A slower shaft counts as this fast where the time from edge to edge is asked for."""


class MainTracker(WheelTracker):
    """Angle, speed, acceleration and swing of the main shaft."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        teeth: int,
        missing: tuple[int, ...] = (),
        geared: GearedWheel | None = None,
        range_ratios: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """range_ratios: i_range of low and high."""
        super().__init__(tuning, teeth, missing, geared, MAIN_FILTER)
        white = 2.0 * tuning.follow_rad_s2**2 * tuning.follow_s
        self._following = SwingMotion(white, tuning.main_walk_rad_s2**2, [STILL] * MODES)
        self.swings = {
            step: DrivelineSwing(tuning, ratio)
            for step, ratio in zip((Range.LOW, Range.HIGH), range_ratios, strict=True)
        }
        self.edge_time = prior(tuning.edge_time_s, 2.0, (1e-6, 2e-4), 0.03)
        """Standard deviation (s) of an edge's time."""
        self._swing = self.swings[Range.HIGH]
        self._free = False
        self._run = EdgeRun()
        self._other: CrossingFilter | None = None
        """The same shaft with its driveline at the other flank of the backlash when the gear came
        out, until the edges have told which."""
        self._side = SIDES[0]
        self._compared = 0
        self._began = (0.0, np.zeros(0), np.zeros((0, 0)))

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges."""
        if self.teeth.learner.running and batch.time_us.size:
            self._run.add(batch.time_us, batch.theta_rad, self.teeth.place(batch))
        self._take(batch, NO_PRESSURES, NO_SWITCHES, self._motion)
        if self._other is not None:
            teeth = self.teeth
            known = teeth.edges(batch, teeth.place(batch))
            self._other.take(known, teeth.sd_rad, NO_PRESSURES, NO_SWITCHES, self._motion)
            self._compare(self._other, batch.time_us.size)

    def _compare(self, other: CrossingFilter, edges: int) -> None:
        """Goes on with the flank that explains the edges better; with that alone once it is
        clear."""
        self._compared += edges
        ahead = self._filter.misfit(0) - other.misfit(0)
        if math.isfinite(ahead) and ahead > 0.0:
            self._filter, self._other, self._side = other, self._filter, -self._side
        if abs(ahead) > CLEAR or self._compared > MOST_COMPARED:
            self._other = None

    def take_edge_time(self, value_s: float, sd: float) -> None:
        """Sets what an earlier run learned of an edge's time."""
        self.edge_time = restored(self.edge_time, value_s, sd)
        self._filter.set_edge_time(self.edge_time.value)

    @property
    def _motion(self) -> SwingMotion:
        return self._swing.used.motion if self._free else self._following

    def lose_speed(self) -> None:
        """Starts again with the next edges; teeth keep their numbers."""
        super().lose_speed()
        self._free, self._other = False, None

    def set_free(self, free: bool, range_: Range | None, events: list[str]) -> None:
        """Whether it turns with the vehicle alone; its teeth and its swing are learned then."""
        if free and not self._free and self._running and range_ is not None:
            self._begin_free(range_)
        elif not free and self._free:
            self._end_free(events)

    def _begin_free(self, range_: Range) -> None:
        state, swing = self._filter, self.swings[range_]
        state.forget_past()
        state.heed(0.0)
        self._swing, self._free = swing, True
        # The torque that the gear had before it came out may have moved the shaft in any way since
        # the last edges: a few new ones tell more than what the estimate was.
        state.p[:2, :2] = 0.0
        state.p[THETA, THETA] = self._half_pitch_rad**2
        state.p[OMEGA, OMEGA] = (RELEASED_SHARE * state.x[OMEGA]) ** 2 + STRUCK_RAD_S**2
        x, p = state.x.copy(), state.p.copy()
        self._side, self._compared = SIDES[0], 0
        other = CrossingFilter(self._tuning, MAIN_FILTER)
        other.set_edge_time(self.edge_time.value)
        time_us = state.time_us
        sides = swing.used.sides
        for side, run in zip(sides, (state, other), strict=False):
            swing.used.start(x, p, side)
            run.begin(time_us, x, p)
        self._other = other if self._geared is None and len(sides) > 1 else None
        self._began = (state.time_us, x.copy(), p.copy())
        self._start_p = p
        self._run.begin()
        self.teeth.learner.begin(state.time_us, x, p)
        self._fuse(True)

    def _end_free(self, events: list[str]) -> None:
        self._free, self._other = False, None
        self._learn_swing()
        line = self.teeth.end_window()
        if line is not None:
            events.append(f"main shaft {line}")
        if self._geared is not None:
            self._geared.end_window(events)
        self._fuse(False)
        state = self._filter
        state.forget_past()
        state.heed(HEED)
        state.x[2:], state.p[2:, :], state.p[:, 2:] = 0.0, 0.0, 0.0
        state.p[STEADY, STEADY] = self._tuning.main_start_rad_s2**2
        # The flank's impact changes the speed in a step.
        state.p[THETA, THETA] += self._half_pitch_rad**2
        state.p[OMEGA, OMEGA] += STRUCK_RAD_S**2

    def _learn_swing(self) -> None:
        """The window's swing, and its teeth once more with what is known of the swing now."""
        teeth, run, (time_us, x, p) = self.teeth, self._run, self._began
        edges, places = run.edges, run.places
        known = edges
        if teeth.learned:
            known = edges.copy()
            known[1] += teeth.error_rad[places]
        window = MainWindow(known, time_us, x, p, teeth.sd_rad)
        self.edge_time = self._swing.learn(window, self.edge_time, teeth.learned)
        self._filter.set_edge_time(self.edge_time.value)
        if teeth.learner.running:
            start_p = self._start_p.copy()
            self._swing.used.start(x, start_p, self._side)
            teeth.learner.begin(time_us, x, start_p)
            teeth.learner.set_edge_time(self.edge_time.value)
            teeth.learner.take_all(edges, places, self._swing.used.motion)

    def at(self, time_us: float) -> ShaftState | None:
        """The state at a time; None before enough edges, or without any for 60 ms."""
        if not self._fresh(time_us):
            return None
        state = self._filter
        motion = self._motion
        newest = Swing(state.x, state.p, motion)
        x, p = newest.spread_ahead((time_us - state.time_us) * US)
        theta_sd, omega_sd = (math.sqrt(max(0.0, p.item(i, i))) for i in (THETA, OMEGA))
        edge_rad2 = (x[OMEGA] * self.edge_time.value) ** 2 + self.teeth.sd_rad**2
        # There are two edges a pitch, and half a pitch takes this long.
        edge_s = self._half_pitch_rad / max(abs(x[OMEGA]), LEAST_RAD_S)
        swing = Swing(x, p, motion, edge_rad2 * edge_s)
        return ShaftState(time_us, x[THETA], x[OMEGA], theta_sd, omega_sd, x[STEADY], swing)

    def _first_state(self, omega_sd_rad_s: float) -> tuple[Vector, Vector]:
        p = np.zeros((SWING_STATES, SWING_STATES))
        p[THETA, THETA] = (2.0 * self._tuning.tooth_error_rad) ** 2
        p[OMEGA, OMEGA] = omega_sd_rad_s**2
        p[STEADY, STEADY] = self._tuning.main_start_rad_s2**2
        return np.zeros(SWING_STATES), p
