"""The main shaft by the crossing-time filter, on a driveline that swings.

While the main box is in neutral and the range in, it turns with the vehicle alone. It then swings
with its driveline as was learned from earlier shifts, by one of two models: linear
(`models/swing`), or with the driveline's backlash (`models/backlash`), whichever has predicted
better. With a gear in mesh its acceleration is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_filter import MAIN_FILTER, NO_PRESSURES
from meshpoint.controller.estimate.driveline_swing import (
    LEAST_EDGES,
    DrivelineSwing,
    EdgeRun,
    MainWindow,
)
from meshpoint.controller.estimate.figures import Search, prior
from meshpoint.controller.estimate.lash import Lash, StartWatch
from meshpoint.controller.estimate.lash_cloud import BacklashParticleFilter
from meshpoint.controller.estimate.loaded_driveline import LoadedDriveline, Shafts
from meshpoint.controller.estimate.wheel_tracker import NOISE_ADAPTATION, STRUCK_RAD_S, WheelTracker
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.backlash import LashTrajectory
from meshpoint.controller.models.layshaft_kernels import OMEGA, THETA
from meshpoint.controller.models.swing import (
    STEADY,
    SWING_STATES,
    ShaftState,
    Swing,
    SwingMotion,
    SwingRates,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.learned import SwingRecord
from meshpoint.gearbox import Range
from meshpoint.gearbox.driveline import Axle
from meshpoint.kernels.records import RecordMemory, Vector
from meshpoint.units import US

AHEAD_US: Final = 45_000.0
"""A sleeve takes this long to its gear, so predictions are compared so far ahead."""
EACH_US: Final = 18_000.0
"""Every second step asks for a prediction: those of nearer ones overlap the more."""
LUCK: Final = 0.05
"""A prediction is never taken for quite wrong."""
FORGET: Final = 0.8
"""Weight of earlier windows against a new one."""
BELIEVED: Final = 5.0
"""Backlash is believed once its score is above this: it is then likelier by e to half of this."""
DROPPED: Final = 0.0
"""Backlash that is believed is dropped when its score falls to this: it is then no likelier than
the linear swing."""
LEAST_WINDOWS: Final = 3
"""Least number of windows before backlash is believed: in the first ones the linear swing has
little but its priors."""
MOST_A_WINDOW: Final = 8.0
"""One window, in which a model lost the driveline, counts for no more than this."""
REJECTED: Final = -4.0
"""At this score or below, backlash is so unlikely that it is no longer tried."""
RETRIED: Final = -3.0
"""Backlash that was rejected is tried again above this score: the windows that spoke against it are
then forgotten so far."""
LOWEST: Final = -6.0
"""The score falls no lower, however many windows speak against backlash, so that it is tried again
after the fourth: a cloud that loses its driveline twice speaks as strongly against a backlash as a
driveline that has none."""
STEP_SHARE: Final = 20_000.0 / AHEAD_US
"""Time from one prediction to the next over the horizon."""

NO_SWITCHES: Final = np.empty((2, 0))
STILL: Final = SwingRates(1.0, 0.5, 0.0)
"""A shaft that does not swing."""
RELEASED_SHARE: Final = 0.1
"""Standard deviation of the speed when a gear comes out, as a share of it."""


class Prediction(NamedTuple):
    """An angle predicted, and its standard deviation."""

    angle_rad: float
    sd_rad: float


class ModelSelector:
    """Scores of both models in one step of the range, over the windows seen."""

    def __init__(self) -> None:
        self._for_lash = 0.0
        self._windows = 0
        """How many have ended."""
        self._tried = True
        self._believed = False
        self._window = 0.0
        self._open: list[tuple[float, Prediction, Prediction]] = []
        self._newest: tuple[float, float] | None = None

    @property
    def lash_is_selected(self) -> bool:
        """Whether the backlash has predicted better so far."""
        return self._believed

    @property
    def lash_is_candidate(self) -> bool:
        """Whether the backlash is worth a try."""
        return self._tried

    def restore(self, has_lash: bool) -> None:
        """Starts from what an earlier run believed."""
        self._for_lash = 2.0 * BELIEVED if has_lash else 0.0
        self._windows = LEAST_WINDOWS if has_lash else 0
        self._believed = has_lash

    def begin(self) -> None:
        """A window begins."""
        self._window, self._newest = 0.0, None
        self._open.clear()

    def is_due(self, from_us: float) -> bool:
        """Whether the next predictions are due."""
        return not self._open or from_us + AHEAD_US >= self._open[-1][0] + EACH_US

    def predict(self, from_us: float, swing: Prediction, lash: Prediction) -> None:
        """Both predictions of the angle `AHEAD_US` after a time."""
        self._open.append((from_us + AHEAD_US, swing, lash))

    def judge(self, edges: Vector, within_rad: float) -> None:
        """Compares the predictions whose time has come with the edges, (2, n): how probable each
        made it that the angle is so near."""
        if not edges.shape[1]:
            return
        if self._newest is not None:
            edges = np.concatenate((np.array(self._newest)[:, np.newaxis], edges), axis=1)
        self._newest = (float(edges[0, -1]), float(edges[1, -1]))
        while self._open and self._open[0][0] <= edges[0, -1]:
            time_us, swing, lash = self._open.pop(0)
            angle = float(np.interp(time_us, edges[0], edges[1]))
            self._window += _deviance(swing, angle, within_rad) - _deviance(lash, angle, within_rad)

    def end(self) -> None:
        """The window is over. Predictions overlap: those of one horizon count as one."""
        self._windows += 1
        shown = min(max(self._window * STEP_SHARE, -MOST_A_WINDOW), MOST_A_WINDOW)
        self._for_lash = max(LOWEST, FORGET * self._for_lash + shown)
        self._tried = self._for_lash > (REJECTED if self._tried else RETRIED)
        enough = self._for_lash > (DROPPED if self._believed else BELIEVED)
        self._believed = self._windows >= LEAST_WINDOWS and enough


def _deviance(predicted: Prediction, angle_rad: float, within_rad: float) -> float:
    """Minus twice the logarithm of the probability given to the angle within half a gap."""
    scale = 1.0 / (math.sqrt(2.0) * predicted.sd_rad)
    off = angle_rad - predicted.angle_rad
    share = math.erf((off + within_rad) * scale) - math.erf((off - within_rad) * scale)
    return -2.0 * math.log(LUCK + (1.0 - LUCK) * 0.5 * share)


class DrivelineSpec(NamedTuple):
    """What turns behind the gearbox, and how closely the main shaft's angle has to be known."""

    axle: Axle = Axle()
    half_gap_rad: float = math.radians(1.0)


