"""What all states of a shift share: how it begins and ends, when plates and teeth are apart, what
is predicted by, and the engine's speed that a slip needs."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.models import LayshaftState
from meshpoint.controller.settings import ControllerSettings, ValveTiming
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.table import ShiftRecord, Trigger
from meshpoint.controller.shift.valve_board import OFF, ValveBoard, ValveName
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftResult, Strategy
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET, SETTINGS = load_sheet("truck12"), ControllerSettings()
MS, NOW_US = 1_000, 5_000_000
EARLIEST_US = NOW_US + 4 * MS
TARGET = DRIVE_GEARS[8]


def made(armed: bool | None = None, known: bool = False) -> ShiftContext:
    references: Any = SimpleNamespace(known=lambda gear: known and gear is MainGear.THIRD)
    board = ValveBoard(ValveTiming.SCHEDULED)
    given: dict[str, bool] = {} if armed is None else {"armed": armed}
    return ShiftContext(SHEET, SETTINGS, board, BrakeInput(12 * MS), references, **given)


def shifting() -> ShiftContext:
    context = made()
    context.shift = ShiftRecord(5, 8, TARGET, 0, Strategy.TARGET_PHASE)
    return context


def step(**changed: Any) -> Any:
    values: dict[str, Any] = {"now_us": NOW_US, "earliest_us": EARLIEST_US}
    return SimpleNamespace(**(values | changed))


def test_before_any_step_the_clutch_is_to_be_open_and_nothing_is_asked() -> None:
    context = made()
    assert context.armed is True
    assert made(armed=False).armed is False
    assert (context.state, context.since_us) == (State.STARTING, 0)
    assert context.clutch is ClutchAction.OPEN
    assert context.clutch_opens
    assert context.fault is FaultCode.NONE
    nothing = (
        context.engine_rad_s, context.engine_share, context.shift, context.finished,
        context.ended_us, context.decision, context.strategy_error, context.on_transition,
        context.predictor_source, context.free_predictor, context.firing_predictor, context.target,
    )  # fmt: skip
    assert nothing == (None,) * len(nothing)
    assert context.free_us == 0
    assert context.settings is SETTINGS
    assert context.tick_us == SETTINGS.timing.tick_ms * MS
    with pytest.raises(RuntimeError, match="STARTING"):
        _ = context.running


def test_the_drag_that_is_not_known_is_that_of_the_settings() -> None:
    rad_s = SETTINGS.crossing_filter.drag_pause_nm * SHEET.sleeve.delay_s
    gear = MainGear.SECOND
    context = made()
    context.drifts._add(context.drifts._learned[gear], 0.1, 1e-4)
    inertia = SHEET.inertia_kgm2(DRIVE_GEARS[12].split)
    assert DRIVE_GEARS[12].split.name == "HIGH"
    prior = (SHEET.main_mesh(gear).ratio * rad_s / inertia) ** 2 + 1e-4
    assert context.drifts.rad_s(gear) == pytest.approx(0.1 * prior / (prior + 1e-4))


def test_a_state_lasts_from_the_step_that_enters_it() -> None:
    context = shifting()
    context.enter(State.COASTING, step())
    assert (context.state, context.since_us) == (State.COASTING, NOW_US)
    for after_us, late in ((0, False), (250_000, False), (250_001, True)):
        assert context.late(step(now_us=NOW_US + after_us), 250) is late
    assert context.target is TARGET
    assert context.running is context.shift
    context.clutch = ClutchAction.CLOSE
    assert not context.clutch_opens


class Falling:
    """A clutch that opens by 1 in 0.2 s, fully closed now."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def falls_to_us(self, level: float) -> float:
        self.asked.append(level)
        return NOW_US + 200_000.0 * (1.0 - level)


def test_splitter_and_range_move_once_the_plates_have_surely_parted() -> None:
    """Half a per cent below where they surely have; the valve takes its delay before that."""
    context, clutch = made(), Falling()
    view = SimpleNamespace(clutch=clutch)
    level = SHEET.clutch.surely_open_share - 0.005
    parted_us = NOW_US + 200_000.0 * (1.0 - level)
    expected = round(parted_us - 1e6 * SHEET.sleeve.valve_delay_s)
    assert context.step_unloaded_us(step(view=view)) == expected
    assert clutch.asked == [pytest.approx(level)]
    assert context.step_unloaded_us(step(view=view, earliest_us=expected + 7)) == expected + 7
    unknown = SimpleNamespace(clutch=SimpleNamespace(falls_to_us=lambda _: None))
    assert context.step_unloaded_us(step(view=unknown)) is None
    assert context.unloaded_us(step(view=unknown)) is None


