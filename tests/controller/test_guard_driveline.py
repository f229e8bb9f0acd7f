"""The guard over clutch and engine, each row by itself, its limit from both sides."""

from __future__ import annotations

import copy
import dataclasses

import pytest
from guard_cases import LIMITS, NOW, SHEET, calm

from meshpoint.controller.guard.driveline import DrivelineGuard, decode_clutch, decode_engine
from meshpoint.controller.guard.limits import CLEAR_M, LEAVING_M_S
from meshpoint.controller.guard.own_speed import ShaftSpeed as Speed
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TSC1,
    ClutchAction,
    ClutchCommand,
    TscOverrideMode,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import MainGear, Split
from meshpoint.units import RPM

SECOND, HIGH = SHEET.main_mesh(MainGear.SECOND).ratio, SHEET.split_mesh(Split.HIGH).ratio
INPUT_RPM = 1200.0
LAYSHAFT_RPM = INPUT_RPM * HIGH
MAIN_RPM = LAYSHAFT_RPM * SECOND


def of(rpm: float) -> Speed:
    return Speed(NOW - 10_000, rpm * RPM)


TURNING = (of(INPUT_RPM), of(LAYSHAFT_RPM), of(MAIN_RPM), of(MAIN_RPM / 3.75))
IN_GEAR = GuardInputs(
    NOW,
    (0.012, 0.0, 0.012, -0.012),
    0.0,
    9.5e5,
    1.013e5,
    TURNING,
    0,
    valid=True,
    engine_rad_s=INPUT_RPM * RPM,
    swings=calm(TURNING),
)
"""Second gear, high split, low range; the clutch open, the engine at the input shaft's speed."""
IN_NEUTRAL = IN_GEAR._replace(positions_m=(0.0, 0.0, 0.012, -0.012))


def clutch(action: ClutchAction) -> bytes:
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(ClutchCommand(action=action)).data


OPEN, CLOSE = clutch(ClutchAction.OPEN), clutch(ClutchAction.CLOSE)


def engine(rpm: float, mode: TscOverrideMode = TscOverrideMode.SPEED_CONTROL) -> bytes:
    request = TSC1(override_control_mode=mode, requested_speed_rad_s=rpm * RPM)
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(request).data


def engine_row(seen: GuardInputs, payload: bytes) -> int | None:
    guard = DrivelineGuard(LIMITS)
    passes = guard.passes_engine(payload, seen)
    assert passes is (guard.blocked_row is None)
    assert guard.blocks == (not passes)
    return guard.blocked_row


def clutch_row(seen: GuardInputs) -> int | None:
    guard = DrivelineGuard(LIMITS)
    assert guard.passes_clutch(OPEN, seen)
    passes = guard.passes_clutch(CLOSE, seen)
    assert passes is (guard.blocked_row is None)
    return guard.blocked_row


def test_the_guards_reading_is_that_of_the_wire() -> None:
    assert not decode_clutch(OPEN)
    assert decode_clutch(CLOSE)
    wish = decode_engine(engine(1234.5))
    assert wish.mode == int(TscOverrideMode.SPEED_CONTROL)
    assert wish.speed_rad_s == pytest.approx(1234.5 * RPM, abs=0.07 * RPM)
    for decode in (decode_clutch, decode_engine):
        with pytest.raises(ValueError, match="8"):
            decode(bytes(7))


@pytest.mark.parametrize("seen", [IN_GEAR, IN_NEUTRAL, IN_GEAR._replace(valid=False)])
def test_opening_and_the_end_of_a_request_are_always_allowed(seen: GuardInputs) -> None:
    guard = DrivelineGuard(LIMITS)
    assert guard.passes_clutch(OPEN, seen)
    assert guard.passes_engine(Transmitter(Node.TRANSMISSION_CONTROL).encode(TSC1()).data, seen)


def test_row_14_the_sheets_limit() -> None:
    top_rpm = 1.01 * SHEET.limits.input_max_rad_s / RPM
    for rpm, row in ((top_rpm - 1.0, None), (top_rpm + 1.0, 14)):
        assert engine_row(IN_NEUTRAL, engine(rpm)) == row


def test_row_14_the_gear_in_mesh() -> None:
    """Its slip window, -60 to 120 rpm at the gear, on the input shaft."""
    through = SECOND * HIGH
    low, high = INPUT_RPM - 60.0 / through, INPUT_RPM + 120.0 / through
    for rpm, row in ((low - 1, 14), (low + 1, None), (high - 1, None), (high + 1, 14)):
        assert engine_row(IN_GEAR, engine(rpm)) == row
    unknown = IN_GEAR._replace(speeds=(None, None, None, None))
    assert engine_row(unknown, engine(INPUT_RPM)) == 14
    denied = IN_NEUTRAL._replace(agreeing=4)
    assert engine_row(denied, engine(high + 1)) == 14


