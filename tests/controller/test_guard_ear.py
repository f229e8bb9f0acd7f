"""The guard's ear, clock, speeds and view exactly at their limits, from raw bytes."""

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
    GuardEar,
    Slow,
)
from meshpoint.controller.guard.own_clock import GuardClock, signed_us
from meshpoint.controller.guard.own_speed import GuardSpeed, ShaftSpeed, TeethCounted, teeth_us
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


@pytest.mark.parametrize(("silent_us", "is_valid"), [(39_999, True), (40_000, False)])
def test_a_channel_is_lost_after_40_ms(silent_us: int, is_valid: bool) -> None:
    channel = Channel(16, DATA_IDS[SENSORS])
    for counter in range(3):
        channel.note(channel.passes(frame(SENSORS, counter), 70_000))
    assert not channel.passes(frame(SENSORS, 2), 90_000)  # repeated: nothing was heard
    channel.tick(70_000 + silent_us)
    assert channel.is_valid is is_valid


def test_a_channel_that_was_lost_needs_three_good_frames_again() -> None:
    ear = GuardEar()
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
        ear = GuardEar()
        for counter in range(3):
            ear.take([frame(each, counter) for each in needed if each != missing], 0)
        assert ear.hears_all is (missing is None)
    ear.take([frame(SLEEVES_AUX, 3, at={7: 2})], 0)  # the fault bits of its sensors
    assert not ear.hears_all
    ear.take([frame(SLEEVES_AUX, 4)], 0)
    assert ear.hears_all
    assert set(ear.slow) == set(needed)
    assert Slow(0, ()) == (0, (), False, (0.0, 0.0))


def test_frames_with_short_identifiers_are_of_somebody_else() -> None:
    ear = GuardEar()
    other = frame(SENSORS, 0)._replace(is_extended=False)
    assert ear.take([other], 0) == []
    assert ear.take([other, frame(SENSORS, 0, 7)], 0) == [7]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("byte", [8, 14, 28, 34])
def test_a_position_beyond_20_mm_is_none(byte: int, sign: int) -> None:
    """The newest of each sleeve, and the one 3 ms before it."""
    ear = GuardEar()
    assert ear.take([frame(SLEEVES_MAIN, 0, 5, {byte: sign * 20_000})], 0) == [5]
    assert ear.take([frame(SLEEVES_MAIN, 1, 6, {byte: sign * 20_001})], 0) == []
    assert ear.slow[SLEEVES_MAIN].stamp == 5
    for counter in range(2, 4):
        ear.take([frame(SLEEVES_MAIN, counter, 6, {byte: sign * 20_001})], 0)
    assert not ear.channels[SLEEVES_MAIN].is_valid


def test_a_sleeves_speed_is_taken_over_3_ms() -> None:
    ear = GuardEar()
    ear.take([frame(SLEEVES_MAIN, 0, 5, {8: 900, 14: 600, 28: -300, 34: 300})], 0)
    assert ear.slow[SLEEVES_MAIN].values == pytest.approx((900e-6, -300e-6))
    assert ear.slow[SLEEVES_MAIN].speeds_m_s == pytest.approx((0.1, -0.2))


def test_pressures_and_the_clutch() -> None:
    ear = GuardEar()
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
    ear = GuardEar()
    found = ear.take([edges_frame(0, shape)], 0)
    assert found == ([] if count is None else [9])
    lows = tuple(1_000 - k for k in range(count or 0))
    assert ear.edges[MAIN_EDGES] == ([] if count is None else [Edges(9, 500, lows)])
    assert ear.edges[LAYSHAFT_EDGES] == []
    ear.take([], 0)
    assert ear.edges[MAIN_EDGES] == []


def test_sensors_have_started_anew_where_an_array_gets_emptier() -> None:
    ear, found = GuardEar(), []
    for counter, shape in enumerate((3, 3, 5, 5 | 0x20, 4, 4)):
        ear.take([edges_frame(counter, shape)], 0)
        found.append(ear.has_restarted)
    assert found == [False, False, False, False, True, False]
    ear.take([edges_frame(6, 2), edges_frame(7, 2)], 0)
    assert ear.has_restarted  # once told in a step it stays told
    ear.take([], 0)
    assert not ear.has_restarted


def test_a_clock_has_been_set_back_where_a_stamp_is_before_the_last_of_its_message() -> None:
    ear = GuardEar()
    two = [frame(SENSORS, 0, 100), frame(VALVE_STATUS, 0, 50)]
    assert ear.take(two, 0) == [100, 50]  # each has its own
    assert not ear.has_restarted
    assert ear.take([frame(VALVE_STATUS, 1, 60), frame(SENSORS, 1, 100)], 0) == [60, 100]
    assert not ear.has_restarted
    assert ear.take([frame(VALVE_STATUS, 2, 70), frame(SENSORS, 2, 99)], 0) == [99]
    assert ear.has_restarted
    assert ear.take([frame(SENSORS, 3, (1 << 32) - 1)], 0) == [(1 << 32) - 1]
    assert ear.has_restarted
    assert ear.take([frame(SENSORS, 4, 5)], 0) == [5]  # over the wrap
    assert not ear.has_restarted


