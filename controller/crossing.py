"""A crossing-time filter over one wheel's edges: `crossing_kernels` with its memory.

Edges that come late (their frame was lost, the next one brought them) are older than the state
by then. The filter keeps its last few states; it goes back before the late edge and takes what
came since once more, in order of time.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from controller.crossing_kernels import GATED, Integers, crossing_filter
from controller.motion import LayshaftState, MotionModel, diagonal, predict_spread, state_of
from controller.motion_kernels import PRESSURE, STATES, Vector
from controller.settings import CrossingFilterTuning

KEPT: Final = 4
"""Batches that can be taken back: 40 ms, more than two lost frames."""
NOTHING: Final = np.empty(0)
NO_PLACES: Final = np.empty(0, np.int64)
NO_TEETH: Final = (np.zeros((STATES, 0)), np.zeros((0, 0)), np.zeros(0))


class Pressures(NamedTuple):
    """Measured brake pressure, gauge, rising in time."""

    time_us: Vector
    pressure_pa: Vector


NO_PRESSURES: Final = Pressures(NOTHING, NOTHING)


class _Taken(NamedTuple):
    """A batch that has been taken, and the state before it."""

    time_us: float
    x: Vector
    p: Vector
    edge_us: Vector
    edge_rad: Vector
    pressures: Pressures


class CrossingFilter:
    """State and covariance of one shaft at its newest edge."""

    def __init__(self, tuning: CrossingFilterTuning) -> None:
        self._tuning = tuning
        self.x = np.zeros(STATES)
        self.p = np.zeros((STATES, STATES))
        self.time_us = 0.0
        self._sensor = np.array(
            [tuning.edge_time_s, tuning.tooth_error_rad, tuning.pressure_sd_pa, tuning.gate_sd]
        )
        self.counts: Integers = np.zeros(3, np.int64)
        self.agreement = np.zeros(2)
        """Sum and number of normalised squared innovations (NIS) since it was last cleared."""
        self._taken: deque[_Taken] = deque(maxlen=KEPT)

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """A new state; nothing before it counts any more."""
        self.time_us = time_us
        self.x[:], self.p[:] = x, p
        self._taken.clear()

    def forget_past(self) -> None:
        """The model changes here: what came before cannot be taken once more."""
        self._taken.clear()

    @property
    def gated(self) -> int:
        """Edges that the gate has refused so far."""
        return int(self.counts[GATED])

    def take(
        self,
        edge_us: Vector,
        edge_rad: Vector,
        sd_rad: float,
        pressures: Pressures,
        switches: tuple[Vector, Vector],
        model: MotionModel,
    ) -> None:
        """New edges, with the angles they stand for and what is unknown of these (sd)."""
        self._sensor[1] = sd_rad
        while self._taken and edge_us.size and edge_us[0] < self.time_us:
            before = self._taken.pop()
            self.time_us = before.time_us
            self.x[:], self.p[:] = before.x, before.p
            edge_us, edge_rad = _merged(before.edge_us, before.edge_rad, edge_us, edge_rad)
            pressures = Pressures(
                np.concatenate((before.pressures.time_us, pressures.time_us)),
                np.concatenate((before.pressures.pressure_pa, pressures.pressure_pa)),
            )
        self._taken.append(
            _Taken(self.time_us, self.x.copy(), self.p.copy(), edge_us, edge_rad, pressures)
        )
        self.time_us = crossing_filter(
            self.x,
            self.p,
            self.time_us,
            edge_us,
            edge_rad,
            *pressures,
            *switches,
            *model,
            self._sensor,
            self.counts,
            self.agreement,
            NO_PLACES,
            *NO_TEETH,
        )

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts."""
        return state_of(self.x, self.p.copy(), self.time_us)

    def at(
        self, time_us: float, switches: tuple[Vector, Vector], model: MotionModel
    ) -> LayshaftState:
        """The state at a time, with its spread grown to then."""
        return predict_spread(self.latest(), time_us, switches, model)


def start_covariance(
    tuning: CrossingFilterTuning, theta_sd_rad: float, omega_sd_rad_s: float, acceleration: float
) -> Vector:
    """Of a state that begins: steady accelerations as unknown as `acceleration` (rad/s2)."""
    return diagonal(
        theta_sd_rad, omega_sd_rad_s, tuning.pressure_start_sd_pa, acceleration, 1e-6, acceleration
    )


def _merged(
    early_us: Vector, early_rad: Vector, late_us: Vector, late_rad: Vector
) -> tuple[Vector, Vector]:
    time_us = np.concatenate((early_us, late_us))
    order = np.argsort(time_us, kind="stable")
    return time_us[order], np.concatenate((early_rad, late_rad))[order]


__all__ = ["NO_PRESSURES", "PRESSURE", "CrossingFilter", "Pressures", "start_covariance"]
