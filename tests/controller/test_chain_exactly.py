"""Frames of one polarity to numbered edges, by hand: what a sensor's array says, frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from meshpoint.controller.records import Integers, RecordMemory
from meshpoint.controller.sensing.chain_kernels import (
    BROKEN,
    CHAIN,
    chain_edges,
    newest_teeth,
    pack_frame,
)

READ = (7 << 16) + 40_000
"""Of the first frame: its low 16 bits are 40,000."""


class Sensor:
    """One polarity: what was made of its frames. Times are told from the first read on."""

    def __init__(self) -> None:
        self.chain = RecordMemory(CHAIN)
        self.rows = np.full((2, 120), -1, np.int64)
        self.count = 0

    def take(
        self,
        newest: int,
        times: list[int],
        read: int = 0,
        long: bool = False,
        stopped: bool = False,
    ) -> int:
        """Times of the newest edges, newest first. The new edges, or BROKEN."""
        low = [(READ + each) & 0xFFFF for each in times] + [0] * (27 - len(times))
        pack_frame(self.chain.flat.data, 0, newest & 0xFFFF, len(times), long, stopped,
                   READ + read, *low)  # fmt: skip
        found = int(chain_edges(self.chain.flat, self.rows, self.count))
        if found == BROKEN:
            return BROKEN
        new, self.count = found - self.count, found
        return new

    def edges(self) -> dict[int, int]:
        """Times by number."""
        numbers, times = self.rows[:, : self.count]
        assert (np.diff(times) > 0).all()
        return dict(zip(numbers.tolist(), (times - READ).tolist(), strict=True))


def every_ms(newest: int, count: int) -> list[int]:
    """A tooth a millisecond, number 0 at -30 ms: the newest so many, newest first."""
    return [-30_000 + 1000 * (newest - k) for k in range(count)]


def test_a_full_frame_is_believed_as_a_whole() -> None:
    sensor = Sensor()
    assert sensor.take(30, every_ms(30, 27)) == 27
    assert sensor.edges() == {k: -30_000 + 1000 * k for k in range(4, 31)}


def test_of_a_sensor_that_has_just_begun_the_first_nine_edges_are_left_out() -> None:
    """Seven in the first frame, two in the next; what comes then is believed."""
    sensor = Sensor()
    assert sensor.take(6, every_ms(6, 7), -24_000) == 0
    assert sensor.take(11, every_ms(11, 12), -19_000) == 3
    assert sensor.edges() == {9: -21_000, 10: -20_000, 11: -19_000}
    assert sensor.take(13, every_ms(13, 14), -17_000) == 2
    twelve = Sensor()
    assert twelve.take(11, every_ms(11, 12), -19_000) == 3
    assert sorted(twelve.edges()) == [9, 10, 11]


def test_a_frame_of_26_edges_is_of_a_sensor_that_has_just_begun() -> None:
    sensor = Sensor()
    assert sensor.take(26, every_ms(26, 26)) == 17


def test_edges_are_appended_once_each_behind_those_that_wait() -> None:
    sensor = Sensor()
    sensor.take(30, every_ms(30, 27), 500)
    assert sensor.take(30, every_ms(30, 27), 900) == 0
    assert sensor.take(32, every_ms(32, 27), 2_500) == 2
    assert sensor.take(57, every_ms(57, 27), 27_500) == 25
    assert sensor.edges() == {k: -30_000 + 1000 * k for k in range(4, 58)}


def test_numbers_go_on_where_the_sensor_s_sixteen_bits_begin_anew() -> None:
    sensor = Sensor()
    sensor.take(0xFFFE, [0, *range(-1000, -27_000, -1000)])
    assert (
        sensor.take(0x10002, [4000, 3000, 2000, 1000, 0, *range(-1000, -23_000, -1000)], 4_000) == 4
    )
    assert [number for number in sensor.edges() if number > 0xFFFE] == [
        0xFFFF + k for k in range(4)
    ]


def test_times_go_on_where_a_stamp_s_sixteen_bits_begin_anew() -> None:
    """The newest is at most as old as the 16 bits reach, and none is later than the read."""
    sensor = Sensor()
    times = [-65_000, *(-65_000 - 1000 * k for k in range(1, 27))]
    assert sensor.take(30, times) == 27
    assert list(sensor.edges().values()) == times[::-1]


@pytest.mark.parametrize(("new", "is_known"), [(26, True), (27, True), (28, False)])
def test_more_new_edges_than_a_frame_holds_break_the_chain(new: int, is_known: bool) -> None:
    sensor = Sensor()
    sensor.take(30, every_ms(30, 27), 500)
    newest = 30 + new
    found = sensor.take(newest, every_ms(newest, 27), 1000 * new + 500)
    assert found == (new if is_known else BROKEN)


@pytest.mark.parametrize(("new", "is_known"), [(26, True), (27, False)])
def test_a_frame_of_new_edges_alone_must_have_no_long_interval(new: int, is_known: bool) -> None:
    """With one edge that is known the chain is seen to lead to it."""
    sensor = Sensor()
    sensor.take(30, every_ms(30, 27), 500)
    newest = 30 + new
    found = sensor.take(newest, every_ms(newest, 27), 1000 * new + 500, long=True)
    assert found == (new if is_known else BROKEN)


def test_a_chain_that_does_not_lead_to_the_last_edge_is_broken_and_begins_anew() -> None:
    sensor = Sensor()
    sensor.take(30, every_ms(30, 27), 500)
    shifted = [each + 7 for each in every_ms(32, 27)]
    assert sensor.take(32, shifted, 2_500) == BROKEN
    assert sensor.count == 27
    assert sensor.take(33, every_ms(33, 27), 3_500) == 27


def test_a_wheel_that_has_stopped_breaks_its_chain_once() -> None:
    """Before anything was known there is nothing to lose."""
    sensor = Sensor()
    assert sensor.take(30, every_ms(30, 27), 90_000, stopped=True) == 0
    assert sensor.take(30, every_ms(30, 27)) == 27
    assert sensor.take(31, every_ms(31, 27), 90_000, stopped=True) == BROKEN
    assert sensor.take(31, every_ms(31, 27), 95_000, stopped=True) == 0


def test_a_wheel_that_has_stopped_since_its_last_edge_has_lost_nothing_yet() -> None:
    """Its next edge will show it."""
    sensor = Sensor()
    sensor.take(30, every_ms(30, 27))
    assert sensor.take(30, every_ms(30, 27), 90_000, stopped=True) == 0


def test_with_a_long_interval_the_first_frame_places_its_newest_edge_alone() -> None:
    sensor = Sensor()
    assert sensor.take(30, every_ms(30, 27), 500, long=True) == 1
    assert sensor.edges() == {30: 0}
    assert sensor.take(31, every_ms(31, 27), 1_500, long=True) == 1


def test_a_frame_without_an_edge_says_nothing() -> None:
    sensor = Sensor()
    assert sensor.take(5, []) == 0
    assert sensor.take(30, every_ms(30, 27)) == 27
    assert sensor.take(31, []) == 0
    assert sensor.take(31, every_ms(31, 27), 1_000) == 1


def test_slow_teeth_are_chained_by_all_sixteen_bits() -> None:
    """20,001 us each; and numbers by all of theirs: a jump of 16,386 is no two edges."""
    sensor = Sensor()
    times = [-20_001 * k for k in range(27)]
    assert sensor.take(30, times, 100) == 27
    assert list(sensor.edges().values()) == times[::-1]
    later = [40_002 - 20_001 * k for k in range(27)]
    assert sensor.take(32, later, 40_100) == 2
    assert list(sensor.edges().values())[-2:] == [20_001, 40_002]
    assert sensor.take(32 + 16_386, [each + 40_002 for each in later], 80_100) == BROKEN
    assert BROKEN < 0, "no count is"


def low_bits(intervals: list[int]) -> Integers:
    """Newest first, by the time from each to the one before; over the end of the 16 bits."""
    times = 1_000 - np.concatenate(([0], np.cumsum(intervals)))
    return np.concatenate((times & 0xFFFF, np.zeros(27, np.int64)))[:27].astype(np.int64)


@pytest.mark.parametrize(
    ("intervals", "found"),
    [
        ([1000] * 26, (15_000, 15)),
        ([4000] * 5, (16_000, 4)),
        ([5000, 5000, 5000, 5000], (15_000, 3)),
        ([7000], (7_000, 1)),
        ([1000, 1690], (2_690, 2)),
        ([1000, 1710], (0, 0)),
        ([1690, 1000], (2_690, 2)),
        ([1710, 1000], (0, 0)),
        ([16_000, 9_000], (0, 0)),
        ([16_000, 9_500], (16_000, 1)),
        ([9_000, 9_000, 16_000], (0, 0)),
        ([1000, 1000, 2000, 1000], (0, 0)),
        ([0], (0, 0)),
        ([1], (1, 1)),
        ([20_001, 20_001], (20_001, 1)),
    ],
)
def test_a_speed_is_over_15_ms_or_all_there_is_of_even_intervals(
    intervals: list[int], found: tuple[int, int]
) -> None:
    """Even: neighbours within a factor of 1.7, that before the last one taken among them."""
    assert newest_teeth(low_bits(intervals), len(intervals) + 1) == found


def test_without_an_edge_there_is_no_speed() -> None:
    assert newest_teeth(low_bits([1000] * 5), 0) == (0, 0)
    assert newest_teeth(low_bits([1000] * 5), 1) == (0, 0)