def j1939(can_id: int, **at: int) -> Frame:
    data = bytearray(b"\xff" * 8)
    for name, value in at.items():
        data[int(name[1:])] = value
    return Frame(can_id, bytes(data), is_fd=False)


def test_the_engine_and_the_gear_asked_for() -> None:
    """0.125 rpm and 1 % a step; from FB00 and FB on there is no value."""
    ear, rpm = GuardEar(), math.pi / 30.0
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


# -- clock ---------------------------------------------------------------------------------------


def clock_at(offset_us: int = 0, seconds: int = 1) -> GuardClock:
    """Heard a stamp each 10 ms since 0: the sensors' clock is the controller's, less this."""
    clock = GuardClock()
    for now_us in range(0, seconds * 1_000_000 + 1, 10_000):
        clock.hear((now_us - offset_us) % (1 << 32), now_us)
    return clock


def test_times_are_compared_the_shorter_way_round() -> None:
    half = 1 << 31
    assert [signed_us(x) for x in (0, 1, -1, half - 1, half, -half, 2 * half - 1)] == [
        0, 1, -1, half - 1, -half, -half, -1
    ]  # fmt: skip


@pytest.mark.parametrize(("back_us", "is_another"), [(20_000, False), (20_001, True)])
def test_a_stamp_20_ms_behind_the_newest_is_of_another_clock(
    back_us: int, is_another: bool
) -> None:
    clock = clock_at()
    clock.hear(1_000_000 - back_us, 1_000_000)
    assert clock.now_us(1_000_000) == (1_000_000 - back_us if is_another else 1_000_000)


@pytest.mark.parametrize(
    ("stamp", "now_us", "said_us"),
    [
        (1_500_000, 1_000_000, 1_500_000),  # ahead: what is heard least late is the clock
        (1_500_001, 1_000_000, 1_500_001),
        (1_100_000, 1_600_001, 1_600_001),  # late by more than 0.5 s, but it goes on
        (1_100_001, 1_600_002, 1_100_001),  # late by as much, and 100.001 ms on
        (1_100_001, 1_600_001, 1_600_001),  # by 0.5 s: late
    ],
)
def test_a_stamp_half_a_second_off_is_of_another_clock_unless_it_goes_on(
    stamp: int, now_us: int, said_us: int
) -> None:
    clock = clock_at()
    clock.hear(stamp, now_us)
    assert clock.now_us(now_us) == said_us


def test_a_stamp_far_ahead_clears_what_was_heard_before() -> None:
    clock = clock_at()
    clock.hear(1_500_001 + 10_000, 1_010_000)
    clock.hear(1_500_001 + 15_000, 1_020_000)  # later by 5 ms: nothing of before makes it less
    clock.hear(2_500_000 + 10_000, 2_010_000)
    assert clock.now_us(2_010_000) == 2_010_000 + 500_001


def test_each_seconds_least_is_kept_for_six_seconds_in_which_stamps_were_heard() -> None:
    clock = GuardClock()
    clock.hear(0, 0)
    for second in range(1, 6):
        for ms in (0, 990):
            now_us = second * 1_000_000 + 1_000 * ms
            clock.hear(now_us - 4_000 - 1_000 * (ms == 0), now_us)
    assert clock.now_us(5_999_999) == 5_999_999
    clock.hear(6_000_000 - 6_000, 6_000_000)  # the seventh second: the first is forgotten
    assert clock.now_us(6_000_000) == 6_000_000 - 4_000
    clock.restart()
    assert clock.now_us(6_000_000) is None
    clock.hear(6_010_000 - 9_000, 6_010_000)
    assert clock.now_us(6_010_000) == 6_010_000 - 9_000


# -- speeds --------------------------------------------------------------------------------------

TEETH = 40
PITCH = 2.0 * math.pi / TEETH


def lows(newest_us: int, *took_us: int) -> tuple[int, ...]:
    times = [newest_us]
    for each in took_us:
        times.append(times[-1] - each)
    return tuple(time & 0xFFFF for time in times)


def test_teeth_are_taken_for_15_ms() -> None:
    assert teeth_us(lows(99_000, *[5_000] * 9)) == [5_000] * 3
    assert teeth_us(lows(99_000, *[4_999] * 9)) == [4_999] * 4
    assert teeth_us(lows(99_000, 20_000, 20_000)) == [20_000]
    assert teeth_us(lows(99_000, 4_000)) == [4_000]
    assert teeth_us(lows(3_000, 4_000, 4_000)) == [4_000, 4_000]  # over the wrap of 16 bits