@dataclass
class SwingLesson:
    """An interval in neutral that has ended, and how far its swing has been learned."""

    swing: DrivelineSwing
    window: MainWindow
    teeth_known: bool
    search: Search | None = None


class MainTracker(WheelTracker[SwingLesson]):
    """Angle, speed, acceleration and swing of the main shaft."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        teeth: int,
        missing: tuple[int, ...] = (),
        range_ratios: tuple[float, float] = (1.0, 1.0),
        behind: DrivelineSpec | None = None,
    ) -> None:
        """range_ratios: i_range of low and high; behind: what turns behind the gearbox."""
        super().__init__(tuning, teeth, missing, MAIN_FILTER)
        white = 2.0 * tuning.follow_rad_s2**2 * tuning.follow_s
        self._following = SwingMotion(white, tuning.main_walk_rad_s2**2, STILL)
        steps = (Range.LOW, Range.HIGH)
        axle, self._half_gap_rad = DrivelineSpec() if behind is None else behind
        self._swings = {step: DrivelineSwing(tuning) for step in steps}
        self._lashes = {
            step: Lash(axle, tuning.lash_rad, tuning.lash_factor, ratio)
            for step, ratio in zip(steps, range_ratios, strict=True)
        }
        self._rivals = {step: ModelSelector() for step in steps}
        self.edge_time = prior(tuning.edge_time_s, 2.0, (1e-6, 2e-4), 0.03)
        """Standard deviation (s) of an edge's time."""
        self._range = Range.HIGH
        self._run = EdgeRun()
        self._before = StartWatch()
        self._cloud: BacklashParticleFilter | None = None
        """The drivelines that may be, once the first edges in neutral have come."""
        self._trajectory: tuple[float, LashTrajectory | None] = (0.0, None)
        """The newest edges' time and the trajectory from then on."""
        self._began = (0.0, np.zeros(0), np.zeros((0, 0)))

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges."""
        if self.teeth.learner.running and batch.time_us.size:
            self._run.add(batch.time_us, batch.theta_rad, self.teeth.place(batch))
        self._take(batch, NO_PRESSURES, NO_SWITCHES, self._motion)
        if not self._free:
            self._in_gear.edges(batch)
        elif batch.time_us.size and self._running:
            self._follow_lash(self.placed)

    def _follow_lash(self, edges: Vector) -> None:
        """The cloud takes new edges, and both models say what comes next."""
        before, lash, rivals = self._before, self._lashes[self._range], self._rivals[self._range]
        if not rivals.lash_is_candidate:
            return
        if self._cloud is None:
            start = before.take_out(edges, lash)
            if start is None:
                return
            self._cloud, edges = (
                BacklashParticleFilter(lash, start, self.edge_time.value),
                before.waiting,
            )
        self._cloud.take(edges, self.teeth.sd_rad)
        rivals.judge(edges, self._half_gap_rad)
        state = self._filter
        asked = rivals.is_due(state.time_us)
        if not (asked or rivals.lash_is_selected):
            return
        trajectory = self._cloud.trajectory(self._half_gap_rad)
        self._trajectory = (self._cloud.time_us, trajectory)
        if asked and trajectory is not None:
            wait_s = AHEAD_US * US
            x, p = Swing(state.x, state.p, self._motion).spread_ahead(wait_s)
            swing = Prediction(x.item(THETA), math.sqrt(max(0.0, p.item(THETA, THETA))))
            wait_s += (state.time_us - self._cloud.time_us) * US
            other = Prediction(trajectory.ahead(wait_s)[0], trajectory.theta_sd_ahead(wait_s))
            rivals.predict(state.time_us, swing, other)

    def take_edge_time(self, value_s: float, sd: float) -> None:
        """Sets what an earlier run learned of an edge's time."""
        self.edge_time = self.edge_time.restored(value_s, sd)
        self._filter.set_edge_time(self.edge_time.value)

    @property
    def _motion(self) -> SwingMotion:
        return self._swings[self._range].motion if self._free else self._following

    def _teeth_motion(self, model: RecordMemory) -> RecordMemory:
        """A driveline that rattles in its backlash moves otherwise than its linear swing: what is
        left over would be taken for teeth. So those are learned by any motion then."""
        return self._following if self._has_lash else model

    @property
    def _has_lash(self) -> bool:
        return self._rivals[self._range].lash_is_selected

    def shafts(self, step: Range) -> Shafts | None:
        """The shafts behind, as far as they are known; None where a step of the range shows no
        backlash, so that nobody asks how it is loaded."""
        if not self._rivals[step].lash_is_candidate:
            return None
        return self._lashes[step].shafts

    def record(self, step: Range) -> SwingRecord | None:
        """What a calibration file keeps of the driveline in a step of the range."""
        has_lash = self._rivals[step].lash_is_selected
        return self._swings[step].record(self._lashes[step].known, has_lash)

    def restore(self, step: Range, record: SwingRecord) -> None:
        """Starts from such a record."""
        self._swings[step].restore(record)
        self._lashes[step].restore(*record.figures[-1])
        self._rivals[step].restore(record.has_lash)

    def lose_speed(self) -> None:
        """Starts again with the next edges; teeth keep their numbers."""
        super().lose_speed()
        self._free = False
        self._let_cloud_go()

    def restart(self) -> None:
        """Tooth numbers were lost: neither they nor what was known of the vehicle hold."""
        super().restart()
        self._before.lose()

    def set_free(
        self,
        free: bool,
        range_: Range | None,
        events: list[str],
        since_us: float = 0.0,
        loaded: LoadedDriveline | None = None,
    ) -> None:
        """Whether it turns with the vehicle alone, surely so since a time; its teeth and its swing
        are learned then. loaded: what was seen of the driveline while the gear was in mesh."""
        if free and not self._free and self._running and range_ is not None:
            since_us = max(since_us, self._filter.time_us)
            behind = None if loaded is None else loaded.behind(since_us)
            self._before.released(since_us, behind)
            self._begin_free(range_)
        elif not free and self._free:
            self._end_free(events)

    def _begin_free(self, range_: Range) -> None:
        state, swing = self._filter, self._swings[range_]
        self._in_gear.pause()
        state.forget_past()
        state.noise_adaptation(0.0)
        self._range, self._free = range_, True
        # The torque that the gear had before it came out may have moved the shaft in any way since
        # the last edges: a few new ones tell more than what the estimate was.
        state.p[:2, :2] = 0.0
        state.p[THETA, THETA] = self._half_pitch_rad**2
        state.p[OMEGA, OMEGA] = (RELEASED_SHARE * state.x[OMEGA]) ** 2 + STRUCK_RAD_S**2
        x, p = state.x.copy(), state.p.copy()
        swing.start(x, p)
        time_us = state.time_us
        state.begin(time_us, x, p)
        self._rivals[range_].begin()
        self._began = (time_us, x.copy(), p.copy())
        self._run.begin()
        self.teeth.learner.begin(time_us, x, p)
        self.teeth.learner.set_edge_time(self.edge_time.value)

    def _end_free(self, events: list[str]) -> None:
        self._free = False
        self._end_lash()
        self._keep_window()
        self._learn_teeth("main shaft", events)
        state = self._filter
        state.forget_past()
        state.noise_adaptation(NOISE_ADAPTATION)
        state.x[2:], state.p[2:, :], state.p[:, 2:] = 0.0, 0.0, 0.0
        state.p[STEADY, STEADY] = self._tuning.main_start_rad_s2**2
        # The flank's impact changes the speed in a step.
        state.p[THETA, THETA] += self._half_pitch_rad**2
        state.p[OMEGA, OMEGA] += STRUCK_RAD_S**2

    def _end_lash(self) -> None:
        cloud, rivals = self._cloud, self._rivals[self._range]
        rivals.end()
        self._let_cloud_go()
        if cloud is None or not cloud.is_alive:
            return
        lash = self._lashes[self._range]
        self._before.take_vehicle(cloud.vehicle.through(lash.ratio))
        if rivals.lash_is_selected:
            lash.learn(cloud.log_figure)

    def _let_cloud_go(self) -> None:
        self._cloud, self._trajectory = None, (0.0, None)

    def _keep_window(self) -> None:
        """The window's swing is learned later, by its teeth as they were known in it."""
        teeth, edges, (time_us, x, p) = self.teeth, self._run.edges, self._began
        if edges.shape[1] < LEAST_EDGES:
            return
        if teeth.learned:
            edges[1] += teeth.error_rad[self._run.places]
        window = MainWindow(edges, time_us, x, p, teeth.sd_rad)
        self._lessons.append(SwingLesson(self._swings[self._range], window, teeth.learned))

    def _learn_part(self, lesson: SwingLesson) -> bool:
        """A little more of what an interval in neutral shows of the swing."""
        if lesson.search is None:
            lesson.search = lesson.swing.search(lesson.window, self.edge_time, lesson.teeth_known)
        lesson.search.step()
        if lesson.search.is_over:
            self.edge_time = lesson.swing.take(lesson.search.found.figures)
            self._filter.set_edge_time(self.edge_time.value)
        return lesson.search.is_over

    def at(self, time_us: float) -> ShaftState | None:
        """The state at a time; None before enough edges, or without any for 60 ms."""
        if not self._fresh(time_us):
            return None
        newest_us, trajectory = self._trajectory
        if trajectory is not None and self._has_lash:
            return _by_lash(time_us, newest_us, trajectory)
        state = self._filter
        motion = self._motion
        newest = Swing(state.x, state.p, motion)
        x, p = newest.spread_ahead((time_us - state.time_us) * US)
        theta_sd, omega_sd = (math.sqrt(max(0.0, p.item(i, i))) for i in (THETA, OMEGA))
        edge_rad2_s = self._edge_rad2_s(state.x.item(OMEGA), self.edge_time.value)
        swing = Swing(x, p, motion, edge_rad2_s)
        return ShaftState(time_us, x[THETA], x[OMEGA], theta_sd, omega_sd, x[STEADY], swing)

    def _first_state(self, omega_sd_rad_s: float) -> tuple[Vector, Vector]:
        p = np.zeros((SWING_STATES, SWING_STATES))
        p[THETA, THETA] = (2.0 * self._tuning.tooth_error_rad) ** 2
        p[OMEGA, OMEGA] = omega_sd_rad_s**2
        p[STEADY, STEADY] = self._tuning.main_start_rad_s2**2
        return np.zeros(SWING_STATES), p


def _by_lash(time_us: float, newest_us: float, trajectory: LashTrajectory) -> ShaftState:
    """The state by the cloud of particles."""
    later = trajectory.after((time_us - newest_us) * US)
    theta, omega = later.ahead(0.0)
    sds = later.theta_sd_ahead(0.0), trajectory.speed_sd_rad_s
    return ShaftState(time_us, theta, omega, *sds, trajectory.hill_rad_s2, later)
