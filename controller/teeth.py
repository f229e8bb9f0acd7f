"""What is known of a sensor wheel's teeth: pitch errors, eccentricity and duty bias, edge by edge.

A wheel of z teeth has 2 z edges; edge 2 k is the rising one of tooth k, 2 k + 1 its falling one.
Their mean error cannot be seen from the wheel itself and is taken as zero: it is part of the phase
reference. Learned by `crossing_kernels` over every window in which the shaft moves freely.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from controller.crossing import Pressures
from controller.crossing_kernels import Integers, crossing_filter, inverse_of_positive
from controller.edges import EdgeBatch
from controller.motion import MotionModel
from controller.motion_kernels import STATES, Vector
from controller.settings import CrossingFilterTuning

NEVER_GATED: Final = 1e9
FORGET: Final = 0.99
"""What was learned before counts this much less after each window: a sensor warms up."""
LEAST_SD_RAD: Final = math.radians(0.003)
USABLE_SD: Final = 0.5
"""Teeth are used when the worst is known to this share of what is expected of an unlearned one."""
DISAGREES: Final = 3.0
"""Squared residuals over their expectation at which a window does not fit the teeth."""
WINDOWS_TO_FORGET: Final = 2
LEAST_EDGES: Final = 40
"""A window with fewer edges says too little to be judged."""


class Window(NamedTuple):
    """Equations of one window: residual squares and their number, normal matrix, right side."""

    squares: float
    edges: float
    normal: Vector
    right: Vector


class TeethLearner:
    """The normal equations of one wheel over one window of free motion."""

    def __init__(self, tuning: CrossingFilterTuning, edges: int) -> None:
        self._sensor = np.array([tuning.edge_time_s, 1e-9, tuning.pressure_sd_pa, NEVER_GATED])
        self._x, self._p = np.zeros(STATES), np.zeros((STATES, STATES))
        self._time_us = 0.0
        self._by_tooth = np.zeros((STATES, edges))
        self._normal, self._right = np.zeros((edges, edges)), np.zeros(edges)
        self._counts: Integers = np.zeros(3, np.int64)
        self._agreement = np.zeros(2)
        self.running = False

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """A window begins with the shaft in this state."""
        self._time_us = time_us
        self._x[:], self._p[:] = x, p
        for array in (self._by_tooth, self._normal, self._right, self._agreement):
            array[:] = 0.0
        self.running = True

    def take(
        self,
        batch: EdgeBatch,
        place: Integers,
        pressures: Pressures,
        switches: tuple[Vector, Vector],
        model: MotionModel,
    ) -> None:
        """New edges of the window, nominal angles."""
        self._time_us = crossing_filter(
            self._x,
            self._p,
            self._time_us,
            batch.time_us,
            batch.theta_rad,
            *pressures,
            *switches,
            *model,
            self._sensor,
            self._counts,
            self._agreement,
            place,
            self._by_tooth,
            self._normal,
            self._right,
        )

    def end(self) -> Window | None:
        """The window's equations; None where it was too short."""
        self.running = False
        squares, count = self._agreement.tolist()
        if count < LEAST_EDGES:
            return None
        upper = np.triu(self._normal)
        return Window(squares, count, upper + np.triu(upper, 1).T, self._right.copy())


class WheelTeeth:
    """The learned errors of a wheel's edges, and whether they may be used."""

    def __init__(self, teeth: int, tuning: CrossingFilterTuning) -> None:
        edges = 2 * teeth
        self._edges = edges
        self._unlearned_sd_rad = tuning.tooth_error_rad
        self._normal, self._right = np.zeros((edges, edges)), np.zeros(edges)
        self._strangers = 0
        self.error_rad: Vector = np.zeros(edges)
        """To be added to an edge's nominal angle."""
        self.sd_rad = tuning.tooth_error_rad
        """What is not known of an edge's angle."""
        self.learned = False
        self.learner = TeethLearner(tuning, edges)

    def place(self, batch: EdgeBatch) -> Integers:
        """Which of the wheel's edges each one is."""
        places: Integers = (2 * batch.tooth + batch.falling) % self._edges
        return places

    def angles(self, batch: EdgeBatch, place: Integers) -> Vector:
        """The angle each edge stands for, as far as its tooth is known."""
        return batch.theta_rad + self.error_rad[place] if self.learned else batch.theta_rad

    def end_window(self) -> str | None:
        """A window has ended: learns from it, or forgets. Returns a line for the log."""
        window = self.learner.end()
        if window is None:
            return None
        if self.learned and self._misfit(window) > DISAGREES:
            self._strangers += 1
            if self._strangers < WINDOWS_TO_FORGET:
                return "teeth do not agree with what was learned"
            self.forget()
            return "teeth forgotten: they are not those that were learned"
        self._strangers = 0
        self._normal = FORGET * self._normal + window.normal
        self._right = FORGET * self._right + window.right
        return self._solve()

    def forget(self) -> None:
        """Nothing is known of this wheel any more."""
        self._normal[:], self._right[:] = 0.0, 0.0
        self.error_rad = np.zeros(self._edges)
        self.sd_rad, self.learned, self._strangers = self._unlearned_sd_rad, False, 0
        self.learner.running = False

    def _misfit(self, window: Window) -> float:
        e = self.error_rad
        squares = window.squares - 2.0 * float(e @ window.right)
        return (squares + float(e @ window.normal @ e)) / window.edges

    def _solve(self) -> str | None:
        """Least squares with a weak prior: one pitch share at most, mean zero."""
        prior = (10.0 * self._unlearned_sd_rad) ** -2
        covariance = inverse_of_positive(self._normal + prior * np.eye(self._edges))
        error = covariance @ self._right
        mean = covariance.mean(axis=0)
        variance = np.diag(covariance) - 2.0 * mean + mean.mean()
        worst = math.sqrt(max(0.0, float(variance.max())))
        if not np.isfinite(error).all():
            self.forget()
            return "teeth forgotten: their equations have no solution"
        if worst > USABLE_SD * self._unlearned_sd_rad:
            return None
        first = not self.learned
        self.error_rad = error - error.mean()
        self.sd_rad = max(LEAST_SD_RAD, math.sqrt(float(variance.mean())))
        self.learned = True
        if first:
            return f"teeth learned to {math.degrees(self.sd_rad):.3f} deg"
        return None
