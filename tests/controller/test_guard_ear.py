"""The guard's ear exactly at its limits, from raw bytes."""

from __future__ import annotations

import math
from typing import Any

import pytest

from meshpoint.controller.guard.listening import (
    GEAR_REQUEST,
    LAYSHAFT_EDGES,
    MAIN_EDGES,
    SENSORS,
    SLEEVES_AUX,
    SLEEVES_MAIN,
    VALVE_STATUS,
    Channel,
    Edges,
    GuardReceiver,
    Slow,
)
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.frame import Frame

ENGINE = 0x0CF00400
LENGTHS = {LAYSHAFT_EDGES: 64, MAIN_EDGES: 64, SENSORS: 16, SLEEVES_MAIN: 48, SLEEVES_AUX: 48,
           VALVE_STATUS: 16}  # fmt: skip
DATA_IDS = {LAYSHAFT_EDGES: 19730, MAIN_EDGES: 19732, SENSORS: 19744, SLEEVES_MAIN: 19745,
            SLEEVES_AUX: 19746, VALVE_STATUS: 19747}  # fmt: skip


def frame(can_id: int, counter: int, stamp: int = 0, at: dict[int, int] | None = None) -> Frame:
    """A good frame of one message, all zero but its stamp and the 16-bit words named by byte."""
    data = bytearray(LENGTHS[can_id])
    data[2] = counter % 256
    data[3:7] = stamp.to_bytes(4, "little")
    for byte, word in (at or {}).items():
        data[byte : byte + 2] = (word & 0xFFFF).to_bytes(2, "little")
    write_crc(data, DATA_IDS[can_id], increment_counter=False)
    return Frame(can_id, bytes(data), is_fd=True)


def heard(can_id: int, counters: list[int], now_us: int = 0) -> list[bool]:
    """Of frames with these counters: which the channel passes."""
    channel = Channel(LENGTHS[can_id], DATA_IDS[can_id])
    return [channel.passes(frame(can_id, counter), now_us) for counter in counters]


def test_one_frame_may_be_lost_between_two_that_are_believed() -> None:
    assert heard(SENSORS, [7, 8, 10, 13, 14, 14, 15, 14]) == [
        True, True, True, False, True, False, True, False
    ]  # fmt: skip
    assert heard(SENSORS, [255, 0, 255, 1]) == [True, True, False, True]


def test_a_frame_of_another_length_kind_or_crc_is_not_believed() -> None:
    channel, good = Channel(16, DATA_IDS[SENSORS]), frame(SENSORS, 5)
    assert not channel.passes(good._replace(data=good.data + bytes(4)), 0)
    assert not channel.passes(good._replace(is_fd=False), 0)
    assert not channel.passes(good._replace(data=bytes([good.data[0] ^ 1]) + good.data[1:]), 0)
    assert channel.passes(good, 0)
    # What was not believed has not moved the counter on.
    assert not channel.passes(frame(SENSORS, 9)._replace(is_fd=False), 0)
    assert channel.passes(frame(SENSORS, 6), 0)


def valid_after(notes: list[bool]) -> list[bool]:
    channel, found = Channel(16, 0), []
    for good in notes:
        channel.note(good)
        found.append(channel.is_valid)
    return found


def test_three_good_frames_in_a_row_begin_a_channel_and_three_bad_ones_of_ten_end_it() -> None:
    assert not Channel(16, 0).is_valid
    assert valid_after([True] * 3) == [False, False, True]
    assert valid_after([True, True, False, True, True, True]) == [False] * 5 + [True]
    assert valid_after([True] * 3 + [False] * 3) == [False, False, True, True, True, False]
    # The eleventh frame forgets the first: two bad ones of ten are borne for ever.
    spread = [True] * 3 + ([False] + [True] * 4) * 6
    assert valid_after(spread)[2:] == [True] * (len(spread) - 2)
    closer = [True] * 3 + [False] + [True] * 4 + [False] + [True] * 3 + [False]
    assert valid_after(closer)[-1] is False
    later = [True] * 3 + [False] + [True] * 4 + [False] + [True] * 4 + [False]
    assert valid_after(later)[-1] is True
    # After that it begins anew, with nothing held against it.
    again = valid_after([True] * 3 + [False] * 3 + [True, True, True, False, False, True])
    assert again[6:] == [False, False, True, True, True, True]


