"""Every estimator over the excitation, scored against truth and beside the bound.

The estimators are the product's own trackers, fed with edges and pressures in batches as the bus
delivers them. `crossing` has not learned its wheel; `crossing_learned` has: with matched
parameters from some seconds at speed, as built from the shifts it made before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.random import PCG64, Generator

from benchmarks.studies.bound_limit import limit
from benchmarks.studies.bound_scene import (
    OMEGA,
    SCENE_STEP_S,
    THETA,
    Parameters,
    Scene,
    SceneRun,
    SceneWheel,
    draw_run,
    draw_wheel,
)
from benchmarks.studies.thesis_predictions import predict_linear
from meshpoint.controller.estimate.baselines import BaselineTracker
from meshpoint.controller.estimate.brake_model import BrakeModel, uncorrelated
from meshpoint.controller.estimate.crossing_filter import NO_PRESSURES
from meshpoint.controller.estimate.figures import Estimate
from meshpoint.controller.estimate.layshaft_tracker import (
    CrossingTracker,
    LayshaftModels,
)
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import (
    BrakeInput,
    LayshaftState,
    diagonal,
    following_motion,
    free_motion,
    predict,
)
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import Estimator
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.gearbox.wheels import Wheel as SheetWheel
from meshpoint.kernels.records import Vector

BATCH_US: Final = 10_000.0
GRID_US: Final = 1_000.0
AHEAD_US: Final = 45_000.0
COMPARED_NAMES: Final = ("window", "thesis", "crossing", "crossing_learned", "bound")
BETWEEN_SHIFTS_US: Final = 60_000_000
"""Between two shifts of one bench, by its clock."""
NO_LAG: Final = (0.0, 0.0)
"""Of a pressure sensor, and its standard deviation (s)."""
START_SD: Final = (0.1, 10.0, 0.2e5)
"""What is known of angle (rad), speed (rad/s) and pressure (Pa) when a shift begins."""


KNOWN: Final[dict[str, Any]] = {
    "gain_walk": 0.0,
    "gain_pause": 0.0,
    "drag_walk_nm": 0.0,
    "drag_pause_nm": 0.0,
    "pressure_walk_pa": 1.0,
}
"""The filter's tuning where its parameters are known: nothing else wanders."""


class ErrorSums(NamedTuple):
    """Sums of squared errors (rad2, rad2/s2, rad2 ahead) and their numbers."""

    theta: float = 0.0
    omega: float = 0.0
    samples: int = 0
    ahead: float = 0.0
    predictions: int = 0

    def plus(self, other: ErrorSums) -> ErrorSums:
        """Both together."""
        return ErrorSums(
            self.theta + other.theta,
            self.omega + other.omega,
            self.samples + other.samples,
            self.ahead + other.ahead,
            self.predictions + other.predictions,
        )


@dataclass(frozen=True)
class Shifts:
    """A job: shifts `first` to `last` of a case, each with a gearbox and wheel of its own."""

    scene: Scene
    sheet: GearboxSheet
    settings: ControllerSettings
    as_built: bool
    seed: int
    first: int
    last: int
    learn_s: float
    earlier_shifts: int

    def run(self) -> dict[str, ErrorSums]:
        """Sums of squared errors by estimator, the bound among them."""
        total = dict.fromkeys(COMPARED_NAMES, ErrorSums())
        for number in range(self.first, self.last):
            for name, squares in self._shift(number).items():
                total[name] = total[name].plus(squares)
        return total

    def _shift(self, number: int) -> dict[str, ErrorSums]:
        rng = Generator(PCG64([self.seed, number, int(self.as_built)]))
        scene = self.scene
        wheel = draw_wheel(scene, rng)
        brake_nm = rng.uniform(scene.brake_low_nm, scene.brake_high_nm)
        sheet = self._sheet(brake_nm)
        wrong = 1.0 + (scene.wrong_share if self.as_built else 0.0) * rng.standard_normal(3)
        wrong = np.clip(wrong, 0.5, 1.5)
        true = Parameters(
            scene.friction_nms / scene.inertia_kgm2 * wrong[0],
            1.0 / (scene.time_constant_s * wrong[1]),
            brake_nm / scene.supply_pa / scene.inertia_kgm2 * wrong[2],
        )
        learned = _Bench(scene, sheet, self.settings, Estimator.CROSSING, not self.as_built)
        if self.as_built:
            for _ in range(self.earlier_shifts):
                learned.drive(draw_run(scene, wheel, true, rng))
        else:
            learned.learn_teeth(wheel, self.learn_s, rng)
        run = draw_run(scene, wheel, true, rng)
        benches = {
            "window": _Bench(scene, sheet, self.settings, Estimator.WINDOW, True),
            "thesis": _Bench(scene, sheet, self.settings, Estimator.THESIS, True),
            "crossing": _Bench(scene, sheet, self.settings, Estimator.CROSSING, not self.as_built),
            "crossing_learned": learned,
        }
        found = {name: _score(bench, run) for name, bench in benches.items()}
        return found | {"bound": _bound(scene, run)}

    def _sheet(self, brake_nm: float) -> GearboxSheet:
        scene, sheet = self.scene, self.sheet
        return replace(
            sheet,
            brake=replace(
                sheet.brake,
                max_torque_nm=brake_nm,
                valve_delay_s=0.0,
                time_constant_s=scene.time_constant_s,
            ),
            air=replace(sheet.air, supply_gauge_pa=scene.supply_pa),
            shafts=replace(
                sheet.shafts,
                layshaft_inertia_kgm2=scene.inertia_kgm2,
                input_inertia_kgm2=1e-6,
                friction_nms=scene.friction_nms,
            ),
            wheels=replace(sheet.wheels, layshaft=SheetWheel(scene.teeth, 0.5)),
        )


