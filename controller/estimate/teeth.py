"""The learned errors of a sensor wheel's edges (pitch, eccentricity, duty), and its teeth by them.

A wheel of z teeth has 2 z edges; edge 2 k is the rising one of tooth k, 2 k + 1 its falling one.
Their mean error cannot be seen from the wheel itself and is taken as zero: it is part of the phase
reference. Learned by `crossing_kernels` over every window in which the shaft moves freely.

After a restart or a standstill any tooth may be number 0: the remembered pattern is then found
again. With e the edges' errors, N e = r the normal equations of what was seen since, and e = R_k m
+ noise of variance s2 the remembered pattern m turned by k teeth, the least sum of squares over e
is, up to a constant

    J_k = |R_k m|2 / s2 - b_k' A^-1 b_k,    A = N + I / s2,    b_k = r + R_k m / s2,

which is the circular correlation of both patterns, each edge weighed by how well it was seen. J is
minus twice a log-likelihood: the least J wins where it leads the second by `MARGIN`.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_filter import (
    LAYSHAFT_FILTER,
    NO_PRESSURES,
    FilterKind,
    FilterRun,
    Pressures,
)
from meshpoint.controller.estimate.crossing_kernels import TeethArrays, inverse_of_positive
from meshpoint.controller.measure.wheel_edges import NO_EDGES, EdgeBatch
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.records import Integers, RecordMemory, Vector

MARGIN: Final = 30.0
"""By how much J of the best turn must lead: a likelihood ratio of e^15, some 3 million to 1."""
FITS: Final = 1.8
"""Largest deviance (J less that of the best free pattern, for each edge) of the same wheel:
expected 1 +- 0.15 for 45 teeth, measured 0.96 to 1.27. With few edges another wheel can come down
to 2."""
STRANGER: Final = 4.0
"""Above this deviance it is another wheel; in between, more edges are needed."""
AGED_RAD: Final = math.radians(0.01)
"""How much an edge's error may have changed since it was learned, for instance with temperature."""
LEAST_TURNS: Final = 2.0
"""Turns to be seen before patterns are compared: of 700 simulated other wheels two were accepted
after one turn, none after two."""

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


class ToothPattern(NamedTuple):
    """A pattern in a numbering that has been lost."""

    error_rad: Vector
    sd_rad: float
    edges: int
    """How many edges it was learned from."""

    @property
    def weight(self) -> float:
        """Inverse variance of an edge's error."""
        return 1.0 / (self.sd_rad**2 + AGED_RAD**2)


class PatternEquations(NamedTuple):
    """Equations of one window of free motion, or the sum of several."""

    normal: Vector
    right: Vector
    squares: float
    """Sum of the edges' squared normalised residuals with all errors at zero."""
    edges: float


class PatternMatch(NamedTuple):
    """Result of a comparison."""

    teeth: int
    """Remembered tooth number less present one, of the likeliest turn."""
    margin: float
    """How far J of the second likeliest lies above."""
    deviance: float
    """Of the likeliest, an edge: about 1 where it is the same wheel."""

    @property
    def certain(self) -> bool:
        """Whether the numbering is known again."""
        return self.deviance <= FITS and self.margin >= MARGIN

    @property
    def stranger(self) -> bool:
        """Whether no turn of the remembered pattern fits."""
        return self.deviance > STRANGER


def turned(error_rad: Vector, teeth: int) -> Vector:
    """The pattern in the present numbering, where tooth t is remembered tooth t + teeth."""
    return np.roll(error_rad, -2 * teeth)


