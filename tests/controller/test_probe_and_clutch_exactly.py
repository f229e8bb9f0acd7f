"""When the controller listens to the bus at once, sends earlier, and what the clutch will do."""

from __future__ import annotations

import pytest

from meshpoint.controller.sensing.clock_probe import FIRST_OF_A_READ, ClockProbe
from meshpoint.controller.sensing.clutch_track import ClutchTrack
from meshpoint.controller.sensing.refused_lead import RefusedLead
from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import EdgesInputRise, EdgesLayshaftRise, ValveStatus

FIRST = Frame(FIRST_OF_A_READ, b"")
OTHER = Frame(FIRST_OF_A_READ + 1, b"")
SECOND_US = 1_000_000


def read_at(*times_us: int) -> StepInputs:
    """A step with a first frame of each of these reads."""
    inputs = StepInputs()
    for time_us in times_us:
        inputs.take(EdgesInputRise(read_time_us=time_us))
        inputs.take(EdgesLayshaftRise(read_time_us=time_us + 7))
    return inputs


def armed() -> ClockProbe:
    probe = ClockProbe()
    probe.plan(10_000, None)
    return probe


def test_no_frame_is_awaited_before_the_first_step() -> None:
    probe = ClockProbe()
    assert (probe.is_armed, probe.is_due) == (False, False)
    probe.receive(FIRST)
    assert probe.is_due is False
    assert probe.stamp(read_at(123), 10_000) is None


def test_after_the_first_step_the_next_read_is_awaited_at_once() -> None:
    assert armed().is_armed is True


def test_only_the_first_frame_of_a_read_makes_a_step() -> None:
    probe = armed()
    probe.receive(OTHER)
    assert probe.is_due is False
    probe.receive(FIRST)
    assert probe.is_due is True
    assert probe.is_armed is True


def test_a_step_at_a_frame_s_arrival_has_that_read_s_time_and_is_the_only_one() -> None:
    probe = armed()
    probe.receive(FIRST)
    assert probe.stamp(read_at(123), 12_345) == 123
    assert (probe.is_armed, probe.is_due) == (False, False)
    assert probe.stamp(read_at(456), 22_345) is None


def test_a_step_that_awaits_a_read_and_comes_by_its_tick_leaves_it_awaited() -> None:
    probe = armed()
    assert probe.stamp(read_at(123), 12_345) is None
    assert probe.is_armed is True


@pytest.mark.parametrize("reads", [(), (100, 10_100)], ids=["none", "two"])
def test_a_step_without_one_read_alone_measures_nothing_and_is_made_up_for(
    reads: tuple[int, ...],
) -> None:
    probe = armed()
    probe.receive(FIRST)
    assert probe.stamp(read_at(*reads), 12_345) is None
    assert (probe.is_armed, probe.is_due) == (False, False)
    probe.plan(12_345, None)
    assert probe.is_armed is True


def measured_at(now_us: int) -> ClockProbe:
    probe = armed()
    probe.receive(FIRST)
    assert probe.stamp(read_at(123), now_us) == 123
    return probe


@pytest.mark.parametrize(
    ("later_us", "awaited"), [(0, False), (SECOND_US - 1, False), (SECOND_US, True)]
)
def test_the_delay_of_the_bus_is_measured_once_a_second(later_us: int, awaited: bool) -> None:
    probe = measured_at(12_345)
    probe.plan(12_345 + later_us, None)
    assert probe.is_armed is awaited


def test_a_clock_that_proved_wrong_is_measured_at_once() -> None:
    probe = measured_at(12_345)
    probe.repeat()
    probe.plan(12_346, None)
    assert probe.is_armed is True


def test_nothing_is_measured_while_a_valve_is_about_to_switch() -> None:
    probe = measured_at(12_345)
    probe.plan(12_345 + 2 * SECOND_US, 12_345 + 2 * SECOND_US + 5_000)
    assert probe.is_armed is False
    probe.plan(12_345 + 2 * SECOND_US, 0)
    assert probe.is_armed is False
    probe = ClockProbe()
    probe.plan(10_000, 15_000)
    assert probe.is_armed is False


def refusals(count: int) -> ValveStatus:
    return ValveStatus(refused_count=count)


def test_the_valves_first_count_of_refusals_is_no_refusal() -> None:
    lead = RefusedLead(10_000)
    assert lead.more_us == 0
    assert lead.take(None, 0) is False
    assert lead.take(refusals(7), 1_000) is False
    assert lead.take(refusals(7), 2_000) is False
    assert lead.more_us == 0


