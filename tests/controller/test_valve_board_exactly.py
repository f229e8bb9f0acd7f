"""When an `off` loses its time, what a valve side tells as driven, and what a command leaves."""

from __future__ import annotations

import pytest

from meshpoint.controller.settings import ValveTiming
from meshpoint.controller.shift.valve_board import (
    NONE_DRIVEN,
    OFF,
    ValveBoard,
    ValveName,
    driven_or_pending,
)
from meshpoint.dbc.messages import ValveAction, ValveCommand, ValveStatus

SECOND_US = 1_000_000
T0 = 7 * SECOND_US
BRAKE, THIRD = ValveName.BRAKE, ValveName.MAIN_THIRD


def scheduled() -> ValveBoard:
    return ValveBoard(ValveTiming.SCHEDULED)


@pytest.mark.parametrize("before_us", [0, 999_999, 1_000_000])
@pytest.mark.parametrize("after_us", [0, 1, 2, 300_000])
def test_an_off_is_told_with_its_time_for_a_second_and_then_without(
    before_us: int, after_us: int
) -> None:
    """Whenever the message was asked for before: a time of 32 bits says nothing after an hour."""
    board = scheduled()
    board.schedule(BRAKE, False, T0, T0)
    told = board.message(T0 + before_us)
    assert (told.brake_action, told.brake_time_us) == (ValveAction.OFF_AT, T0)
    told = board.message(T0 + SECOND_US + after_us)
    is_old = after_us > 0
    action = ValveAction.OFF_NOW if is_old else ValveAction.OFF_AT
    assert (told.brake_action, told.brake_time_us) == (action, 0 if is_old else T0)


def test_of_two_offs_each_loses_its_time_by_itself() -> None:
    board = scheduled()
    board.schedule(BRAKE, False, T0, T0)
    board.schedule(THIRD, False, T0 + 400_000, T0)
    board.message(T0 + 500_000)
    told = board.message(T0 + SECOND_US + 1)
    assert told.brake_action is ValveAction.OFF_NOW
    assert told.main_third_action is ValveAction.OFF_AT
    told = board.message(T0 + SECOND_US + 400_001)
    assert told.main_third_action is ValveAction.OFF_NOW


def test_an_on_keeps_its_time_however_old() -> None:
    board = scheduled()
    board.schedule(BRAKE, True, T0, T0)
    told = board.message(T0 + 100 * SECOND_US)
    assert (told.brake_action, told.brake_time_us) == (ValveAction.ON_AT, T0)


@pytest.mark.parametrize("now_us", [0, 1, 500_000])
def test_a_valve_that_was_never_on_is_off_without_a_time_from_the_clocks_first_microsecond_on(
    now_us: int,
) -> None:
    board = scheduled()
    assert board.message(now_us) == ValveCommand()
    assert not any(board.driven(valve, now_us) for valve in ValveName)
    assert {board.command(valve) for valve in ValveName} == {OFF}
    assert (OFF.on, OFF.before) == (False, False)


def test_a_command_is_what_was_scheduled_and_what_was_before_until_it_is_taken_off() -> None:
    board = scheduled()
    board.schedule(THIRD, True, T0 + 5, T0)
    assert board.command(THIRD) == (T0 + 5, True, False)
    board.schedule(THIRD, False, T0 + 90, T0 + 5)
    assert board.command(THIRD) == (T0 + 90, False, True)
    assert board.message(T0 + 6).main_third_action is ValveAction.OFF_AT
    board.off(THIRD)
    assert board.message(T0 + 6) == ValveCommand()
    board.schedule(THIRD, True, T0 + 200, T0 + 7)
    assert board.command(THIRD) == (T0 + 200, True, False), "off is off before, too"


def test_hardware_without_a_clock_switches_when_it_is_told() -> None:
    """At the moment of the command, and at that of the next one."""
    board = ValveBoard(ValveTiming.IMMEDIATE)
    board.schedule(BRAKE, True, T0 + 10, T0)
    board.schedule(THIRD, True, T0 + 30, T0)
    actions = {}
    for since_us in (0, 9, 10, 29, 30, 31):
        told = board.message(T0 + since_us)
        actions[since_us] = (told.brake_action.name, told.main_third_action.name)
        assert (told.brake_time_us, told.main_third_time_us) == (0, 0)
    off, on = "OFF_NOW", "ON_NOW"
    assert actions == {
        0: (off, off), 9: (off, off), 10: (on, off), 29: (on, off), 30: (on, on), 31: (on, on),
    }  # fmt: skip


def test_a_valve_is_driven_or_about_to_be_as_the_valve_side_tells_it() -> None:
    """By its coil or its pending activation; of a valve side not heard yet none is."""
    assert driven_or_pending(None) == NONE_DRIVEN == (False,) * 9
    assert driven_or_pending(ValveStatus()) == NONE_DRIVEN
    fields = ValveStatus._fields
    for kind in ("_energised", "_pending"):
        names = [name for name in fields if name.endswith(kind)]
        assert len(names) == len(ValveName)
        for name, valve in zip(names, ValveName, strict=True):
            told = driven_or_pending(ValveStatus()._replace(**{name: True}))
            assert told == tuple(each is valve for each in ValveName)
