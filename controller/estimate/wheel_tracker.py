"""A filter over a wheel's edges with its teeth: what layshaft and main shaft have in common.

Teeth are learned in neutral, where the shaft moves freely, and with a gear in mesh or a clutch that
drives the shaft. What drives it then is not known, but it is the same for all teeth: over some
turns the shaft moves by accelerations of short memory, and what comes back with each turn of the
wheel is the wheel's own. How strong the accelerations are, and how exact an edge's time is, are the
figures under which the window's edges are likeliest whatever the teeth are: with the normal
equations N e = r of the tooth errors (`crossing_kernels`), their prior variance v, and the
innovations' squares and variances s under no errors, twice the negative logarithm of that
likelihood is, but for a constant,

    squares - r' (N + 1/v)^-1 r + sum log s + log det (N + 1/v)

(the marginal likelihood of a linear model, Bishop, Pattern Recognition and Machine Learning, 3.5).
The windows in neutral are shorter than that, few, and know no sensor's jitter while the teeth are
unknown; these come first.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import Final, Generic, TypeVar

import numpy as np

from meshpoint.controller.estimate.crossing_filter import (
    LAYSHAFT_FILTER,
    CrossingFilter,
    FilterKind,
    Pressures,
)
from meshpoint.controller.estimate.crossing_kernels import cholesky, inverse_by_root
from meshpoint.controller.estimate.teeth import PatternEquations, TeethLearner, WheelTeeth
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import WALK_RAD_S2, following_motion, following_start
from meshpoint.controller.models.layshaft_kernels import OMEGA, THETA
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.settings import MS_IN_US
from meshpoint.kernels.records import RecordMemory, Vector
from meshpoint.units import US

SPEED_WINDOW_US = 10_000
"""The production speed's window: one read of the arrays (thesis 2.5)."""
ESTIMATE_STALE_US = 60_000
"""An angle extrapolated for longer than this may be off by more than a tooth gap allows."""

TURNS: Final = 3
"""A window is this many turns: as many as tell what comes back with each from what does not."""
LONGEST_GAP_US: Final = 60 * MS_IN_US
"""A shaft with a longer time from edge to edge is too slow, or not all of its edges came."""
MOST_WINDOWS: Final = 6
"""Windows that are taken in one stretch at most, while the teeth are not known well."""
KNOWN_SD_RAD: Final = math.radians(0.03)
"""Of teeth known to this standard deviation one window a stretch is taken, with the figures as they
are."""
EDGE_TIME, ACCELERATION = range(2)
"""Places of the two figures: the standard deviation of an edge's time (s), and that of the
acceleration (rad/s2)."""
RANGES: Final = ((1e-6, 2e-4), (0.1, 1e4))
"""Least and greatest value of each figure."""
TRIED: Final = (
    *((ACCELERATION, factor) for factor in (1.0, 0.25, 0.5, 2.0, 4.0)),
    *((EDGE_TIME, factor) for factor in (0.5, 0.7, 0.85, 1.2, 1.4, 2.0)),
)
"""What is tried in a window, in this order: a figure, and a factor on what it was; one a step,
because a window takes a millisecond each time."""

LEAST_RAD_S: Final = 1.0
"""A slower shaft counts as this fast where the time from edge to edge is asked for."""
STRUCK_RAD_S: Final = 5.0
"""Standard deviation of the step that a flank's impact makes in a shaft's speed (48 rpm)."""
NOISE_ADAPTATION: Final = 0.1
"""How fast the process noise of a shaft with a gear in mesh follows the innovations, a share an
edge: what drives it then is not known, and an impact is over within some edges."""
Lesson = TypeVar("Lesson")
"""An interval in which the shaft was free, and what of it is still to be learned."""


class WindowSpeed:
    """The production speed: teeth in the last 10 ms over the time they took, held until the next.

    The window runs from the newest edge at least 10 ms old to the newest edge of all."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._angles: list[float] = []
        self.omega_rad_s: float | None = None

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges, in order of time, and computes the speed again if there are any."""
        if not batch.time_us.size:
            return
        self._times += batch.time_us.tolist()
        self._angles += batch.theta_rad.tolist()
        start = self._times[-1] - SPEED_WINDOW_US
        keep = next((i for i, t in enumerate(self._times) if t > start), len(self._times) - 1)
        keep = max(0, keep - 1)
        del self._times[:keep], self._angles[:keep]
        if len(self._times) > 1:
            turned = self._angles[-1] - self._angles[0]
            self.omega_rad_s = turned / ((self._times[-1] - self._times[0]) * US)

    def restart(self) -> None:
        """Forgets all edges."""
        self._times, self._angles, self.omega_rad_s = [], [], None

    @property
    def newest(self) -> tuple[float, float] | None:
        """Time and angle of the newest edge."""
        return (self._times[-1], self._angles[-1]) if self._times else None