def test_row_14_either_splitter_step_where_it_stands_in_none() -> None:
    between = IN_GEAR._replace(positions_m=(0.012, 0.0, 0.0, -0.012))
    low = MAIN_RPM / (SECOND * SHEET.split_mesh(Split.LOW).ratio)
    for rpm, row in ((INPUT_RPM, None), (low, None), (low + 300.0, 14), (INPUT_RPM - 200.0, 14)):
        assert engine_row(between, engine(rpm)) == row


@pytest.mark.parametrize(
    "mode", [TscOverrideMode.TORQUE_CONTROL, TscOverrideMode.SPEED_TORQUE_LIMIT]
)
def test_row_14_torque_is_not_asked_for(mode: TscOverrideMode) -> None:
    assert engine_row(IN_NEUTRAL, engine(1000.0, mode)) == 14


def torque(share: float) -> bytes:
    request = TSC1(
        override_control_mode=TscOverrideMode.TORQUE_CONTROL, requested_torque_fraction=share
    )
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(request).data


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_row_14_torque_may_be_taken_away_and_nothing_else(sign: float) -> None:
    """The engine gives 40 %: anything from there to none may be asked for, a step of the signal
    and its rounding beside."""
    pulls = IN_GEAR._replace(clutch_closed=1.0, engine_torque_share=0.4 * sign)
    for share, row in ((0.0, None), (0.4, None), (0.41, None), (0.43, 14), (-0.02, 14), (1.0, 14)):
        assert engine_row(pulls, torque(share * sign)) == row
    assert engine_row(pulls._replace(engine_torque_share=None), torque(0.0)) == 14
    assert engine_row(pulls._replace(valid=False), torque(0.0)) == 14


def turned(
    rad_s2: float, measurements: int = 6, **changes: object
) -> tuple[DrivelineGuard, GuardInputs]:
    """A guard that has seen a pulling engine change its speed for this many steps, and the next
    step's inputs."""
    guard, seen = DrivelineGuard(LIMITS), IN_GEAR._replace(clutch_closed=1.0)
    for step in range(measurements):
        seen = IN_GEAR._replace(
            now_us=NOW + step * LIMITS.tick_us,
            clutch_closed=1.0,
            engine_torque_share=0.04,
            engine_rad_s=INPUT_RPM * RPM + rad_s2 * step * LIMITS.tick_us * 1e-6,
        )
        assert guard.passes_engine(torque(0.0), seen)
    assert seen.engine_rad_s is not None
    after = seen._replace(
        now_us=seen.now_us + LIMITS.tick_us,
        engine_rad_s=seen.engine_rad_s + rad_s2 * LIMITS.tick_us * 1e-6,
    )
    return guard, after._replace(**changes)  # type: ignore[arg-type]


def test_row_14_beyond_none_only_what_turns_the_engine_along() -> None:
    """It slows by 40 rad/s2: 3.2 kgm2 take 5.1 % of 2,500 Nm; 6.1 % with tolerance and error, and
    the signal's own 1.5 %."""
    for share, passes in (
        (-0.05, True),
        (-0.07, True),
        (-0.08, False),
        (0.05, True),
        (0.06, False),
    ):
        guard, seen = turned(-40.0)
        assert guard.passes_engine(torque(share), seen) is passes
    for share, passes in ((0.07, True), (0.12, False), (-0.02, False)):
        guard, seen = turned(40.0)
        assert guard.passes_engine(torque(share), seen) is passes


def test_row_14_what_turns_the_engine_has_to_be_known() -> None:
    """Too few measurements, a pause between them, no speed, plates that are apart: nothing beyond
    none."""
    guard, seen = turned(-40.0, measurements=4)
    assert not guard.passes_engine(torque(-0.05), seen)
    for changes in (
        {"now_us": NOW + 10 * LIMITS.tick_us},
        {"engine_rad_s": None},
        {"clutch_closed": LIMITS.clutch_open_share},
    ):
        guard, seen = turned(-40.0, **changes)
        assert not guard.passes_engine(torque(-0.05), seen)