class _Bench:
    """One estimator with what it believes of the layshaft."""

    def __init__(
        self,
        scene: Scene,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        estimator: Estimator,
        parameters_known: bool,
    ) -> None:
        self.scene, self._sheet = scene, sheet
        self.brake = BrakeInput(0)
        self._estimator, self._tuning = estimator, settings.crossing_filter.of(sheet)
        if parameters_known:
            self._tuning = replace(self._tuning, **KNOWN)
        self.offset_us = 0.0
        known = BrakeModel(sheet, self._tuning.gain_sd, self._tuning.drag_sd_nm)
        # The scene's sensor has no lag, whatever the sheet's may have.
        known.touch_and_lag = uncorrelated((known.touch_pa.value, known.touch_pa.sd), NO_LAG)
        self._known = known
        if parameters_known:
            known.gain, known.drag_nm = Estimate(1.0, 0.0), Estimate(0.0, 0.0)
            known.touch_and_lag = uncorrelated((0.0, 1.0), NO_LAG)
        self._learns = not parameters_known
        self.tracker: BaselineTracker | CrossingTracker
        if estimator is Estimator.CROSSING:
            self.tracker = CrossingTracker(self._tuning, self.brake, known, scene.teeth)
        else:
            pitch = 2.0 * math.pi / scene.teeth
            self.tracker = BaselineTracker(estimator, settings, self.brake, pitch)
        self.refresh()

    @property
    def teeth(self) -> WheelTeeth:
        """What has been learned of the wheel."""
        if not isinstance(self.tracker, CrossingTracker):
            raise TypeError(f"estimator {self._estimator.name} learns no teeth")
        return self.tracker.teeth

    def refresh(self) -> None:
        """The model of what is known."""
        sheet, split = self._sheet, Split.HIGH
        law = self._known.law()
        if self._learns and self._estimator is Estimator.CROSSING:
            self.brake.set_delays(self._known.off_delay_us, self._known.on_delay_us)
        motion = free_motion(sheet, split, law, self._tuning)
        thesis = layshaft_model(sheet, split)
        self.tracker.set_models(LayshaftModels(motion, thesis, sheet.inertia_kgm2(split)))

    def learn_teeth(self, wheel: SceneWheel, learn_s: float, rng: Generator) -> None:
        """Some seconds at a speed that is held, the disturbances as ever."""
        scene = self.scene
        held = replace(scene, before_s=learn_s, after_s=1e-3, from_low_rad_s=scene.from_high_rad_s)
        still = Parameters(0.0, 1.0 / scene.time_constant_s, 1e-12)
        cruise = replace(held, to_low_rad_s=scene.from_high_rad_s, to_high_rad_s=1e4 * 0.1047)
        run = draw_run(cruise, wheel, still, rng)
        sigma = scene.disturbance_nm / scene.inertia_kgm2
        model = following_motion(sigma, scene.disturbance_s, 1e-3)
        teeth = self.teeth
        x = np.array([run.state[0, THETA], run.state[0, OMEGA], 0.0, 0.0, 1.0, 0.0])
        p = diagonal(0.05, 1.0, 1.0, sigma, 1e-9, 1e-3)
        teeth.learner.begin(0.0, x, p)
        none = np.empty((2, 0))
        batch = batch_of(scene, run, 0.0, math.inf, 0.0)
        teeth.learner.take(batch, teeth.place(batch), NO_PRESSURES, none, model)
        teeth.end_window()

    def drive(self, run: SceneRun, each: Callable[[float], None] | None = None) -> None:
        """One shift from its first edge to its end; `each` is called with the time after every
        batch.

        The layshaft is known to be free from half of the time before the brake on."""
        tracker, brake = self.tracker, self.brake
        self.offset_us += BETWEEN_SHIFTS_US
        if isinstance(tracker, CrossingTracker):
            tracker.lose_speed()
        on_us, off_us = (round(self.offset_us + s * 1e6) for s in (run.on_s, run.off_s))
        brake.schedule(on_us, True, on_us - 1)
        brake.schedule(off_us, False, on_us)
        end_us, free_us = run.end_s * 1e6, 0.5 * run.on_s * 1e6
        for batch_us in np.arange(BATCH_US, end_us, BATCH_US):
            tracker.edges(
                batch_of(self.scene, run, batch_us - BATCH_US, batch_us, self.offset_us),
                _pressures(run, batch_us - BATCH_US, batch_us, self.offset_us),
            )
            tracker.set_free(bool(batch_us >= free_us), self.offset_us + batch_us, [])
            if each is not None:
                each(batch_us)
        tracker.set_free(False, self.offset_us + end_us, [])
        self.refresh()

    def at(self, time_us: float) -> LayshaftState | None:
        """The estimate at a time of the run."""
        return self.tracker.at(self.offset_us + time_us)

    def ahead(self, time_us: float) -> LayshaftState | None:
        """The prediction for AHEAD_US after a time, future commands known."""
        state = self.at(time_us)
        if state is None:
            return None
        to_us = self.offset_us + time_us + AHEAD_US
        if self._estimator is Estimator.WINDOW:
            return predict_linear(state, to_us)
        return predict(state, to_us, self.brake.arrays(), self.tracker.model)


