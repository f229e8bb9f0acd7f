"""The watchdog's window: it is restarted neither too early nor too late, whatever is to do."""

from __future__ import annotations

import random

import pytest
from firmware_bench import command
from timed_board import timed_board
from worst_case import NOISE_EDGES, orders

from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.node import Node
from meshpoint.firmware.board import Failure
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard

SLOWEST_HZ, FASTEST_HZ = 29_500, 34_000
"""LSI from -40 to 125 degrees, by the data sheet of the STM32G474."""
MS, CYCLE_MS = 1_000, 10


def noise(board: EmulatedBoard) -> None:
    """As many edges of each channel as are taken in a millisecond."""
    for channel in range(8):
        board.capture(channel, [board.sensor_us & 0xFFFF_FFFF] * (NOISE_EDGES // CYCLE_MS))


@pytest.mark.parametrize("lsi_hz", [SLOWEST_HZ, FASTEST_HZ])
@pytest.mark.parametrize("scan_us", [130, 500, 750])
def test_it_holds_with_noise_on_all_wheels_and_orders_for_all_valves(
    lsi_hz: int, scan_us: int
) -> None:
    """Wherever between two ticks a scan begins."""
    board = timed_board(lsi_hz=lsi_hz)
    sender, rng = Transmitter(Node.TRANSMISSION_CONTROL), random.Random(48)
    board.chip.timers["TIM6"].show(scan_us, board.own_us)
    for _ in range(16):
        noise(board)
        board.receive(sender.encode(command(orders(rng, board.sensor_us))))
        board.advance(MS)
    assert board.resets == 0


@pytest.mark.parametrize("image", ["both", "sensor", "valve", "teeth"])
def test_a_main_loop_that_is_stuck_resets_the_board_though_interrupts_go_on(image: str) -> None:
    board = timed_board(image)
    board.fail(Failure.STUCK)
    board.advance(3_200)
    assert board.resets == 1
