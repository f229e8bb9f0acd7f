"""Whatever ends the commands: every valve is off within 101 ms of the last valid one."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest
from firmware_bench import VALVES, WRAP, CommandBench, Order
from shared_clock import TwoBoards

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ValveAction

OFF_US = 101_000
ENDS = ("silence", "reset", "bus-off", "garbage", "clock jump", "stuck main loop", "deaf", "fault")


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
    memory = bench.memory
    match how:
        case "reset":
            bench.board.power_on(memory.sensor_us)
        case "bus-off":
            memory.is_bus_off = True
        case "clock jump":
            memory.sensor_us = rng.randrange(WRAP)
        case "stuck main loop":
            memory.is_stuck = True
        case "deaf":
            memory.is_deaf = True
        case "fault":
            bench.board.code.board_on_fault()
        case "wire cut":
            bench.is_wired = False


def go_through(rng: random.Random, bench: CommandBench, how: str) -> bool:
    """One moment; whether anything was driven before it was over."""
    for _ in range(rng.randint(3, 8)):
        bench.command(**orders(rng, bench.now_us))
        if rng.random() < 0.9:
            bench.wait(rng.randint(1, 12_000))
    bench.command(**orders(rng, bench.now_us))
    last_us = bench.memory.own_us
    if rng.random() < 0.8:
        bench.wait(rng.randint(0, 40_000))
    was_driven = bool(bench.driven)
    end(rng, bench, how)
    while bench.memory.own_us - last_us < OFF_US:
        left_us = OFF_US - (bench.memory.own_us - last_us)
        bench.wait(min(left_us, rng.randint(1, 20_000)))
        if how == "garbage":
            bench.board.receive(garbage(rng, bench.valve_frame()))
    assert bench.driven == set(), how
    bench.wait(rng.randint(0, 200_000))
    assert bench.driven == set(), how
    assert bench.memory.coils_together == 0
    return was_driven


def go_through_all(bench: CommandBench, ends: Sequence[str], times: int) -> None:
    rng, driven = random.Random(48), Counter[str]()
    for number in range(times):
        how = ends[number % len(ends)]
        driven[how] += go_through(rng, bench, how)
        bench.memory.is_bus_off = bench.memory.is_stuck = bench.memory.is_deaf = False
        bench.be_heard()
    assert all(driven[how] > times // len(ends) // 3 for how in ends), driven


def test_every_valve_is_off_within_101_ms_in_10_000_random_moments(bench: CommandBench) -> None:
    go_through_all(bench, ENDS, 10_000)


def test_every_valve_of_a_board_without_sensors_is_off_as_well(boards: TwoBoards) -> None:
    go_through_all(boards, (*ENDS, "wire cut"), 450)


@pytest.mark.parametrize("dead_us", [100, 50_000, 98_000])
def test_a_board_that_is_dead_altogether_is_off_2_ms_later(
    bench: CommandBench, dead_us: int
) -> None:
    """Main loop and interrupts: then the watchdog alone is left."""
    bench.command(brake=ValveAction.ON_NOW)
    bench.wait(dead_us)
    bench.memory.is_stuck = bench.memory.is_deaf = True
    bench.wait(2_000)
    assert bench.driven == set()
    assert bench.memory.resets == 1