class TeethInGear:
    """Gathers a wheel's edges while its shaft is not free, and learns teeth from them."""

    def __init__(self, teeth: WheelTeeth, tuning: CrossingFilterTuning) -> None:
        self._teeth, self._tuning = teeth, tuning
        self._learner = TeethLearner(tuning, 2 * teeth.count)
        self.figures = [tuning.edge_time_s, tuning.follow_rad_s2]
        """An edge's time (s) and the accelerations (rad/s2) that suited the last window best."""
        self._window: Vector | None = None
        """The edges of the window that is being learned from."""
        self._tries: list[tuple[int, float]] = []
        self._best, self._least = list(self.figures), math.inf
        self._batches: list[Vector] = []
        self._count = 0
        self._windows: list[PatternEquations] = []
        """Those of this stretch."""

    def lose(self) -> None:
        """Edges were lost: what has been gathered is dropped."""
        self.pause()
        self._windows.clear()

    def pause(self) -> None:
        """The shaft is free from here on: the stretch is over."""
        self._batches.clear()
        self._count, self._window = 0, None

    def end(self) -> list[str]:
        """The next stretch begins: the teeth learn from the windows of the last one, not before. A
        phase is watched while a gear is in mesh, and would move with them. Returns lines for the
        log."""
        said = [self._teeth.take(window) for window in self._windows]
        self.lose()
        return [line for line in said if line is not None]

    def edges(self, batch: EdgeBatch) -> None:
        """Takes new edges, with their nominal angles."""
        most = 1 if self._is_known else MOST_WINDOWS
        if self._window is not None:
            self._work(self._window)
        if len(self._windows) >= most or not batch.time_us.size:
            return
        self._batches.append(np.array([batch.time_us, batch.theta_rad, self._teeth.place(batch)]))
        self._count += batch.time_us.size
        if self._window is None and self._count >= 2 * TURNS * self._teeth.count:
            self._begin(np.concatenate(self._batches, axis=1))

    def _begin(self, edges: Vector) -> None:
        """A window is whole: it is learned from in the steps to come, unless edges are missing."""
        self.pause()
        # By rows in memory, as `take` leaves them: of columns numba would make a filter once more.
        edges = np.take(edges, np.argsort(edges[0], kind="stable"), axis=1)
        if float(np.diff(edges[0]).max()) <= LONGEST_GAP_US:
            self._window = edges
            self._tries = [] if self._is_known else list(TRIED)
            self._best, self._least = list(self.figures), math.inf

    @property
    def _is_known(self) -> bool:
        return self._teeth.learned and self._teeth.sd_rad <= KNOWN_SD_RAD

    def _work(self, edges: Vector) -> None:
        """The next try with a window, or its end."""
        if not self._tries:
            self.figures = self._best
            self._run(edges, self.figures)
            self._windows.append(self._learner.so_far())
            self._window = None
            return
        figure, factor = self._tries.pop(0)
        tried, (low, high) = list(self._best), RANGES[figure]
        tried[figure] = min(max(factor * self.figures[figure], low), high)
        deviance = self._deviance(edges, tried)
        if deviance < self._least:
            self._best, self._least = tried, deviance

    def _run(self, edges: Vector, figures: Sequence[float]) -> None:
        """The window's equations with these figures."""
        tuning, learner = self._tuning, self._learner
        edge_time_s, acceleration = figures[EDGE_TIME], figures[ACCELERATION]
        times, angles, place = edges
        omega = (angles[-1] - angles[0]) / ((times[-1] - times[0]) * US)
        theta_sd, omega_sd = 2.0 * tuning.tooth_error_rad, 0.05 * abs(omega) + 1.0
        x, p = following_start(theta_sd, omega_sd, acceleration)
        x[THETA], x[OMEGA] = angles[0], omega
        learner.begin(times[0] - 1.0, x, p)
        learner.set_edge_time(edge_time_s)
        motion = following_motion(acceleration, tuning.follow_s, WALK_RAD_S2)
        learner.take_all(edges[:2], place.astype(np.int64), motion)

    def _deviance(self, edges: Vector, figures: Sequence[float]) -> float:
        """Twice the negative logarithm of the edges' likelihood whatever the teeth are."""
        self._run(edges, figures)
        window = self._learner.so_far()
        matrix = window.normal + self._tuning.tooth_error_rad**-2 * np.eye(window.right.size)
        root = cholesky(matrix)
        explained = float(window.right @ inverse_by_root(root) @ window.right)
        log_determinant = 2.0 * float(np.log(np.diag(root)).sum())
        return window.squares - explained + self._learner.log_variance + log_determinant


