"""Row 3 in the last step in which a fired sleeve's valve going off stops it short of the teeth, and
in the last one before contact: what the shafts may do until contact is bounded by what they have
done within a period."""

from __future__ import annotations

import math

import pytest
from guard_cases import (
    LIMITS,
    NEUTRAL,
    NOW,
    SHEET,
    encoded,
    payload,
    ready,
    speeds,
    swing_within,
)
from test_guard_view import LAYSHAFT_EDGES, MAIN_EDGES, SLOW, frame, turning, view

from meshpoint.controller.guard.limits import REACT_US
from meshpoint.controller.guard.own_speed import ShaftSpeed
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.guard.sleeve_motion import longest_pulse_us
from meshpoint.controller.guard.swing import Swing, SwingMemory
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ValveCommand
from meshpoint.gearbox import MainGear
from meshpoint.units import RPM

SECOND = ValveName.MAIN_SECOND
RATIO = SHEET.main_mesh(MainGear.SECOND).ratio
FIRED_US = NOW - 31_000
"""The sleeve may meet its gear from 9 ms after NOW on, and does within 19 ms: 29 ms after the
newest speeds, which are 10 ms old."""
AHEAD_S = 0.029
OLD_S = 0.010
STOPS_US = FIRED_US + math.ceil(longest_pulse_us(LIMITS, 0.0))
"""A valve that is off then has not moved its sleeve to the teeth."""
LAST_STOP_US = STOPS_US - 1
CYCLE_US = 10_000


def fired() -> Guard:
    """A guard that has let a sleeve be fired into second gear, in a calm."""
    guard = ready()
    assert guard.passes(payload(SECOND, at_us=FIRED_US), at(NOW - 35_000))
    return guard


def at(now_us: int) -> GuardInputs:
    """Neutral, second gear near, at another time; how the shafts swing is not known."""
    earlier_us = now_us - NOW
    moved = [speed._replace(time_us=speed.time_us + earlier_us) for speed in speeds()]
    return NEUTRAL._replace(now_us=now_us, speeds=tuple(moved), swings=(None, None))


def swinging(
    slip_rpm: float = 20.0,
    layshaft_rpm_s: float = 0.0,
    falls_rpm_s: float = 0.0,
    rises_rpm_s: float = 0.0,
    down_rpm: float = 1e3,
    up_rpm: float = 1e3,
) -> GuardInputs:
    """The moment NOW. Rates are those of the last period, `down_rpm` and `up_rpm` how far the main
    shaft has been below and above its speed of now."""
    _, layshaft, main, _ = speeds(slip_rpm=slip_rpm)
    omega = main.omega_rad_s
    return NEUTRAL._replace(
        speeds=speeds(slip_rpm=slip_rpm),
        swings=(
            swing_within(layshaft, layshaft_rpm_s * RPM, 0.0, 1e3),
            swing_within(
                main, 0.0, omega - down_rpm * RPM, omega + up_rpm * RPM,
                falls_rpm_s * RPM, rises_rpm_s * RPM,
            ),
        ),
    )  # fmt: skip


def judged(seen: GuardInputs, guard: Guard | None = None) -> int | None:
    guard = guard or fired()
    guard.passes(payload(SECOND, at_us=FIRED_US), seen)
    return guard.blocked_row


def test_a_calm_main_shaft_lets_the_sleeve_go_on() -> None:
    assert judged(swinging()) is None


@pytest.mark.parametrize(
    ("beyond_rpm", "row"), [(-0.5, None), (0.5, 3)], ids=["in the window", "out of it"]
)
def test_what_has_fallen_or_risen_so_fast_may_do_so_until_contact(
    beyond_rpm: float, row: int | None
) -> None:
    """The window is -60 to 120 rpm, and 10 rpm of doubt; the slip is 20 rpm now."""
    falls_rpm_s = -(110.0 + beyond_rpm) / AHEAD_S
    rises_rpm_s = (90.0 + beyond_rpm) / AHEAD_S
    assert judged(swinging(falls_rpm_s=falls_rpm_s)) == row
    assert judged(swinging(rises_rpm_s=rises_rpm_s)) == row
    assert judged(swinging(layshaft_rpm_s=-(90.0 + beyond_rpm) / RATIO / AHEAD_S)) == row


@pytest.mark.parametrize(("beyond_rpm", "row"), [(-0.5, None), (0.5, 3)])
def test_however_fast_it_swings_no_further_than_it_has_been(
    beyond_rpm: float, row: int | None
) -> None:
    fast = {"falls_rpm_s": -1e5, "rises_rpm_s": 1e5}
    assert judged(swinging(down_rpm=110.0 + beyond_rpm, up_rpm=0.0, **fast)) == row
    assert judged(swinging(down_rpm=0.0, up_rpm=90.0 + beyond_rpm, **fast)) == row


