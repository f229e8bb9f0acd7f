"""A crossing-time filter over one wheel's edges: `crossing_kernels` with its memory.

Edges that come late (their frame was lost, the next one brought them) are older than the state
by then. The filter keeps its last few states; it goes back before the late edge and takes what
came since once more, in order of time.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from controller.crossing_kernels import crossing_filter
from controller.crossing_layout import (
    GATED,
    KEPT,
    LATE,
    SENSOR,
    SIGMA_ANGLE,
    FilterArrays,
)
from controller.motion import LayshaftState, MotionModel, diagonal, predict_spread, state_of
from controller.motion_kernels import PRESSURE, Vector
from controller.settings import CrossingFilterTuning

NOTHING: Final = np.empty(0)
NO_PLACES: Final = np.empty(0, np.int64)


class Pressures(NamedTuple):
    """Measured brake pressure, gauge, rising in time."""

    time_us: Vector
    pressure_pa: Vector


NO_PRESSURES: Final = Pressures(NOTHING, NOTHING)


class CrossingFilter:
    """State and covariance of one shaft at its newest edge."""

    def __init__(self, tuning: CrossingFilterTuning) -> None:
        self._tuning = tuning
        self._arrays = arrays = FilterArrays()
        self._floats, self._integers = arrays.floats, arrays.integers
        self.x, self.p = arrays.x, arrays.p
        arrays.sensor[:] = (
            tuning.edge_time_s, tuning.tooth_error_rad, tuning.pressure_sd_pa, tuning.gate_sd,
        )  # fmt: skip
        self._sd_rad = tuning.tooth_error_rad
        self._model: MotionModel | None = None
        self.agreement = arrays.agreement
        """Sum and number of normalised squared innovations (NIS) since it was last cleared."""
        self._taken: deque[tuple[Vector, Vector, Pressures]] = deque(maxlen=KEPT)
        """The batches behind the moments that the arrays hold."""

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """A new state; nothing before it counts any more."""
        self._arrays.time_us = time_us
        self.x[:], self.p[:] = x, p
        self.forget_past()

    def forget_past(self) -> None:
        """The model changes here: what came before cannot be taken once more."""
        self._taken.clear()
        self._arrays.forget_past()

    @property
    def time_us(self) -> float:
        """Time of the state."""
        return self._arrays.time_us

    @property
    def gated(self) -> int:
        """Edges that the gate has refused so far."""
        return int(self._integers[GATED])

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
        if model is not self._model:
            self._model = model
            self._arrays.set_model(*model)
        if sd_rad != self._sd_rad:
            self._sd_rad = self._floats[SENSOR + SIGMA_ANGLE] = sd_rad
        switch_us, switch_u = switches
        while True:
            pressure_us, pressure_pa = pressures
            done = crossing_filter(
                self._floats, self._integers, edge_us, edge_rad, pressure_us, pressure_pa,
                switch_us, switch_u, NOTHING, NO_PLACES,
            )  # fmt: skip
            if done != LATE:
                break
            edge_us, edge_rad, pressures = self._with_newest(edge_us, edge_rad, pressures)
            self._arrays.go_back()
        self._taken.append((edge_us, edge_rad, pressures))

    def _with_newest(
        self, late_us: Vector, late_rad: Vector, late: Pressures
    ) -> tuple[Vector, Vector, Pressures]:
        """Late edges and the newest batch, which is taken back, as one batch."""
        early_us, early_rad, early = self._taken.pop()
        time_us = np.concatenate((early_us, late_us))
        order = np.argsort(time_us, kind="stable")
        pressures = Pressures(
            np.concatenate((early.time_us, late.time_us)),
            np.concatenate((early.pressure_pa, late.pressure_pa)),
        )
        return time_us[order], np.concatenate((early_rad, late_rad))[order], pressures

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts."""
        return state_of(self.x, self.p.copy(), self._arrays.time_us)

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


__all__ = ["NO_PRESSURES", "PRESSURE", "CrossingFilter", "Pressures", "start_covariance"]
