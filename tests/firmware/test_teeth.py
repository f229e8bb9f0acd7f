"""The image `teeth`: what a rig says of its shafts is on the pins, and a sensor board reads it."""

from __future__ import annotations

import random
from bisect import bisect
from collections.abc import Callable, Iterable
from itertools import pairwise

import pytest
from firmware_bench import AT_REST, WRAP, emulated_board
from teeth_chain import (
    CHANNEL_OF,
    DELAY_US,
    FOUND_US,
    READ_US,
    Comparison,
    Timed,
    TwoBoards,
    edges_of,
    read_back,
    reads,
    shifts,
)

from meshpoint.dbc.e2e import write_crc
from meshpoint.dbc.frame import Frame
from meshpoint.firmware.build import CROSS_COMPILERS
from meshpoint.firmware.native_board import CHANNELS, NativeBoard

SLEW = 450e-6
"""200 ppm by which the clocks may drift, and 250 by which they are followed."""
SECOND_US = 1_000_000
STEP_S = 0.004
"""In which the run-up's speed is changed; the first one is over 1 ms after power-on."""
START_US = WRAP - 2 * SECOND_US
LAST = 4 * CHANNELS
"""Frames of four reads."""
AT_THE_CHANGE = 4
"""From run-up to rig, a pin may show one edge more than was reported, or one less."""
TOP_EDGES_S = [2.0 * 18.5 * each for each in (40, 43 * 35 / 37, 45, 42)]
"""1,110 rpm in gear 12: what docs/firmware.md promises of the run-up."""


@pytest.fixture(scope="module")
def rig() -> list[Timed]:
    """The edge frames of three shifts on a loaded bus. The rig's clock wraps in them."""
    frames = [
        each for each in shifts(seed=3, count=3, bus_load=0.8) if each[1].can_id in CHANNEL_OF
    ]
    times_us = [read.read_us for read in reads(frame for _, frame in frames)]
    assert times_us[0] < WRAP < times_us[-1]
    return frames


@pytest.fixture
def boards(built: bytes, teeth_built: bytes) -> TwoBoards:
    """Their clock wraps 2 s after power-on."""
    return TwoBoards(NativeBoard(teeth_built), NativeBoard(built), start_us=START_US)


def played(
    boards: TwoBoards, rig: list[Timed], heard: Iterable[Timed], ppm: float = 0.0
) -> list[Comparison]:
    """What came of the rig's edges where the boards hear these frames."""
    boards.hear(heard, ppm)
    boards.advance_by(2 * DELAY_US)
    return read_back(rig, boards, ppm)


def missed(channels: list[Comparison], least: int = 500) -> int:
    """How many edges were not read; none was read that the rig did not report."""
    assert not any(channel.extra for channel in channels)
    assert all(len(channel.pairs) > least for channel in channels)
    return sum(len(channel.missed) for channel in channels)


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 200.0])
def test_a_sensor_board_reads_every_interval_that_the_rig_reported(
    boards: TwoBoards, rig: list[Timed], ppm: float
) -> None:
    """Wheels out of round, teeth out of place, all of a shift: to 1 us, and what the clocks do."""
    channels = played(boards, rig, rig, ppm)
    assert missed(channels) == 0
    assert abs(boards.not_shown) <= AT_THE_CHANGE
    for channel in channels:
        assert len({reported_us for reported_us, _ in channel.intervals_us}) > 100
        for reported_us, read_us in channel.intervals_us:
            assert abs(read_us - reported_us) <= 1 + SLEW * reported_us
        (from_us, first_us), (to_us, last_us) = channel.pairs[0], channel.pairs[-1]
        drift_us = ppm * 1e-6 * (to_us - from_us)
        assert last_us - to_us == pytest.approx(first_us - from_us + drift_us, abs=300.0)