def test_row_14_torque_cannot_be_talked_up() -> None:
    """A sequence gone mad asks for the most that passes, in every step, in the lowest gear of the
    lightest vehicle, where engine and gearbox weigh three times as much as the vehicle: the torque
    turns the engine, which lets more pass, but it comes to an end below an eighth."""
    guard, share, asked, speed = DrivelineGuard(LIMITS), 0.0, 0.0, INPUT_RPM * RPM
    weigh_kgm2 = 3.2 * (1.0 + 300.0 / 917.0) * 917.0 / 860.0
    for step in range(LIMITS.torque_away_us // LIMITS.tick_us):
        seen = IN_GEAR._replace(
            now_us=NOW + step * LIMITS.tick_us,
            clutch_closed=1.0,
            engine_torque_share=share,
            engine_rad_s=speed,
        )
        while asked < 0.5 and copy.deepcopy(guard).passes_engine(torque(asked + 0.01), seen):
            asked += 0.01
        while not copy.deepcopy(guard).passes_engine(torque(asked), seen):
            asked -= 0.01
        assert guard.passes_engine(torque(asked), seen)
        share += 0.15 * (asked - share)
        speed += share * 2500.0 / weigh_kgm2 * LIMITS.tick_us * 1e-6
    assert 0.01 < share < 0.125


def test_row_14_torque_is_not_taken_away_for_good() -> None:
    """No longer than ramp and clutch may take, and anew once the plates have been apart."""
    guard, pulls = (
        DrivelineGuard(LIMITS),
        IN_GEAR._replace(clutch_closed=1.0, engine_torque_share=0.4),
    )
    allowed = LIMITS.torque_away_us // LIMITS.tick_us
    for _ in range(2):
        passed = [guard.passes_engine(torque(0.0), pulls) for _ in range(allowed + 3)]
        assert passed == [True] * (allowed + 1) + [False] * 2
        end = Transmitter(Node.TRANSMISSION_CONTROL).encode(TSC1()).data
        assert guard.passes_engine(end, pulls)
        assert not guard.passes_engine(torque(0.0), pulls)
        assert guard.passes_engine(end, pulls._replace(clutch_closed=0.3))


def test_row_14_nothing_is_asked_for_on_lost_inputs() -> None:
    assert engine_row(IN_NEUTRAL._replace(valid=False), engine(1000.0)) == 14


def test_row_15_the_limit_is_the_closest_step_at_the_sheets_limit() -> None:
    """23:53 against 17:57, 1.455: of 2,400 rpm it leaves 1,649."""
    assert LIMITS.plate_slip_rad_s / RPM == pytest.approx(750.6, abs=0.5)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_row_15_closing_onto_slip(sign: float) -> None:
    for slip_rpm, row in ((748.0, None), (753.0, 15)):
        seen = IN_GEAR._replace(engine_rad_s=(INPUT_RPM + sign * slip_rpm) * RPM)
        assert clutch_row(seen) == row
        assert clutch_row(seen._replace(positions_m=IN_NEUTRAL.positions_m)) is None
        clear_m = LIMITS.contact_m - CLEAR_M
        out, at_teeth = (
            seen._replace(positions_m=(at_m, 0.0, 0.012, -0.012))
            for at_m in (clear_m, clear_m + 1e-6)
        )
        assert clutch_row(out) is None
        assert clutch_row(at_teeth) == row
        assert clutch_row(out._replace(speeds_m_s=(LEAVING_M_S, 0.0))) == row


def test_row_15_the_shaft_that_slips_most_counts() -> None:
    """A lying input sensor is found out by layshaft or main shaft."""
    for place in (0, 1, 2):
        speeds = list(IN_GEAR.speeds)
        speeds[place] = of(3.0 * INPUT_RPM)
        a, b, c, d = speeds
        assert clutch_row(IN_GEAR._replace(speeds=(a, b, c, d))) == 15
        others: list[Speed | None] = [None, None, None, None]
        others[place] = IN_GEAR.speeds[place]
        a, b, c, d = others
        assert clutch_row(IN_GEAR._replace(speeds=(a, b, c, d))) is None


def test_row_15_what_is_not_known() -> None:
    """No engine speed, no valid inputs; shafts that give no edges stand."""
    assert clutch_row(IN_GEAR._replace(engine_rad_s=None)) == 15
    assert clutch_row(IN_GEAR._replace(valid=False)) == 15
    still = IN_GEAR._replace(speeds=(None, None, None, None))
    assert clutch_row(still) == 15
    assert clutch_row(still._replace(engine_rad_s=600.0 * RPM)) is None


def test_row_15_a_closed_clutch_is_held_whatever_is_lost() -> None:
    guard, closed = DrivelineGuard(LIMITS), IN_GEAR._replace(clutch_closed=1.0)
    assert guard.passes_clutch(CLOSE, IN_GEAR)
    assert guard.passes_clutch(CLOSE, closed)
    assert guard.passes_clutch(CLOSE, closed._replace(valid=False, engine_rad_s=None))
    slipping = IN_GEAR._replace(clutch_closed=0.9, engine_rad_s=2300.0 * RPM)
    assert not guard.passes_clutch(CLOSE, slipping)
    assert guard.blocked_row == 15


def close_and_open(guard: DrivelineGuard, now_us: int, seen: GuardInputs = IN_GEAR) -> int | None:
    guard.passes_clutch(CLOSE, seen._replace(now_us=now_us))
    row = guard.blocked_row
    assert guard.passes_clutch(OPEN, seen._replace(now_us=now_us + 1))
    return row


def test_row_16_so_often_as_a_shift_needs_until_a_sleeve_has_moved() -> None:
    """Four times: three raises and the last."""
    guard = DrivelineGuard(dataclasses.replace(LIMITS, closing_again_us=1 << 60))
    rows = [close_and_open(guard, NOW + 400_000 * k) for k in range(6)]
    assert rows == [None] * 4 + [16] * 2
    assert close_and_open(guard, NOW + 2_400_000, IN_NEUTRAL) is None
    assert close_and_open(guard, NOW + 2_800_000, IN_NEUTRAL) == 16
    lost = IN_GEAR._replace(valid=False)
    assert guard.passes_clutch(OPEN, lost)  # what is not valid has not moved
    assert close_and_open(guard, NOW + 3_200_000, IN_NEUTRAL) == 16


def test_row_16_once_more_after_four_seconds() -> None:
    guard = DrivelineGuard(LIMITS)
    for k in range(4):
        close_and_open(guard, NOW + 300_000 * k)
    assert close_and_open(guard, NOW + 3_900_000) == 16
    assert close_and_open(guard, NOW + 4_100_000) is None


# -- requests and cycling: rows of the valve frame -----------------------------------------------


def valve(name: str) -> bytes:
    action = {f"{name}_action": ValveAction.ON_NOW}
    return Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand(**action)).data  # type: ignore[arg-type]