def test_bad_frames_while_a_channel_is_lost_are_held_against_it() -> None:
    """As in the state machine of AUTOSAR E2E: with over two bad ones of the newest ten it stays
    lost, however many good ones came last."""
    lost = [True] * 3 + [False] * 3
    found = valid_after([*lost, *[False] * 4, *[True] * 9])
    assert found[len(lost) :] == [False] * 4 + [False] * 7 + [True] * 2
    assert valid_after([*lost, False, False, True, True, True])[-3:] == [False, False, True]


@pytest.mark.parametrize(("silent_us", "is_valid"), [(39_999, True), (40_000, False)])
def test_a_channel_is_lost_after_40_ms(silent_us: int, is_valid: bool) -> None:
    channel = Channel(16, DATA_IDS[SENSORS])
    for counter in range(3):
        channel.note(channel.passes(frame(SENSORS, counter), 70_000))
    assert not channel.passes(frame(SENSORS, 2), 90_000)  # repeated: nothing was heard
    channel.tick(70_000 + silent_us)
    assert channel.is_valid is is_valid


def test_a_channel_that_was_lost_needs_three_good_frames_again() -> None:
    ear = GuardReceiver()
    found = []
    for cycle in range(10):
        now_us = 10_000 * cycle + (100_000 if cycle >= 5 else 0)
        ear.take([frame(VALVE_STATUS, cycle, now_us)], now_us)
        found.append(ear.channels[VALVE_STATUS].is_valid)
        if cycle == 4:
            ear.take([], now_us + 90_000)
            assert not ear.channels[VALVE_STATUS].is_valid
    assert found == [False, False, True, True, True, False, False, True, True, True]


def test_all_needed_channels_must_be_heard_and_no_sensor_faulty() -> None:
    needed = (SENSORS, SLEEVES_MAIN, SLEEVES_AUX, VALVE_STATUS)
    for missing in (*needed, None):
        ear = GuardReceiver()
        for counter in range(3):
            ear.take([frame(each, counter) for each in needed if each != missing], 0)
        assert ear.hears_all is (missing is None)
    ear.take([frame(SLEEVES_AUX, 3, at={7: 2})], 0)  # the fault bits of its sensors
    assert not ear.hears_all
    ear.take([frame(SLEEVES_AUX, 4)], 0)
    assert ear.hears_all
    assert set(ear.slow) == set(needed)
    assert Slow(0, ()) == (0, (), False, (0.0, 0.0), (0.0, 0.0))


def test_frames_with_short_identifiers_are_of_somebody_else() -> None:
    ear = GuardReceiver()
    other = frame(SENSORS, 0)._replace(is_extended=False)
    assert ear.take([other], 0) == []
    assert ear.take([other, frame(SENSORS, 0, 7)], 0) == [7]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("byte", [8, 14, 26, 28, 34, 46])
def test_a_position_beyond_20_mm_is_none(byte: int, sign: int) -> None:
    """The newest of each sleeve, the one 3 ms before it and the oldest."""
    ear = GuardReceiver()
    assert ear.take([frame(SLEEVES_MAIN, 0, 5, {byte: sign * 20_000})], 0) == [5]
    assert ear.take([frame(SLEEVES_MAIN, 1, 6, {byte: sign * 20_001})], 0) == []
    assert ear.slow[SLEEVES_MAIN].time_us == 5
    for counter in range(2, 4):
        ear.take([frame(SLEEVES_MAIN, counter, 6, {byte: sign * 20_001})], 0)
    assert not ear.channels[SLEEVES_MAIN].is_valid


