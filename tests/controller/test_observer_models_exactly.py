"""The observer's models, its beginnings, and the way of a step's messages through it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from calibration_example import example
from test_observer_exactly import SHEET, T0, Main, Noted, an_observer

from meshpoint.controller.motion.models import first_order_law, free_motion
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.controller.sensing.wheel_edges import NO_EDGES
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.messages import (
    EEC1,
    EdgesMainFall,
    EdgesMainRise,
    Estimator,
    SleevesAux,
    SleevesMain,
)
from meshpoint.gearbox import MainGear, Split


def test_before_it_has_seen_anything_an_observer_knows_the_sheet() -> None:
    observer = an_observer()
    assert observer.pressed_nm == 0.0
    assert observer.kiss_share == SHEET.clutch.kiss_share
    assert observer.recovery is not None
    assert observer._main._half_gap_rad == pytest.approx(SHEET.dog.backlash_rad / 2.0)
    assert an_observer(Estimator.WINDOW).recovery is None
    assert (observer.main_at(1.0), observer.layshaft_at(1.0)) == (None, None)
    assert an_observer(Estimator.THESIS).noise() is None


@pytest.mark.parametrize("split", [Split.LOW, Split.HIGH])
def test_a_baseline_s_brake_fills_by_the_sheet_s_time_constant(split: Split) -> None:
    """45 ms, to 8.5 bar, with the inertia of the splitter's step; the valve's delay is the
    sheet's."""
    observer = an_observer(Estimator.THESIS)
    layshaft = observer.layshaft = Noted()
    observer._split = split
    observer._brake_input.set_delays(1, 2)
    observer._model_layshaft()
    ((models,),) = layshaft.named("set_models")
    law = first_order_law(1.0 / 0.045, 8.5e5)
    tuning = ControllerSettings().crossing_filter.of(SHEET)
    expected = free_motion(SHEET, split, law, tuning, None, None)
    assert np.array_equal(models.motion.flat, expected.flat)
    assert models.inertia_kgm2 == SHEET.inertia_kgm2(split)
    assert (observer._brake_input.off_delay_us, observer._brake_input.on_delay_us) == (1, 2)


def test_a_brake_that_was_learned_is_the_model_s_with_its_law_and_its_delays() -> None:
    observer, given = an_observer(), example().brake
    layshaft, learns = observer.layshaft, Noted()
    layshaft.set_models = lambda models: learns.calls.append(("set_models", models))
    observer.take_brake(given)
    brake_input = observer._brake_input
    assert brake_input.off_delay_us == 9_800
    assert brake_input.on_delay_us == observer.brake.on_delay_us > 8_300
    ((models,),) = learns.named("set_models")
    tuning = ControllerSettings().crossing_filter.of(SHEET)
    expected = free_motion(
        SHEET, Split.HIGH, observer.brake.law(), tuning, layshaft.disturbance,
        layshaft.friction.value,
    )  # fmt: skip
    assert np.array_equal(models.motion.flat, expected.flat)
    observer.take_noise(example().noise)
    assert len(learns.named("set_models")) == 2


def test_the_newest_of_three_engine_messages_counts() -> None:
    observer, inputs = an_observer(Estimator.THESIS), StepInputs()
    observer.view = SimpleNamespace(gear_number=0, clutch_closed=None)
    for share in (0.1, 0.2, 0.3):
        inputs.take(EEC1(actual_engine_torque_fraction=share))
    observer._see_load(inputs)
    assert observer._torque_nm == pytest.approx(0.3 * SHEET.engine.reference_nm)


def test_each_wheel_reads_its_own_rising_and_falling_edges() -> None:
    observer, inputs, read = an_observer(), StepInputs(), list[Any]()
    rise, fall = EdgesMainRise(read_time_us=1), EdgesMainFall(read_time_us=2)
    inputs.take(rise)
    inputs.take(fall)
    wheel: Any = SimpleNamespace(read=lambda *args: read.append(args) or "batch")
    assert observer._read(wheel, inputs, EdgesMainRise, EdgesMainFall, T0) == "batch"
    assert read == [([rise], [fall], observer.clock, T0)]