def test_a_layshaft_that_gains_speed_is_not_taken_to_lose_any() -> None:
    """Nor to gain any until contact: the main shaft may rise by 9.5 rpm, which with the slip is the
    window and its doubt of 1 rad/s."""
    for up_rpm, row in ((9.5, None), (9.6, 3)):
        rises = {"rises_rpm_s": 1e5, "up_rpm": up_rpm}
        assert judged(swinging(slip_rpm=-60.0, layshaft_rpm_s=900.0, **rises)) == row


@pytest.mark.parametrize("unknown", [0, 1], ids=["layshaft", "main shaft"])
def test_a_swing_that_is_not_known_may_do_anything(unknown: int) -> None:
    seen = swinging()
    swings = list(seen.swings)
    swings[unknown] = None
    layshaft, main = swings
    assert judged(seen._replace(swings=(layshaft, main))) == 3


@pytest.mark.parametrize(
    ("later_us", "row"), [(-6_001, None), (-6_000, 3), (8_999, 3), (9_000, None)]
)
def test_the_last_call_is_from_a_step_before_the_earliest_contact_until_it(
    later_us: int, row: int | None
) -> None:
    """A command of the next step can act 15 ms from now."""
    assert judged(at(NOW + later_us)) == row


@pytest.mark.parametrize(
    ("now_us", "row"),
    [
        (STOPS_US - REACT_US - 1, None),
        (STOPS_US - REACT_US, 3),
        (STOPS_US - 1, 3),
        (STOPS_US, None),
    ],
)
def test_the_last_stop_is_the_last_step_in_which_the_valve_going_off_stops_the_sleeve(
    now_us: int, row: int | None
) -> None:
    """Judged with a swing that is not known."""
    assert judged(at(now_us)) == row


def at_the_last_stop(**swing: float) -> GuardInputs:
    """As `swinging`, in that step."""
    seen, earlier_us = swinging(**swing), LAST_STOP_US - NOW

    def moved(speed: ShaftSpeed) -> ShaftSpeed:
        return speed._replace(time_us=speed.time_us + earlier_us)

    swings = [each._replace(newest=moved(each.newest)) for each in seen.swings if each is not None]
    layshaft, main = swings
    turning = tuple(moved(speed) for speed in seen.speeds if speed is not None)
    return seen._replace(now_us=LAST_STOP_US, speeds=turning, swings=(layshaft, main))


@pytest.mark.parametrize(
    ("beyond_rpm", "row"), [(-0.5, None), (0.5, 3)], ids=["in the window", "out of it"]
)
def test_at_the_last_stop_the_main_shaft_may_go_on_as_it_has_until_contact(
    beyond_rpm: float, row: int | None
) -> None:
    ahead_s = AHEAD_S + 1e-6 * (NOW - LAST_STOP_US)
    falls_rpm_s, rises_rpm_s = -(110.0 + beyond_rpm) / ahead_s, (90.0 + beyond_rpm) / ahead_s
    assert judged(at_the_last_stop(falls_rpm_s=falls_rpm_s)) == row
    assert judged(at_the_last_stop(rises_rpm_s=rises_rpm_s)) == row
    fast = {"falls_rpm_s": -1e5, "rises_rpm_s": 1e5}
    assert judged(at_the_last_stop(down_rpm=110.0 + beyond_rpm, up_rpm=0.0, **fast)) == row
    assert judged(at_the_last_stop(down_rpm=0.0, up_rpm=90.0 + beyond_rpm, **fast)) == row


@pytest.mark.parametrize(
    ("beyond_rpm", "row"), [(-0.5, None), (0.5, 3)], ids=["in the window", "out of it"]
)
def test_at_the_last_stop_the_layshaft_has_fallen_on_until_now(
    beyond_rpm: float, row: int | None
) -> None:
    """Its newest speed is 10 ms old; slip and margin may be 130 rpm at most and -70 at least. From
    now on it keeps its speed: the brake may slow it still, and what it does until contact is asked
    at the last call."""
    high = at_the_last_stop(slip_rpm=140.0 + beyond_rpm, layshaft_rpm_s=-10.0 / RATIO / OLD_S)
    low = at_the_last_stop(slip_rpm=-60.0 - beyond_rpm, layshaft_rpm_s=-10.0 / RATIO / OLD_S)
    assert judged(high) == row
    assert judged(low) == row


def test_at_the_last_stop_a_layshaft_that_gains_speed_is_taken_to_keep_it() -> None:
    assert judged(at_the_last_stop(slip_rpm=129.5, layshaft_rpm_s=1e4)) is None
    assert judged(at_the_last_stop(slip_rpm=130.5, layshaft_rpm_s=1e4)) == 3


@pytest.mark.parametrize("unknown", [0, 1], ids=["layshaft", "main shaft"])
def test_at_the_last_stop_a_swing_that_is_not_known_forbids(unknown: int) -> None:
    seen = at_the_last_stop()
    assert judged(seen) is None
    layshaft, main = (None if k == unknown else each for k, each in enumerate(seen.swings))
    assert judged(seen._replace(swings=(layshaft, main))) == 3


