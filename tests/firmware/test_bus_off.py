"""A board comes back from bus-off, whichever image it has, and what it sends is never old."""

from __future__ import annotations

import pytest
from timed_board import run_until, sent, timed_board

from meshpoint.dbc.messages import Message
from meshpoint.firmware.board import Failure
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard

OLDEST_US = 22_000
"""20 ms, a millisecond to look at it and one on the bus (docs/firmware.md)."""
CYCLE_US = 10_000


def stamp(message: Message) -> int:
    """When what it says was so."""
    fields = message._asdict()
    return int(fields["read_time_us" if "read_time_us" in fields else "sample_time_us"])


def assert_all_young(board: EmulatedBoard, messages: list[Message]) -> None:
    ages = [(type(each).__name__, board.sensor_us - stamp(each)) for each in messages]
    assert messages and all(0 <= age_us <= OLDEST_US for _, age_us in ages), ages


@pytest.mark.parametrize("image", ["both", "sensor", "valve"])
def test_each_image_sends_again_after_bus_off(image: str) -> None:
    board = timed_board(image)
    sent(board)  # what it has sent by now
    board.fail(Failure.BUS_OFF)
    board.advance(60_000)
    assert sent(board) == []
    board.mend()
    board.advance(2 * CYCLE_US)
    assert_all_young(board, sent(board))


def test_frames_that_waited_as_it_went_off_are_not_sent_behind_it() -> None:
    board = timed_board()
    sent(board)
    board.chip.fdcan.is_alone = True
    board.advance(2 * CYCLE_US)
    board.fail(Failure.BUS_OFF)
    board.advance(60_000)
    board.chip.fdcan.is_alone = False
    board.mend()
    for _ in range(20):
        board.advance(1_000)
        messages = sent(board)
        if messages:
            assert_all_young(board, messages)


@pytest.mark.parametrize("alone_us", [15_000, 40_000, 80_000])
def test_a_board_that_was_alone_on_its_bus_sends_the_newest_first_of_all(alone_us: int) -> None:
    board = timed_board()
    sent(board)
    board.chip.fdcan.is_alone = True
    board.advance(alone_us)
    assert sent(board) == []
    board.chip.fdcan.is_alone = False
    board.advance(1_000)
    assert_all_young(board, sent(board))
    board.advance(CYCLE_US)
    assert_all_young(board, sent(board))


def test_frames_go_out_in_the_order_in_which_they_were_made() -> None:
    """Also where buffers send the lowest identifier first, and all of them are full."""
    board = timed_board()
    run_until(board, "SleevesAux")
    board.chip.fdcan.is_alone = True
    board.advance(15_000)
    board.chip.fdcan.is_alone = False
    board.advance(CYCLE_US)
    names = [type(each).__name__ for each in sent(board)]
    assert names[:12] == names[12:24]
    assert names[8:12] == ["GearboxSensors", "ValveStatus", "SleevesMain", "SleevesAux"]
