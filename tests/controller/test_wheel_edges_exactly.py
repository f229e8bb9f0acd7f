"""A wheel read by read: what it says of itself beside its edges, and what makes it forget."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from wheel import Wheel

from meshpoint.controller.sensing.sensor_clock import SensorClockEstimate
from meshpoint.controller.sensing.wheel_edges import EdgeBatch, Polarity, WheelEdges
from meshpoint.dbc.messages import EdgesMainFall, EdgesMainRise
from meshpoint.gearbox import load_sheet

TEETH, TOOTH_US, FALL_US = 45, 1_000, 400
BEGIN = 1_000_000


def steady(count: int, first: int = 100) -> Wheel:
    """A tooth a millisecond; the first falling edges are those of the first teeth."""
    rises = [BEGIN + TOOTH_US * k for k in range(count)]
    return Wheel(first, rises, [each + FALL_US for each in rises])


class Read:
    """A wheel of 45 teeth, duty 0.4, and its frames every 10 ms."""

    def __init__(self, missing: tuple[int, ...] = (), wheel: Wheel | None = None) -> None:
        self.edges = WheelEdges(TEETH, 0.4, missing)
        self.clock = SensorClockEstimate()
        self.wheel = wheel or steady(900)

    def at(self, ms: float, rise: bool = True, fall: bool = True) -> EdgeBatch:
        read_us = BEGIN + round(1000 * ms)
        rises = [self.wheel.rise(read_us)] if rise else []
        falls = [self.wheel.fall(read_us)] if fall else []
        return self.edges.read(rises, falls, self.clock, read_us)


def test_a_new_wheel_has_seen_nothing() -> None:
    edges = WheelEdges(TEETH, 0.4)
    assert edges.pitch_rad == pytest.approx(2.0 * math.pi / 45)
    assert tuple(edges.health) == (0, 0, 0, 0, False)
    assert (edges.broken, edges.newest, edges.begins_falling) == (0, None, False)
    assert edges.extra_us.tolist() == []
    batch = edges.read([], [], SensorClockEstimate(), 5)
    assert [each.size for each in batch] == [0] * 4
    assert edges.extra_us.tolist() == []


def test_edges_come_once_each_in_order_with_their_teeth() -> None:
    read = Read()
    first = read.at(45)
    assert first.time_us[-1] == BEGIN + 45_000
    assert first.tooth[-1] == 145
    newest = read.edges.newest
    assert newest is not None
    assert newest.time_us == BEGIN + 45_000
    assert newest.theta_rad == pytest.approx(145 * 2.0 * math.pi / 45)
    second = read.at(48)
    assert (second.time_us - BEGIN).tolist() == [45_400, 46_000, 46_400, 47_000, 47_400, 48_000]
    assert second.falling.tolist() == [1, 0, 1, 0, 1, 0]
    assert second.theta_rad * 45 / (2.0 * math.pi) == pytest.approx(
        [145.4, 146.0, 146.4, 147.0, 147.4, 148.0]
    )
    assert last_us(read) == BEGIN + 48_000
    assert tuple(read.edges.health) == (0, 0, 0, 0, True)
    none = read.at(48)
    assert none.time_us.size == 0
    assert last_us(read) == BEGIN + 48_000


def last_us(read: Read) -> int:
    newest = read.edges.newest
    assert newest is not None
    return newest.time_us


def test_a_wheel_of_the_sheet_is_that_wheel() -> None:
    sheet = load_sheet("truck12").wheels.layshaft
    edges = WheelEdges.of(sheet, 170.0)
    assert edges.pitch_rad == pytest.approx(2.0 * math.pi / sheet.teeth)
    assert edges._gate.part("duty_share")[0] == sheet.duty_share
    pitches = 170.0 / edges.pitch_rad
    assert edges._gate.part("least_rate_per_us")[0] == pytest.approx(
        math.sqrt(6.0 * pitches) * 1e-6
    )
    assert edges._gate.part("bend_per_us2")[0] == pytest.approx(150e-12 / edges.pitch_rad)
    plain = WheelEdges.of(replace(sheet, missing=(3, 4)))
    assert plain._gate.part("widest")[0] == 3
    least = math.sqrt(6.0 * 300.0 / edges.pitch_rad) * 1e-6
    assert plain._gate.part("least_rate_per_us")[0] == pytest.approx(least)


@pytest.mark.parametrize(("silent_ms", "stands"), [(65, False), (66, True)])
def test_a_wheel_without_an_edge_for_longer_than_a_stamp_reaches_stands(
    silent_ms: int, stands: bool
) -> None:
    """65,535 us, by the time of its frames."""
    read = Read(wheel=steady(46))
    read.at(45)
    read.at(46)
    assert read.edges.newest is not None
    newest_us = read.edges.newest.time_us
    assert newest_us == BEGIN + 45_400
    read.at(45 + silent_ms)
    read.at(45 + silent_ms)
    assert (read.edges.broken == 1) is stands
    assert (read.edges.newest is None) is stands
    assert tuple(read.edges.health) == (0, 0, 0, int(stands), not stands)


def test_a_wheel_that_is_not_read_does_not_stand() -> None:
    read = Read(wheel=steady(46))
    read.at(46)
    read.edges.read([], [], read.clock, BEGIN + 900_000)
    assert read.edges.broken == 0


def test_what_a_faulty_sensor_shows_is_no_edge_but_its_time_is_seen() -> None:
    read = Read()
    read.at(45)
    read_us = BEGIN + 55_000
    bad = replace_fault(read.wheel.rise(read_us))
    batch = read.edges.read([bad], [], read.clock, read_us)
    assert batch.time_us.size == 0
    assert read.clock.latest_us == read_us
    assert read.at(56).time_us.size > 0


def replace_fault(frame: EdgesMainRise) -> EdgesMainRise:
    return frame._replace(sensor_fault=True)


def test_an_extra_edge_is_told_by_its_time_till_the_next_read() -> None:
    rises = [BEGIN + TOOTH_US * k for k in range(80)]
    falls = [each + FALL_US for each in rises]
    noisy = sorted([*rises, BEGIN + 47_650])
    wheel = Wheel(100, noisy, falls)
    read = Read(wheel=wheel)
    read.at(45)
    read.at(55)
    assert read.edges.extra_us.tolist() == [BEGIN + 47_650]
    assert read.edges.health.extra == 1
    read.at(60)
    assert read.edges.extra_us.tolist() == []
    read.at(60)
    assert read.edges.extra_us.tolist() == []


def test_a_restart_forgets_numbers_and_counts_as_a_loss() -> None:
    read = Read()
    read.at(45)
    read.edges.restart()
    assert (read.edges.broken, read.edges.newest) == (1, None)
    assert not read.edges.health.counting
    assert read.edges.sensor.renumbered.uncounted == 1
    assert not read.edges.begins_falling
    batch = read.at(55)
    assert batch.time_us.size > 40


def test_a_sensor_that_has_begun_anew_restarts_the_wheel_and_the_clock() -> None:
    """Its array is emptier than before."""
    read = Read(wheel=steady(20))
    read.at(15)
    young = Wheel(7, [BEGIN + 25_000 + TOOTH_US * k for k in range(3)], [])
    read_us = BEGIN + 28_000
    batch = read.edges.read([young.rise(read_us)], [], read.clock, read_us)
    assert batch.time_us.size == 0
    assert (read.edges.broken, read.edges.newest) == (1, None)
    assert read.clock.jumps == 1
    assert not read.edges.sensor.anew


def test_falling_edges_alone_are_a_wheel_that_begins_with_them() -> None:
    """After ten of them. Teeth are numbered by them then; a tooth's rising edge is a duty on."""
    read = Read()
    assert read.at(9, rise=False).time_us.size == 0
    begins_falling = [read.edges.begins_falling]
    for ms in (19, 29, 39, 49, 59):
        batch = read.at(ms, rise=False)
    assert [*begins_falling, read.edges.begins_falling] == [False, True]
    assert set(batch.falling.tolist()) == {1}
    assert np.diff(batch.time_us) == pytest.approx(1000.0)
    assert np.diff(batch.theta_rad) == pytest.approx(2.0 * math.pi / 45)
    assert batch.theta_rad[0] * 45 / (2.0 * math.pi) % 1.0 == pytest.approx(0.4)
    read.edges.restart()
    assert read.edges.begins_falling