def test_a_sleeves_speed_is_taken_over_3_ms_and_over_the_whole_frame() -> None:
    ear = GuardReceiver()
    positions = {8: 900, 14: 600, 26: 450, 28: -300, 34: 300, 46: 60}
    ear.take([frame(SLEEVES_MAIN, 0, 5, positions)], 0)
    assert ear.slow[SLEEVES_MAIN].means_m_s == pytest.approx((0.05, -0.04))
    assert ear.slow[SLEEVES_MAIN].values == pytest.approx((900e-6, -300e-6))
    assert ear.slow[SLEEVES_MAIN].speeds_m_s == pytest.approx((0.1, -0.2))


def test_pressures_and_the_clutch() -> None:
    ear = GuardReceiver()
    assert ear.take([frame(SENSORS, 0, 5, {7: 3, 9: 50_000, 13: 2_500})], 0) == [5]
    assert ear.slow[SENSORS].values == pytest.approx((60.0, 1e6, 0.25))
    assert ear.clutch == [(5, 0.25)]
    assert ear.take([frame(SENSORS, 1, 6, {13: 10_000})], 0) == [6]
    assert ear.clutch == [(6, 1.0)]
    assert ear.take([frame(SENSORS, 2, 7, {13: 10_001})], 0) == []
    assert ear.take([], 0) == []
    assert ear.clutch == []


def edges_frame(counter: int, shape: int, stamp: int = 9, index: int = 500) -> Frame:
    words = {7: index} | {10 + 2 * k: 1_000 - k for k in range(27)}
    data = bytearray(frame(MAIN_EDGES, counter, stamp, words).data)
    data[9] = shape
    write_crc(data, DATA_IDS[MAIN_EDGES], increment_counter=False)
    return Frame(MAIN_EDGES, bytes(data), is_fd=True)


@pytest.mark.parametrize(
    ("shape", "count"),
    [(27, 27), (0, 0), (5, 5), (28, None), (31, None), (27 | 0x20, 0), (27 | 0x40, 0),
     (27 | 0x80, 0)],
)  # fmt: skip
def test_edges_are_used_where_all_of_them_can_be_placed(shape: int, count: int | None) -> None:
    ear = GuardReceiver()
    found = ear.take([edges_frame(0, shape)], 0)
    assert found == ([] if count is None else [9])
    lows = tuple(1_000 - k for k in range(count or 0))
    assert ear.edges[MAIN_EDGES] == ([] if count is None else [Edges(9, 500, lows)])
    assert ear.edges[LAYSHAFT_EDGES] == []
    ear.take([], 0)
    assert ear.edges[MAIN_EDGES] == []


def test_an_ear_begins_with_nothing() -> None:
    ear = GuardReceiver()
    assert (ear.edges, ear.engine, ear.clutch, ear.requested_gear) == ({}, [], [], None)
    assert not ear.has_restarted
    ear.take([edges_frame(0, 0)], 0)
    assert not ear.has_restarted  # no array has got emptier


def test_sensors_have_started_anew_where_an_array_gets_emptier() -> None:
    ear, found = GuardReceiver(), []
    for counter, shape in enumerate((3, 3, 5, 5 | 0x20, 4, 4)):
        ear.take([edges_frame(counter, shape)], 0)
        found.append(ear.has_restarted)
    assert found == [False, False, False, False, True, False]
    ear.take([edges_frame(6, 2), edges_frame(7, 2)], 0)
    assert ear.has_restarted  # once reported in a step it stays reported
    ear.take([], 0)
    assert not ear.has_restarted


@pytest.mark.parametrize(("shape", "stamp"), [(2, 60), (4, 40)])
def test_edges_of_a_step_from_before_the_sensors_started_anew_are_left_out(
    shape: int, stamp: int
) -> None:
    """They are told by an array that got emptier, or by a time that went back."""
    ear = GuardReceiver()
    ear.take([edges_frame(0, 3, 30)], 0)
    ear.take([edges_frame(1, 4, 50), edges_frame(2, shape, stamp), edges_frame(3, 5, 70)], 0)
    assert [edges.time_us for edges in ear.edges[MAIN_EDGES]] == [stamp, 70]


