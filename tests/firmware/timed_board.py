"""A board on which code and conversions take their time, with edges, samples and commands."""

from __future__ import annotations

import pytest
from firmware_bench import BY_ID

from meshpoint.base.errors import CommandError
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import Message
from meshpoint.firmware.build import (
    IMAGES,
    image,
    installed_cross_compiler,
    source_folder,
)
from meshpoint.firmware.cortex_m4.emulated_board import EmulatedBoard
from meshpoint.firmware.cortex_m4.iwdg import LSI_HZ

STARTED_US = 16_000
"""By then a board is on its bus and its main loop sleeps."""


def timed_board(name: str = "both", sensor_us: int = 0, lsi_hz: int = LSI_HZ) -> EmulatedBoard:
    """One with this image that has started; skips where it cannot be built or run."""
    pytest.importorskip("unicorn", reason="meshpoint[firmware] is not installed")
    try:
        elf = image(source_folder(), IMAGES[name], installed_cross_compiler())
    except CommandError as error:
        pytest.skip(str(error))
    board = EmulatedBoard(elf, takes_time=True, lsi_hz=lsi_hz)
    board.power_on(sensor_us)
    board.advance(STARTED_US)
    return board


def sent(board: EmulatedBoard) -> list[Message]:
    """What it has sent since the last call, each a whole frame, in order."""
    found = []
    for frame in board.take_sent():
        message = read_alone(BY_ID[frame.can_id], frame)
        assert message is not None, frame
        found.append(message)
    return found


def run_until(board: EmulatedBoard, name: str, most_us: int = 30_000) -> Message:
    """Until a message of this name was sent, which it returns."""
    for _ in range(0, most_us, 50):
        board.advance(50)
        for message in sent(board):
            if type(message).__name__ == name:
                return message
    raise AssertionError(f"no {name} in {most_us} us")
