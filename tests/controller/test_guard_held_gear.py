"""Row 13: a gear that was seen to turn with its sleeve is held until it has turned free."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.guard.held_gear import HeldGear, Shaft
from meshpoint.controller.guard.limits import MainValve
from meshpoint.controller.guard.own_speed import ShaftSpeed, TeethCounted

FIRST, THIRD = 3, 6
MAIN = {FIRST: MainValve(0, -1, 0.5), THIRD: MainValve(1, 1, 1.0)}
PITCH_RAD = math.radians(7.5)
NEUTRAL = (0.0, 0.0)
APART_M = 0.0048
"""Of the teeth: a sleeve measured short of it is in no gear."""
START_US = 5_000_000
TEETH = 49
"""Of both wheels: two pass in a little less of a turn than two pitches of the dog teeth are."""


def shaft(teeth: int, late_us: int = 0, turns_s: float | None = 1.0) -> Shaft:
    """At START_US, or with its newest edge so much earlier."""
    speed = None if turns_s is None else ShaftSpeed(START_US, turns_s * math.tau)
    return Shaft(TeethCounted(START_US - late_us, teeth), speed, TEETH)


def held(valve: int = THIRD) -> HeldGear:
    gear = HeldGear(MAIN, PITCH_RAD, APART_M)
    assert gear.take(valve, NEUTRAL, shaft(200), shaft(100)) == valve
    return gear


def test_nothing_is_held_before_a_gear_was_seen_to_turn_with_its_sleeve() -> None:
    gear = HeldGear(MAIN, PITCH_RAD, APART_M)
    assert gear.take(0, NEUTRAL, shaft(200), shaft(100)) == 0
    assert gear.take(0, NEUTRAL, shaft(900), shaft(100)) == 0


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_gear_that_has_turned_by_two_pitches_is_still_held_by_more_it_is_free(sign: int) -> None:
    gear = held()
    assert gear.take(0, NEUTRAL, shaft(200 + 2 * sign), shaft(100)) == THIRD
    assert gear.take(0, NEUTRAL, shaft(200), shaft(100)) == THIRD
    assert gear.take(0, NEUTRAL, shaft(200), shaft(100 + 3 * sign)) == 0
    assert gear.take(0, NEUTRAL, shaft(200), shaft(100)) == 0


def test_a_gear_turns_by_its_ratio() -> None:
    """Half as far as the layshaft: in mesh the main shaft does so, too."""
    gear = held(FIRST)
    assert gear.take(0, NEUTRAL, shaft(1_200), shaft(600)) == FIRST
    assert gear.take(0, NEUTRAL, shaft(1_206), shaft(600)) == 0


@pytest.mark.parametrize("layshaft_late", [True, False])
def test_edges_of_different_times_are_compared_at_the_later(layshaft_late: bool) -> None:
    """One turn a second: in 122 ms six teeth, which a shaft whose newest edge is older has turned
    on since."""
    late, newest = shaft(94, late_us=122_449), shaft(100)
    gear = held()
    shafts = (shaft(194, late_us=122_449), newest) if layshaft_late else (shaft(200), late)
    assert gear.take(0, NEUTRAL, *shafts) == THIRD


def test_it_is_held_from_where_it_was_seen_to_turn_with_its_sleeve_last() -> None:
    gear = held()
    assert gear.take(THIRD, NEUTRAL, shaft(202), shaft(100)) == THIRD
    assert gear.take(0, NEUTRAL, shaft(204), shaft(100)) == THIRD
    assert gear.take(FIRST, NEUTRAL, shaft(208), shaft(100)) == FIRST
    assert gear.take(0, NEUTRAL, shaft(208), shaft(100)) == FIRST


@pytest.mark.parametrize(
    "unknown",
    [shaft(900, turns_s=None), Shaft(None, ShaftSpeed(START_US, 1.0), TEETH)],
    ids=["speed", "teeth"],
)
def test_what_is_not_known_frees_no_gear(unknown: Shaft) -> None:
    for shafts in ((unknown, shaft(100)), (shaft(200), unknown)):
        gear = held()
        assert gear.take(0, NEUTRAL, *shafts) == THIRD
        assert gear.take(0, NEUTRAL, shaft(202), shaft(100)) == THIRD


@pytest.mark.parametrize("sleeve", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_sleeve_measured_at_its_gears_teeth_is_no_longer_denied(sleeve: int, sign: float) -> None:
    for away_m, valve in ((0.0, THIRD), (1e-9, 0)):
        positions = [0.0, 0.0]
        positions[sleeve] = sign * (APART_M + away_m)
        gear = held()
        assert gear.take(0, tuple(positions), shaft(200), shaft(100)) == valve
        assert gear.take(0, NEUTRAL, shaft(200), shaft(100)) == valve


def test_with_another_clock_nothing_is_held() -> None:
    gear = held()
    gear.forget()
    assert gear.take(0, NEUTRAL, shaft(200), shaft(100)) == 0
