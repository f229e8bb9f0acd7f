"""The data of one interval of free layshaft, to run the filter again with another touch pressure.

The sum of normalised innovation squares (NIS) is least for the parameter that fits best. Three runs
give a parabola, whose minimum is the estimate and whose curvature gives its variance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from meshpoint.controller.estimation.brake_model import MOST_TOUCH_PA, BrakeModel, Carried
from meshpoint.controller.estimation.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.estimation.likelihood import Learned, learn
from meshpoint.controller.motion.kernels import DISTURBANCE
from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.controller.motion.models import Disturbance, MotionModel
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.units import SECOND_US

EDGE_TIME, TORQUE, MEMORY = range(3)
"""Figures of the noise, in their order."""
PROBE_PA = 0.1e5
MOST_PA = 0.25e5
"""Largest change of the touch pressure by one run."""
CAUTION = 2.0
"""Factor on the estimate's standard deviation, for other errors of the model."""
PROBE_LAG_S = 1.5e-3
MOST_LAG_S = 20e-3
DRIFT_LAG_S = 0.1e-3
"""The same of the lag of the brake's sensor."""
DRIFT_PA = 0.01e5
"""Standard deviation of the touch pressure's change from shift to shift."""


class _Least(NamedTuple):
    """The minimum of a parabola of misfits: where, from the middle probe, and its variance."""

    offset: float
    variance: float


def _least(low: float, middle: float, high: float, probe: float) -> _Least | None:
    """The minimum through the misfits of three probes; None where they have none."""
    curvature = (low - 2.0 * middle + high) / probe**2
    if not math.isfinite(curvature) or curvature <= 0.0:
        return None
    return _Least(-(high - low) / (2.0 * probe) / curvature, CAUTION**2 * 2.0 / curvature)


def _gain(known: Carried, drift_sd: float, found: _Least) -> tuple[float, float]:
    """Weight of what was found, and the variance of what was known, grown by its drift."""
    prior = known.sd**2 + drift_sd**2
    return prior / (prior + found.variance), prior


class FreeRun:
    """The edges and pressures since the layshaft became free, and the state it started from."""

    def __init__(self, tuning: CrossingFilterTuning) -> None:
        self._tuning = tuning
        self._time_us = 0.0
        self._x, self._p = np.zeros(0), np.zeros((0, 0))
        self._edges: list[Vector] = []
        self._pressure_us: list[Vector] = []
        self._pressure_pa: list[Vector] = []

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """The layshaft is free from here on."""
        self._time_us, self._x, self._p = time_us, x.copy(), p.copy()
        for kept in (self._edges, self._pressure_us, self._pressure_pa):
            kept.clear()

    def add(self, edges: Vector, pressures: Pressures) -> None:
        """What the filter takes; pressures are those measured, gauge."""
        self._edges.append(edges)
        self._pressure_us.append(pressures.time_us)
        self._pressure_pa.append(pressures.pressure_pa)

    @property
    def pressures(self) -> Pressures:
        """All measured pressures."""
        return Pressures(np.concatenate(self._pressure_us), np.concatenate(self._pressure_pa))

    def learn_touch(
        self, brake: BrakeModel, sd_rad: float, switches: Vector, model: MotionModel
    ) -> None:
        """Updates the brake's touch pressure with the value that fits this run best."""
        known = brake.touch_pa
        centre = max(known.value, PROBE_PA)
        low, middle, high = (
            self._misfit(brake, centre + probe, sd_rad, switches, model)
            for probe in (-PROBE_PA, 0.0, PROBE_PA)
        )
        found = _least(low, middle, high, PROBE_PA)
        if found is None:
            return
        gain, prior = _gain(known, DRIFT_PA, found)
        step = float(np.clip(centre + found.offset - known.value, -MOST_PA, MOST_PA))
        value = min(max(known.value + gain * step, 0.0), MOST_TOUCH_PA)
        brake.touch_pa = Carried(value, math.sqrt((1.0 - gain) * prior))

    def learn_lag(
        self, brake: BrakeModel, sd_rad: float, switches: Vector, model: MotionModel
    ) -> None:
        """Updates the lag of the brake's sensor: the brake may act sooner, or later, than pressures
        and law say, and one lag fits this run best."""
        known, touch_pa = brake.sensor_lag_s, brake.touch_pa.value
        if known.sd <= 0.0:
            return
        low, middle, high = (
            self._misfit(brake, touch_pa, sd_rad, switches, model, probe_s)
            for probe_s in (-PROBE_LAG_S, 0.0, PROBE_LAG_S)
        )
        found = _least(low, middle, high, PROBE_LAG_S)
        if found is None:
            return
        gain, prior = _gain(known, DRIFT_LAG_S, found)
        step = float(np.clip(found.offset, -PROBE_LAG_S, PROBE_LAG_S))
        value = min(max(known.value + gain * step, 0.0), MOST_LAG_S)
        # A parabola that leads out of the probes tells the direction alone.
        left = prior if step != found.offset else (1.0 - gain) * prior
        brake.sensor_lag_s = Carried(value, math.sqrt(left))

    def learn_noise(
        self,
        known: list[Learned],
        brake: BrakeModel,
        sd_rad: float,
        switches: Vector,
        model: MotionModel,
        inertia_kgm2: float,
        teeth_known: bool,
    ) -> list[Learned]:
        """What is known of an edge's time and of the disturbance's torque and memory after this
        run. An edge's time cannot be told from tooth errors that are not known."""
        edges = np.concatenate(self._edges, axis=1)
        touch_pa = brake.touch_pa.value
        measured = self.pressures
        above = Pressures(measured.time_us, np.maximum(measured.pressure_pa - touch_pa, 0.0))
        law = model.with_law(brake.law(touch_pa))
        given = known[0].log

        def misfit(logs: Sequence[float]) -> float:
            time_s = math.exp(logs[EDGE_TIME] if teeth_known else given)
            disturbance = Disturbance(math.exp(logs[TORQUE]), math.exp(logs[MEMORY]))
            rate, density = disturbance.density(inertia_kgm2)
            run = CrossingFilter(self._tuning)
            run.set_edge_time(time_s)
            p = self._p.copy()
            p[DISTURBANCE, DISTURBANCE] = (disturbance.torque_nm / inertia_kgm2) ** 2
            run.begin(self._time_us, self._x, p)
            run.take(edges, sd_rad, above, switches, law.with_disturbance(rate, density))
            return run.misfit(edges.shape[1])

        found = learn(known, misfit).figures
        return found if teeth_known else [known[0], *found[1:]]

    def _misfit(
        self,
        brake: BrakeModel,
        touch_pa: float,
        sd_rad: float,
        switches: Vector,
        model: MotionModel,
        sooner_s: float = 0.0,
    ) -> float:
        run = CrossingFilter(self._tuning)
        run.begin(self._time_us, self._x, self._p)
        measured, sooner_us = self.pressures, sooner_s * SECOND_US
        pressure_pa = np.maximum(measured.pressure_pa - touch_pa, 0.0)
        above = Pressures(measured.time_us - sooner_us, pressure_pa)
        edges = np.concatenate(self._edges, axis=1)
        acting = switches - np.array([[sooner_us], [0.0]])
        run.take(edges, sd_rad, above, acting, model.with_law(brake.law(touch_pa)))
        return float(run.nis[0])
