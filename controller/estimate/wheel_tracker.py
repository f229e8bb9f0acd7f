"""A filter over a wheel's edges with its teeth: what layshaft and main shaft have in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from typing import Final, Generic, TypeVar

import numpy as np

from meshpoint.controller.estimate.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.estimate.cruise import ESTIMATE_STALE_US, WindowSpeed
from meshpoint.controller.estimate.swing_filter import LAYSHAFT_FILTER, FilterKind
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.estimate.teeth_in_gear import TeethInGear
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft_kernels import OMEGA, THETA
from meshpoint.controller.settings.settings import CrossingFilterTuning
from meshpoint.kernels.records import RecordMemory, Vector

LEAST_RAD_S: Final = 1.0
"""A slower shaft counts as this fast where the time from edge to edge is asked for."""
STRUCK_RAD_S: Final = 5.0
"""Standard deviation of the step that a flank's impact makes in a shaft's speed (48 rpm)."""

NOISE_ADAPTATION: Final = 0.1
"""How fast the process noise of a shaft with a gear in mesh follows the innovations, a share an
edge: what drives it then is not known, and an impact is over within some edges."""


Lesson = TypeVar("Lesson")
"""An interval in which the shaft was free, and what of it is still to be learned."""


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
        self,
        batch: EdgeBatch,
        pressures: Pressures,
        switches: Vector,
        model: RecordMemory,
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