def test_positions_of_a_step_come_into_the_view_at_their_own_times() -> None:
    observer, inputs, taken = an_observer(), StepInputs(), Noted(split=None, range_=None)
    observer.view = taken
    observer._sensors = lambda *_: "pressures"
    observer._lose_what_broke = lambda _events: False
    for name in ("_see_whether_free", "_see_load", "_see_synchronisers"):
        setattr(observer, name, lambda *args, name=name: taken.calls.append((name, *args)))
    observer._read = lambda *_: NO_EDGES
    observer.layshaft, observer._main, observer.recovery = Noted(), Noted(), None
    main, aux = SleevesMain(sample_time_us=4_990_000), SleevesAux(sample_time_us=4_991_000)
    inputs.take(main)
    inputs.take(aux)
    events: list[str] = []
    observer.take(inputs, T0, events)
    assert taken.calls == [
        ("_see_synchronisers", T0),
        ("sleeves_main", main, 4_990_000),
        ("sleeves_aux", aux, 4_991_000),
        ("work_out",),
        ("_see_whether_free", events),
        ("_see_load", inputs),
    ]


def pulls(drag_rad_s2: float, acceleration: float, closed: float | None = None) -> bool:
    """Whether drag that slows third gear so much pulls, beside a main shaft that does so."""
    observer = an_observer()
    observer.view = SimpleNamespace(clutch_closed=closed)
    ratio = SHEET.main_mesh(MainGear.THIRD).ratio / SHEET.inertia_kgm2(Split.HIGH)
    observer.brake.drag_nm = SimpleNamespace(value=drag_rad_s2 / ratio)
    main = ShaftState(5e6, 0.0, 60.0, 0.0, 0.0, acceleration)
    coasting = observer._coasting_rad_s2
    return bool(observer._locked._drag_pulls(MainGear.THIRD, main, coasting))


@pytest.mark.parametrize(
    ("drag_rad_s2", "acceleration", "does"),
    [
        (-5.1, 0.0, True), (-4.9, 0.0, False), (-15.1, -10.0, True), (-14.9, -10.0, False),
        (-6.0, -10.0, False), (0.0, 5.1, True), (0.0, 4.9, False), (6.0, 0.0, False),
    ],
)  # fmt: skip
def test_drag_pulls_where_the_gear_slows_by_five_more_than_the_main_shaft(
    drag_rad_s2: float, acceleration: float, does: bool
) -> None:
    assert pulls(drag_rad_s2, acceleration) is does


@pytest.mark.parametrize(("closed", "does"), [(0.19, True), (0.21, False), (0.0, True)])
def test_a_clutch_that_is_a_fifth_closed_may_turn_the_layshaft(closed: float, does: bool) -> None:
    assert pulls(-50.0, 0.0, closed) is does


def test_a_look_is_forgotten_when_it_is_exactly_80_ms_old() -> None:
    """Looks 20 ms apart; the first step of the speed is over the first two of them."""
    locked, main = an_observer()._locked, None
    for k, speed in enumerate((62.0, 60.0, 60.0, 60.0, 60.0)):
        main = ShaftState(5e6 + 20_000.0 * k, 0.0, speed, 0.0, 0.0)
        locked._main_speeds.append((main.time_us, main.omega_rad_s))
        if k == 3:
            assert locked._slowest_rad_s2(main) == pytest.approx(-2.0 / 40e-3)
    assert locked._slowest_rad_s2(main) == 0.0


def test_looks_at_one_and_the_same_time_tell_no_acceleration() -> None:
    locked, main = an_observer()._locked, ShaftState(5e6, 0.0, 58.0, 0.0, 0.0, -1.5)
    locked._main_speeds.extend([(5e6, 60.0), (5e6, 59.0), (5e6, 58.0)])
    assert locked._slowest_rad_s2(main) == -1.5


def test_a_clock_that_jumped_as_often_as_a_wheel_broke_has_jumped_all_the_same() -> None:
    observer = an_observer()
    observer.clock = SimpleNamespace(late=0, jumps=1)
    observer._lost = (0, 1, 1)
    observer._layshaft_wheel, observer._main_wheel = Noted(broken=1), Noted(broken=1)
    observer.recovery = observer.references = observer.layshaft = Noted()
    observer._main = Main(None)
    observer._main.restart = observer._main.lose_speed = lambda: None
    assert observer._lose_what_broke([])
    assert not observer._lose_what_broke([])
