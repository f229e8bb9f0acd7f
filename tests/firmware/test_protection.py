"""E2E in C against the product's in Python: CRC, counters, the state machine over random frames."""

from __future__ import annotations

import ctypes
import random

import numpy as np
from structures import CChannel

from meshpoint.dbc.e2e import StateMachine, Status, check_counter, write_crc
from meshpoint.firmware.native_board import NativeBoard

DATA_ID = 0x1234
MOST_DELTA = 2
CYCLE_US, SILENCE_US = 10_000, 50_000


def test_the_example_of_the_wire_contract(board: NativeBoard) -> None:
    data = ctypes.create_string_buffer(8)
    board.code.e2e_protect(data, 8, DATA_ID, 0)
    assert data.raw.hex(" ") == "1c ca 00 00 00 00 00 00"
    board.code.e2e_protect(data, 8, DATA_ID, 1)
    assert data.raw.hex(" ") == "cf 8d 01 00 00 00 00 00"


def test_any_frame_is_protected_as_the_library_does_it(board: NativeBoard) -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    for _ in range(2_000):
        expected = bytearray(rng.bytes(int(rng.integers(3, 65))))
        data_id, counter = int(rng.integers(1 << 16)), int(rng.integers(256))
        data = ctypes.create_string_buffer(bytes(expected), len(expected))
        expected[2] = counter
        write_crc(expected, data_id, increment_counter=False)
        board.code.e2e_protect(data, len(expected), data_id, counter)
        assert data.raw == expected


def deltas(rng: random.Random) -> int:
    """How far a sender's counter goes on: mostly as it should."""
    return rng.choice([1, 1, 1, 1, 1, 1, 2, 3, 0, rng.randrange(256)])


def test_a_channel_goes_through_the_same_states(board: NativeBoard) -> None:
    """20,000 frames, some damaged, lost or late, of a machine that begins anew now and then."""
    rng = random.Random(5)
    code, seen, counter, now_us = board.code, set(), 0, 0
    for step in range(20_000):
        if step % 50 == 0:
            channel, machine, previous, heard_us = CChannel(), StateMachine(), None, None
        now_us += rng.choice([CYCLE_US, CYCLE_US, CYCLE_US, SILENCE_US - 1, SILENCE_US])
        code.e2e_watch(ctypes.byref(channel), now_us & 0xFFFF_FFFF)
        if heard_us is not None and now_us - heard_us >= SILENCE_US:
            machine.update(Status.NO_NEW_DATA)
            heard_us = None
        counter = (counter + deltas(rng)) & 0xFF
        data = ctypes.create_string_buffer(rng.randbytes(8), 8)
        code.e2e_protect(data, 8, DATA_ID, counter)
        if rng.random() < 0.15:
            data[7] = bytes([data.raw[7] ^ 0x40])
            status = Status.ERROR
        else:
            status = check_counter(previous, counter, MOST_DELTA)
            previous = counter
        assert code.e2e_check(ctypes.byref(channel), data, 8, DATA_ID) == status
        code.e2e_update(ctypes.byref(channel), int(status), now_us & 0xFFFF_FFFF)
        machine.update(status)
        heard_us = now_us if status is Status.OK else heard_us
        assert channel.state == machine.state
        seen.add((int(status), channel.state))
    assert len(seen) >= 12
