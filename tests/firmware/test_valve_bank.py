"""The slots in C and the rig's valve drivers, which were written apart, do the same."""

from __future__ import annotations

import ctypes
import random

import pytest
from structures import COrder, CValves

from meshpoint.dbc.messages import ValveAction
from meshpoint.firmware.native_board import NativeBoard
from meshpoint.rig_sim.shared.valve_drivers import Order, ValveBank

PAUSES_US = [0, 1, 999, 1_000, 5_000, 10_000, 10_000, 10_000, 10_000, 40_000, 99_999, 100_000]
STEPS_US = [-(1 << 31), -150_000, -2_000, 2_000, 99_999, 1 << 30]
LIMITS_US = [-2_001, -2_000, 0, 1, 100_000, 100_001]
GRID_US = 10_000
LONGEST_WAIT_US = 1_000_000
ACTIONS = list(ValveAction)


def mask(flags: tuple[bool, ...]) -> int:
    return sum(flag << place for place, flag in enumerate(flags))


def drawn(rng: random.Random, clock_us: int) -> tuple[tuple[Order, ...], object]:
    """A command with times on a coarse grid, so that many are sent again; some at the limits."""
    pairs = []
    for _ in range(9):
        time_us = (clock_us // GRID_US + rng.randint(-1, 11)) * GRID_US
        if rng.random() < 0.1:
            time_us = clock_us + rng.choice(LIMITS_US)
        pairs.append((rng.randrange(4), time_us & 0xFFFF_FFFF))
    return tuple(Order(ACTIONS[a], t) for a, t in pairs), (COrder * 9)(*pairs)


def test_slots_and_outputs_are_the_same_over_random_commands(board: NativeBoard) -> None:
    compare(board, commands=8_000)


@pytest.mark.long
def test_slots_and_outputs_are_the_same_over_100_000_random_commands(board: NativeBoard) -> None:
    compare(board, commands=100_000)


def compare(board: NativeBoard, commands: int) -> None:
    rng = random.Random(48)
    bank, valves, code = ValveBank(), CValves(), board.code
    code.valves_next_us.restype = ctypes.c_uint32
    at = ctypes.byref(valves)
    own_us, clock_us = 1 << 31, (1 << 32) - 10_000_000
    for _ in range(commands):
        wait_us = rng.choice(PAUSES_US)
        step_us = rng.choice(STEPS_US) if rng.random() < 0.002 else 0
        own_us, clock_us = own_us + wait_us, clock_us + wait_us + step_us
        bank.activate(clock_us)
        bank.expire(own_us)
        if rng.random() < 0.1:
            code.valves_run(at, clock_us & 0xFFFF_FFFF, own_us & 0xFFFF_FFFF)
        else:  # which does first what is due
            orders, c_orders = drawn(rng, clock_us)
            bank.command(orders, clock_us, own_us)
            code.valves_command(at, c_orders, clock_us & 0xFFFF_FFFF, own_us & 0xFFFF_FFFF)
        assert code.valves_wanted(at) == mask(bank.energised)
        assert code.valves_pending(at) == mask(bank.pending)
        assert valves.refused_count == bank.refused & 0xFFFF
        assert valves.expired_count == bank.expired & 0xFFFF
        next_us = min(bank.activation_us or 1 << 99, clock_us + LONGEST_WAIT_US)
        assert code.valves_next_us(at) == next_us & 0xFFFF_FFFF
    assert bank.refused > commands // 8 and bank.expired > commands // 40
