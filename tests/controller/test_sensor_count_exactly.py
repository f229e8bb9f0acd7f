"""By how many teeth a wheel was renumbered, from numbers that are told by hand.

The count of this wheel ends below a tooth in 10 ms."""

from __future__ import annotations

import pytest

from meshpoint.controller.sensing.sensor_count import Renumbered, SensorCount

LEAST = 1e-4
BEND = 1e-10
"""Half the acceleration, teeth/us2: from LEAST to a stop and back it takes a second."""


class Wheel:
    """A wheel's frames: both polarities' running numbers at a read, and what has a tooth."""

    def __init__(self, whole: bool = True) -> None:
        self.count = SensorCount(BEND, LEAST, whole)
        self.rises = self.falls = 0

    def read(self, time_us: int, rises: int, falls: int | None = None, stamps: int = 27) -> None:
        """So many new edges."""
        self.rises += rises
        self.falls += rises if falls is None else falls
        self.count.frame(False, self.rises & 0xFFFF, stamps, time_us)
        self.count.frame(True, self.falls & 0xFFFF, stamps, time_us)

    def told(self) -> Renumbered:
        return self.count.renumbered


def counting(whole: bool = True, rate: float = LEAST) -> Wheel:
    """Rising edge 1000 of the sensor is tooth 40; two newer edges wait."""
    wheel = Wheel(whole)
    wheel.read(0, 1002)
    wheel.count.counting(40, 2, 0, rate)
    return wheel


def test_a_wheel_that_is_seen_all_along_keeps_its_numbers() -> None:
    wheel = counting()
    for k in range(1, 5):
        wheel.read(10_000 * k, 3)
        wheel.count.counting(40 + 3 * k, 2, 10_000 * k, LEAST)
    assert wheel.told() == (0, 0, 0)
    assert not wheel.count.anew


def test_a_wheel_that_had_time_to_stop_may_have_turned_back_by_each_of_its_edges() -> None:
    """Ten edges later tooth 7 has the number that would have been 50: it had 43 more before, less
    two for each edge, and three to spare. From and to such a speed it takes a second."""
    wheel = counting()
    wheel.count.lost()
    wheel.read(20_000, 10)
    wheel.count.counting(7, 2, 1_000_000, LEAST)
    assert wheel.told() == (43 - 20 - 3, 43 + 3, 0)


def test_a_wheel_that_had_no_time_to_stop_has_turned_on() -> None:
    wheel = counting()
    wheel.count.lost()
    wheel.read(20_000, 10)
    wheel.count.counting(7, 2, 999_999, LEAST)
    assert wheel.told() == (40, 46, 0)


def test_a_dragged_wheel_stops_and_starts_at_once() -> None:
    wheel = counting()
    wheel.count.lost()
    wheel.count.dragged()
    wheel.read(20_000, 10)
    wheel.count.counting(7, 2, 20_000, LEAST)
    assert wheel.told() == (20, 46, 0)
    wheel.count.lost()
    wheel.read(30_000, 1)
    wheel.count.counting(8, 2, 30_000, LEAST)
    assert wheel.told() == (20 - 3, 46 + 3, 0), "it is dragged no more"


def test_the_speed_before_and_after_a_loss_says_how_long_a_stop_takes() -> None:
    """Twice as quick after it: a second and a half."""
    for time_us, least in ((1_499_999, 40), (1_500_000, 20)):
        wheel = counting()
        wheel.count.lost()
        wheel.read(20_000, 10)
        wheel.count.counting(7, 2, time_us, 2.0 * LEAST)
        assert wheel.told() == (least, 46, 0)


def test_losses_add_up() -> None:
    wheel = counting()
    for k in (1, 2):
        wheel.count.lost()
        wheel.read(1_000_000 * k - 999_000, 10)
        wheel.read(1_000_000 * k, 0)
        wheel.count.counting(40 + 10 * k - 5 * k, 2, 1_000_000 * k, LEAST)
    assert wheel.told() == (2 * (5 - 20 - 3), 2 * (5 + 3), 0)


def test_a_loss_that_is_not_over_counts_from_its_beginning() -> None:
    """Teeth that are lost again before they are numbered were known at the first loss."""
    wheel = counting()
    wheel.count.lost()
    wheel.read(20_000, 4)
    wheel.count.lost()
    wheel.read(30_000, 6)
    wheel.count.counting(7, 2, 1_000_000, LEAST)
    assert wheel.told() == (20, 46, 0)


def test_edges_that_wait_have_no_tooth_yet() -> None:
    """Five newer edges wait beside two before: tooth 47 is that of edge 1007."""
    wheel = counting()
    wheel.count.lost()
    wheel.read(20_000, 10)
    wheel.count.counting(47, 5, 20_000, LEAST)
    assert wheel.told() == (-3, 3, 0)