OFF = Transmitter(Node.TRANSMISSION_CONTROL).encode(ValveCommand()).data


def proven(asked: int | None) -> Guard:
    guard = Guard(LIMITS, armed=True)
    for _ in range(3):
        assert guard.passes(OFF, IN_NEUTRAL._replace(requested_gear=asked))
    return guard


@pytest.mark.parametrize("name", ["main_second", "split_low", "range_low"])
def test_row_17_no_sleeve_moves_unasked(name: str) -> None:
    for asked, row in ((None, 17), (0, 17), (15, 17), (10, None)):
        guard = proven(asked)
        assert guard.passes(valve(name), IN_NEUTRAL) is (row is None)
        assert guard.blocked_row == row


def test_row_17_a_request_ends_when_its_gear_is_in_and_the_clutch_closed() -> None:
    """Gear 4: second, high split, low range."""
    for asked, closed, row in ((4, 1.0, 17), (4, 0.9, None), (7, 1.0, None)):
        guard = proven(asked)
        assert guard.passes(OFF, IN_GEAR._replace(clutch_closed=closed))
        guard.passes(valve("main_first"), IN_GEAR)
        assert guard.blocked_row == row


def test_row_17_a_request_ends_with_the_longest_shift() -> None:
    for later_us, row in ((LIMITS.request_us, None), (LIMITS.request_us + 1, 17)):
        guard = proven(10)
        later = IN_NEUTRAL._replace(now_us=NOW + later_us)
        guard.passes(valve("split_high"), later)
        assert guard.blocked_row == row


def test_row_17_a_valve_on_its_way_goes_on() -> None:
    guard = proven(4)
    assert guard.passes(valve("main_first"), IN_GEAR)
    assert guard.passes(valve("main_first"), IN_GEAR._replace(clutch_closed=1.0)) is False
    assert guard.blocked_row == 10  # by its torque, not by the request


@pytest.mark.parametrize("group", ["split", "range"])
def test_row_18_back_not_before_a_clutch_opens_and_closes(group: str) -> None:
    slow = IN_NEUTRAL._replace(speeds=tuple(of(300.0) for _ in range(4)))
    for pause_us, row in ((299_999, 18), (300_000, None)):
        guard = proven(10)
        assert guard.passes(valve(f"{group}_high"), slow)
        assert guard.passes(OFF, slow)
        guard.passes(valve(f"{group}_low"), slow._replace(now_us=NOW + pause_us))
        assert guard.blocked_row == row
    guard = proven(10)
    for _ in range(3):  # the same way again is no swing
        assert guard.passes(valve(f"{group}_high"), slow)
        assert guard.passes(OFF, slow)


@pytest.mark.parametrize("group", ["split", "range"])
def test_row_18_does_not_wait_for_a_sensor_clock_that_restarted_behind(group: str) -> None:
    slow = IN_NEUTRAL._replace(speeds=tuple(of(300.0) for _ in range(4)))
    guard = proven(10)
    assert guard.passes(valve(f"{group}_high"), slow)
    assert guard.passes(OFF, slow)
    restarted = slow._replace(now_us=NOW - 4_000_000, requested_gear=10)
    assert guard.passes(OFF, restarted)
    guard.passes(valve(f"{group}_low"), restarted)
    assert guard.blocked_row != 18