def test_a_frame_that_is_lost_costs_no_edge(boards: TwoBoards, rig: list[Timed]) -> None:
    """Each third one of a channel, but for the last reads: the next one says it again, in time."""
    heard = [each for place, each in enumerate(rig[:-LAST]) if place // CHANNELS % 3 != place % 3]
    assert len(heard) < 0.7 * len(rig)
    assert missed(played(boards, rig, heard + rig[-LAST:])) == 0


def test_after_a_gap_of_any_length_no_pulse_is_late_or_upside_down(
    boards: TwoBoards, rig: list[Timed]
) -> None:
    """One frame in ten is lost besides; of the last reads none, so that all is reported."""
    rng, heard, from_us = random.Random(1), [], 0.0
    for time_us, frame in rig[:-LAST]:
        if time_us > from_us + 300_000.0:
            from_us = time_us + rng.uniform(20_000.0, 150_000.0)
        if time_us >= from_us and rng.random() > 0.1:
            heard.append((time_us, frame))
    late = missed(played(boards, rig, heard + rig[-LAST:]))
    assert late > 0
    assert abs(boards.not_shown - late) <= AT_THE_CHANGE


@pytest.mark.parametrize("until_us", [2_035_000, 2_045_000, 2_200_000])
def test_what_is_held_up_too_long_is_counted_and_not_shown_in_a_bunch(
    boards: TwoBoards, rig: list[Timed], until_us: int
) -> None:
    held = [(until_us if 2_000_000 < time_us < until_us else time_us, frame)
            for time_us, frame in rig]  # fmt: skip
    late = missed(played(boards, rig, held))
    assert late > 0
    assert abs(boards.not_shown - late) <= AT_THE_CHANGE


def test_after_a_gap_a_slow_wheels_older_edges_are_not_taken_for_new(
    built: bytes, teeth_built: bytes
) -> None:
    """A stamp has 16 bits: an edge of 80 ms ago looks like one of 14 ms ago. The rig's clock is
    15 ms before the boards', as near as two that are switched on together may be."""
    boards = TwoBoards(NativeBoard(teeth_built), NativeBoard(built))
    source, rig = NativeBoard(built), []
    source.power_on(15_000)
    for read_us in range(READ_US, 3_800_000, READ_US):
        source.advance(READ_US)
        for channel in range(CHANNELS):
            source.capture(channel, [read_us + 6_000 + channel % 2 * 5_000])
        source.read(AT_REST)
        rig += [(read_us, frame) for frame in source.take_sent() if frame.can_id in CHANNEL_OF]
    heard = [each for each in rig if each[0] < 1_500_000 or each[0] % 300_000 > 100_000]
    late = missed(played(boards, rig, heard), least=100)
    assert late > 0
    assert abs(boards.not_shown - late) <= AT_THE_CHANGE


def lying(frame: Frame, **changes: object) -> Frame:
    """The frame with its newest edge 4 us off, protected as such a frame of the rig's would be."""
    false = frame._replace(**changes)  # type: ignore[arg-type]
    data = bytearray(false.data)
    data[10] ^= 4
    write_crc(data, 0x4D00 | false.can_id >> 8 & 0xFF, increment_counter=False)
    return false._replace(data=bytes(data))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda frame: frame._replace(data=lying(frame).data[:3] + frame.data[3:]),
        lambda frame: frame._replace(data=frame.data[:3] + lying(frame).data[3:]),
        lambda frame: lying(frame, data=frame.data[:-4]),
        lambda frame: lying(frame, is_fd=False),
        lambda frame: lying(frame, is_extended=False),
        lambda frame: lying(frame, can_id=frame.can_id + 1),
        lambda frame: lying(frame, can_id=frame.can_id + 0x800),
    ],
    ids=["CRC", "content", "short", "classic", "11 bits", "another sender", "another message"],
)
def test_a_frame_that_is_not_the_rigs_is_not_played(
    boards: TwoBoards, rig: list[Timed], spoil: Callable[[Frame], Frame]
) -> None:
    """One in eight comes after a false one, and again: neither is played."""
    heard = []
    for place, (time_us, frame) in enumerate(rig):
        is_one = place % CHANNELS == place // CHANNELS % CHANNELS
        heard += [(time_us, each) for each in ([spoil(frame), frame] * is_one + [frame])]
    channels = played(boards, rig, heard)
    assert missed(channels) == 0
    assert all(abs(a - b) <= 1 for each in channels for a, b in each.intervals_us)


def test_a_rig_that_is_started_anew_is_found_like_the_first(
    boards: TwoBoards, rig: list[Timed]
) -> None:
    """Another clock, indices and counters, without a pause."""
    begun_us = 1_500_000
    boards.hear(each for each in rig if each[0] < begun_us)
    anew = [(begun_us + time_us, frame) for time_us, frame in rig]
    boards.hear(anew)
    boards.advance_by(2 * DELAY_US)
    assert missed(read_back(anew, boards, from_us=begun_us + 2 * FOUND_US)) == 0