def batch_of(
    scene: Scene, run: SceneRun, from_us: float, to_us: float, offset_us: float
) -> EdgeBatch:
    """The edges of a time, as `meshpoint.controller.measure.wheel_edges` gives them."""
    inside = (run.edge_us > from_us) & (run.edge_us <= to_us)
    number = run.edge[inside]
    theta: Vector = np.pi / scene.teeth * number.astype(np.float64)
    return EdgeBatch(run.edge_us[inside] + offset_us, theta, number // 2, number % 2)


def _pressures(run: SceneRun, from_us: float, to_us: float, offset_us: float) -> PressureSamples:
    """By a sensor without a lag."""
    inside = (run.pressure_us > from_us) & (run.pressure_us <= to_us)
    time_us, pressure_pa = run.pressure_us[inside] + offset_us, run.pressure_pa[inside]
    return PressureSamples(time_us, pressure_pa, np.zeros(time_us.size))


def _score(bench: _Bench, run: SceneRun) -> ErrorSums:
    """Errors from brake on to the end, each from batches delivered before; and of predictions whose
    horizon holds the brake's release."""
    sums = np.zeros(3)
    numbers = np.zeros(2, np.int64)

    def each(batch_us: float) -> None:
        for time_us in np.arange(batch_us, batch_us + BATCH_US, GRID_US):
            state = bench.at(time_us)
            if state is None or not run.on_s * 1e6 <= time_us < run.end_s * 1e6:
                continue
            sums[0] += (state.theta_rad - _true(run, THETA, time_us)) ** 2
            sums[1] += (state.omega_rad_s - _true(run, OMEGA, time_us)) ** 2
            numbers[0] += 1
        predicted = bench.ahead(batch_us) if _predicts(run, batch_us) else None
        if predicted is not None:
            sums[2] += (predicted.theta_rad - _true(run, THETA, batch_us + AHEAD_US)) ** 2
            numbers[1] += 1

    bench.drive(run, each)
    return ErrorSums(
        float(sums[0]), float(sums[1]), int(numbers[0]), float(sums[2]), int(numbers[1])
    )


def _bound(scene: Scene, run: SceneRun) -> ErrorSums:
    first_us = math.ceil(run.on_s * 1e6 / GRID_US) * GRID_US
    grid_us = np.arange(first_us, run.end_s * 1e6, GRID_US)
    sigma = scene.disturbance_nm / scene.inertia_kgm2
    start = np.diag(np.square([*START_SD, sigma]))
    least = limit(scene, run, start, grid_us, BATCH_US, AHEAD_US)
    ahead = np.array([time_us % BATCH_US == 0.0 and _predicts(run, time_us) for time_us in grid_us])
    return ErrorSums(
        float(least.theta_rad2.sum()),
        float(least.omega_rad2_s2.sum()),
        grid_us.size,
        float(least.ahead_rad2[ahead].sum()),
        int(ahead.sum()),
    )


def _predicts(run: SceneRun, time_us: float) -> bool:
    """Whether the brake's release lies within the prediction's horizon."""
    return time_us <= run.off_s * 1e6 < time_us + AHEAD_US < run.end_s * 1e6


def _true(run: SceneRun, state: int, time_us: float) -> float:
    """Truth between grid points: angle by the speed's trapezoid, else linear."""
    at = min(int(time_us * 1e-6 / SCENE_STEP_S), run.time_s.size - 2)
    left_s = time_us * 1e-6 - run.time_s[at]
    slope = (run.state[at + 1, state] - run.state[at, state]) / SCENE_STEP_S
    return float(run.state[at, state] + slope * left_s)