def test_a_clock_has_been_set_back_where_a_stamp_is_before_the_last_of_its_message() -> None:
    ear = GuardReceiver()
    two = [frame(SENSORS, 0, 100), frame(VALVE_STATUS, 0, 50)]
    assert ear.take(two, 0) == [100, 50]  # each has its own
    assert not ear.has_restarted
    assert ear.take([frame(VALVE_STATUS, 1, 60), frame(SENSORS, 1, 100)], 0) == [60, 100]
    assert not ear.has_restarted
    assert ear.take([frame(VALVE_STATUS, 2, 70), frame(SENSORS, 2, 99)], 0) == [99]
    assert ear.has_restarted


@pytest.mark.parametrize("back_us", [0, 7, 20_000])
def test_times_go_on_where_their_32_bits_begin_anew(back_us: int) -> None:
    """Those of a step may go back and forth over it, each message's own only on."""
    ear, turn = GuardReceiver(), 1 << 32
    assert ear.take([frame(SENSORS, 0, turn - 6)], 0) == [turn - 6]
    heard = ear.take([frame(SENSORS, 1, 4), frame(VALVE_STATUS, 0, turn - 6 - back_us)], 0)
    assert heard == [turn + 4, turn - 6 - back_us]
    assert not ear.has_restarted
    assert ear.take([frame(SENSORS, 2, turn - 6)], 0) == [turn - 6]
    assert ear.has_restarted


def j1939(can_id: int, **at: int) -> Frame:
    data = bytearray(b"\xff" * 8)
    for name, value in at.items():
        data[int(name[1:])] = value
    return Frame(can_id, bytes(data), is_fd=False)


def test_the_engine_and_the_gear_asked_for() -> None:
    """0.125 rpm and 1 % a step; from FB00 and FB on there is no value."""
    ear, rpm = GuardReceiver(), math.pi / 30.0
    ear.take([j1939(ENGINE, b3=0x00, b4=0x10, b2=125 + 40), j1939(GEAR_REQUEST, b2=125 + 10)], 0)
    assert ear.engine == [(pytest.approx(512.0 * rpm), pytest.approx(0.4))]
    assert ear.requested_gear == 10
    ear.take([j1939(ENGINE, b3=0xFF, b4=0xFA, b2=0xFA), j1939(GEAR_REQUEST, b2=0xFA)], 0)
    assert ear.engine == [(pytest.approx(64_255 * 0.125 * rpm), pytest.approx(1.25))]
    assert ear.requested_gear == 125
    ear.take([j1939(ENGINE, b3=0x00, b4=0xFB, b2=0xFB), j1939(GEAR_REQUEST, b2=0xFB)], 0)
    assert ear.engine == [(None, None)]
    assert ear.requested_gear is None
    for odd in (
        {"is_fd": True},
        {"data": bytes(7)},
        {"is_extended": False},
        {"can_id": 0x18FEF100},
    ):
        ear.take([j1939(ENGINE)._replace(**odd), j1939(GEAR_REQUEST, b2=130)._replace(**odd)], 0)
        assert (ear.engine, ear.requested_gear) == ([], None)
    ear.take([j1939(GEAR_REQUEST, b2=130)], 0)
    ear.take([], 0)
    assert ear.requested_gear is None  # of one step


def test_what_the_guard_sees_before_it_has_heard_of_engine_clutch_or_request() -> None:
    seen = GuardInputs(1, (0.0,) * 4, 0.0, 0.0, 0.0, (None,) * 4, 0, True)
    rest: Any = seen[8:]
    assert rest == (None, None, 0, 0, (0.0, 0.0), 0, None, 0.0, 0, False, True, (), (None, None),
                    (0.0, 0.0), None, False)  # fmt: skip