def test_what_is_taken_back_can_be_fired_anew_once_it_is_seen_to_stand() -> None:
    """The slowest valve shuts 17 ms after it is off. Before, the sleeve may be at the teeth."""
    for sampled_us, row in ((NOW + 17_000, None), (NOW + 16_999, 3)):
        guard = fired()
        assert judged(swinging(falls_rpm_s=-1e4), guard) == 3
        assert guard.passes(encoded(ValveCommand()), at(NOW + 10_000))
        seen = at(NOW + 20_000)._replace(positions_us=sampled_us)
        guard.passes(payload(SECOND, at_us=NOW + 24_000), seen)
        assert guard.blocked_row == row


def remembered(*speeds_rpm: float, cycle_us: int = CYCLE_US) -> Swing | None:
    """After this many speeds, one a cycle."""
    memory, swing = SwingMemory(), None
    for k, rpm in enumerate(speeds_rpm):
        swing = memory.take(ShaftSpeed(NOW + k * cycle_us, rpm * RPM))
    return swing


def test_a_swing_is_known_from_three_speeds_on() -> None:
    assert remembered(500.0, 510.0) is None
    swing = remembered(500.0, 510.0, 530.0)
    assert swing is not None
    assert swing.newest == ShaftSpeed(NOW + 20_000, 530.0 * RPM)
    assert swing.rate_rad_s2 == pytest.approx(1500.0 * RPM)
    assert [speed.omega_rad_s for speed in swing.speeds] == [500.0 * RPM, 510.0 * RPM, 530.0 * RPM]
    assert swing.rates_rad_s2 == (swing.rate_rad_s2,)


def test_extremes_are_those_of_one_period() -> None:
    """Of 180 ms: a speed of then still counts, as does a rate that ended then, not one before."""
    for later, most_rpm, fell_rpm_s, rose_rpm_s in (
        (15, 700.0, 1e4, 3e3), (16, 560.0, 1e4, 3e3), (17, 560.0, 1e4, 3e3),
        (18, 560.0, 3e3, 3e3), (19, 500.0, 3e3, 0.0),
    ):  # fmt: skip
        swing = remembered(700.0, 500.0, 500.0, 560.0, *[500.0] * later)
        assert swing is not None
        omegas = [speed.omega_rad_s for speed in swing.speeds]
        assert min(omegas) == pytest.approx(500.0 * RPM)
        assert max(omegas) == pytest.approx(most_rpm * RPM)
        assert min(0.0, *swing.rates_rad_s2) == pytest.approx(-fell_rpm_s * RPM)
        assert max(0.0, *swing.rates_rad_s2) == pytest.approx(rose_rpm_s * RPM)


@pytest.mark.parametrize(("cycle_us", "is_known"), [(22_500, True), (22_501, False)])
def test_speeds_far_apart_say_nothing_of_a_rate(cycle_us: int, is_known: bool) -> None:
    """Further than a quarter of a swing's period. A controller that steps every 20 ms hears speeds
    as far apart, but for a tooth."""
    assert (remembered(500.0, 510.0, 530.0, cycle_us=cycle_us) is not None) is is_known


def test_the_same_speed_heard_again_changes_nothing_and_none_is_not_known() -> None:
    memory = SwingMemory()
    for k, rpm in enumerate((500.0, 510.0, 530.0)):
        swing = memory.take(ShaftSpeed(NOW + k * CYCLE_US, rpm * RPM))
    assert memory.take(ShaftSpeed(NOW + 2 * CYCLE_US, 530.0 * RPM)) == swing
    assert memory.take(None) is None


def test_with_another_clock_no_rate_of_before_is_one_of_the_period() -> None:
    memory = SwingMemory()
    for k, rpm in enumerate((500.0, 510.0, 530.0)):
        memory.take(ShaftSpeed(NOW + k * CYCLE_US, rpm * RPM))
    memory.forget()
    for k in range(3):
        swing = memory.take(ShaftSpeed(NOW + (k + 3) * CYCLE_US, 500.0 * RPM))
    assert swing is not None
    assert set(swing.rates_rad_s2) == {0.0}


def test_the_view_tells_how_the_shafts_swing_and_nothing_of_before_another_clock() -> None:
    """After the sixth frame the sensors start anew; their first two speeds tell no swing yet."""
    guard_view, seen = view(), []
    for step in range(10):
        stamp = 100_000 + CYCLE_US * (step % 6)
        frames = [frame(each, step, stamp) for each in SLOW]
        frames += [turning(LAYSHAFT_EDGES, step, stamp, [2_000] * 10)]
        frames += [turning(MAIN_EDGES, step, stamp, [2_000 - 50 * step] * 10)]
        seen.append(guard_view.take(frames, 500_000 + CYCLE_US * step, stamp))
    layshaft, main = seen[5].swings
    assert layshaft is not None
    assert main is not None
    assert layshaft.rate_rad_s2 == 0.0 < main.rate_rad_s2
    assert max(main.rates_rad_s2) == main.rate_rad_s2
    assert main.newest == seen[5].speeds[2]
    known = [each.swings[1] is not None for each in seen]
    assert known == [False] * 4 + [True] * 2 + [False] * 2 + [True] * 2
