"""Whatever ends the commands: every valve is off within 101 ms of the last valid one."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest
from firmware_bench import VALVES, WRAP, CommandBench, Order, emulated_board
from shared_clock import TwoBoards

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ValveAction
from meshpoint.firmware.board import Failure
from meshpoint.firmware.build import CROSS_COMPILERS
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard

OFF_US = 101_000
ENDS = ("silence", "reset", "bus-off", "garbage", "clock jump", "stuck main loop", "deaf", "fault")


FAILURES = {"bus-off": Failure.BUS_OFF, "stuck main loop": Failure.STUCK, "deaf": Failure.DEAF,
            "fault": Failure.FAULT}  # fmt: skip
RECOVERY_US = 5_000
"""Until a CAN controller is on its bus again."""


def orders(rng: random.Random, now_us: int) -> dict[str, Order]:
    """Something for some valves, now and later."""
    found: dict[str, Order] = {}
    for valve in rng.sample(VALVES, rng.randint(1, 9)):
        action = rng.choice(list(ValveAction))
        found[valve] = (action, now_us + rng.randint(-2_500, 105_000))
    return found


def garbage(rng: random.Random, frame: Frame) -> Frame:
    """A command with a few bits of it turned over, or with other content altogether."""
    data = bytearray(frame.data if rng.random() < 0.7 else rng.randbytes(len(frame.data)))
    for _ in range(rng.randint(1, 5)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return frame._replace(data=bytes(data))


def end(rng: random.Random, bench: Any, how: str) -> None:
    """Ends the commands."""
    if how == "reset":
        bench.board.power_on(bench.board.sensor_us)
    elif how == "clock jump":
        bench.board.set_sensor_us(rng.randrange(WRAP))
    elif how == "wire cut":
        bench.is_wired = False
    elif how in FAILURES:
        bench.board.fail(FAILURES[how])


def go_through(rng: random.Random, bench: CommandBench, how: str, after_us: int) -> bool:
    """One moment, and how long it stays so; whether anything was driven before it was over."""
    for _ in range(rng.randint(3, 8)):
        bench.command(**orders(rng, bench.now_us))
        if rng.random() < 0.9:
            bench.wait(rng.randint(1, 12_000))
    bench.command(**orders(rng, bench.now_us))
    last_us = bench.board.own_us
    if rng.random() < 0.8:
        bench.wait(rng.randint(0, 40_000))
    was_driven = bool(bench.driven)
    end(rng, bench, how)
    while bench.board.own_us - last_us < OFF_US:
        left_us = OFF_US - (bench.board.own_us - last_us)
        bench.wait(min(left_us, rng.randint(1, 20_000)))
        if how == "garbage":
            bench.board.receive(garbage(rng, bench.valve_frame()))
    assert bench.driven == set(), how
    bench.wait(rng.randint(0, after_us))
    assert bench.driven == set(), how
    assert bench.board.coils_together == 0
    return was_driven


def go_through_all(
    bench: CommandBench, ends: Sequence[str], times: int, after_us: int = 200_000
) -> None:
    rng, driven = random.Random(48), Counter[str]()
    for number in range(times):
        how = ends[number % len(ends)]
        driven[how] += go_through(rng, bench, how, after_us)
        bench.board.mend()
        bench.wait(RECOVERY_US)
        bench.be_heard()
    assert all(driven[how] > times // len(ends) // 3 for how in ends), driven


def test_every_valve_is_off_within_101_ms_in_10_000_random_moments(bench: CommandBench) -> None:
    go_through_all(bench, ENDS, 10_000)


def test_every_valve_of_a_board_without_sensors_is_off_as_well(boards: TwoBoards) -> None:
    go_through_all(boards, (*ENDS, "wire cut"), 450)


def test_the_emulated_board_is_as_safe_in_some_of_them(emulated: EmulatedBoard) -> None:
    go_through_all(CommandBench(emulated), ENDS, 120, after_us=1_000)


@pytest.mark.long
@pytest.mark.parametrize("by", CROSS_COMPILERS)
def test_the_emulated_board_is_as_safe_in_all_of_them(by: str) -> None:
    go_through_all(CommandBench(emulated_board(by)), ENDS, 10_000)


@pytest.mark.parametrize("dead_us", [100, 50_000, 98_000])
@pytest.mark.parametrize("kind", ["board", "emulated"])
def test_a_board_that_is_dead_altogether_is_off_2_ms_later(
    request: pytest.FixtureRequest, kind: str, dead_us: int
) -> None:
    """Main loop and interrupts: then the watchdog alone is left."""
    bench = CommandBench(request.getfixturevalue(kind))
    bench.wait(1_000)
    bench.command(brake=ValveAction.ON_NOW)
    bench.wait(dead_us)
    bench.board.fail(Failure.STUCK)
    bench.board.fail(Failure.DEAF)
    assert bench.driven == {"brake"}
    bench.wait(2_000)
    assert bench.driven == set()
    assert bench.board.resets == 1
