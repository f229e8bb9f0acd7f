"""The path from a brake's command to its torque, learned from measured pressures of a brake that is
another than the data sheet's, and known as well as is said."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.estimate.brake_model import (
    LEAST_SAMPLES,
    PARAMETERS,
    BrakeModel,
    uncorrelated,
)
from meshpoint.controller.estimate.figures import Estimate
from meshpoint.controller.measure.gearbox_view import PressureSampler, PressureSamples
from meshpoint.controller.models.layshaft import LayshaftState, MotionModel, free_motion, predict
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import Split, load_sheet

SHEET = load_sheet("truck12")
TAU_S, DELAY_S = SHEET.brake.time_constant_s, SHEET.brake.valve_delay_s
SUPPLY_PA = SHEET.air.supply_gauge_pa
LAG_S = SHEET.air.sensor_lag_s
ON_US, OFF_US, END_US = 1_000_000.0, 1_180_000.0, 1_500_000.0
COMMANDS = np.array([ON_US, OFF_US]), np.array([1.0, 0.0])
TUNING = ControllerSettings().crossing_filter


def fresh() -> BrakeModel:
    return BrakeModel(SHEET, 0.1, 5.0)


def motion_of(law: np.ndarray) -> MotionModel:
    return free_motion(SHEET, Split.HIGH, law, TUNING)


def pressure_by(model: BrakeModel, time_us: float, touch_pa: float | None = None) -> float:
    """By the model's law, of a brake that was filled from nothing."""
    switches = np.array((COMMANDS[0] + [model.on_delay_us, model.off_delay_us], COMMANDS[1]))
    start = LayshaftState(ON_US - 1e4, 0.0, 150.0, 0.0)
    return predict(start, time_us, switches, motion_of(model.law(touch_pa))).pressure_pa


def true_pressure(
    time_us: np.ndarray, filling_s: float, emptying_s: float, on_s: float, off_s: float
) -> np.ndarray:
    """Of a brake of the first order with a time constant a direction."""
    filled_us, emptied_us = ON_US + 1e6 * on_s, OFF_US + 1e6 * off_s
    filling = SUPPLY_PA * -np.expm1(-np.maximum(0.0, time_us - filled_us) * 1e-6 / filling_s)
    most = SUPPLY_PA * -math.expm1(-(emptied_us - filled_us) * 1e-6 / filling_s)
    emptying = most * np.exp(-np.maximum(0.0, time_us - emptied_us) * 1e-6 / emptying_s)
    return np.where(time_us < emptied_us, filling, emptying)


def measured(seed: int, lag_s: float = LAG_S, **brake: float) -> PressureSamples:
    """A sample every 5 ms, with an error of 1 kPa, by a sensor that lags."""
    time_us = np.arange(ON_US - 3e4, END_US, 5e3)
    rng = np.random.default_rng(seed)
    seen = true_pressure(time_us - 1e6 * lag_s, **brake) + rng.normal(0.0, 1e3, time_us.size)
    smooth = PressureSampler().take(
        list(zip(time_us.astype(int).tolist(), seen.tolist(), strict=True))
    )
    return smooth._replace(curvature_pa_s2=np.zeros(time_us.size))


OTHER = {"filling_s": 1.18 * TAU_S, "emptying_s": 0.85 * TAU_S,
         "on_s": DELAY_S + 0.0015, "off_s": DELAY_S - 0.001}  # fmt: skip


def test_before_any_shift_the_brake_is_the_data_sheet_s() -> None:
    model = fresh()
    assert (model.on_delay_us, model.off_delay_us) == (round(1e6 * DELAY_S),) * 2
    assert (model.gain.value, model.gain.sd) == (1.0, 0.1)
    assert (model.drag_nm.value, model.drag_nm.sd) == (0.0, 5.0)
    assert (model.touch_pa.value, model.sensor_lag_s.value) == (0.0, LAG_S)
    assert model.record() is None
    sheet = {"filling_s": TAU_S, "emptying_s": TAU_S, "on_s": DELAY_S, "off_s": DELAY_S}
    for time_us in np.arange(ON_US, END_US, 7e3):
        expected = float(true_pressure(np.array([time_us]), **sheet)[0])
        assert pressure_by(model, time_us) == pytest.approx(expected, abs=2e-3 * SUPPLY_PA)


