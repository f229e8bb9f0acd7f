"""The learned errors of a sensor wheel's edges: pitch errors, eccentricity and duty bias.

A wheel of z teeth has 2 z edges; edge 2 k is the rising one of tooth k, 2 k + 1 its falling one.
Their mean error cannot be seen from the wheel itself and is taken as zero: it is part of the phase
reference. Learned by `crossing_kernels` over every window in which the shaft moves freely.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_filter import NO_PRESSURES, Pressures
from meshpoint.controller.estimate.crossing_kernels import inverse_of_positive
from meshpoint.controller.estimate.crossing_layout import TeethArrays
from meshpoint.controller.estimate.swing_filter import LAYSHAFT_FILTER, FilterKind
from meshpoint.controller.estimate.tooth_match import (
    PatternEquations,
    PatternMatch,
    ToothPattern,
    compare,
    turned,
)
from meshpoint.controller.measure.wheel_edges import NO_EDGES, EdgeBatch
from meshpoint.controller.settings.settings import CrossingFilterTuning
from meshpoint.kernels.records import Integers, RecordMemory, Vector

NEVER_GATED: Final = 1e9
NO_SWITCHES: Final = np.empty((2, 0))
FORGET: Final = 0.99
"""Weight of older windows relative to each newer one: the errors change as a sensor warms up."""
LEAST_SD_RAD: Final = math.radians(0.003)
USABLE_SD: Final = 0.8
"""The errors are used once the least certain one has at most this share of an unlearned edge's sd:
with bad sensors a tooth that is half known is better than one that is not."""
DISAGREES: Final = 3.0
"""Squared residuals over their expectation at which a window does not fit the teeth."""
UNLIKE_MODEL: Final = 2.0
"""Squared residuals over their expectation, with the errors that suit a window best, at which the
shaft did not move as its model has it: what that left over would be taken for errors of teeth."""
LARGEST_SD: Final = 3.0
"""Errors of that many standard deviations of an unlearned tooth are still possible ones."""
WINDOWS_TO_FORGET: Final = 2
WINDOWS_TO_TELL: Final = 3
"""A remembered pattern that is not recognised after this many windows with learned teeth is
dropped: more windows would not help."""
LEAST_EDGES: Final = 40
"""A window with fewer edges is ignored."""


class TeethLearner:
    """The normal equations of one wheel over one window of free motion."""

    def __init__(
        self, tuning: CrossingFilterTuning, edges: int, kind: FilterKind = LAYSHAFT_FILTER
    ) -> None:
        self._run = kind.run
        self._memory, self._teeth = kind.memory(), TeethArrays(edges)
        self._memory.set_sensor(tuning.edge_time_s, 1e-9, tuning.pressure_sd_pa, NEVER_GATED)
        self._model: RecordMemory | None = None
        self.running = False

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """A window begins with the shaft in this state."""
        memory = self._memory
        memory.time_us[0] = time_us
        memory.x[:], memory.p[:], memory.nis[:] = x, p, 0.0
        memory.log_variance[0] = 0.0
        self._teeth.flat[:] = 0.0
        self.running = True

    def take(
        self,
        batch: EdgeBatch,
        place: Integers,
        pressures: Pressures,
        switches: Vector,
        model: RecordMemory,
    ) -> None:
        """Adds new edges to the window, with their nominal angles. place: which of the wheel's
        edges each is."""
        memory = self._memory
        if model is not self._model:
            self._model = model
            memory.model[:] = model.flat
        memory.forget_past()
        edges = np.empty((3, place.size))
        edges[0], edges[1], edges[2] = batch.time_us, batch.theta_rad, place
        self._run(memory.flat, edges, *pressures, switches, self._teeth.flat)

    def set_edge_time(self, edge_time_s: float) -> None:
        """Standard deviation of an edge's time from now on."""
        self._memory.part("edge_time_s")[0] = edge_time_s

    def take_all(self, edges: Vector, place: Integers, model: RecordMemory) -> None:
        """Edges (2, n), times and nominal angles, of a shaft on which nothing else is measured."""
        self._model = model
        memory = self._memory
        memory.model[:] = model.flat
        memory.forget_past()
        both = np.concatenate((edges, place[np.newaxis].astype(np.float64)))
        self._run(memory.flat, both, *NO_PRESSURES, NO_SWITCHES, self._teeth.flat)

    @property
    def edges(self) -> float:
        """How many edges the window has so far."""
        return float(self._memory.nis[1]) if self.running else 0.0

    def end(self) -> PatternEquations | None:
        """The window ends; its equations, None where it was too short."""
        window = self.so_far() if self.running else None
        self.running = False
        return window if window is not None and window.edges >= LEAST_EDGES else None

    @property
    def log_variance(self) -> float:
        """Sum of the logarithms of the innovations' variances."""
        return float(self._memory.log_variance[0])

    def so_far(self) -> PatternEquations:
        """The window's equations up to now."""
        squares, count = self._memory.nis.tolist()
        upper = np.triu(self._teeth.normal)
        return PatternEquations(
            upper + np.triu(upper, 1).T, self._teeth.right.copy(), squares, count
        )