@pytest.mark.parametrize(("edges", "turned"), [(9, False), (10, True)])
def test_ten_edges_of_the_other_polarity_alone_turn_a_wheel(edges: int, turned: bool) -> None:
    wheel = Wheel(100, [], [BEGIN + TOOTH_US * k for k in range(9 + edges)])
    read = Read(wheel=wheel)
    read.at(8 + edges, rise=False)
    assert read.edges.begins_falling is turned


def test_a_dragged_wheel_is_told_so_till_it_is_not() -> None:
    edges = WheelEdges(TEETH, 0.4)
    edges.set_dragged(True)
    assert edges._gate.dragged[0] == 1
    assert edges.sensor._dragged
    edges.set_dragged(False)
    assert edges._gate.dragged[0] == 0


def test_edges_that_are_not_used_are_kept_in_front_of_the_next() -> None:
    """And there is always room for another frame's."""
    polarity, wheel = Polarity(), steady(400)
    assert polarity.take(wheel.rise(BEGIN + 40_000), BEGIN + 40_000)
    assert polarity.count == 27
    for k in range(1, 6):
        read_us = BEGIN + 40_000 + 20_000 * k
        assert polarity.take(wheel.rise(read_us), read_us)
    assert polarity.count == 27 + 5 * 20
    numbers = [number for number, _ in polarity.edges()]
    assert numbers == list(range(114, 241))
    polarity.use(120)
    assert polarity.edges() == [(number, BEGIN + 1000 * (number - 100)) for number in numbers[120:]]
    polarity.use(0)
    assert polarity.count == 7
    polarity.use(7)
    assert polarity.edges() == []