def test_a_rig_whose_clock_jumps_ahead_is_found_by_the_next_second(
    boards: TwoBoards, rig: list[Timed]
) -> None:
    """Until then its edges are of the far future, for which no pin waits."""
    ahead = [(time_us - 2 * SECOND_US, frame) for time_us, frame in rig if time_us > 3_500_000]
    boards.hear(each for each in rig if each[0] < ahead[0][0])
    boards.hear(ahead)
    boards.advance_by(2 * DELAY_US)
    assert missed(read_back(ahead, boards, from_us=2_200_000), least=50) == 0


PINS = (("A", 0), ("A", 1), ("B", 10), ("B", 11))


@pytest.mark.parametrize("by", CROSS_COMPILERS)
def test_the_emulated_board_switches_its_pins_when_the_native_one_does(
    boards: TwoBoards, rig: list[Timed], by: str
) -> None:
    """The run-up of a second, and what a rig says in the next one."""
    emulated = emulated_board(by, "teeth")
    emulated.power_on(START_US)
    heard = [each for each in rig if each[0] < 2.2 * SECOND_US]
    for time_us, frame in heard:
        boards.hear([(time_us, frame)])
        emulated.advance(time_us - emulated.own_us)
        emulated.receive(frame)
    for pin, toggled_us in zip(PINS, boards.toggled_us, strict=True):
        assert len(toggled_us) > SECOND_US // 1_000
        assert [START_US + at_us for at_us, which, _ in emulated.outputs if which == pin] == (
            toggled_us
        )
    assert emulated.resets == 0


def since_power_on(toggled_us: list[int]) -> list[int]:
    return [each - START_US for each in toggled_us]


def between(times_us: list[int], from_us: int, to_us: int) -> int:
    """How many of them are."""
    return sum(from_us <= each < to_us for each in times_us)


def turned(time_s: float) -> float:
    """The integral of the run-up's speed as a share of the top's: 2 s up, 6 s at it, 2 s down."""
    if time_s <= 2.0:
        return time_s * time_s / 4.0
    return time_s - 1.0 if time_s <= 8.0 else 8.0 - turned(10.0 - time_s)


def test_without_a_rig_the_four_wheels_run_up_and_down_together(boards: TwoBoards) -> None:
    boards.advance(11 * SECOND_US)
    for toggled_us, edges_s in zip(boards.toggled_us, TOP_EDGES_S, strict=True):
        times_us = [each - DELAY_US for each in since_power_on(toggled_us)]
        for tenth in range(1, 101):
            expected = edges_s * turned(tenth / 10.0)
            assert bisect(times_us, tenth * 100_000) == pytest.approx(
                expected, abs=2.0 * STEP_S * edges_s
            )
        at_top = [b - a for a, b in pairwise(times_us) if 3_000_000 < a < 7_000_000]
        assert {round(1e6 / edges_s - each) for each in at_top} <= {-1, 0, 1}
        assert bisect(times_us, 10_010_000) == round(8.0 * edges_s)


def test_a_sensor_board_reads_the_run_up(boards: TwoBoards) -> None:
    boards.advance(7 * SECOND_US)
    reported = reads(boards.sent)
    for channel in range(CHANNELS):
        times_us = since_power_on(edges_of(channel, reported))
        edges = between(times_us, 4 * SECOND_US, 6 * SECOND_US)
        assert edges == pytest.approx(TOP_EDGES_S[channel // 2], abs=1.0)


def test_the_run_up_ends_with_a_rig_and_begins_anew_after_it(
    boards: TwoBoards, rig: list[Timed]
) -> None:
    heard = [(3 * SECOND_US + time_us, frame) for time_us, frame in rig if time_us < 2 * SECOND_US]
    boards.hear(heard)
    boards.advance(9 * SECOND_US)
    assert not any(channel.missed for channel in read_back(heard, boards, from_us=4_100_000))
    for toggled_us, edges_s in zip(boards.toggled_us, TOP_EDGES_S, strict=True):
        times_us = since_power_on(toggled_us)
        assert between(times_us, 2 * SECOND_US, 3 * SECOND_US) > 0.9 * edges_s
        assert between(times_us, 5_100_000, 6_000_000) == 0
        again = between(times_us, 6_000_000, 9_000_000)
        assert again == pytest.approx(edges_s * turned(2.97), rel=0.01)