class Found(NamedTuple):
    """A wheel whose remembered tooth pattern was found again."""

    teeth: int
    """Remembered tooth number less present one."""
    margin: float


class WheelTeeth:
    """The learned errors of a wheel's edges, and whether they may be used.

    A pattern whose tooth numbers were lost, or that comes from a calibration file, is the `memory`:
    it is compared with the errors seen now, and used once it is certain which tooth is which."""

    def __init__(
        self,
        teeth: int,
        tuning: CrossingFilterTuning,
        missing: tuple[int, ...] = (),
        kind: FilterKind = LAYSHAFT_FILTER,
    ) -> None:
        edges = 2 * teeth
        self._edges = edges
        self._missing = np.array([2 * tooth + side for tooth in missing for side in (0, 1)], int)
        """Edges that the drawing leaves out; teeth then have the drawing's numbers."""
        self._unlearned_sd_rad = tuning.tooth_error_rad
        self._normal, self._right = np.zeros((edges, edges)), np.zeros(edges)
        self._seen = (0.0, 0.0)
        """Squares and edges of the windows that have ended since the teeth were numbered."""
        self._looked_at = 0.0
        self._strangers = self._unlike = self._untold = 0
        self.memory: ToothPattern | None = None
        self.found: Found | None = None
        """Set when the memory has been recognised; the reader resets it to None."""
        self.edges_seen = 0
        """How many edges the present errors were learned from."""
        self.error_rad: Vector = np.zeros(edges)
        """To be added to an edge's nominal angle."""
        self.sd_rad = tuning.tooth_error_rad
        """Standard deviation of an edge's angle (rad), tooth errors taken out as far as known."""
        self.learned = False
        self.learner = TeethLearner(tuning, edges, kind)
        self._placed: tuple[EdgeBatch, Integers] = (NO_EDGES, np.empty(0, np.int64))
        """The newest edges, and their places."""

    @property
    def count(self) -> int:
        """Teeth of the wheel, missing ones included."""
        return self._edges // 2

    def place(self, batch: EdgeBatch) -> Integers:
        """Which of the wheel's edges each one is. Asked several times of a step's edges."""
        if batch is not self._placed[0]:
            self._placed = (batch, (2 * batch.tooth + batch.falling) % self._edges)
        return self._placed[1]

    def edges(self, batch: EdgeBatch, place: Integers) -> Vector:
        """Times (us) and angles (rad) of edges, learned errors added: the (2, n) array that
        `CrossingFilter.take` wants."""
        edges = np.empty((2, batch.time_us.size))
        edges[0] = batch.time_us
        if self.learned:
            np.add(batch.theta_rad, self.error_rad[place], out=edges[1])
        else:
            edges[1] = batch.theta_rad
        return edges

    def end_window(self) -> str | None:
        """A window has ended: learns from it, or forgets. Returns a line for the log."""
        window = self.learner.end()
        return None if window is None else self.take(window)

    def take(self, window: PatternEquations) -> str | None:
        """Learns from a window, or forgets. Returns a line for the log."""
        if self._best_deviance(window) > UNLIKE_MODEL:
            return None
        if self.learned and self._is_a_stranger_s(window):
            self._strangers += 1
            if self._strangers < WINDOWS_TO_FORGET:
                return "teeth do not agree with what was learned"
            self.forget()
            return "teeth forgotten: they are not those that were learned"
        self._strangers = 0
        self._normal = FORGET * self._normal + window.normal
        self._right = FORGET * self._right + window.right
        self._seen = (self._seen[0] + window.squares, self._seen[1] + window.edges)
        self._looked_at = 0.0
        self.edges_seen += int(window.edges)
        line = self._solve()
        return line if self.memory is None else self._compare(self.memory) or line

    def measure(self) -> bool:
        """Compares the running window with the memory, once a turn of the wheel.

        True where the teeth have just been found again."""
        edges = self.learner.edges
        if self.memory is None or edges - self._looked_at < self._edges:
            return False
        self._looked_at = edges
        verdict = self._verdict(self.memory, self.learner.so_far())
        if verdict is None or not verdict.certain:
            return False
        self._take_over(self.memory, verdict)
        return True

    def lose_numbers(self) -> None:
        """The tooth numbers are lost; the learned pattern becomes the memory."""
        if self.learned:
            self.memory = ToothPattern(self.error_rad, self.sd_rad, self.edges_seen)
        self._clear()

    def forget(self) -> None:
        """Nothing is known of this wheel any more."""
        self.memory = None
        self._clear()

    def _clear(self) -> None:
        self._normal[:], self._right[:] = 0.0, 0.0
        self._seen, self._looked_at = (0.0, 0.0), 0.0
        self.error_rad = np.zeros(self._edges)
        self.sd_rad, self.learned = self._unlearned_sd_rad, False
        self._strangers = self._unlike = self._untold = self.edges_seen = 0
        self.found = None
        self.learner.running = False

    def _compare(self, memory: ToothPattern) -> str | None:
        """At the end of a window: recognises the memory, or drops it. Returns a line for the
        log."""
        verdict = self._verdict(memory, None)
        if verdict is None:
            return None
        if not verdict.certain:
            return self._not_found(verdict)
        self._take_over(memory, verdict)
        return None

    def _verdict(
        self, memory: ToothPattern, running: PatternEquations | None
    ) -> PatternMatch | None:
        """Compares the memory with everything seen, a running window included."""
        normal, right, (squares, edges) = self._normal, self._right, self._seen
        if running is not None:
            normal, right = normal + running.normal, right + running.right
            squares, edges = squares + running.squares, edges + running.edges
        seen = PatternEquations(normal, right, squares, edges)
        return compare(memory, seen, 10.0 * self._unlearned_sd_rad, self._missing.size > 0)

    def _take_over(self, memory: ToothPattern, verdict: PatternMatch) -> None:
        """Adds the recognised memory to the equations, as if its edges had been seen now."""
        self._normal += memory.weight * np.eye(self._edges)
        self._right += memory.weight * turned(memory.error_rad, verdict.teeth)
        self.edges_seen += memory.edges
        self.found = Found(verdict.teeth, verdict.margin)
        self.memory = None
        self._solve()

    def _not_found(self, verdict: PatternMatch) -> str | None:
        """After a whole window: drops the memory if it belongs to another wheel, or if the wheel's
        own errors are known and the turn is still not certain. Returns a line for the log."""
        if verdict.stranger:
            self._unlike += 1
            if self._unlike >= WINDOWS_TO_FORGET:
                self.memory, self._unlike = None, 0
                return "teeth forgotten: they are not those that were remembered"
            return "teeth do not agree with those that were remembered"
        self._untold += self.learned
        if self._untold < WINDOWS_TO_TELL:
            return None
        self.memory = None
        return "teeth cannot be distinguished: their old numbers stay unknown"

    def _is_a_stranger_s(self, window: PatternEquations) -> bool:
        """Whether a window was made by another wheel: the learned errors explain it badly, and no
        better than a wheel without errors would."""
        deviance = self._deviance(window)
        return deviance > DISAGREES and deviance > window.squares / window.edges

    def _best_deviance(self, window: PatternEquations) -> float:
        """Squared residuals a window has, over their expectation, with the errors that suit it
        best; infinite where it has no solution."""
        prior = (LARGEST_SD * self._unlearned_sd_rad) ** -2
        covariance = inverse_of_positive(window.normal + prior * np.eye(self._edges))
        squares = window.squares - float(window.right @ covariance @ window.right)
        return squares / window.edges if math.isfinite(squares) else math.inf

    def _deviance(self, window: PatternEquations) -> float:
        e = self.error_rad
        squares = window.squares - 2.0 * float(e @ window.right)
        return (squares + float(e @ window.normal @ e)) / window.edges

    def _solve(self) -> str | None:
        """The most probable errors, mean zero."""
        prior = (LARGEST_SD * self._unlearned_sd_rad) ** -2
        covariance = inverse_of_positive(self._normal + prior * np.eye(self._edges))
        error = covariance @ self._right
        mean = covariance.mean(axis=0)
        variance = np.diag(covariance) - 2.0 * mean + mean.mean()
        variance[self._missing] = 0.0
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