class WheelTracker(ABC, Generic[Lesson]):
    """A filter over a wheel's edges with its teeth, which learns while a gear is in mesh from the
    intervals in which the shaft was free."""

    def __init__(
        self,
        tuning: CrossingFilterTuning,
        teeth: int,
        missing: tuple[int, ...],
        kind: FilterKind = LAYSHAFT_FILTER,
    ) -> None:
        self._tuning = tuning
        self._filter = CrossingFilter(tuning, kind)
        self.teeth = WheelTeeth(teeth, tuning, missing, kind)
        self._in_gear = TeethInGear(self.teeth, tuning)
        self._half_pitch_rad = math.pi / teeth
        self._seed = WindowSpeed()
        self._running = self._free = False
        self._lessons: deque[Lesson] = deque()
        self.learned = 0
        """From how many such intervals everything has been learned."""
        self.placed = np.zeros((2, 0))
        """Times (us) and angles (rad) of the step's edges as their teeth are known, (2, n)."""

    def lose_speed(self) -> None:
        """Starts again with the next edges; teeth keep their numbers."""
        self._running = False
        self._seed.restart()
        self.teeth.learner.running = False
        self._in_gear.lose()

    def restart(self) -> None:
        """Tooth numbers were lost: starts again, and which tooth is which is no longer known."""
        self.lose_speed()
        self.teeth.lose_numbers()

    @property
    def newest_us(self) -> float:
        """Time of the newest edge used; 0 before there was one."""
        return self._filter.time_us

    @property
    def is_learning(self) -> bool:
        """Whether `learn` has something to do: not while the shaft is free, whose figures stay."""
        return bool(self._lessons) and not self._free

    def learn(self) -> None:
        """The next part of what such intervals teach, the oldest first; nothing where there is
        none."""
        if self.is_learning and self._learn_part(self._lessons[0]):
            self._lessons.popleft()
            self.learned += 1

    @abstractmethod
    def _learn_part(self, lesson: Lesson) -> bool:
        """Whether it was the last one."""

    def _take(
        self, batch: EdgeBatch, pressures: Pressures, switches: Vector, model: RecordMemory
    ) -> None:
        teeth, place = self.teeth, self.teeth.place(batch)
        edges = self.placed = teeth.edges(batch, place)
        if not self._running:
            self._start(batch)
            return
        if not batch.time_us.size and not pressures.time_us.size:
            return
        self._filter.take(edges, teeth.sd_rad, pressures, switches, model)
        if teeth.learner.running:
            teeth.learner.take(batch, place, pressures, switches, self._teeth_motion(model))
            if teeth.measure():
                self._teeth_found()
                self.placed = teeth.edges(batch, place)

    def _edge_rad2_s(self, omega_rad_s: float, edge_time_s: float) -> float:
        """Variance of an edge's angle times the time from edge to edge: two edges a pitch."""
        edge_rad2 = (omega_rad_s * edge_time_s) ** 2 + self.teeth.sd_rad**2
        return edge_rad2 * self._half_pitch_rad / max(abs(omega_rad_s), LEAST_RAD_S)

    def _teeth_motion(self, model: RecordMemory) -> RecordMemory:
        """The model by which teeth are learned, where `model` is the filter's."""
        return model

    def _learn_teeth(self, name: str, events: list[str]) -> None:
        """The shaft is no longer free: what was seen in gear before, and since, is learned."""
        said = [*self._in_gear.end(), self.teeth.end_window()]
        events += [f"{name} {line}" for line in said if line is not None]

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
        x, p = self._first_state(0.05 * abs(omega) + 1.0)
        x[THETA], x[OMEGA] = newest[1], omega
        self._filter.begin(newest[0], x, p)
        self._filter.noise_adaptation(NOISE_ADAPTATION)
        self._running = True

    @abstractmethod
    def _first_state(self, omega_sd_rad_s: float) -> tuple[Vector, Vector]:
        """State and covariance of a shaft of which only angle and speed have been seen."""

    def _fresh(self, time_us: float) -> bool:
        # Nor may the newest edge be of a clock that has jumped and come back.
        return self._running and abs(time_us - self._filter.time_us) <= ESTIMATE_STALE_US
