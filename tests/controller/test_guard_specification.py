"""The rows of the guard exactly at their limits, with limits that are round numbers: what a rule
comes to is worked out by hand, and one step of the last digit beside it is the other side."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from guard_cases import kept

from meshpoint.controller.guard import rules
from meshpoint.controller.guard.case import (
    NO_SPANS,
    GuardState,
    JudgedCommand,
    Span,
    Spans,
    ValveRequest,
)
from meshpoint.controller.guard.limits import (
    CLUTCH_CLOSED_SHARE,
    GUARD_NEUTRAL_M,
    MainValve,
    guard_limits,
)
from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.controller.guard.rules import (
    Guard,
    actuation_at_low_supply,
    back_and_forth,
    brake_against_the_driveline,
    brake_beyond_its_limits,
    disengage_under_torque,
    driven_too_long_or_blind,
    input_overspeed,
    range_change_out_of_neutral,
    slip_out_of_its_window,
    two_sleeves_of_the_main_box,
)
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet

BRAKE, SPLIT_LOW, SPLIT_HIGH, FIRST, SECOND = range(5)
RANGE_LOW = 7
S = 1_000_000
NOW = 8 * S
FOREVER = 1 << 62
SOON = 15_000
"""From a judgement until the next command can take effect."""
ROUND = dataclasses.replace(
    guard_limits(load_sheet("truck12"), ControllerSettings()),
    main={3: MainValve(0, -1, 0.25), 4: MainValve(0, 1, 0.5),
          5: MainValve(1, -1, 0.125), 6: MainValve(1, 1, 1.0)},
    split_ratio={-1: 0.5, 1: 1.0},
    range_ratio={-1: 0.25, 1: 1.0},
    sleeve_delay_us=S / 2, sleeve_scatter_us=S / 4,
    brake_delay_us=(S / 32, S / 8), brake_lag_us=S / 8,
    brake_rad_s2=(16.0, 32.0), drag_rad_s2=8.0, drag_rate=0.5,
    slip_rad_s=(-4.0, 8.0),
    input_max_rad_s=256.0, main_max_rad_s=128.0,
    brake_on_us=4 * S, brake_j=1000.0, brake_floor_rad_s=16.0,
    brake_nm_per_pa=2.0**-10, atmosphere_pa=1024.0,
    clutch_open_share=0.25, supply_low_pa=4096.0, teeth_out_us=S / 4, sleeve_valve_us=S / 8,
)  # fmt: skip
"""A contact is met 0.25 to 0.75 s after its valve; the brake's pressure may outlast it 0.5 s."""


def case(driven: dict[int, Span] | None = None, state: GuardState | None = None,
         rad_s: tuple[float | None, ...] = (None, 64.0, 32.0, 32.0), measured_us: int = NOW,
         **changes: Any) -> JudgedCommand:  # fmt: skip
    spans: Spans = tuple((driven or {}).get(valve) for valve in range(9)) if driven else NO_SPANS
    speeds = tuple(None if w is None else ShaftSpeed(measured_us, w) for w in rad_s)
    values: dict[str, Any] = {
        "now_us": NOW, "positions_m": (0.0, 0.0, 0.012, 0.012), "clutch_closed": 0.0,
        "supply_pa": 1e6, "brake_pa": 1024.0, "agreeing": 0, "valid": True,
        "positions_us": NOW, "clutch_us": NOW,
    }  # fmt: skip
    seen = GuardInputs(speeds=speeds, **(values | changes))  # type: ignore[arg-type]
    return JudgedCommand(spans, seen, state or GuardState(), ROUND)


def on(since_us: int = NOW, until_us: int = FOREVER) -> Span:
    return Span(since_us, until_us)


def test_row_2_the_other_sleeve_exactly_at_the_edge_of_neutral() -> None:
    for position_m, forbids in ((GUARD_NEUTRAL_M, False), (GUARD_NEUTRAL_M + 1e-9, True)):
        judged = case({SECOND: on()}, positions_m=(0.0, position_m, 0.012, 0.012))
        assert two_sleeves_of_the_main_box(judged) is forbids


