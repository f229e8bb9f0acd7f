"""Each row of the guard forbids what no other row does: with the row left out it passes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import pytest
from guard_cases import LIMITS, NEUTRAL, NOW, SHEET, calm, kept, payload, place, ready, speeds
from test_guard_driveline import CLOSE, IN_GEAR, INPUT_RPM, OPEN, engine

from meshpoint.controller.guard import driveline, rules
from meshpoint.controller.guard.case import GuardState
from meshpoint.controller.guard.driveline import CLUTCH_ROWS, ENGINE_ROWS, DrivelineGuard
from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.controller.guard.rules import GUARD_ROWS
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.gearbox import Split
from meshpoint.units import RPM


class Forbidden(NamedTuple):
    """A command that one row forbids: the valves driven, what is seen, what has been before."""

    driven: tuple[ValveName, ...]
    seen: GuardInputs
    before: Callable[[GuardState], object] = lambda state: None


def too_fast() -> GuardInputs:
    """First gear, high split, would turn the input shaft 1 % too fast."""
    ratio = LIMITS.main[int(ValveName.MAIN_FIRST)].ratio
    main = 1.01 * LIMITS.input_max_rad_s * SHEET.split_mesh(Split.HIGH).ratio * ratio
    turning = (None, ShaftSpeed(NOW, main / ratio), ShaftSpeed(NOW, main), None)
    return NEUTRAL._replace(speeds=turning, swings=calm(turning))


def without(shaft: int) -> GuardInputs:
    a, b, c, d = (None if k == shaft else speed for k, speed in enumerate(speeds()))
    return NEUTRAL._replace(speeds=(a, b, c, d))


SECOND, HIGH = (ValveName.MAIN_SECOND,), (ValveName.RANGE_HIGH,)
FORBIDDEN: Final = {
    1: Forbidden((ValveName.SPLIT_LOW, ValveName.SPLIT_HIGH), NEUTRAL),
    2: Forbidden(SECOND, place(NEUTRAL, 1, 1.6e-3)),
    3: Forbidden(SECOND, NEUTRAL._replace(speeds=speeds(slip_rpm=400.0))),
    4: Forbidden(SECOND, without(2)),
    5: Forbidden((ValveName.BRAKE,), NEUTRAL._replace(clutch_closed=0.31)),
    6: Forbidden((ValveName.BRAKE,), NEUTRAL, lambda state: setattr(state, "brake_j", 15_001.0)),
    7: Forbidden(HIGH, NEUTRAL._replace(valid=False)),
    8: Forbidden(HIGH, place(NEUTRAL, 0, 0.012)),
    9: Forbidden((ValveName.MAIN_FIRST,), too_fast()),
    10: Forbidden((ValveName.MAIN_FIRST,), place(NEUTRAL, 0, 0.012)._replace(clutch_closed=0.31)),
    11: Forbidden(HIGH, NEUTRAL._replace(supply_pa=4.9e5)),
    12: Forbidden(HIGH, NEUTRAL, lambda state: setattr(state, "armed", False)),
    13: Forbidden(HIGH, NEUTRAL._replace(agreeing=int(ValveName.MAIN_SECOND))),
    17: Forbidden(HIGH, NEUTRAL, lambda state: setattr(state, "wanted", None)),
    18: Forbidden(HIGH, NEUTRAL, lambda state: state.group_us.update({7: NOW - 100_000})),
    19: Forbidden(HIGH, NEUTRAL._replace(clock_error_us=12_001)),
    20: Forbidden(
        (ValveName.SPLIT_LOW,), place(NEUTRAL, 0, 3e-3),
        lambda state: state.before_teeth_us.update({0: NOW - 500_001}),
    ),
}  # fmt: skip
DRIVELINE: Final = (14, 15, 16)


@pytest.mark.parametrize("is_wrong", [False, True])
def test_row_13_forbids_to_pull_a_gear_that_the_wheels_say_is_not_in(is_wrong: bool) -> None:
    seen = place(NEUTRAL, 0, -0.012)._replace(gear_is_wrong=is_wrong)
    guard = ready()
    assert guard.passes(payload(*SECOND, at_us=NOW), seen) is not is_wrong
    assert guard.blocked_row == (13 if is_wrong else None)
    assert guard.gear_is_denied is is_wrong


def test_there_is_a_command_for_each_row() -> None:
    assert {*FORBIDDEN, *DRIVELINE} == {
        row.number for row in (*GUARD_ROWS, *CLUTCH_ROWS, *ENGINE_ROWS)
    }


@pytest.mark.parametrize("row", FORBIDDEN)
def test_each_row_forbids_what_no_other_does(row: int, monkeypatch: pytest.MonkeyPatch) -> None:
    driven, seen, before = FORBIDDEN[row]
    others = tuple(each for each in GUARD_ROWS if each.number != row)
    for rows, expected in ((GUARD_ROWS, row), (others, None)):
        monkeypatch.setattr(rules, "GUARD_ROWS", rows)
        guard = ready()
        before(kept(guard))
        guard.passes(payload(*driven, at_us=NOW), seen)
        assert guard.blocked_row == expected
        assert kept(guard).latched_by == (expected if expected in (1, 2) else 0)


@pytest.mark.parametrize("row", DRIVELINE)
def test_so_does_each_row_of_clutch_and_engine(row: int, monkeypatch: pytest.MonkeyPatch) -> None:
    apart = IN_GEAR._replace(engine_rad_s=2.0 * INPUT_RPM * RPM)
    for left_out in (False, True):
        if left_out:
            for name in ("CLUTCH_ROWS", "ENGINE_ROWS"):
                left = tuple(each for each in getattr(driveline, name) if each.number != row)
                monkeypatch.setattr(driveline, name, left)
        guard = DrivelineGuard(LIMITS)
        if row == 14:
            guard.passes_engine(engine(2.0 * INPUT_RPM), IN_GEAR)
        else:
            for _ in range(LIMITS.closings if row == 16 else 0):
                assert guard.passes_clutch(CLOSE, IN_GEAR)
                assert guard.passes_clutch(OPEN, IN_GEAR)
            guard.passes_clutch(CLOSE, apart if row == 15 else IN_GEAR)
        assert guard.blocked_row == (None if left_out else row)
