"""u_brake(t - t_delay,valve) of thesis 4.15b: what the brake was and will be commanded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.models.layshaft import BrakeInput
from meshpoint.kernels.records import Vector

DELAY_US = 12_000


def u_at(switches: Vector, time_us: float) -> float:
    times, states = switches
    held = states[times <= time_us]
    return float(held[-1]) if held.size else 0.0


def test_a_brake_never_commanded_is_off() -> None:
    times, states = BrakeInput(DELAY_US).arrays()
    assert times.size == states.size == 0


@settings(deadline=None, max_examples=60)
@given(
    commands=st.lists(
        st.tuples(st.booleans(), st.integers(0, 90_000), st.integers(1, 50_000)),
        min_size=1,
        max_size=12,
    ),
    release_us=st.integers(0, 600_000),
)
def test_the_valve_follows_its_newest_command_after_its_delay(
    commands: list[tuple[bool, int, int]], release_us: int
) -> None:
    """The past stays as it was commanded; of the future only the newest command stands."""
    brake, now_us = BrakeInput(DELAY_US), 0
    plain: list[tuple[int, bool]] = []
    for on, ahead_us, pause_us in commands:
        brake.schedule(now_us + ahead_us, on, now_us)
        plain = [switch for switch in plain if switch[0] <= now_us]
        plain.append((now_us + ahead_us, on))
        now_us += pause_us
    probes = sorted({t + d for t, _ in plain for d in (-1, 0, 1)} | {0, now_us, now_us + 200_000})
    for time_us in probes:
        commanded = next((on for t, on in reversed(plain) if t <= time_us), False)
        assert u_at(brake.arrays(), time_us + DELAY_US) == float(commanded)
    times, _ = brake.arrays()
    assert np.all(np.diff(times) > 0.0)
    released = brake.with_release(now_us + release_us)
    assert u_at(released, now_us + release_us + DELAY_US) == 0.0
    assert u_at(released, now_us + release_us + 10**6) == 0.0
    assert np.all(np.diff(released[0]) > 0.0)


def test_a_release_may_be_tried_without_being_commanded() -> None:
    brake = BrakeInput(DELAY_US)
    brake.schedule(100_000, True, 90_000)
    assert u_at(brake.with_release(200_000), 211_999.0) == 1.0
    assert u_at(brake.with_release(200_000), 212_000.0) == 0.0
    assert u_at(brake.arrays(), 300_000.0) == 1.0


def test_a_planned_release_can_be_moved_either_way() -> None:
    """Tried later than it is planned, the brake stays on until the later one."""
    brake = BrakeInput(DELAY_US)
    brake.schedule(100_000, True, 90_000)
    brake.schedule(200_000, False, 150_000)
    for release_us in (170_000, 250_000):
        moved = brake.with_release(release_us)
        assert u_at(moved, release_us + DELAY_US - 1) == 1.0
        assert u_at(moved, release_us + DELAY_US) == 0.0


def test_what_is_seen_through_another_valve_is_the_same_brake_also_when_it_is_moved_later() -> None:
    brake = BrakeInput(10_000)
    brake.schedule(1_000, True, 0)
    brake.schedule(90_000, False, 20_000)
    other = brake.seen_through(4_000)
    assert list(other.arrays()[0]) == [5_000, 94_000]
    brake.schedule(70_000, False, 30_000)
    assert list(other.arrays()[0]) == [5_000, 74_000]
    assert list(brake.arrays()[0]) == [11_000, 80_000]


def on_and_off(*times_us: int) -> BrakeInput:
    """Switched on, off, on ... at these times, each one commanded then; on after 5 ms, off 3."""
    brake = BrakeInput(0)
    brake.set_delays(3_000, 5_000)
    for k, time_us in enumerate(times_us):
        brake.schedule(time_us, k % 2 == 0, time_us)
    return brake


def test_each_switch_shows_after_its_own_delay_also_once_that_is_known_better() -> None:
    brake = on_and_off(10_000, 40_000, 60_000)
    assert brake.arrays().tolist() == [[15_000.0, 43_000.0, 65_000.0], [1.0, 0.0, 1.0]]
    assert brake.commanded().tolist() == [
        [10_000.0, 40_000.0, 60_000.0], [1.0, 0.0, 1.0], [15_000.0, 43_000.0, 65_000.0],
    ]  # fmt: skip
    brake.set_delays(4_000, 7_000)
    assert brake.arrays()[0].tolist() == [17_000.0, 44_000.0, 67_000.0]


@pytest.mark.parametrize(
    ("release_us", "kept"),
    [(10_000, 0), (10_001, 1), (40_000, 1), (60_000, 1), (60_001, 3), (90_000, 3)],
)
def test_a_release_instead_keeps_what_was_switched_before_it(release_us: int, kept: int) -> None:
    """Not the release that it moves, nor a switching-on that would come with it or later."""
    found = on_and_off(10_000, 40_000, 60_000).with_release(release_us)
    assert found[0].tolist() == [*[15_000.0, 43_000.0, 65_000.0][:kept], release_us + 3_000.0]
    assert found[1].tolist() == [*[1.0, 0.0, 1.0][:kept], 0.0]


def test_the_newest_sixteen_switches_are_kept() -> None:
    brake = on_and_off(*range(1_000, 31_000, 1_000))
    assert [switch.time_us for switch in brake.switches] == [*range(15_000, 31_000, 1_000)]
    other = BrakeInput(1_000)
    other.follow(brake)
    assert other.switches == brake.switches
    brake.schedule(90_000, True, 90_000)
    assert other.switches != brake.switches, "from then on each goes its own way"
