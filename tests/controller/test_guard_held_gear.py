"""Row 13: a gear that was seen to turn with its sleeve is held until it has turned free; one that
was pulled and is still measured in is denied once it has."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.guard.held_gear import HeldGear, PulledGear, Shaft, gear_angle_rad
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


FREE_RAD = math.radians(4.5)


def pulled(angle_rad: float | None = 1.0) -> PulledGear:
    gear = PulledGear()
    gear.pull(START_US, angle_rad)
    return gear


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_pulled_gear_that_turns_by_more_than_its_backlash_is_denied(sign: float) -> None:
    gear = pulled()
    gear.stands(START_US + 50_000, 1.0 + sign * (FREE_RAD - 1e-9), FREE_RAD)
    assert not gear.is_denied
    gear.stands(START_US + 60_000, 1.0 + sign * (FREE_RAD + 1e-9), FREE_RAD)
    assert gear.is_denied


def test_it_counts_from_its_first_pull() -> None:
    gear = pulled()
    gear.pull(START_US + 200_000, 1.0 + 0.9 * FREE_RAD)
    gear.stands(START_US + 300_000, 1.0 + 1.1 * FREE_RAD, FREE_RAD)
    assert gear.is_denied


def test_a_gear_that_nothing_has_pulled_is_not_denied() -> None:
    for gear in (PulledGear(), pulled(None)):
        for at_ms in (0, 100):
            gear.stands(START_US + 1_000 * at_ms, 0.01 * at_ms, FREE_RAD)
        assert not gear.is_denied


def test_a_second_after_its_pull_a_gear_in_mesh_is_looked_at_no_more() -> None:
    """A wheel that counts wrong for once would deny it."""
    for after_us, is_denied in ((1_000_000, True), (1_000_001, False)):
        gear = pulled()
        gear.stands(START_US + after_us, 1.0, FREE_RAD)
        gear.stands(START_US + 1_100_000, 2.0, FREE_RAD)
        assert gear.is_denied is is_denied


def test_a_denied_gear_is_believed_once_it_has_turned_with_its_sleeve_for_a_second() -> None:
    gear = pulled()
    gear.stands(START_US, 2.0, FREE_RAD)
    gear.stands(START_US + 900_000, 2.1, FREE_RAD)
    gear.stands(START_US + 1_900_000, 2.1, FREE_RAD)
    assert gear.is_denied
    gear.stands(START_US + 1_900_001, 2.1, FREE_RAD)
    assert not gear.is_denied


def test_a_denied_gear_stays_so_by_another_clock_and_while_no_teeth_are_counted() -> None:
    gear = pulled()
    gear.stands(START_US, 2.0, FREE_RAD)
    gear.restart()
    gear.stands(7_000, None, FREE_RAD)
    gear.stands(8_000, 5.0, FREE_RAD)
    gear.stands(1_008_000, 5.0, FREE_RAD)
    assert gear.is_denied
    gear.stands(1_008_001, 5.0, FREE_RAD)
    assert not gear.is_denied


def test_teeth_that_are_counted_anew_deny_no_gear() -> None:
    gear = pulled()
    gear.restart()
    gear.stands(7_000, 5.0, FREE_RAD)
    assert not gear.is_denied


def test_a_sleeve_measured_elsewhere_ends_it() -> None:
    gear = pulled()
    gear.stands(START_US, 2.0, FREE_RAD)
    gear.forget()
    assert not gear.is_denied
    gear.stands(START_US + 10_000, 3.0, FREE_RAD)
    assert not gear.is_denied


def test_the_angle_of_a_gear_is_by_its_ratio_and_the_newest_edge_of_both() -> None:
    """A turn a second: an edge an eighth of a second old is an eighth of a turn on."""
    late = shaft(49, late_us=125_000)
    assert gear_angle_rad(0.5, shaft(98), shaft(49)) == pytest.approx(0.0)
    assert gear_angle_rad(0.5, late, shaft(49)) == pytest.approx(math.tau * (0.5625 - 1.0))
    assert gear_angle_rad(0.5, shaft(98), late) == pytest.approx(-math.tau * 0.125)
    assert gear_angle_rad(0.5, Shaft(None, None, TEETH), late) is None
