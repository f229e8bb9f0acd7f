"""Teeth learned from a shaft that something unknown drives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.estimate.wheel_tracker import ACCELERATION, EDGE_TIME, TURNS, TeethInGear
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.settings import Preset, Profile

TUNING = CrossingFilterTuning()
TEETH, PITCH_DEG, RUNOUT_DEG = 43, 0.28, 0.14
JITTER_S = 20e-6
STEP_S = 1e-4


def a_wheel(rng: np.random.Generator) -> Vector:
    """Errors of its edges (rad), without their mean."""
    turn = math.pi / TEETH * np.arange(2 * TEETH)
    errors = np.radians(PITCH_DEG) * np.repeat(rng.uniform(-1.0, 1.0, TEETH), 2)
    errors += np.radians(RUNOUT_DEG) * np.sin(turn + 1.0)
    errors[1::2] += np.radians(0.3)
    return np.asarray(errors - errors.mean())


def a_drive(rng: np.random.Generator, turns: int, omega: float, accel: float) -> Vector:
    """Times (us) at which a shaft with accelerations of chance passes each edge's nominal angle."""
    count = int(1.1 * turns * math.tau / omega / STEP_S)
    memory, chance = math.exp(-STEP_S / 0.01), rng.standard_normal(count)
    torque = np.empty(count)
    value = 0.0
    for k in range(count):
        value = memory * value + accel * math.sqrt(1.0 - memory**2) * chance[k]
        torque[k] = value
    speed = omega + np.cumsum(torque) * STEP_S
    angle = np.concatenate(([0.0], np.cumsum(speed) * STEP_S))
    nominal = math.pi / TEETH * np.arange(1, 2 * TEETH * turns + 1)
    return np.asarray(np.interp(nominal, angle, np.arange(angle.size) * STEP_S * 1e6))


def seen(errors: Vector, times_us: Vector, omega: float, rng: np.random.Generator) -> EdgeBatch:
    """The edges of a wheel with these errors, stamped with jitter."""
    number = np.arange(1, times_us.size + 1)
    later_us = errors[number % (2 * TEETH)] / omega * 1e6
    stamps = times_us + later_us + 1e6 * JITTER_S * rng.standard_normal(times_us.size)
    nominal = math.pi / TEETH * number
    return EdgeBatch(stamps, nominal, number // 2 % TEETH, number % 2)


def learned_from(errors: Vector, turns: int, seed: int) -> tuple[WheelTeeth, TeethInGear]:
    rng = np.random.default_rng(seed)
    teeth = WheelTeeth(TEETH, TUNING)
    gear = TeethInGear(teeth, TUNING)
    batch = seen(errors, a_drive(rng, turns, 100.0, 15.0), 100.0, rng)
    for first in range(0, batch.time_us.size, 14):
        part = EdgeBatch(*(column[first : first + 14] for column in batch[:4]))
        gear.edges(part)
        if first % 1400 == 0:
            gear.end()
    gear.end()
    return teeth, gear


def test_a_wheel_is_learned_in_gear_though_its_sensor_is_twice_as_inexact_as_was_thought() -> None:
    errors = a_wheel(np.random.default_rng(3))
    teeth, gear = learned_from(errors, 30, 4)
    assert teeth.learned
    left = np.asarray(teeth.error_rad - errors)
    assert math.degrees(float(np.std(left))) < 0.03
    assert math.degrees(float(np.std(errors))) > 0.2
    assert gear.figures[EDGE_TIME] == pytest.approx(JITTER_S, rel=0.15)
    assert 5.0 < gear.figures[ACCELERATION] < 45.0


def test_errors_are_about_as_large_as_is_said() -> None:
    squares = []
    for seed in range(6):
        errors = a_wheel(np.random.default_rng(seed))
        teeth, _ = learned_from(errors, 4 * TURNS, 100 + seed)
        squares.append(float(np.mean((teeth.error_rad - errors) ** 2)) / teeth.sd_rad**2)
    assert 0.3 < np.mean(squares) < 3.0


def test_a_stretch_with_edges_missing_teaches_nothing() -> None:
    teeth = WheelTeeth(TEETH, TUNING)
    gear = TeethInGear(teeth, TUNING)
    rng = np.random.default_rng(1)
    batch = seen(np.zeros(2 * TEETH), a_drive(rng, TURNS, 100.0, 1.0), 100.0, rng)
    batch.time_us[100:] += 100_000.0
    gear.edges(batch)
    gear.end()
    assert teeth.edges_seen == 0


@pytest.mark.check
def test_teeth_are_known_after_the_first_shifts_of_a_gearbox_with_a_sensor_of_20_us() -> None:
    """This gearbox's wheels were never learned from its windows in neutral: a jitter twice as large
    as was thought made each measurement like a motion that the model does not have."""
    truck12 = load_sheet("truck12")
    drawn = draw(1_900_000_007, truck12, Preset.TRUCK, upshifts(), 2, {}, Profile.TYPICAL)
    loop = ClosedLoop(truck12, ControllerSettings(), Preset.TRUCK, drawn)
    assert loop.as_built["hall"]["jitter_us"] > 19.0
    loop.shift()
    loop.shift()
    teeth = loop.controller.observer.layshaft.teeth
    assert teeth.learned
    assert math.degrees(teeth.sd_rad) < 0.07
