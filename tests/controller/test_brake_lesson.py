"""A free run teaches the brake by the switches of that run: by those of before and in it, and none
that come after, whenever the lesson is learned. Against a brake of the first order in closed form
(`test_brake_model.true_pressure`)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_brake_model import END_US, OFF_US, ON_US, OTHER, SHEET, TUNING, fresh, measured, motion_of

from meshpoint.controller.estimate.brake_model import BrakeModel
from meshpoint.controller.estimate.layshaft_tracker import CrossingTracker, LayshaftModels
from meshpoint.controller.measure.gearbox_view import NO_SAMPLES, PressureSamples
from meshpoint.controller.measure.wheel_edges import EdgeBatch
from meshpoint.controller.models.layshaft import BrakeInput
from meshpoint.controller.settings.learned import BrakeRecord
from meshpoint.gearbox import Split

TEETH, OMEGA_RAD_S, STEP_US = SHEET.wheels.layshaft.teeth, 150.0, 10_000
BEGIN_US, FREE_US = int(ON_US) - 200_000, int(ON_US) - 30_000


def edges(from_us: int, to_us: int) -> EdgeBatch:
    """Of a wheel that turns evenly."""
    half_pitch = math.pi / TEETH
    first, end = (math.ceil(us * 1e-6 * OMEGA_RAD_S / half_pitch) for us in (from_us, to_us))
    number = np.arange(first, end)
    angle = number * half_pitch
    return EdgeBatch(angle / OMEGA_RAD_S * 1e6, angle, number // 2 % TEETH, number % 2)


def between(samples: PressureSamples, from_us: int, to_us: int) -> PressureSamples:
    inside = (samples.time_us >= from_us) & (samples.time_us < to_us)
    return PressureSamples(*(column[inside] for column in samples))


def after_a_run(
    later_us: list[int], is_shifting: bool = True
) -> tuple[CrossingTracker, BrakeModel]:
    """After a run, and these further switches, on first."""
    brake, known = BrakeInput(0), fresh()
    tracker = CrossingTracker(TUNING, brake, known, TEETH)
    tracker.set_models(
        LayshaftModels(motion_of(known.law()), np.zeros(1), SHEET.inertia_kgm2(Split.HIGH))
    )
    samples, said = measured(1, **OTHER), list[str]()
    brake.schedule(int(ON_US), True, FREE_US)
    for now_us in range(BEGIN_US, int(END_US), STEP_US):
        if now_us == int(ON_US) + 100_000:
            brake.schedule(int(OFF_US), False, now_us)
        if now_us == FREE_US:
            tracker.set_free(True, now_us, said, is_shifting)
        pressures = between(samples, now_us - STEP_US, now_us) if tracker.free else NO_SAMPLES
        tracker.edges(edges(now_us - STEP_US, now_us), pressures)
    tracker.set_free(False, END_US, said)
    for number, time_us in enumerate(later_us):
        brake.schedule(time_us, number % 2 == 0, time_us)
    return tracker, known


def learned(later_us: list[int]) -> BrakeRecord:
    """What such a run has taught."""
    tracker, known = after_a_run(later_us)
    assert tracker.is_learning
    tracker.learn()
    record = known.record()
    assert record is not None
    return record


def test_a_run_out_of_a_shift_teaches_nothing() -> None:
    """A bench that turned the layshaft back taught a drag of 225 Nm: gears were raised beyond the
    input shaft's limit, and ended in neutral."""
    tracker, known = after_a_run([], is_shifting=False)
    assert not tracker.is_learning
    fresh_one = fresh()
    assert (known.gain, known.drag_nm) == (fresh_one.gain, fresh_one.drag_nm)


def test_a_run_teaches_the_delays_of_its_own_switches_each_way_by_itself() -> None:
    record = learned([])
    assert record.on_delay_s == pytest.approx(OTHER["on_s"], abs=5e-4)
    assert record.off_delay_s == pytest.approx(OTHER["off_s"], abs=5e-4)
    assert record.shifts == 1


@pytest.mark.parametrize("count", [1, 2, 17])
def test_what_the_brake_does_after_a_run_teaches_nothing_of_it(count: int) -> None:
    """A lesson is learned in the steps after a run, while the brake may be at work for the next."""
    later_us = [int(END_US) + 5_000 + 20_000 * number for number in range(count)]
    assert learned(later_us) == learned([])