def test_a_gear_is_pulled_as_the_plates_part_where_the_clutch_is_quick() -> None:
    """Its sleeve moves a valve's delay after that; here it needs no longer to be out."""
    context, clutch = made(), Falling()
    context.kiss.share, context.kiss.sd = 0.3, 0.02
    sleeve: Any = SimpleNamespace(valve_delay_s=0.015, least_pull_s=0.5)
    sheet: Any = SimpleNamespace(clutch=SHEET.clutch, sleeve=sleeve)
    context.sheet = sheet
    parted_us = NOW_US + 200_000.0 * (1.0 - context.kiss.parted_share)
    seen_at = step(view=SimpleNamespace(clutch=clutch))
    assert context.unloaded_us(seen_at) == round(parted_us - 15_000.0)


def test_plates_that_surely_part_only_when_the_clutch_is_open_do_so_then() -> None:
    context, clutch = made(), Falling()
    sheet: Any = SimpleNamespace(
        clutch=SimpleNamespace(surely_open_share=0.002), sleeve=SHEET.sleeve
    )
    context.sheet = sheet
    context.step_unloaded_us(step(view=SimpleNamespace(clutch=clutch)))
    assert clutch.asked == [0.0]


def test_the_brake_is_switched_and_known_to_the_filter_at_the_same_time() -> None:
    context = shifting()
    context.switch_brake(True, NOW_US + 9 * MS, step())
    assert context.board.command(ValveName.BRAKE) == (NOW_US + 9 * MS, True, False)
    assert context.brake.switches == [(NOW_US + 9 * MS, True)]
    context.board.schedule(ValveName.RANGE_LOW, True, NOW_US, NOW_US)
    context.all_off(NOW_US + 10 * MS)
    assert {context.board.command(valve) for valve in ValveName} == {OFF}
    assert context.brake.switches[-1] == (NOW_US + 10 * MS, False)


@pytest.mark.parametrize("ended_us", [None, NOW_US - 7 * MS])
def test_a_shift_that_ends_leaves_nothing_on_and_nothing_asked(ended_us: int | None) -> None:
    context = shifting()
    shift, left = context.running, context
    context.engine_rad_s = context.engine_share = 0.5
    context.brake.schedule(NOW_US - 50 * MS, True, NOW_US - 60 * MS)
    context.board.schedule(ValveName.BRAKE, True, NOW_US - 50 * MS, NOW_US - 60 * MS)
    context.end(step(), ShiftResult.ENDED_IN_OLD_GEAR, FaultCode.CLUTCH_STUCK, ended_us)
    assert (shift.result, shift.fault) == (ShiftResult.ENDED_IN_OLD_GEAR, FaultCode.CLUTCH_STUCK)
    assert shift.end_us == (NOW_US if ended_us is None else ended_us)
    assert context.fault is FaultCode.CLUTCH_STUCK
    assert context.finished is shift
    nothing: tuple[Any, ...] = (left.shift, left.engine_rad_s, left.engine_share)
    assert nothing == (None, None, None)
    assert context.ended_us == NOW_US
    assert context.board.command(ValveName.BRAKE) == OFF
    assert context.brake.switches[-1] == (NOW_US, False)


@pytest.mark.parametrize(
    ("gear", "fault", "result", "trigger"),
    [(MainGear.NEUTRAL, FaultCode.ENGAGE_FAILED, ShiftResult.ENDED_IN_NEUTRAL, Trigger.GAVE_UP),
     (MainGear.SECOND, FaultCode.ENGAGE_FAILED, ShiftResult.ENDED_IN_OLD_GEAR, Trigger.GAVE_UP),
     (None, FaultCode.ENGAGE_FAILED, ShiftResult.ENDED_BETWEEN_GEARS, Trigger.GEAR_UNKNOWN),
     (MainGear.SECOND, FaultCode.POSITION_STALE, ShiftResult.ENDED_BETWEEN_GEARS,
      Trigger.GEAR_UNKNOWN)],
)  # fmt: skip
def test_a_shift_that_is_given_up_ends_where_the_gearbox_is(
    gear: MainGear | None, fault: FaultCode, result: ShiftResult, trigger: Trigger
) -> None:
    context = shifting()
    shift = context.running
    seen = step(view=SimpleNamespace(main_gear=gear))
    assert context.give_up(seen, fault) is trigger
    assert (shift.result, shift.fault, shift.end_us) == (result, fault, NOW_US)
    assert context.fault is fault


LAYSHAFT = LayshaftState(float(NOW_US), 1.0, 100.0, 0.0)
MAIN, MODEL = object(), object()


def seen(
    layshaft: LayshaftState = LAYSHAFT, free: bool = True, main: object = MAIN,
    supply_pa: float = math.inf,
) -> Any:  # fmt: skip
    tracker = SimpleNamespace(free=free, latest=lambda: layshaft, model=MODEL)
    return step(main=main, layshaft=tracker, supply_pa=supply_pa)