def learned(shifts: int = 5) -> BrakeModel:
    model = fresh()
    for shift in range(shifts):
        assert model.learn(measured(shift, **OTHER), *COMMANDS)
    return model


def test_another_brake_is_known_after_some_shifts() -> None:
    """Its pressures within 1.5 % of the supply's, its delays within half a millisecond."""
    model = learned()
    assert model.shifts == 5
    assert model.on_delay_us == pytest.approx(1e6 * OTHER["on_s"], abs=500)
    assert model.off_delay_us == pytest.approx(1e6 * OTHER["off_s"], abs=500)
    for time_us in np.arange(ON_US, END_US, 7e3):
        expected = float(true_pressure(np.array([time_us]), **OTHER)[0])
        assert pressure_by(model, time_us) == pytest.approx(expected, abs=0.015 * SUPPLY_PA)


def test_what_is_learned_of_a_brake_is_as_sure_as_it_says() -> None:
    """Each shift makes it surer; where it has been, rates and delays are off by some deviations at
    most; where it has not been, they are as unsure as before."""
    before, after = fresh(), learned(1)
    more = learned(6)
    one, six = after.record(), more.record()
    assert one is not None and six is not None
    sheet_sd_s = SHEET.brake.valve_delay_tolerance * DELAY_S
    for record in (one, six):
        assert record.on_delay_sd_s < 0.5 * sheet_sd_s
        assert abs(record.on_delay_s - OTHER["on_s"]) < 4.0 * record.on_delay_sd_s + 2e-4
        assert abs(record.off_delay_s - OTHER["off_s"]) < 4.0 * record.off_delay_sd_s + 2e-4
        assert record.filling[0] == pytest.approx(1.0 / 1.18, abs=4.0 * record.filling_sd[0] + 0.02)
    assert six.on_delay_sd_s < one.on_delay_sd_s
    assert six.filling_sd[0] < one.filling_sd[0]
    assert before.record() is None


def test_a_shift_that_shows_no_brake_teaches_nothing() -> None:
    model, samples = fresh(), measured(1, **OTHER)
    few = PressureSamples(*(column[: LEAST_SAMPLES - 1] for column in samples))
    nothing = np.array([]), np.array([])
    never = np.array([ON_US]), np.array([0.0])
    for taken, commands in ((few, COMMANDS), (samples, nothing), (samples, never)):
        assert not model.learn(taken, *commands)
    assert model.shifts == 0
    assert (model.law() == fresh().law()).all()
    enough = PressureSamples(*(column[:LEAST_SAMPLES] for column in samples))
    assert model.learn(enough, *COMMANDS)


def test_samples_that_come_late_are_of_before() -> None:
    """A sensor's lag is no delay of the valve."""
    quick = learned()
    slow = fresh()
    slow.touch_and_lag = uncorrelated((0.0, 1e4), (LAG_S + 0.004, 1e-3))
    for shift in range(5):
        assert slow.learn(measured(shift, LAG_S + 0.004, **OTHER), *COMMANDS)
    assert slow.on_delay_us == pytest.approx(quick.on_delay_us, abs=150)
    assert slow.off_delay_us == pytest.approx(quick.off_delay_us, abs=150)
    later = learned()
    later.take_touch_and_lag(uncorrelated((0.0, 1e4), (LAG_S + 0.002, 1e-3)))
    assert later.on_delay_us == pytest.approx(quick.on_delay_us - 2_000, abs=2)
    assert later.off_delay_us == pytest.approx(quick.off_delay_us - 2_000, abs=2)
    assert later.sensor_lag_s.value == LAG_S + 0.002