def test_a_polarity_whose_chain_is_broken_says_so_and_keeps_what_it_has() -> None:
    polarity, wheel = Polarity(), steady(400)
    assert polarity.take(wheel.rise(BEGIN + 40_000), BEGIN + 40_000)
    late = BEGIN + 90_000
    assert not polarity.take(wheel.rise(late), late)
    assert polarity.count == 27
    fall: EdgesMainFall = wheel.fall(late)
    assert fall.valid_stamps == 27


@pytest.mark.parametrize(("ms", "stands"), [(110.935, False), (110.936, True)])
def test_frames_of_one_polarity_show_that_a_wheel_stands(ms: float, stands: bool) -> None:
    """Its last edge was at 45.4 ms."""
    read = Read(wheel=steady(46))
    read.at(46)
    read.at(ms, fall=False)
    assert (read.edges.broken == 1) is stands


def test_a_loss_at_speed_is_not_bounded_by_the_sensor_s_count() -> None:
    """All frames came, and the wheel was quick."""
    read = Read(wheel=steady(46))
    for ms in range(46, 120, 10):
        read.at(ms)
    assert read.edges.broken == 1
    assert read.edges.sensor.renumbered.uncounted == 1


def test_a_wheel_s_teeth_are_told_to_its_sensor_s_count() -> None:
    """The first frame's rising edge is number none of the count, and tooth 145."""
    read = Read()
    for ms in (45, 55):
        read.at(ms)
        known = read.edges.sensor._last
        assert known is not None
        assert known.ahead == 145
        assert known.rises == ms - 45
        assert known.time_us == BEGIN + 1000 * ms
        assert known.rate == pytest.approx(1e-3)


def test_only_a_whole_wheel_s_count_is_bounded() -> None:
    assert WheelEdges(TEETH, 0.4).sensor._whole
    assert not WheelEdges(TEETH, 0.4, (3,)).sensor._whole


def test_a_shaft_that_is_not_dragged_is_not_said_to_have_been() -> None:
    edges = WheelEdges(TEETH, 0.4)
    edges.set_dragged(False)
    assert not edges.sensor._dragged


def test_a_read_without_an_edge_has_no_extra_one() -> None:
    """Nor has one at which the sensor turns out to have begun anew."""
    rises = [BEGIN + TOOTH_US * k for k in range(60)]
    wheel = Wheel(100, sorted([*rises, BEGIN + 47_650]), [each + FALL_US for each in rises])
    for again in (False, True):
        read = Read(wheel=wheel)
        read.at(45)
        read.at(55)
        assert read.edges.extra_us.size == 1
        if again:
            young = Wheel(7, [BEGIN + 65_000 + TOOTH_US * k for k in range(3)], [])
            at_us = BEGIN + 68_000
            read.edges.read([young.rise(at_us)], [], read.clock, at_us)
        else:
            read.at(55)
        assert read.edges.extra_us.size == 0


def test_falling_edges_are_not_alone_while_a_rising_one_waits_for_others() -> None:
    """Six, then a rising one, then twenty. The first nine of either polarity are not believed."""
    rises = [BEGIN + 5_000 + 10 * k for k in range(9)] + [BEGIN + 20_500]
    read = Read(wheel=Wheel(100, rises, [BEGIN + TOOTH_US * k for k in range(99)]))
    read.at(14, rise=False)
    read.at(21)
    for ms in (30, 41):
        read.at(ms, rise=False)
        assert not read.edges.begins_falling


def test_gaps_that_end_with_falling_edges_turn_a_wheel_after_two_of_them() -> None:
    """A sensor the wrong way round: its falling edges are the teeth's beginnings."""
    own = [k for k in range(400) if k % TEETH not in (7, 8)]
    falls = [BEGIN + TOOTH_US * k for k in own]
    wheel = Wheel(100, [each + FALL_US for each in falls], falls)
    read, turned = Read((7, 8), wheel), []
    for ms in range(40, 260, 10):
        read.at(ms)
        turned.append(read.edges.begins_falling)
    first = 40 + 10 * turned.index(True)
    assert 2 * TEETH - 10 < first < 4 * TEETH
    assert turned == sorted(turned)
    assert max(read.edges._fall.count, read.edges._rise.count) < 5


def test_used_edges_leave_their_room_and_it_grows_for_more_than_four_frames_alone() -> None:
    """27 edges a frame: 81 and another frame's fill it, 82 would not leave room enough."""
    polarity, wheel = Polarity(), steady(400)
    assert polarity.rows.shape == (2, 108)
    for k in range(3):
        read_us = BEGIN + 40_000 + 27_000 * k
        assert polarity.take(wheel.rise(read_us), read_us)
    assert (polarity.count, polarity.rows.shape[1]) == (81, 108)
    read_us = BEGIN + 40_000 + 27_000 * 2 + 1_000
    assert polarity.take(wheel.rise(read_us), read_us)
    assert (polarity.count, polarity.rows.shape[1]) == (82, 108)
    assert polarity.take(wheel.rise(read_us + 1_000), read_us + 1_000)
    assert (polarity.count, polarity.rows.shape[1]) == (83, 216)
