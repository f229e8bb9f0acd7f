"""Edges that come while the board looks for edges have their own times, to the microsecond."""

from __future__ import annotations

import random
from typing import Any

from timed_board import sent, timed_board

LOOKS_US = range(20, 60)
"""Behind a tick the board looks for edges then."""
BURST = 10
"""Edges of one wheel, one a microsecond."""
CHANNELS, TICKS = 8, 150


def test_an_edge_between_two_registers_that_are_read_has_its_own_time() -> None:
    """Edges come at any microsecond of the time in which the board looks for them. A stamp of 16
    bits that is taken to be of a later time than now's is 65 ms wrong, and what lies before it a
    standstill."""
    board, rng = timed_board(), random.Random(64)
    sent(board)
    reads: list[Any] = []
    for _ in range(TICKS):
        tick_us = board.chip.nvic.systick.next_us
        assert tick_us is not None
        for channel in range(CHANNELS):
            board.pulse(channel, [tick_us + rng.randrange(LOOKS_US.start)])
        begun_us = tick_us + rng.choice(LOOKS_US)
        board.pulse(rng.randrange(CHANNELS), range(begun_us, begun_us + BURST))
        board.advance(tick_us + LOOKS_US.stop + BURST - board.own_us)
        reads += [each for each in sent(board) if type(each).__name__.startswith("Edges")]
    assert len(reads) >= CHANNELS * (TICKS // 10 - 1)
    assert all(each.newest_index > TICKS - 12 for each in reads[-CHANNELS:])
    assert not any(each.long_interval or each.stopped or each.sensor_fault for each in reads)
