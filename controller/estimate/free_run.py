"""The data of one interval of free layshaft, to run the filter again with other figures.

The sum of normalised innovation squares (NIS) is least for the figures that fit best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from meshpoint.controller.estimate.brake_model import BrakeModel, above_touch, best_of
from meshpoint.controller.estimate.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.estimate.figures import Figure, Search, learn
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.measure.gearbox_view import PressureSamples, together
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import Disturbance, MotionModel
from meshpoint.controller.models.layshaft_kernels import DISTURBANCE, DRAG, GAIN
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.kernels.records import Integers, Vector
from meshpoint.units import SECOND_US

EDGE_TIME, TORQUE, MEMORY = range(3)
"""Figures of the noise, in their order."""


class FreeMotion(NamedTuple):
    """How the free layshaft moves, by what is known at the end of a run."""

    teeth: WheelTeeth
    edge_time_s: float
    """Standard deviation of an edge's time."""
    switches: Vector
    """Of the brake, as the kernels take them."""
    model: MotionModel
    inertia_kgm2: float


class FreeRun:
    """The edges and pressures since the layshaft became free, and the state it started from."""

    def __init__(self, tuning: CrossingFilterTuning) -> None:
        self._tuning = tuning
        self._time_us = 0.0
        self._x, self._p = np.zeros(0), np.zeros((0, 0))
        self._edges: list[tuple[EdgeBatch, Integers]] = []
        self._samples: list[PressureSamples] = []

    def begin(self, time_us: float, x: Vector, p: Vector) -> None:
        """The layshaft is free from here on."""
        self._time_us, self._x, self._p = time_us, x.copy(), p.copy()
        self._edges.clear()
        self._samples.clear()

    def add(self, batch: EdgeBatch, place: Integers, samples: PressureSamples) -> None:
        """What the filter takes, and where on the wheel the edges are."""
        self._edges.append((batch, place))
        self._samples.append(samples)

    @property
    def samples(self) -> PressureSamples:
        """All measured pressures."""
        return together(self._samples)

    def learn_touch_and_lag(self, brake: BrakeModel, motion: FreeMotion) -> None:
        """Updates the brake's touch pressure and its sensor's lag with those that fit this run
        best, and gain and drag with what the run then says of them.

        While they are looked for, gain and drag are as open as before the first shift: what earlier
        shifts showed of them holds for the touch and the lag that were believed then."""
        tuning, known, open_p = self._tuning, brake.touch_and_lag, self._p.copy()
        inertia = motion.inertia_kgm2
        for figure, open_sd in ((GAIN, tuning.gain_sd), (DRAG, tuning.drag_sd_nm / inertia)):
            open_p[figure, figure] = max(open_p[figure, figure], open_sd**2)
        edges, samples = self._edges_by(motion.teeth), self.samples
        before_s = float(known.mean[1])

        def run(touch_pa: float, lag_s: float, p: Vector) -> CrossingFilter:
            law = motion.model.changed(segments=brake.law(touch_pa))
            acting = motion.switches - np.array([[(lag_s - before_s) * SECOND_US], [0.0]])
            changed = motion._replace(model=law, switches=acting)
            return self._again(edges, above_touch(samples, touch_pa, lag_s), changed, p)

        found = best_of(lambda touch, lag: float(run(touch, lag, open_p).nis[0]), known)
        end = run(float(found.mean[0]), float(found.mean[1]), self._p)
        if np.isfinite(end.x).all():
            brake.take_touch_and_lag(found)
            brake.carry(end.x, end.p, inertia)

    def search_noise(self, known: list[Figure], brake: BrakeModel, motion: FreeMotion) -> Search:
        """Looks for an edge's time and for the disturbance's torque and memory in this run. An
        edge's time cannot be distinguished from tooth errors that are not known: it stays then."""
        inertia = motion.inertia_kgm2
        edges, pressures = self._edges_by(motion.teeth), brake.above_touch(self.samples)
        law = motion.model.changed(segments=brake.law())

        def deviance(logs: Sequence[float]) -> float:
            time_s = math.exp(logs[EDGE_TIME])
            disturbance = Disturbance(math.exp(logs[TORQUE]), math.exp(logs[MEMORY]))
            p = self._p.copy()
            p[DISTURBANCE, DISTURBANCE] = (disturbance.torque_nm / inertia) ** 2
            rate, density = disturbance.density(inertia)
            model = law.changed(fading_per_s=rate, disturbance_rad2_s5=density)
            changed = motion._replace(model=model, edge_time_s=time_s)
            return self._again(edges, pressures, changed, p).deviance(edges.shape[1])

        return Search(known, deviance, held=() if motion.teeth.learned else (EDGE_TIME,))

    def learn_friction(
        self, known: Figure, steady_rad_s: float, brake: BrakeModel, motion: FreeMotion
    ) -> Figure:
        """What is known of the viscous friction (Nms) after this run, by which the drag falls with
        the speed; updates gain and drag with what the run then says of them.

        steady_rad_s: the speed at which the drag is known, whatever the friction."""
        edges, pressures = self._edges_by(motion.teeth), brake.above_touch(self.samples)
        law = motion.model.changed(segments=brake.law())

        def run(friction_nms: float) -> CrossingFilter:
            rate = friction_nms / motion.inertia_kgm2
            x = self._x.copy()
            x[DRAG] += (rate - motion.model.friction_per_s) * steady_rad_s
            changed = motion._replace(model=law.changed(friction_per_s=rate))
            return self._again(edges, pressures, changed, self._p, x)

        found = learn([known], lambda logs: run(math.exp(logs[0])).deviance(edges.shape[1]))
        if not math.isfinite(found.deviance):
            return known
        end = run(found.figures[0].value)
        brake.carry(end.x, end.p, motion.inertia_kgm2)
        return found.figures[0]

    def _edges_by(self, teeth: WheelTeeth) -> Vector:
        """All edges (2, n), their angles by what is known of the teeth now."""
        return np.concatenate([teeth.edges(*taken) for taken in self._edges], axis=1)

    def _again(
        self,
        edges: Vector,
        pressures: Pressures,
        motion: FreeMotion,
        p: Vector,
        x: Vector | None = None,
    ) -> CrossingFilter:
        """The filter over this run once more, from covariance `p`, and another state than it began
        with if one is given."""
        run = CrossingFilter(self._tuning)
        run.set_edge_time(motion.edge_time_s)
        run.begin(self._time_us, self._x if x is None else x, p)
        run.take(edges, motion.teeth.sd_rad, pressures, motion.switches, motion.model)
        return run
