"""The brake valve's switches, one by one; and angles between shafts, gears and sleeves, by hand."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.motion.brake_input import SWITCHES_KEPT, BrakeInput, Switch
from meshpoint.controller.motion.kinematics import (
    are_finite,
    raw_phase_rad,
    slip_rad_s,
    wrap_to_pitch,
)


def on_and_off(*times_us: int, off_us: int = 3_000, on_us: int = 5_000) -> BrakeInput:
    """Switched on, off, on ... at these times, each one commanded then."""
    brake = BrakeInput(0)
    brake.set_delays(off_us, on_us)
    for k, time_us in enumerate(times_us):
        brake.schedule(time_us, k % 2 == 0, time_us)
    return brake


def test_each_switch_shows_after_its_own_delay() -> None:
    """On after 5 ms, off after 3 ms; commands are without."""
    brake = on_and_off(10_000, 40_000, 60_000)
    assert brake.arrays().tolist() == [[15_000.0, 43_000.0, 65_000.0], [1.0, 0.0, 1.0]]
    times, states = brake.commands
    assert (times.tolist(), states.tolist()) == ([10_000.0, 40_000.0, 60_000.0], [1.0, 0.0, 1.0])
    assert brake.commanded().tolist() == [
        [10_000.0, 40_000.0, 60_000.0], [1.0, 0.0, 1.0], [15_000.0, 43_000.0, 65_000.0],
    ]  # fmt: skip
    assert (brake.off_delay_us, brake.on_delay_us) == (3_000, 5_000)
    fresh = BrakeInput(12_000)
    assert (fresh.off_delay_us, fresh.on_delay_us) == (12_000, 12_000)
    assert fresh.commanded().shape == (3, 0)


def test_delays_that_were_learned_move_what_was_switched_before() -> None:
    brake = on_and_off(10_000, 40_000)
    before = brake.arrays()
    brake.set_delays(3_000, 5_000)
    assert brake.arrays() is before, "nothing new"
    brake.set_delays(4_000, 5_000)
    assert brake.arrays()[0].tolist() == [15_000.0, 44_000.0]
    brake.set_delays(4_000, 7_000)
    assert brake.arrays()[0].tolist() == [17_000.0, 44_000.0]
    brake.schedule(70_000, True, 70_000)
    assert brake.arrays()[0].tolist() == [17_000.0, 44_000.0, 77_000.0]


def test_the_same_state_once_more_is_no_switch_and_off_is_none_at_first() -> None:
    brake = BrakeInput(0)
    brake.schedule(1_000, False, 0)
    assert brake.switches == []
    brake.schedule(2_000, True, 2_000)
    brake.schedule(3_000, True, 3_000)
    assert brake.switches == [Switch(2_000, True)]
    brake.schedule(4_000, False, 4_000)
    brake.schedule(5_000, False, 5_000)
    assert brake.switches == [Switch(2_000, True), Switch(4_000, False)]


def test_what_is_planned_for_later_than_now_is_replaced() -> None:
    """What is to happen just now stays."""
    brake = on_and_off(10_000)
    brake.schedule(40_000, False, 20_000)
    brake.schedule(50_000, False, 39_999)
    assert brake.switches == [Switch(10_000, True), Switch(50_000, False)]
    brake.schedule(70_000, True, 50_000)
    assert brake.switches[1:] == [Switch(50_000, False), Switch(70_000, True)]
    brake.schedule(80_000, False, 60_000)
    assert brake.switches == [Switch(10_000, True), Switch(50_000, False)], (
        "the pulse is called off"
    )


def test_the_newest_sixteen_switches_are_kept() -> None:
    assert SWITCHES_KEPT == 16
    brake = on_and_off(*range(1_000, 31_000, 1_000))
    assert [switch.time_us for switch in brake.switches] == [*range(15_000, 31_000, 1_000)]


def test_switches_are_told_as_a_copy_and_taken_over_without_the_delays() -> None:
    brake, other = on_and_off(10_000, 40_000), BrakeInput(1_000)
    brake.switches.clear()
    assert len(brake.switches) == 2
    other.follow(brake)
    assert other.switches == brake.switches
    assert other.arrays()[0].tolist() == [11_000.0, 41_000.0]
    brake.schedule(90_000, True, 90_000)
    assert len(other.switches) == 2, "from then on each goes its own way"
    through = brake.seen_through(2_000)
    assert through.arrays()[0].tolist() == [12_000.0, 42_000.0, 92_000.0]
    brake.schedule(99_000, False, 99_000)
    assert through.arrays()[0].tolist() == [12_000.0, 42_000.0, 92_000.0, 101_000.0]


@pytest.mark.parametrize(
    ("release_us", "kept"),
    [(9_000, 0), (10_000, 0), (10_001, 1), (30_000, 1), (40_000, 1), (59_000, 1), (60_000, 1),
     (60_001, 3), (90_000, 3)],
)  # fmt: skip
def test_a_release_instead_keeps_what_was_switched_before_it(release_us: int, kept: int) -> None:
    """Not the release that it moves, nor a switching-on that would come with it or later."""
    brake = on_and_off(10_000, 40_000, 60_000)
    found = brake.with_release(release_us)
    assert found[0].tolist() == [*[15_000.0, 43_000.0, 65_000.0][:kept], release_us + 3_000.0]
    assert found[1].tolist() == [*[1.0, 0.0, 1.0][:kept], 0.0]


def test_a_planned_release_is_moved_and_does_not_stay_beside_the_other() -> None:
    brake = on_and_off(10_000, 40_000)
    assert brake.with_release(70_000).tolist() == [[15_000.0, 73_000.0], [1.0, 0.0]]
    assert BrakeInput(2_000).with_release(5_000).tolist() == [[7_000.0], [0.0]]


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (0.9, 0.9), (1.0, -1.0), (-1.0, -1.0), (-1.1, 0.9), (1.1, -0.9), (7.3, -0.7),
     (-6.2, -0.2)],
)  # fmt: skip
def test_an_angle_is_wrapped_to_half_a_pitch_either_way(angle: float, wrapped: float) -> None:
    """Of 2 here; the upper half itself is the lower one."""
    assert wrap_to_pitch(angle, 2.0) == pytest.approx(wrapped)


def test_slip_and_raw_phase_are_the_gear_s_less_the_sleeve_s() -> None:
    assert slip_rad_s(0.5, 120.0, 50.0) == 10.0
    assert raw_phase_rad(0.5, 12.0, 5.0) == 1.0


def test_numbers_are_finite_where_all_and_their_sum_are() -> None:
    assert are_finite([1.0, -2.0, 0.0])
    assert not are_finite([1.0, math.nan])
    assert not are_finite([math.inf, 1.0])
    assert not are_finite([1e308, 1e308])