@pytest.mark.parametrize(
    ("took_us", "is_alike"),
    [((1_000, 1_699), True), ((1_000, 1_700), False), ((1_700, 1_001), True),
     ((1_700, 1_000), False), ((1_000, 0), False), ((0,), False), ((1_000, 1_699, 2_800), True)],
)  # fmt: skip
def test_neighbouring_teeth_do_not_differ_by_more_than_a_factor(
    took_us: tuple[int, ...], is_alike: bool
) -> None:
    assert teeth_us(lows(50_000, *took_us)) == (list(took_us) if is_alike else [])


def test_a_speed_is_the_mean_over_its_teeth_in_the_middle_of_their_time() -> None:
    shaft, now_us = GuardSpeed(TEETH), (5 << 32) + 70_000
    assert shaft.at(now_us) is None
    assert shaft.counted is None
    shaft.take(Edges((now_us - 500) & 0xFFFF_FFFF, 7, lows(now_us - 900, *[4_000] * 6)), now_us)
    found = shaft.at(now_us)
    assert found == ShaftSpeed(now_us - 900 - 8_000, pytest.approx(PITCH / 4e-3))
    assert shaft.counted == TeethCounted(now_us - 900, 7)


def test_teeth_are_counted_on_and_never_by_a_stamp_that_only_looks_young() -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(10_000, 65_534, lows(9_000, 4_000, 4_000)), 10_000)
    shaft.take(Edges(20_000, 3, lows(19_000, 4_000, 4_000)), 20_000)
    assert shaft.counted == TeethCounted(19_000, 65_534 + 5)
    shaft.take(Edges(90_000, 3, lows(19_000, 4_000, 4_000)), 90_000)  # 19 ms + 65.5 ms = 84.5 ms
    assert shaft.counted == TeethCounted(19_000, 65_534 + 5)
    assert shaft.at(90_000) is None
    shaft.take(Edges(91_000, 4, lows(90_500, 4_000, 4_000)), 91_000)
    assert shaft.counted == TeethCounted(90_500, 65_534 + 6)
    assert shaft.at(91_000) is not None


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_edges_are_no_speed(count: int) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(10_000, 5, lows(9_000, 4_000, 4_000)), 10_000)
    shaft.take(Edges(20_000, 5, lows(9_000)[:count]), 20_000)
    assert shaft.at(20_000) is None


@pytest.mark.parametrize(
    ("tooth_us", "silent_us", "is_dead"),
    [(4_000, 20_000, False), (4_000, 20_001, True), (8_000, 24_000, False), (8_000, 24_001, True)],
)
def test_a_sensor_is_dead_after_20_ms_or_three_teeth(
    tooth_us: int, silent_us: int, is_dead: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 5, lows(30_000, *[tooth_us] * 6)), 30_000)
    now_us = 30_000 + silent_us
    shaft.take(Edges(now_us, 5, lows(30_000, *[tooth_us] * 6)), now_us)
    assert (shaft.at(now_us) is None) is is_dead


@pytest.mark.parametrize(
    ("tooth_us", "silent_us", "is_lost"),
    [(4_000, 25_000, False), (4_000, 25_001, True), (9_000, 27_000, False), (9_000, 27_001, True)],
)
def test_a_shaft_without_frames_is_lost_after_25_ms_or_three_teeth(
    tooth_us: int, silent_us: int, is_lost: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 5, lows(30_000, *[tooth_us] * 6)), 30_000)
    assert (shaft.at(30_000 + silent_us) is None) is is_lost


@pytest.mark.parametrize(
    ("tooth_us", "held_us", "is_lost"),
    [(4_000, 45_000, False), (4_000, 45_001, True), (20_000, 60_000, False),
     (20_000, 60_001, True)],
)  # fmt: skip
def test_an_earlier_speed_stands_in_for_teeth_that_are_unlike(
    tooth_us: int, held_us: int, is_lost: bool
) -> None:
    shaft = GuardSpeed(TEETH)
    shaft.take(Edges(30_000, 5, lows(30_000, *[tooth_us] * 3)), 30_000)
    before = shaft.at(30_000)
    for now_us in (45_000, 30_000 + held_us):
        shaft.take(Edges(now_us, now_us // 1_000, lows(now_us, 1_000, 9_000)), now_us)
    assert before is not None
    assert shaft.at(30_000 + held_us) == (None if is_lost else before)


def test_what_the_guard_sees_before_it_has_heard_of_engine_clutch_or_request() -> None:
    seen = GuardInputs(1, (0.0,) * 4, 0.0, 0.0, 0.0, (None,) * 4, 0, True)
    rest: Any = seen[8:]
    assert rest == (None, None, 0, 0, (0.0, 0.0), 0, None, 0.0, 0)
