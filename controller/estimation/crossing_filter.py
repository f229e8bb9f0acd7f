"""A crossing-time filter over one wheel's edges: `crossing_kernels` with its memory.

Edges that come late (their frame was lost, the next one brought them) are older than the state
by then. The filter keeps its last few states; it goes back before the late edge and takes what
came since once more, in order of time.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimation.crossing_kernels import crossing_filter
from meshpoint.controller.estimation.crossing_layout import (
    FURTHER,
    GATED,
    KEPT,
    LATE,
    OFFSET,
    OFFSET_VAR,
    SENSOR,
    SIGMA_ANGLE,
    SIGMA_FURTHER,
    FilterArrays,
    TeethArrays,
)
from meshpoint.controller.motion.kernels import PRESSURE, Vector
from meshpoint.controller.motion.models import LayshaftState, MotionModel, ahead, diagonal, state_of
from meshpoint.controller.settings import CrossingFilterTuning

NO_TEETH: Final = TeethArrays(0).floats
NO_PLACES: Final = np.empty(0, np.int64)


class Pressures(NamedTuple):
    """Measured brake pressure, gauge, rising in time."""

    time_us: Vector
    pressure_pa: Vector


NO_PRESSURES: Final = Pressures(np.empty(0), np.empty(0))


class FurtherEdges(NamedTuple):
    """New edges of a wheel that turns with the filter's shaft by an exact ratio, rising in time."""

    time_us: Vector
    angle_rad: Vector
    """As angles of the filter's shaft, the offset between the wheels not taken out."""
    sd_rad: float
    """What is unknown of these."""


_Batch = tuple[Vector, Vector, int, Pressures]
"""Times and angles of edges, how many of them, at the end, are a further wheel's, pressures."""


class CrossingFilter:
    """State and covariance of one shaft at its newest edge."""

    def __init__(self, tuning: CrossingFilterTuning) -> None:
        self._tuning = tuning
        self._arrays = arrays = FilterArrays()
        self._floats, self._integers = arrays.floats, arrays.integers
        arrays.sensor[:] = (
            tuning.edge_time_s, tuning.tooth_error_rad, tuning.pressure_sd_pa, tuning.gate_sd,
            tuning.tooth_error_rad,
        )  # fmt: skip
        self._sd_rad = tuning.tooth_error_rad
        self._model: MotionModel | None = None
        self._taken: deque[_Batch] = deque(maxlen=KEPT)
        """The batches behind the moments that the arrays hold."""

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """A new state; nothing before it counts any more."""
        arrays = self._arrays
        arrays.time_us = time_us
        arrays.x[:], arrays.p[:] = x, p
        self.lose_offset()

    def set_mesh(self, at_flank_rad2_s: float, loose_rad2_s: float, loose_us: float) -> None:
        """How the angle between this wheel and a further one moves (`crossing_layout.MESH`)."""
        self._arrays.mesh[:] = at_flank_rad2_s, loose_rad2_s, loose_us

    def lose_offset(self) -> None:
        """How a further wheel stands to this one is not known any more; nor what came before."""
        self._floats[OFFSET_VAR] = 0.0
        self.forget_past()

    @property
    def offset(self) -> tuple[float, float] | None:
        """Angle of a further wheel less that of the shaft, and its sd, rad; None while unknown."""
        variance = float(self._floats[OFFSET_VAR])
        return (float(self._floats[OFFSET]), math.sqrt(variance)) if variance > 0.0 else None

    def forget_past(self) -> None:
        """The model changes here: what came before cannot be taken once more."""
        self._taken.clear()
        self._arrays.forget_past()

    @property
    def time_us(self) -> float:
        """Time of the state."""
        return self._arrays.time_us

    @property
    def x(self) -> Vector:
        """The state (6,), a view."""
        return self._arrays.x

    @property
    def p(self) -> Vector:
        """Its covariance (6, 6), a view."""
        return self._arrays.p

    @property
    def agreement(self) -> Vector:
        """Sum and number of normalised squared innovations (NIS) since it was last cleared."""
        return self._arrays.agreement

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
        further: FurtherEdges | None = None,
    ) -> None:
        """New edges, with the angles they stand for and what is unknown of these (sd); and those of
        a further wheel."""
        if model is not self._model:
            self._model = model
            self._arrays.set_model(*model)
        if sd_rad != self._sd_rad:
            self._sd_rad = self._floats[SENSOR + SIGMA_ANGLE] = sd_rad
        extra = 0
        if further is not None:
            extra = self._integers[FURTHER] = further.time_us.size
            edge_us = np.concatenate((edge_us, further.time_us))
            edge_rad = np.concatenate((edge_rad, further.angle_rad))
            self._floats[SENSOR + SIGMA_FURTHER] = further.sd_rad
        switch_us, switch_u = switches
        while True:
            pressure_us, pressure_pa = pressures
            done = crossing_filter(
                self._floats, self._integers, edge_us, edge_rad, pressure_us, pressure_pa,
                switch_us, switch_u, NO_TEETH, NO_PLACES,
            )  # fmt: skip
            if done != LATE:
                break
            edge_us, edge_rad, extra, pressures = _merged(
                self._taken.pop(), (edge_us, edge_rad, extra, pressures)
            )
            self._arrays.go_back()
            self._integers[FURTHER] = extra
        self._taken.append((edge_us, edge_rad, extra, pressures))
        if extra:
            self._integers[FURTHER] = 0

    def latest(self) -> LayshaftState:
        """The state at the newest edge; where a prediction starts."""
        return state_of(self.x, self.p.copy(), self._arrays.time_us)

    def at(
        self, time_us: float, switches: tuple[Vector, Vector], model: MotionModel
    ) -> LayshaftState:
        """The state at a time, with its spread grown to then."""
        return ahead(self.x, self.p, self._arrays.time_us, time_us, switches, model)


def start_covariance(
    tuning: CrossingFilterTuning, theta_sd_rad: float, omega_sd_rad_s: float, acceleration: float
) -> Vector:
    """Of a state that begins: steady accelerations as unknown as `acceleration` (rad/s2)."""
    return diagonal(
        theta_sd_rad, omega_sd_rad_s, tuning.pressure_start_sd_pa, acceleration, 1e-6, acceleration
    )


def _merged(early: _Batch, late: _Batch) -> _Batch:
    """Two batches as one, each wheel's edges in order of time."""
    first, then = early[0].size - early[2], late[0].size - late[2]
    own, extra = first + then, early[2] + late[2]
    time_us, angle = (
        np.concatenate((before[:first], after[:then], before[first:], after[then:]))
        for before, after in zip(early[:2], late[:2], strict=True)
    )
    order = np.concatenate(
        (
            np.argsort(time_us[:own], kind="stable"),
            own + np.argsort(time_us[own:], kind="stable"),
        )
    )
    pressures = Pressures(
        np.concatenate((early[3].time_us, late[3].time_us)),
        np.concatenate((early[3].pressure_pa, late[3].pressure_pa)),
    )
    return time_us[order], angle[order], extra, pressures


__all__ = ["NO_PRESSURES", "PRESSURE", "CrossingFilter", "Pressures", "start_covariance"]