def compare(
    memory: ToothPattern, seen: PatternEquations, free_sd_rad: float, only_as_drawn: bool
) -> PatternMatch | None:
    """Compares all turns; None before two turns were seen or where the equations do not hold.

    free_sd_rad: what an edge's error may be on any wheel. only_as_drawn: the wheel has missing
    teeth, so its numbers are those of the drawing and no other turn is possible."""
    size = memory.error_rad.size
    if seen.edges < LEAST_TURNS * size:
        return None
    turns = 1 if only_as_drawn else size // 2
    weight = memory.weight
    inverse = inverse_of_positive(seen.normal + weight * np.eye(size))
    free = inverse_of_positive(seen.normal + free_sd_rad**-2 * np.eye(size))
    patterns = np.stack([turned(memory.error_rad, k) for k in range(turns)])
    b = seen.right + weight * patterns
    j = weight * np.sum(patterns**2, axis=1) - np.einsum("ki,ij,kj->k", b, inverse, b)
    least_free = -float(seen.right @ free @ seen.right)
    if not (np.isfinite(j).all() and np.isfinite(least_free)):
        return None
    # Errors of the motion model enlarge all differences of J equally; the residual of the best free
    # pattern shows by how much.
    scale = max(1.0, (seen.squares + least_free) / seen.edges)
    order = np.argsort(j, kind="stable")
    best = int(order[0])
    margin = np.inf if turns == 1 else float(j[order[1]] - j[best]) / scale
    return PatternMatch(best, margin, (float(j[best]) - least_free) / size / scale)


class TeethLearner(FilterRun):
    """The normal equations of one wheel over one window of free motion."""

    def __init__(
        self, tuning: CrossingFilterTuning, edges: int, kind: FilterKind = LAYSHAFT_FILTER
    ) -> None:
        super().__init__(tuning, kind, 1e-9, NEVER_GATED)
        self._teeth = TeethArrays(edges)
        self.running = False

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """A window begins with the shaft in this state."""
        super().begin(time_us, x, p)
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
        edges = np.array((batch.time_us, batch.theta_rad, place), dtype=np.float64)
        self._add(edges, pressures, switches, model)

    def take_all(self, edges: Vector, place: Integers, model: RecordMemory) -> None:
        """Edges (2, n), times and nominal angles, of a shaft on which nothing else is measured."""
        both = np.concatenate((edges, place[np.newaxis].astype(np.float64)))
        self._add(both, NO_PRESSURES, NO_SWITCHES, model)

    def _add(
        self, edges: Vector, pressures: Pressures, switches: Vector, model: RecordMemory
    ) -> None:
        self._move_by(model)
        self._memory.forget_past()
        self._run(self._memory.flat, edges, *pressures, switches, self._teeth.flat)

    @property
    def edges(self) -> float:
        """How many edges the window has so far."""
        return float(self.nis[1]) if self.running else 0.0

    def end(self) -> PatternEquations | None:
        """The window ends; its equations, None where it was too short."""
        window = self.so_far() if self.running else None
        self.running = False
        return window if window is not None and window.edges >= LEAST_EDGES else None

    def so_far(self) -> PatternEquations:
        """The window's equations up to now."""
        squares, count = self.nis.tolist()
        upper = np.triu(self._teeth.normal)
        return PatternEquations(
            upper + np.triu(upper, 1).T, self._teeth.right.copy(), squares, count
        )


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
        self._unmatched = self._inconsistent = self._unreported = 0
        self.memory: ToothPattern | None = None
        self.found: PatternMatch | None = None
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

    @property
    def pattern(self) -> ToothPattern | None:
        """The learned pattern; the remembered one where none has been learned."""
        if self.learned:
            return ToothPattern(self.error_rad, self.sd_rad, self.edges_seen)
        return self.memory

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
            self._unmatched += 1
            if self._unmatched < WINDOWS_TO_FORGET:
                return "teeth do not agree with what was learned"
            self.forget()
            return "teeth forgotten: they are not those that were learned"
        self._unmatched = 0
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
        self.memory = self.pattern
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
        self._unmatched = self._inconsistent = self._unreported = self.edges_seen = 0
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
        self.found = verdict
        self.memory = None
        self._solve()

    def _not_found(self, verdict: PatternMatch) -> str | None:
        """After a whole window: drops the memory if it belongs to another wheel, or if the wheel's
        own errors are known and the turn is still not certain. Returns a line for the log."""
        if verdict.stranger:
            self._inconsistent += 1
            if self._inconsistent >= WINDOWS_TO_FORGET:
                self.memory, self._inconsistent = None, 0
                return "teeth forgotten: they are not those that were remembered"
            return "teeth do not agree with those that were remembered"
        self._unreported += self.learned
        if self._unreported < WINDOWS_TO_TELL:
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