def slip_case(slip: float, brake: Span | None = None, brake_off_us: int = -FOREVER,
              layshaft: float = 64.0, measured_us: int = NOW) -> JudgedCommand:  # fmt: skip
    """Second gear, ratio 1/2, is met 0.25 to 0.75 s from now."""
    driven = {SECOND: on()} | ({} if brake is None else {BRAKE: brake})
    main = 0.5 * layshaft - slip
    state = GuardState(brake_off_us=brake_off_us)
    return case(driven, state, (None, layshaft, main, None), measured_us)


def test_row_3_without_the_brake() -> None:
    """Drag takes up to (8 + 64 / 2) / 2 = 20 rad/s a second of the slip, for 0.75 s since the speed
    was measured: 15. The window is -4 to 8, and a doubt of 1."""
    for slip, forbids in ((8.0 + 1.0 + 15.0, False), (8.0 + 1.0 + 15.0 + 1e-9, True),
                          (-4.0 - 1.0, False), (-4.0 - 1.0 - 1e-9, True)):  # fmt: skip
        assert slip_out_of_its_window(slip_case(slip)) is forbids
    # Measured when the sleeve has long met its gear: none.
    for slip, forbids in ((9.0, False), (9.0 + 1e-9, True)):
        assert slip_out_of_its_window(slip_case(slip, measured_us=NOW + S)) is forbids
    # Measured a quarter of a second ago it has had longer: 20.
    for slip, forbids in ((29.0, False), (29.0 + 1e-9, True)):
        assert slip_out_of_its_window(slip_case(slip, measured_us=NOW - S // 4)) is forbids


def test_row_3_with_the_brake_on_for_good() -> None:
    """It may act from now on, 0.75 s at 32 / 2, and must from half a second after its start on: not
    before the earliest contact."""
    for slip, forbids in ((24.0 + 12.0, False), (24.0 + 12.0 + 1e-9, True),
                          (-5.0, False), (-5.0 - 1e-9, True)):  # fmt: skip
        assert slip_out_of_its_window(slip_case(slip, on())) is forbids
    # On for a quarter of a second: nothing is sure yet. For half a second: 0.25 s at 16 / 2.
    for since_us, sure in ((NOW - S // 4, 0.0), (NOW - S // 2, 2.0), (NOW - S, 2.0)):
        for slip, forbids in ((sure - 5.0, False), (sure - 5.0 - 1e-9, True)):
            assert slip_out_of_its_window(slip_case(slip, on(since_us))) is forbids


def test_row_3_with_the_brake_released_before_contact() -> None:
    """Off in 1/8 s: it acts no longer than 1/8 + 1/2 s, at 32 / 2, and surely for 1/8 s if it has
    been on for long."""
    brake = on(NOW - S, NOW + S // 8)
    for slip, forbids in ((24.0 + 10.0, False), (24.0 + 10.0 + 1e-9, True),
                          (1.0 - 5.0, False), (1.0 - 5.0 - 1e-9, True)):  # fmt: skip
        assert slip_out_of_its_window(slip_case(slip, brake)) is forbids


def test_row_3_with_the_brake_yet_to_come() -> None:
    """From 1/4 s on: it can act for half a second until the latest contact."""
    for slip, forbids in ((24.0 + 8.0, False), (24.0 + 8.0 + 1e-9, True)):
        assert slip_out_of_its_window(slip_case(slip, on(NOW + S // 4))) is forbids
    for slip, forbids in ((24.0, False), (24.0 + 1e-9, True)):  # after the latest contact: none
        assert slip_out_of_its_window(slip_case(slip, on(NOW + S))) is forbids


def test_row_3_the_plates_are_apart_at_the_earliest_contact() -> None:
    """The sleeve may meet its gear now: a clutch that opens by then is not enough later."""
    for closed, forbids in ((0.25, False), (0.25 + 1e-9, True)):
        judged = case({SECOND: on(NOW - S // 4)}, clutch_closed=closed, clutch_per_s=-1.0)
        assert slip_out_of_its_window(judged) is forbids


def test_row_3_after_the_brake() -> None:
    """Off a quarter of a second ago, its pressure may last as long again."""
    for ago_us, takes in ((S // 4, 4.0), (S // 2, 0.0), (S, 0.0), (-S, 12.0)):
        for slip, forbids in ((24.0 + takes, False), (24.0 + takes + 1e-9, True)):
            judged = slip_case(slip, brake_off_us=NOW - ago_us)
            assert slip_out_of_its_window(judged) is forbids


def test_row_5_a_release_at_the_very_contact() -> None:
    """The earliest is a quarter of a second from now."""
    for until_us, forbids in ((NOW + S // 4, False), (NOW + S // 4 + 1, True)):
        judged = case({BRAKE: on(NOW, until_us), SECOND: on()})
        assert brake_against_the_driveline(judged) is forbids
    # The clutch where it is when air comes in, 1/32 s on at the earliest.
    for closed, forbids in ((0.25 + 1 / 32, False), (0.25 + 1 / 32 + 1e-9, True)):
        judged = case({BRAKE: on()}, clutch_closed=closed, clutch_per_s=-1.0)
        assert brake_against_the_driveline(judged) is forbids
    early = case({BRAKE: on(NOW - S)}, clutch_closed=0.25 + 1e-9, clutch_per_s=-1.0)
    assert brake_against_the_driveline(early)


def test_row_6_exactly_at_its_limits() -> None:
    for brake_j, forbids in ((1000.0, False), (1000.0 + 1e-9, True)):
        judged = case({BRAKE: on()}, GuardState(brake_j=brake_j))
        assert brake_beyond_its_limits(judged) is forbids
    assert not brake_beyond_its_limits(case({SECOND: on()}, GuardState(brake_j=1e9)))
    assert not brake_beyond_its_limits(case({BRAKE: on(NOW - 4 * S)}, rad_s=(None, 1e3, 0.0, 0.0)))
    assert brake_beyond_its_limits(case({BRAKE: on(NOW - 4 * S - 1)}, rad_s=(None, 1e3, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("since_us", "measured_us", "acting_us"),
    [
        (NOW - S, NOW, SOON + S // 4),  # off in 15 ms and 1/4 s; since the speed was measured
        (NOW - S, NOW - S // 4, SOON + S // 2),
        (NOW, NOW, SOON + 7 * S // 32),  # since the air can have come in
        (NOW + S, NOW, 0),  # it can be withdrawn before
    ],
)
def test_row_6_the_lowest_speed(since_us: int, measured_us: int, acting_us: int) -> None:
    least = 16.0 + 32.0 * acting_us * 1e-6
    for rad_s, forbids in ((least + 1e-9, False), (least - 1e-9, True)):
        judged = case({BRAKE: on(since_us)}, rad_s=(None, rad_s, None, None),
                      measured_us=measured_us)  # fmt: skip
        assert brake_beyond_its_limits(judged) is forbids
    at_rest = case({BRAKE: on(NOW + S)}, rad_s=(None, 16.0, None, None))
    assert not brake_beyond_its_limits(at_rest)


def test_row_7_asks_each_valve_that_is_driven() -> None:
    long = NOW - ROUND.valve_on_us
    for since_us, forbids in ((long, False), (long - 1, True)):
        judged = case({SPLIT_LOW: on(), RANGE_LOW: on(since_us)})
        assert driven_too_long_or_blind(judged) is forbids


def test_row_8_exactly_at_its_limit() -> None:
    for rad_s, forbids in ((32.0, False), (32.0 + 1e-9, True)):
        judged = case({RANGE_LOW: on()}, rad_s=(None, None, None, rad_s))
        assert range_change_out_of_neutral(judged) is forbids


def test_row_9_exactly_at_its_limit() -> None:
    """Second in low split: the input shaft turns four times as fast as the main shaft."""
    edge = GUARD_NEUTRAL_M
    for splitter_m, most in ((0.012, 128.0), (edge + 1e-9, 128.0), (edge, 64.0), (-0.012, 64.0)):
        positions = (0.0, 0.0, splitter_m, 0.012)
        for rad_s, forbids in ((most, False), (most + 1e-9, True)):
            judged = case({SECOND: on()}, rad_s=(None, 1.0, rad_s, None), positions_m=positions)
            assert input_overspeed(judged) is forbids
    assert not input_overspeed(case({SECOND: on()}, rad_s=(None, 1.0, None, None)))
    for rad_s, forbids in ((128.0, False), (128.0 + 1e-9, True)):
        assert input_overspeed(case({SPLIT_LOW: on()}, rad_s=(None, rad_s, 0.0, None))) is forbids


def test_row_10_where_teeth_are_in_mesh() -> None:
    """A main sleeve more than 4.5 mm into its gear, the splitter more than 1.5 mm into its step;
    none is pulled with the clutch closed."""
    in_m = ROUND.contact_m - 0.5e-3
    for position_m, forbids in ((in_m, False), (in_m + 1e-9, True)):
        judged = case({FIRST: on()}, positions_m=(position_m, 0.0, 0.0, 0.012), clutch_closed=1.0)
        assert disengage_under_torque(judged) is forbids
    for valve, way in ((SPLIT_LOW, 1.0), (SPLIT_HIGH, -1.0)):
        for position_m, forbids in ((GUARD_NEUTRAL_M, False), (GUARD_NEUTRAL_M + 1e-9, True)):
            positions = (0.0, 0.0, way * position_m, 0.012)
            judged = case({valve: on()}, positions_m=positions, clutch_closed=1.0)
            assert disengage_under_torque(judged) is forbids


@pytest.mark.parametrize(("gauge_pa", "forbids"), [(1e5, False), (1e5 + 1.0, True)])
def test_row_10_the_brakes_pressure_exactly_at_its_limit(gauge_pa: float, forbids: bool) -> None:
    judged = case({FIRST: on()}, positions_m=(0.012, 0.0, 0.012, 0.012), brake_pa=1024.0 + gauge_pa)
    assert disengage_under_torque(judged) is forbids


@pytest.mark.parametrize(
    ("valve", "since_us", "foreseen_us"),
    [
        (FIRST, NOW - S, 0),
        (FIRST, NOW - S // 4 + 30_000, 30_000),  # the teeth may be out 1/4 s after its valve
        (FIRST, NOW, 60_000),
        (SPLIT_LOW, NOW - S, 0),
        (SPLIT_LOW, NOW - S // 8 + 30_000, 30_000),
        (SPLIT_LOW, NOW, 60_000),
    ],
)
def test_row_10_the_clutch_when_the_teeth_may_be_out(
    valve: int, since_us: int, foreseen_us: int
) -> None:
    for beside, forbids in ((-1e-9, False), (1e-9, True)):
        closed = 0.25 + foreseen_us * 1e-6 + beside
        judged = case({valve: on(since_us)}, positions_m=(0.012, 0.0, 0.012, 0.012),
                      clutch_closed=closed, clutch_per_s=-1.0)  # fmt: skip
        assert disengage_under_torque(judged) is forbids


def test_row_11_exactly_at_its_limit() -> None:
    for supply_pa, forbids in ((4096.0, False), (4096.0 - 1e-9, True)):
        assert actuation_at_low_supply(case({SECOND: on()}, supply_pa=supply_pa)) is forbids


@pytest.mark.parametrize(("valve", "other"), [(1, 2), (2, 1), (7, 8), (8, 7)])
@pytest.mark.parametrize(
    ("ago_us", "forbids"),
    [(0, True), (-1, False), (ROUND.clutch_travel_us - 1, True), (ROUND.clutch_travel_us, False)],
)
def test_row_18_exactly_at_its_limits(valve: int, other: int, ago_us: int, forbids: bool) -> None:
    state = GuardState(group_us={other: NOW - ago_us})
    assert back_and_forth(case({valve: on()}, state)) is forbids
    assert not back_and_forth(case({other: on()}, state))
    assert not back_and_forth(case({valve: on()}))


# -- what the guard keeps ------------------------------------------------------------------------


def test_a_guard_is_armed_or_not() -> None:
    assert Guard(ROUND, armed=True).is_armed
    assert Guard(ROUND, armed=False).is_armed is False


def noted(guard: Guard, now_us: int, **changes: Any) -> GuardState:
    guard._note(case(**changes).seen._replace(now_us=now_us))
    return kept(guard)


def test_the_brakes_energy_is_torque_times_speed_times_time() -> None:
    """1 MPa of gauge pressure gives 1,024 Nm here; at 64 rad/s for half a second."""
    guard, pressed = Guard(ROUND, armed=True), {"brake_pa": 1024.0 + 2.0**20}
    assert noted(guard, NOW, **pressed).brake_j == 0.0  # no time has passed yet
    assert noted(guard, NOW + S // 2, **pressed).brake_j == 1024.0 * 64.0 / 2.0
    assert noted(guard, NOW + S, brake_pa=0.0).brake_j == 1024.0 * 64.0 / 2.0  # no less than none
    unknown = {"rad_s": (None, None, 0.0, 0.0)} | pressed
    assert noted(guard, NOW + 2 * S, **unknown).brake_j == 1024.0 * 64.0 / 2.0
    assert noted(guard, NOW + 3 * S, **pressed).brake_j == 1024.0 * 64.0 * 1.5
    assert kept(guard).judged_us == NOW + 3 * S


def test_a_request_is_kept_for_a_gear_there_is_until_it_is_in() -> None:
    guard = Guard(ROUND, armed=True)
    assert noted(guard, NOW, requested_gear=15).wanted is None
    assert noted(guard, NOW, requested_gear=10).wanted == (10, NOW)
    assert noted(guard, NOW + 1).wanted == (10, NOW)
    in_gear = {"positions_m": (0.012, 0.0, 0.012, 0.012)}  # second, high, high: gear 10
    almost = CLUTCH_CLOSED_SHARE - 1e-9
    assert noted(guard, NOW, clutch_closed=almost, **in_gear).wanted == (10, NOW)
    assert noted(guard, NOW, clutch_closed=1.0, valid=False, **in_gear).wanted == (10, NOW)
    assert noted(guard, NOW, clutch_closed=1.0).wanted == (10, NOW)  # in neutral
    assert noted(guard, NOW, clutch_closed=CLUTCH_CLOSED_SHARE, **in_gear).wanted is None


def passed(guard: Guard, spans: Spans, now_us: int = NOW) -> GuardState:
    """What is kept of a command that was let pass, where nothing else is noted."""
    guard._remember(spans, case().seen._replace(now_us=now_us))
    return kept(guard)


def test_what_is_remembered_of_the_command_that_passed() -> None:
    guard = Guard(ROUND, armed=True)
    braked, moved = case({BRAKE: on()}).spans, case({RANGE_LOW: on(), SECOND: on()}).spans
    kept(guard).brake_j = 5.0
    state = passed(guard, braked)
    assert (state.brake_off_us, state.brake_j) == (-FOREVER, 5.0)
    state = passed(guard, moved)
    assert state.spans is moved
    assert state.group_us == {RANGE_LOW: NOW}
    assert (state.brake_off_us, state.brake_j) == (NOW, 5.0)  # off only now
    state = passed(guard, moved, NOW + 9)
    assert state.group_us == {RANGE_LOW: NOW + 9}
    assert (state.brake_off_us, state.brake_j) == (NOW, 0.0)
    for was, now_us, off_us in (
        (on(NOW, NOW + 5), NOW + 9, NOW + 5), (on(NOW, NOW + 5), NOW + 3, NOW + 3),
        (on(NOW + 7), NOW + 3, -FOREVER), (on(NOW + 7), NOW + 7, NOW + 7),
    ):  # fmt: skip
        guard = Guard(ROUND, armed=True)
        kept(guard).spans = case({BRAKE: was}).spans
        assert passed(guard, NO_SPANS, now_us).brake_off_us == off_us


@pytest.mark.parametrize("always", [False, True])
def test_a_guard_whose_decoder_is_wrong_is_never_proven(
    always: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Guard(ROUND, armed=True)._is_sound
    wish = ValveRequest((1 if always else 0,) * 9, (0,) * 9)
    monkeypatch.setattr(rules, "decode", lambda payload: wish)
    guard = Guard(ROUND, armed=True)
    for _ in range(9):
        noted(guard, NOW)
    assert not guard.is_proven
    assert kept(guard).proofs == 0


def test_with_another_sensor_clock_the_self_test_begins_anew() -> None:
    guard = Guard(ROUND, armed=True)
    found = [noted(guard, NOW, clock_is_new=each == 4).proofs for each in range(8)]
    assert found == [1, 2, 3, 3, 1, 2, 3, 3]


def test_proofs_are_counted_from_one_that_fails_and_no_further_than_needed() -> None:
    guard = Guard(ROUND, armed=True)
    assert (guard.blocks, guard.blocked_row) == (0, None)
    counts = [noted(guard, NOW, valid=valid).proofs for valid in (True, True, False, True)]
    assert counts == [1, 2, 0, 1]
    assert [noted(guard, NOW, valid=valid).proofs for valid in (True, True, True, False)] == [
        2, 3, 3, 3
    ]  # fmt: skip
