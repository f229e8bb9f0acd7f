"""A wheel's teeth learned while a gear is in mesh, or the clutch drives the shaft.

What drives the shaft then is not known, but it is the same for all teeth: over some turns the shaft
moves by accelerations of short memory, and what comes back with each turn of the wheel is the
wheel's own. How strong the accelerations are, and how exact an edge's time is, are the figures
under which the window's edges are likeliest whatever the teeth are: with the normal equations N e =
r of the tooth errors (`crossing_kernels`), their prior variance v, and the innovations' squares and
variances s under no errors, twice the negative logarithm of that likelihood is, but for a constant,

    squares - r' (N + 1/v)^-1 r + sum log s + log det (N + 1/v)

(the marginal likelihood of a linear model, Bishop, Pattern Recognition and Machine Learning, 3.5).
The windows in neutral are shorter than that, few, and know no sensor's jitter while the teeth are
unknown; these come first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from meshpoint.controller.estimate.crossing_kernels import cholesky, inverse_by_root
from meshpoint.controller.estimate.teeth import TeethLearner, WheelTeeth
from meshpoint.controller.estimate.tooth_match import PatternEquations
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import WALK_RAD_S2, following_motion, following_start
from meshpoint.controller.models.layshaft_kernels import OMEGA, THETA
from meshpoint.controller.settings.settings import MS_IN_US, CrossingFilterTuning
from meshpoint.kernels.records import Vector
from meshpoint.units import US

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
