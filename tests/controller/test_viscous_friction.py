"""The layshaft's viscous friction is learned from free motion, and the drag with it, against a
layshaft written apart from the filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest
from free_layshaft import Runs, World, drive, law_array

from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.estimate.crossing_filter import Pressures
from meshpoint.controller.estimate.figures import Figure, prior
from meshpoint.controller.estimate.free_run import FreeMotion, FreeRun
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import diagonal, free_motion
from meshpoint.controller.models.layshaft_kernels import DRAG
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.kernels.records import Vector

TUNING = CrossingFilterTuning(tooth_error_rad=3e-4)
SHIFTS, SECONDS = 4, 0.35
SWITCHES = np.array([[30e3, 200e3], [1.0, 0.0]])
START_RAD_S, DRAG_NM = 140.0, -1.5


@dataclass
class Teeth:
    """A wheel whose teeth are known."""

    sd_rad: float = TUNING.tooth_error_rad

    def edges(self, batch: EdgeBatch, place: Vector) -> Vector:
        return np.array((batch.time_us, batch.theta_rad))


@dataclass
class Brake:
    """A brake that is known; what a run says of the drag is kept."""

    drag_nm: tuple[float, float]

    def law(self) -> Vector:
        return law_array()

    def above_touch(self, samples: PressureSamples) -> Pressures:
        return Pressures(samples.time_us, samples.pressure_pa)

    def carry(self, x: Vector, p: Vector, inertia_kgm2: float) -> None:
        self.drag_nm = (x[DRAG] * inertia_kgm2, math.sqrt(p[DRAG, DRAG]) * inertia_kgm2)


@dataclass
class Box:
    """A layshaft of some friction, shifted again and again."""

    sheet: GearboxSheet
    factor: float
    friction: Figure = field(init=False)
    brake: Brake = field(init=False)

    def __post_init__(self) -> None:
        self.friction = prior(self.sheet.shafts.friction_nms, 3.0, (1e-3, 2.0), 0.1)
        self.inertia = self.sheet.inertia_kgm2(Split.HIGH)
        world = World.of(self.sheet, TUNING)
        self.world = replace(world, a=world.a * self.factor)
        self.steady_rad_s = START_RAD_S - 50.0
        self.brake = Brake((self.total_nm(self.steady_rad_s), TUNING.drag_pause_nm))

    def total_nm(self, omega_rad_s: float) -> float:
        """The true drag at a speed, as the drag of a layshaft that has the sheet's friction."""
        surplus = self.friction.value - self.sheet.shafts.friction_nms * self.factor
        return DRAG_NM + surplus * omega_rad_s

    def shift(self, rng: np.random.Generator) -> None:
        inertia = self.inertia
        start = np.array([[0.0, START_RAD_S, 0.0, 0.0, 1.0, DRAG_NM / inertia]])
        runs = drive(self.world, start, SWITCHES, SECONDS, rng)
        drag_nm, drag_sd_nm = self.brake.drag_nm
        drag_sd = math.hypot(drag_sd_nm, TUNING.drag_pause_nm) / inertia
        p = diagonal(1e-3, 0.5, 1e3, TUNING.torque_disturbance_nm / inertia,
                     TUNING.gain_pause, drag_sd)  # fmt: skip
        run = FreeRun(TUNING)
        run.begin(0.0, np.array([0.0, START_RAD_S, 0.0, 0.0, 1.0, drag_nm / inertia]), p)
        run.add(*taken(runs))
        self.friction = run.learn_friction(
            self.friction, self.steady_rad_s, *self.reported(SWITCHES)
        )
        self.steady_rad_s = float(runs.state[-1, 0, 1])

    def reported(self, switches: Vector) -> tuple[BrakeModel, FreeMotion]:
        """What is believed of brake and motion."""
        friction_nms = self.friction.value
        model = free_motion(self.sheet, Split.HIGH, law_array(), TUNING, None, friction_nms)
        teeth = cast(WheelTeeth, Teeth())
        motion = FreeMotion(teeth, TUNING.edge_time_s, switches, model, self.inertia)
        return cast(BrakeModel, self.brake), motion


def taken(runs: Runs) -> tuple[EdgeBatch, Vector, PressureSamples]:
    (time_us, theta_rad, number), (pressure_us, pressure_pa) = runs.edges[0], runs.pressures[0]
    batch = EdgeBatch(time_us, theta_rad, number // 2, number % 2)
    return batch, number, PressureSamples(pressure_us, pressure_pa, np.zeros(pressure_us.size))


@pytest.mark.check
@pytest.mark.parametrize("factor", [0.28, 1.0, 2.5])
def test_a_friction_that_is_not_the_sheets_is_learned(sheet: GearboxSheet, factor: float) -> None:
    """And the drag that is left at the end of a shift is the true one, by whatever friction."""
    box, rng = Box(sheet, factor), np.random.default_rng(4)
    for _ in range(SHIFTS):
        box.shift(rng)
    truth_nms = factor * sheet.shafts.friction_nms
    assert abs(math.log(box.friction.value / truth_nms)) < 3.0 * box.friction.sd
    assert box.friction.sd < 0.5
    drag_nm, drag_sd_nm = box.brake.drag_nm
    assert drag_nm == pytest.approx(box.total_nm(box.steady_rad_s), abs=3.0 * drag_sd_nm)


def test_a_moment_of_coasting_tells_no_friction(sheet: GearboxSheet) -> None:
    """Without a change of speed friction and drag are one."""
    box = Box(sheet, 0.28)
    known, total_nm = box.friction, box.total_nm(START_RAD_S)
    start = np.array([[0.0, START_RAD_S, 0.0, 0.0, 1.0, total_nm / box.inertia]])
    never = np.zeros(0)
    runs = drive(box.world, start, (never, never), 0.04, np.random.default_rng(5))
    run = FreeRun(TUNING)
    run.begin(0.0, start[0], diagonal(1e-3, 0.5, 1.0, 1.0, 1e-6, TUNING.drag_sd_nm / box.inertia))
    run.add(*taken(runs))
    found = run.learn_friction(known, START_RAD_S, *box.reported(np.array([never, never])))
    assert found.sd > 0.9 * known.sd
    assert abs(found.log - known.log) < 0.2 * known.sd