def test_a_gear_is_predicted_from_what_is_estimated_and_learned() -> None:
    context, gear = made(), MainGear.SECOND
    context.delays.learn(gear, 1e6 * SHEET.sleeve.delay_s + 2_000.0)
    context.drifts._learned[gear].mean_rad_s = 0.07
    context.drifts._learned[gear].share_squares = 9.0
    found = context.predictor(gear, seen())
    assert found is not None
    assert (found.gear, found.i_gear) == (gear, SHEET.main_mesh(gear).ratio)
    parts: tuple[Any, ...] = (found.layshaft, found.main, found.model, found.brake)
    expected: tuple[Any, ...] = (LAYSHAFT, MAIN, MODEL, context.brake)
    assert all(one is other for one, other in zip(parts, expected, strict=True))
    assert found.references is context.references
    assert found.delay_us == context.delays.delay_us(gear)
    assert found.delay_us != context.delays.delay_us(MainGear.THIRD)
    assert found.delay_sd_s == context.delays.delay_sd_s(gear)
    assert (found.drift_rad_s, found.spread_share) == pytest.approx((0.07, 1.5))


@pytest.mark.parametrize(
    "given",
    [seen(main=None), seen(free=False), seen(LAYSHAFT._replace(omega_rad_s=math.nan)),
     seen(LAYSHAFT._replace(time_us=NOW_US + 1e9))],
    ids=["no main shaft", "not free", "no number", "far ahead"],
)  # fmt: skip
def test_nothing_is_predicted_from_what_is_not_known(given: Any) -> None:
    assert made().predictor(MainGear.SECOND, given) is None


def test_an_estimate_up_to_60_ms_ahead_still_counts() -> None:
    for ahead_us, counts in ((60_000, True), (60_001, False)):
        given = seen(LAYSHAFT._replace(time_us=float(NOW_US + ahead_us)))
        assert (made().predictor(MainGear.SECOND, given) is not None) is counts


def test_a_sleeve_is_slower_with_less_air_than_the_sheet_says() -> None:
    """The supply is told as absolute pressure; before the first frame the sheet's holds."""
    context, way_s = made(), SHEET.sleeve.delay_s - SHEET.sleeve.valve_delay_s
    gear = MainGear.SECOND
    context.predictor(gear, seen())
    assert context.delays.supply_pa == SHEET.air.supply_gauge_pa
    quarter_pa = SHEET.air.atmosphere_pa + 0.25 * SHEET.air.supply_gauge_pa
    found = context.predictor(gear, seen(supply_pa=quarter_pa))
    assert found is not None
    assert context.delays.supply_pa == pytest.approx(0.25 * SHEET.air.supply_gauge_pa)
    assert found.delay_us == round(1e6 * (SHEET.sleeve.valve_delay_s + 2.0 * way_s))


def test_who_looks_on_may_give_another_prediction_and_knows_every_phase() -> None:
    context, other = made(known=True), object()
    assert context.reference_known(MainGear.THIRD)
    assert not context.reference_known(MainGear.SECOND)
    given: list[Any] = []

    def source(predictor: object) -> Any:
        given.append(predictor)
        return other

    context.predictor_source = source
    assert context.predictor(MainGear.SECOND, seen()) is other
    assert given[0].gear is MainGear.SECOND
    assert context.reference_known(MainGear.SECOND)


def test_other_settings_make_another_strategist() -> None:
    context = made()
    before, settings = context.strategist, replace(SETTINGS, strategy_name="speed_window")
    context.change_settings(settings)
    assert context.settings is settings
    assert context.strategist is not before
    acting = context.strategist.acting(reference_known=True)
    assert context.strategist.wire(acting) is Strategy.SPEED_WINDOW


@pytest.mark.parametrize("number", [3, 8, 11])
@pytest.mark.parametrize("slip", [-2.0, 4.0])
def test_the_engine_is_asked_for_the_speed_that_gives_the_slip(number: int, slip: float) -> None:
    """Through splitter and main gear: the gear then turns so much faster than the main shaft."""
    context, gear, main = made(), DRIVE_GEARS[number], 90.0
    asked = step(speeds=SimpleNamespace(main=main))
    context.ask_engine(gear, slip, asked)
    assert context.engine_rad_s is not None
    turned = SHEET.split_mesh(gear.split).ratio * SHEET.main_mesh(gear.main).ratio
    assert context.engine_rad_s * turned - main == pytest.approx(slip)
    context.ask_engine(gear, slip, step(speeds=SimpleNamespace(main=None)))
    assert context.engine_rad_s is None


def test_no_speed_is_asked_for_that_the_engine_does_not_have() -> None:
    """From the least of the settings to the most of the input shaft, both allowed."""
    context, gear = made(), DRIVE_GEARS[8]
    turned = SHEET.split_mesh(gear.split).ratio * SHEET.main_mesh(gear.main).ratio
    least, most = SETTINGS.engine.least_rad_s, SHEET.limits.input_max_rad_s
    for wanted, is_asked in (
        (0.999 * least, False), (1.001 * least, True), (0.999 * most, True), (1.001 * most, False),
    ):  # fmt: skip
        context.engine_rad_s = 1.0
        context.ask_engine(gear, 0.0, step(speeds=SimpleNamespace(main=wanted * turned)))
        assert context.engine_rad_s == (pytest.approx(wanted) if is_asked else None)
    assert np.isfinite(most)
