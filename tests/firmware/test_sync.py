"""Two boards, one sensor clock: a pulse by wire, its time by GearboxSensors."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from firmware_bench import WRAP, Order
from shared_clock import READ_US, TwoBoards

from meshpoint.dbc.messages import ValveAction
from meshpoint.firmware.native_board import NativeBoard

ON, OFF_AT, ON_AT = ValveAction.ON_NOW, ValveAction.OFF_AT, ValveAction.ON_AT
MOST_WRONG_US = 100
OFF_US = 60_000
KNOWN_AGAIN_US = 100_000


def keep_on(boards: TwoBoards, for_us: int, **orders: Order) -> None:
    """Time goes on, with a command each 10 ms."""
    for passed_us in range(0, for_us, READ_US):
        boards.command(**orders)
        boards.wait(min(READ_US, for_us - passed_us))


def is_on_after(boards: TwoBoards, for_us: int) -> bool:
    """Whether the brake valve is driven at the end, having been commanded on all the time."""
    keep_on(boards, for_us, brake=ON)
    return bool(boards.driven)


@pytest.mark.parametrize("drift_ppm", [-200, -100, 0, 100, 200])
def test_valves_are_switched_at_the_other_boards_time(boards: TwoBoards, drift_ppm: int) -> None:
    """Within 100 us, 100 times, through a wrap of the sensor clock."""
    rng = random.Random(drift_ppm)
    boards.drift_ppm = drift_ppm
    boards.be_heard()
    for action, before in [(ON_AT, set()), (OFF_AT, {"brake"})] * 50:
        wait_us = rng.randint(1_000, 99_000)
        due = (action, boards.now_us + wait_us)
        keep_on(boards, wait_us - MOST_WRONG_US, brake=due)
        assert boards.driven == before
        boards.wait(2 * MOST_WRONG_US)
        assert boards.driven == {"brake"} - before
    assert boards.memory.resets == 0


def test_before_the_clock_is_known_nothing_is_driven(boards: TwoBoards) -> None:
    boards.board.power_on(sensor_us=3_000_000_000)
    boards.is_wired = False
    assert not is_on_after(boards, 500_000)
    boards.is_wired = True
    assert is_on_after(boards, KNOWN_AGAIN_US)


def test_a_board_that_was_reset_knows_no_clock(boards: TwoBoards) -> None:
    boards.board.power_on(boards.memory.sensor_us)
    for _ in range(4):
        boards.command(brake=ON)
    assert boards.driven == set()


@pytest.mark.parametrize(
    ("what", "value", "last_us"),
    [("is_wired", False, 0), ("is_sending", False, 0), ("late_us", 13_000, 13_000),
     ("late_us", 30_000, 30_000)],
)  # fmt: skip
def test_60_ms_after_the_last_pair_of_pulse_and_frame_all_is_off_until_they_come_again(
    boards: TwoBoards, what: str, value: int, last_us: int
) -> None:
    """A frame that is not through as the next pulse is due goes without one, and so on."""
    assert is_on_after(boards, READ_US)
    setattr(boards, what, value)
    assert is_on_after(boards, 40_000)
    keep_on(boards, last_us + OFF_US - 40_000, brake=ON)
    assert boards.driven == set()
    assert not is_on_after(boards, 500_000)
    boards.be_heard()
    assert is_on_after(boards, READ_US)


def lose_a_pulse(boards: TwoBoards) -> None:
    boards.is_wired = False
    boards.wait(READ_US)
    boards.is_wired = True


def lose_a_frame(boards: TwoBoards) -> None:
    boards.is_sending = False
    boards.wait(READ_US)
    boards.is_sending = True


def delay_a_frame(boards: TwoBoards) -> None:
    """Until the next pulse has come."""
    boards.late_us = 13_000
    boards.wait(READ_US)
    boards.late_us = 14_000
    boards.wait(READ_US)
    boards.late_us = 4_000


def disturb_the_wire(boards: TwoBoards) -> None:
    """Between a pulse and its frame, and between that and the next pulse."""
    for _ in range(10):
        boards.wait(READ_US // 10)
        boards.pulse()


@pytest.mark.parametrize("mishap", [lose_a_pulse, lose_a_frame, delay_a_frame, disturb_the_wire])
def test_a_mishap_costs_nothing(boards: TwoBoards, mishap: Callable[[TwoBoards], None]) -> None:
    for _ in range(10):
        boards.command(brake=ON)
        mishap(boards)
        assert boards.driven == {"brake"}
        assert abs(boards.wrong_us) < MOST_WRONG_US
        assert is_on_after(boards, 2 * READ_US)


@pytest.mark.parametrize("step_us", [-WRAP // 2, -1_000_000, -60_000, 100, 10_000, 1_000_000])
def test_when_the_other_clock_jumps_everything_is_off_at_once_and_it_is_followed(
    boards: TwoBoards, step_us: int
) -> None:
    assert is_on_after(boards, READ_US)
    boards.sensor.memory.sensor_us = (boards.now_us + step_us) % WRAP
    boards.wait(2 * READ_US)
    assert boards.driven == set()
    assert is_on_after(boards, KNOWN_AGAIN_US)
    assert abs(boards.wrong_us) < MOST_WRONG_US


def test_a_sensor_board_that_is_switched_on_again_is_followed(boards: TwoBoards) -> None:
    boards.sensor.power_on(sensor_us=0)
    keep_on(boards, 3 * READ_US, brake=ON)
    assert boards.driven == set()
    assert is_on_after(boards, KNOWN_AGAIN_US)
    assert abs(boards.wrong_us) < MOST_WRONG_US


def test_a_board_with_sensors_of_its_own_takes_nobody_elses_clock(
    boards: TwoBoards, board: NativeBoard
) -> None:
    both = TwoBoards(boards.sensor, board, drift_ppm=0)
    apart_us = both.wrong_us
    assert is_on_after(both, KNOWN_AGAIN_US)
    assert both.wrong_us == apart_us