def test_each_refusal_makes_activations_a_tick_earlier_up_to_three() -> None:
    lead = RefusedLead(10_000)
    lead.take(refusals(0), 0)
    seen = []
    for count in (1, 2, 2, 3, 4, 5):
        told = lead.take(refusals(count), 1_000 * count)
        seen.append((told, lead.more_us))
    assert seen == [
        (True, 10_000),
        (True, 20_000),
        (False, 20_000),
        (True, 30_000),
        (True, 30_000),
        (True, 30_000),
    ]


def test_a_count_that_wraps_tells_of_a_refusal_as_well() -> None:
    lead = RefusedLead(10_000)
    lead.take(refusals(15), 0)
    assert lead.take(refusals(0), 1_000) is True
    assert lead.more_us == 10_000


@pytest.mark.parametrize("status", [None, refusals(1)], ids=["silent", "the same count"])
def test_ten_seconds_after_the_last_refusal_activations_are_sent_as_before(
    status: ValveStatus | None,
) -> None:
    lead = RefusedLead(10_000)
    lead.take(refusals(0), 0)
    lead.take(refusals(1), 5_000)
    lead.take(status, 5_000 + 10 * SECOND_US)
    assert lead.more_us == 10_000
    assert lead.take(status, 5_001 + 10 * SECOND_US) is False
    assert lead.more_us == 0


def test_a_silence_of_the_valves_forgets_no_count() -> None:
    lead = RefusedLead(10_000)
    lead.take(refusals(3), 0)
    lead.take(None, 1_000)
    assert lead.take(refusals(4), 2_000) is True


def test_of_a_clutch_that_was_never_seen_nothing_is_known() -> None:
    track = ClutchTrack()
    assert (track.closed, track.newest_us, track.rate_per_s, track.before) == (None, 0, 0.0, None)
    track.take(10_000, 0.5)
    assert (track.closed, track.newest_us, track.rate_per_s) == (0.5, 10_000, 0.0)
    assert track.before is None


@pytest.mark.parametrize(
    ("since_us", "rate_per_s"),
    [(1, 1e5), (10_000, 10.0), (25_000, 4.0), (25_001, None), (0, None), (-10_000, None)],
)
def test_a_clutch_s_rate_is_that_of_two_samples_of_25_ms_at_most(
    since_us: int, rate_per_s: float | None
) -> None:
    track = ClutchTrack()
    track.take(100_000, 0.5)
    track.take(100_000 + since_us, 0.6)
    assert (track.closed, track.newest_us) == (0.6, 100_000 + since_us)
    if rate_per_s is None:
        assert (track.rate_per_s, track.before) == (0.0, None)
    else:
        assert track.rate_per_s == pytest.approx(rate_per_s)
        assert track.before == (100_000, 0.5)


@pytest.mark.parametrize(
    ("moved", "rate_per_s"),
    [(0.004, 0.0), (-0.004, 0.0), (0.0078125, 0.5), (-0.0078125, -0.5), (0.006, 0.0)],
)
def test_a_clutch_that_takes_two_seconds_for_its_travel_still_moves(
    moved: float, rate_per_s: float
) -> None:
    """1/128 of the travel in 1/64 s is a half a second, in numbers without rounding."""
    track = ClutchTrack()
    track.take(0, 0.5)
    track.take(15_625, 0.5 + moved)
    assert track.rate_per_s == rate_per_s


def test_a_clutch_that_was_open_at_the_sample_before_closes_from_there() -> None:
    track = ClutchTrack()
    track.take(0, 0.0)
    track.take(10_000, 0.25)
    assert track.before == (0, 0.0)
    assert track.rate_per_s == pytest.approx(25.0)


def opening(by: float) -> ClutchTrack:
    track = ClutchTrack()
    track.take(40_000, 1.0)
    track.take(50_000, 1.0 - by)
    return track


def test_where_an_opening_clutch_will_be_is_said_for_a_tenth_of_a_second() -> None:
    """From 0.875 at 12.5 a second: 0.625 in 20 ms."""
    track = opening(0.125)
    assert track.falls_to_us(0.625) == pytest.approx(70_000.0)
    assert track.falls_to_us(0.875) == 50_000.0
    assert track.falls_to_us(0.9) == 50_000.0
    slow = ClutchTrack()
    slow.take(0, 1.0)
    slow.take(15_625, 1.0 - 0.03125)  # 2 a second
    assert slow.falls_to_us(0.96875 - 0.198) == pytest.approx(15_625 + 99_000)
    assert slow.falls_to_us(0.96875 - 0.202) is None


def test_a_clutch_that_closes_passes_no_level_below_it() -> None:
    track = opening(-0.05)
    assert track.falls_to_us(0.5) is None
    assert track.falls_to_us(1.05) == 50_000.0
    assert opening(0.0).falls_to_us(0.5) is None