@pytest.mark.parametrize("touch_pa", [1e4, 4e4])
def test_pads_that_touch_at_a_pressure_brake_later_and_by_as_much_less(touch_pa: float) -> None:
    """From where it is reached on, the pressure that brakes is the whole one less the touch's;
    emptied, it is none as soon as that is reached."""
    model, whole = learned(), learned()
    model.touch_and_lag = uncorrelated((touch_pa, 1e3), (LAG_S, 1e-3))
    reached_s = touch_pa / SUPPLY_PA * OTHER["filling_s"]
    later_us = model.on_delay_us - whole.on_delay_us
    assert later_us == pytest.approx(1e6 * reached_s, rel=0.1)
    assert model.off_delay_us == whole.off_delay_us
    for time_us in np.arange(ON_US, END_US, 7e3):
        expected = max(0.0, pressure_by(whole, time_us) - touch_pa)
        assert pressure_by(model, time_us) == pytest.approx(expected, abs=0.004 * SUPPLY_PA)
    samples = PressureSamples(np.array([1e6]), np.array([3e5]), np.array([0.0]))
    assert model.above_touch(samples).pressure_pa[0] == pytest.approx(3e5 - touch_pa)
    assert model.above_touch(samples).time_us[0] == pytest.approx(1e6 - 1e6 * LAG_S)
    nearly = PressureSamples(np.array([1e6]), np.array([0.5 * touch_pa]), np.array([0.0]))
    assert model.above_touch(nearly).pressure_pa[0] == 0.0


def test_a_restored_brake_is_the_one_that_was_kept() -> None:
    model = learned()
    model.gain = Estimate(1.07, model.gain.sd)
    model.drag_nm = Estimate(model.drag_nm.value, 0.3)
    record = model.record()
    assert record is not None
    other = fresh()
    other.restore(record)
    assert other.record() == record
    assert np.allclose(other.law()[np.isfinite(other.law())], model.law()[np.isfinite(model.law())])
    assert (other.on_delay_us, other.off_delay_us) == (model.on_delay_us, model.off_delay_us)
    assert (other.gain.value, other.drag_nm.sd, other.shifts) == (1.07, 0.3, 5)


def test_gain_and_drag_are_carried_as_the_filter_knows_them() -> None:
    """Drag as a torque: the filter has it as an acceleration."""
    model, x, p = fresh(), np.zeros(6), np.zeros((6, 6))
    x[4], x[5] = 1.1, -8.0
    p[4, 4], p[5, 5] = 0.02**2, 0.5**2
    model.carry(x, p, 0.4)
    assert (model.gain.value, model.gain.sd) == (1.1, pytest.approx(0.02))
    assert model.drag_nm.value == pytest.approx(-3.2)
    assert model.drag_nm.sd == pytest.approx(0.2)
    p[4, 4] = -1e-18
    model.carry(x, p, 0.4)
    assert model.gain.sd == 0.0


def test_brakes_drawn_from_what_is_known_scatter_as_it_is_known() -> None:
    model, rng = fresh(), np.random.default_rng(2)
    drawn = [model.varied(rng.standard_normal(PARAMETERS)) for _ in range(300)]
    delays = np.array([(each.on_delay_us, each.off_delay_us) for each in drawn])
    sheet_us = 1e6 * SHEET.brake.valve_delay_tolerance * DELAY_S
    assert np.mean(delays, axis=0) == pytest.approx(1e6 * DELAY_S, abs=0.25 * sheet_us)
    assert np.std(delays, axis=0) == pytest.approx(sheet_us, rel=0.15)
    still = model.varied(np.zeros(PARAMETERS))
    assert (still.law() == model.law()).all()
    assert all(each.gain is model.gain for each in drawn)