def test_teeth_that_begin_with_falling_edges_are_counted_by_these() -> None:
    wheel = Wheel()
    wheel.read(0, 1002, 800)
    wheel.count.counting(40, 2, 0, LEAST, turned=True)
    wheel.count.lost()
    wheel.read(20_000, 9, 10)
    wheel.count.counting(47, 2, 1_000_000, LEAST, turned=True)
    assert wheel.told() == (3 - 20 - 3, 3 + 3, 0)


@pytest.mark.parametrize(("falls", "uncounted"), [(13, 0), (7, 0), (14, 1), (6, 1)])
def test_polarities_that_have_counted_apart_by_more_than_three_bound_nothing(
    falls: int, uncounted: int
) -> None:
    wheel = counting()
    wheel.count.lost()
    wheel.read(20_000, 10, falls)
    wheel.count.counting(50, 2, 20_000, LEAST)
    assert wheel.told() == (-3, 3, uncounted)


@pytest.mark.parametrize(("rate", "uncounted"), [(1.49 * LEAST, 0), (1.5 * LEAST, 1)])
def test_a_loss_at_speed_is_of_a_blind_sensor_that_has_not_counted(
    rate: float, uncounted: int
) -> None:
    wheel = counting(rate=rate)
    wheel.count.lost()
    assert wheel.told() == (0, 0, uncounted)


@pytest.mark.parametrize(("gap_us", "uncounted"), [(50_000, 1), (50_001, 0)])
def test_where_frames_were_lost_the_sensor_has_counted_on(gap_us: int, uncounted: int) -> None:
    """More than four in a row; shorter gaps do not add up."""
    wheel = counting(rate=2.0 * LEAST)
    wheel.read(gap_us, 3)
    wheel.read(gap_us + 10_000, 3)
    wheel.count.lost()
    assert wheel.told() == (0, 0, uncounted)


def test_a_gap_of_frames_is_over_when_the_wheel_is_counted_again() -> None:
    wheel = counting(rate=2.0 * LEAST)
    wheel.read(60_000, 3)
    wheel.count.counting(43, 2, 60_000, 2.0 * LEAST)
    wheel.count.lost()
    assert wheel.told() == (0, 0, 1)


def test_nothing_is_bound_on_a_wheel_with_missing_teeth_nor_before_any_was_known() -> None:
    wheel = counting(whole=False)
    wheel.count.lost()
    assert wheel.told() == (0, 0, 1)
    new = Wheel()
    new.read(0, 30)
    new.count.lost()
    assert new.told() == (0, 0, 1)
    new.count.counting(7, 0, 10_000, LEAST)
    assert new.told() == (0, 0, 1)


@pytest.mark.parametrize(("gap_us", "uncounted"), [(5_000_000, 0), (5_000_001, 1)])
def test_after_five_seconds_without_a_frame_the_sixteen_bits_may_have_gone_round(
    gap_us: int, uncounted: int
) -> None:
    """Each polarity says so."""
    wheel = counting()
    wheel.read(gap_us, 3)
    assert wheel.told() == (0, 0, 2 * uncounted)


def test_the_sensor_s_numbers_go_on_over_their_sixteen_bits() -> None:
    wheel = Wheel()
    wheel.read(0, 0xFFF0)
    wheel.read(10_000, 5)
    wheel.count.counting(40, 0, 10_000, LEAST)
    wheel.count.lost()
    wheel.read(20_000, 30)
    wheel.count.counting(70, 0, 1_010_000, LEAST)
    assert wheel.told() == (-60 - 3, 3, 0)


def test_an_array_that_gets_emptier_is_that_of_a_sensor_that_has_begun_anew() -> None:
    wheel = Wheel()
    wheel.read(0, 5, stamps=5)
    wheel.read(10_000, 3, stamps=8)
    wheel.read(20_000, 0, stamps=8)
    assert not wheel.count.anew
    wheel.count.counting(8, 0, 20_000, LEAST)
    wheel.count.frame(True, 2, 7, 30_000)
    anew = [wheel.count.anew]
    wheel.count.restart()
    assert [*anew, wheel.count.anew] == [True, False]
    assert wheel.told() == (0, 0, 1)
    wheel.count.frame(True, 9, 9, 40_000)
    wheel.count.frame(False, 9, 9, 40_000)
    wheel.count.counting(3, 0, 40_000, LEAST)
    assert wheel.told() == (0, 0, 1), "what was before it is of no account"


def test_renumbered_begins_with_nothing() -> None:
    assert Renumbered() == (0, 0, 0)


def test_a_wheel_that_turned_on_by_many_teeth_is_counted_by_all_sixteen_bits() -> None:
    """However late it is: a stop takes a second, and here is none."""
    wheel = Wheel()
    wheel.read(90_000_000, 1002)
    wheel.count.counting(40, 2, 90_000_000, LEAST)
    wheel.count.lost()
    wheel.read(90_020_000, 20_000)
    wheel.count.counting(20_040, 2, 90_500_000, LEAST)
    assert wheel.told() == (-3, 3, 0)


def test_a_sensor_that_has_seen_no_edge_yet_has_not_begun_anew() -> None:
    wheel = Wheel()
    wheel.read(0, 0, stamps=0)
    assert not wheel.count.anew
