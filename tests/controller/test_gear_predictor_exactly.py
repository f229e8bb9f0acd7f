"""Where two shafts will be that slow down steadily, and how well that will be known: by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.models import LayshaftState, MotionModel, Ticks, first_order_law
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.controller.planning import gear_predictor
from meshpoint.controller.planning.gear_predictor import (
    GearPredictor,
    LastLook,
    Trajectory,
    _falling_root,
)
from meshpoint.controller.records import Vector
from meshpoint.gearbox import MainGear

I_GEAR, AT_ZERO, DRIFT, SHARE, DELAY_SD_S = 0.8, 0.3, 0.05, 0.5, 2e-3
LAYSHAFT_US, MAIN_US = 1_000.0, 3_000.0
THETA, OMEGA, DRAG = 1.5, 100.0, -30.0
MAIN_THETA, MAIN_OMEGA, MAIN_ACCELERATION = 2.0, 64.0, -5.0
G, SUPPLY = 2e-3, 5e5
BRAKED_RAD_S2 = G * SUPPLY


class References:
    """Of a gear whose phase is known: AT_ZERO where both angles are zero."""

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        assert gear is MainGear.THIRD
        return I_GEAR * theta_layshaft - theta_main + AT_ZERO


class Cloudy(ShaftState):
    """A main shaft that a cloud of drivelines tells."""

    is_by_cloud = True


MAIN = ShaftState(MAIN_US, MAIN_THETA, MAIN_OMEGA, 3e-3, 0.5, MAIN_ACCELERATION)


def predictor(drag: float = DRAG, brake: BrakeInput | None = None, **changed: Any) -> GearPredictor:
    """Of a layshaft that nothing but its drag and its brake slow down; pressure comes at once."""
    model = MotionModel(np.array([0.0, G, 1.0]), first_order_law(1e5, SUPPLY), np.zeros(4))
    layshaft = LayshaftState(LAYSHAFT_US, THETA, OMEGA, 0.0, 4e-3, 0.25, drag_rad_s2=drag)
    made = GearPredictor(
        MainGear.THIRD, I_GEAR, layshaft, MAIN, brake or BrakeInput(0), model,
        cast(PhaseReferences, References()), 45_000, DELAY_SD_S, DRIFT, SHARE,
    )  # fmt: skip
    return replace(made, **changed)


def layshaft_at(time_us: float, drag: float = DRAG) -> tuple[float, float]:
    t = (time_us - LAYSHAFT_US) * 1e-6
    return THETA + OMEGA * t + drag * t * t / 2.0, OMEGA + drag * t


def main_at(time_us: float) -> tuple[float, float]:
    t = (time_us - MAIN_US) * 1e-6
    return MAIN_THETA + MAIN_OMEGA * t + MAIN_ACCELERATION * t * t / 2.0, (
        MAIN_OMEGA + MAIN_ACCELERATION * t
    )


def phase_and_slip(time_us: float) -> tuple[float, float]:
    (theta, omega), (theta_main, omega_main) = layshaft_at(time_us), main_at(time_us)
    drifted = DRIFT * (time_us - MAIN_US) * 1e-6
    phase = I_GEAR * theta - theta_main + AT_ZERO + drifted
    return phase, I_GEAR * omega - omega_main + DRIFT


def brake_on(off_us: int = 1_000) -> BrakeInput:
    """Pressed from 2 ms on, for ever; it lets go `off_us` after its release."""
    brake = BrakeInput(0)
    brake.set_delays(off_us=off_us, on_us=500)
    brake.schedule(1_500, True, -1)
    return brake


@pytest.mark.parametrize("time_us", [3_000.0, 21_000.0, 81_000.0])
def test_phase_and_slip_are_those_of_two_shafts_that_slow_down_steadily(time_us: float) -> None:
    phase, slip = phase_and_slip(time_us)
    found = predictor().phase_and_slip(time_us)
    assert found == pytest.approx((phase, slip), abs=1e-12)
    assert predictor().slip_rad_s(time_us) == pytest.approx(slip, abs=1e-12)
    assert predictor().steady_slip_rad_s(time_us) == pytest.approx(slip, abs=1e-12)


def test_a_brake_takes_speed_until_it_lets_go() -> None:
    """From 2 ms to 1 ms after its release; without one, for ever."""
    braked, at_us = predictor(brake=brake_on()), 30_000.0
    _, slip = phase_and_slip(at_us)
    for release_us, braked_s in ((9_000, 8e-3), (20_000, 19e-3), (None, 28e-3)):
        expected = slip - I_GEAR * BRAKED_RAD_S2 * braked_s
        for ask in (braked.slip_rad_s, braked.steady_slip_rad_s):
            assert ask(at_us, release_us) == pytest.approx(expected, abs=0.02)
        omega = braked.layshaft_at(at_us, release_us).omega_rad_s
        assert omega == pytest.approx(layshaft_at(at_us)[1] - BRAKED_RAD_S2 * braked_s, abs=0.02)


class Swings:
    """The swing of a main shaft: now 3 rad/s of its speed, and later something else."""

    speed_rad_s = 3.0

    def ahead(self, wait_s: float) -> tuple[float, float]:
        return 7.0 + wait_s, 70.0 + 2.0 * wait_s


def test_brake_and_drag_have_to_bring_down_the_slip_against_a_shaft_that_does_not_swing() -> None:
    swinging = predictor(main=MAIN._replace(swing=cast(Any, Swings())))
    time_us = 23_000.0
    omega = I_GEAR * layshaft_at(time_us)[1]
    assert swinging.slip_rad_s(time_us) == pytest.approx(omega - 70.04 + DRIFT)
    steady = main_at(time_us)[1] - 3.0
    assert swinging.steady_slip_rad_s(time_us) == pytest.approx(omega - steady + DRIFT)


@pytest.mark.parametrize("time_us", [3_000.0, 43_000.0])
def test_what_is_not_known_of_both_speeds_grows_with_time(time_us: float) -> None:
    """Without a covariance: sd of the angle and of the speed over the time, as independent; the
    sleeve's delay besides, by the slip. The filters' own are taken by the learned share."""
    layshaft = math.hypot(4e-3, 0.25 * (time_us - LAYSHAFT_US) * 1e-6)
    main = math.hypot(3e-3, 0.5 * (time_us - MAIN_US) * 1e-6)
    slip = phase_and_slip(time_us)[1]
    for shaft, share in ((MAIN, SHARE), (Cloudy(*MAIN), 1.0)):
        expected = (SHARE * I_GEAR * layshaft) ** 2 + (share * main) ** 2
        made = predictor(main=shaft)
        assert made.estimate_variance(time_us) == pytest.approx(expected)
        sd = math.sqrt(expected + (slip * DELAY_SD_S) ** 2)
        assert made.phase_sd_rad(time_us) == pytest.approx(sd)
        known = made.variances(time_us, 1_000.0, 3)
        assert known == pytest.approx(np.full(3, expected))


COVARIANCE = np.diag([16e-6, 0.0625, 0.0, 0.0, 0.0, 0.0])
COVARIANCE[0, 1] = COVARIANCE[1, 0] = -5e-4


def test_a_covariance_tells_how_errors_of_angle_and_speed_go_together() -> None:
    """var(theta + omega t) = var theta + 2 t cov + t^2 var omega."""
    made = predictor()
    told = replace(made, layshaft=made.layshaft._replace(covariance=COVARIANCE))
    for time_us in (LAYSHAFT_US, 41_000.0):
        t = (time_us - LAYSHAFT_US) * 1e-6
        layshaft = 16e-6 - 2.0 * t * 5e-4 + t * t * 0.0625
        main = MAIN.theta_sd_at(time_us) ** 2
        expected = (SHARE * I_GEAR) ** 2 * layshaft + SHARE**2 * main
        assert told.estimate_variance(time_us) == pytest.approx(expected)
        assert told.variances(time_us, 5e3, 2) == pytest.approx(np.full(2, expected)), "no edges"


Looked = list[tuple[Ticks, Vector]]


def looking(monkeypatch: pytest.MonkeyPatch, known: list[float]) -> Looked:
    """What the filter will know is this, tick by tick; returns what it is asked."""
    asked: Looked = []

    def outlook(_state: object, ticks: Ticks, switches: Vector, _model: object) -> Vector:
        asked.append((ticks, switches))
        return np.array(known)

    monkeypatch.setattr(gear_predictor, "outlook", outlook)
    return asked


def heard(brake: BrakeInput | None = None, edge_rad2_s: float = 1e-6) -> GearPredictor:
    made = predictor(brake=brake, main=MAIN._replace(theta_sd_rad=0.0, omega_sd_rad_s=0.0))
    state = made.layshaft._replace(covariance=COVARIANCE, edge_rad2_s=edge_rad2_s)
    return replace(made, layshaft=state)


def test_what_edges_will_tell_comes_tick_by_tick_of_10_ms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = looking(monkeypatch, [8e-6, 4e-6, 2e-6])
    found = heard(brake_on()).variances(31_000.0, 5_000.0, 5)
    scale = (SHARE * I_GEAR) ** 2
    assert found == pytest.approx(scale * np.array([8e-6, 6e-6, 4e-6, 3e-6, 2e-6]))
    ((ticks, switches),) = asked
    assert ticks == Ticks(30_000.0, 10_000.0, 2 + 2)
    assert switches.tolist() == [[2_000.0], [1.0]]
    heard(brake_on()).variances(500.0, 5_000.0, 5, 9_000)
    ticks, switches = asked[1]
    assert ticks.horizon_us == 0.0, "never back in time"
    assert switches.tolist() == [[2_000.0, 10_000.0], [1.0, 0.0]]


@pytest.mark.parametrize(("count", "looks"), [(27, 2 + 13), (29, 16), (60, 16)])
def test_no_more_than_16_ticks_are_looked_ahead(
    count: int, looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = looking(monkeypatch, [1e-6])
    heard().variances(31_000.0, 5_000.0, count)
    assert asked[0][0].looks == looks


@pytest.mark.parametrize("edge_rad2_s", [0.0, -1.0])
def test_an_estimator_that_says_nothing_of_edges_will_know_no_more_than_now(
    edge_rad2_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not looking(monkeypatch, [])
    found = heard(edge_rad2_s=edge_rad2_s).variances(41_000.0, 5_000.0, 4)
    layshaft = 16e-6 - 2.0 * 0.04 * 5e-4 + 0.04**2 * 0.0625
    assert found == pytest.approx(np.full(4, (SHARE * I_GEAR) ** 2 * layshaft))


class Told(GearPredictor):
    """Which will know an n-th of the variance at the n-th tick, and now knows by `growth`."""

    asked: list[tuple[float, float, int]]
    growth: Callable[[float], float]

    def variances(
        self, first_us: float, step_us: float, count: int, release_us: float | None = None
    ) -> Vector:
        assert release_us is None
        self.asked.append((first_us, step_us, count))
        return np.asarray(1e-6 / (1.0 + np.arange(count)))

    def estimate_variance(self, time_us: float) -> float:
        return self.growth(time_us)


def told(growth: Callable[[float], float]) -> Told:
    made = predictor()
    values = {name: getattr(made, name) for name in GearPredictor.__dataclass_fields__}
    other = Told(**values)
    object.__setattr__(other, "asked", [])
    object.__setattr__(other, "growth", growth)
    return other


NOW_US, LOOK = 100_000, LastLook(36_000.0, 10_000)


def test_a_contact_is_as_uncertain_as_its_last_look_leaves_it() -> None:
    """A look comes every 10 ms; what is left of one is what is known 36 ms ahead of it, and so much
    more as the contact is later than that, up to a tick: here one and a half times at a tick."""
    made = told(lambda time_us: 1.0 + 0.5 * (time_us - NOW_US - 36_000.0) / 10_000.0)
    found = made.told_variances(NOW_US + 31_000.0, 5_000.0, 8, NOW_US, LOOK)
    shares = [1.0, 1.0, 1.25, 1.0, 1.25, 1.0, 1.25, 1.0]
    ticks = [0, 0, 0, 1, 1, 2, 2, 3]
    assert found == pytest.approx([1e-6 / (1 + k) * s for k, s in zip(ticks, shares, strict=True)])
    assert made.asked == [(NOW_US + 36_000, 10_000.0, 4)]


def test_how_a_variance_grows_within_a_tick_is_taken_from_its_half_and_whole() -> None:
    """Straight between: a parabola is met at 0 and 5 ms, and at 2.5 and 7.5 ms its chords are."""
    made = told(lambda time_us: 2.0 + ((time_us - NOW_US - 36_000.0) / 10_000.0) ** 2)
    found = made.told_variances(NOW_US + 36_000.0, 2_500.0, 4, NOW_US, LOOK)
    assert found == pytest.approx(1e-6 / 2.0 * np.array([2.0, 2.125, 2.25, 2.625]))


def test_where_everything_is_known_nothing_grows() -> None:
    found = told(lambda _: 0.0).told_variances(NOW_US + 36_000.0, 10_000.0, 2, NOW_US, LOOK)
    assert found.tolist() == [1e-6, 0.5e-6]
    known_now = told(lambda time_us: float(time_us > NOW_US + 36_000.0))
    assert known_now.told_variances(NOW_US + 36_000.0, 5e3, 2, NOW_US, LOOK).tolist() == [1e-6] * 2


def test_a_trajectory_is_phase_and_slip_step_by_step() -> None:
    found = predictor().trajectory(6_000.0, 4_000.0, 3)
    times = [6_000.0, 10_000.0, 14_000.0]
    assert found[:2] == (6_000.0, 4_000.0)
    phases, slips = zip(*(phase_and_slip(time_us) for time_us in times), strict=True)
    assert found.phase_rad == pytest.approx(list(phases), abs=1e-12)
    assert found.slip_rad_s == pytest.approx(list(slips), abs=1e-12)
    assert isinstance(found, Trajectory)


def test_a_trajectory_after_a_release_has_lost_what_the_brake_has_taken() -> None:
    braked = predictor(brake=brake_on())
    for release_us, braked_s in ((9_000.0, 8e-3), (None, 38e-3)):
        found = braked.trajectory(40_000.0, 1_000.0, 1, release_us)
        expected = phase_and_slip(40_000.0)[1] - I_GEAR * BRAKED_RAD_S2 * braked_s
        assert found.slip_rad_s[0] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    "firsts_us", [(40e3, 40e3, 52e3), (40e3, 52e3, 40e3), (52e3, 40e3, 40e3), (40e3, 50e3, 60e3)]
)
def test_each_release_has_its_course_from_its_own_time_on(
    firsts_us: tuple[float, float, float],
) -> None:
    """Both shafts, at each of the times; the brake lets go 1 ms after each release."""
    braked, releases_us = predictor(brake=brake_on()), (9_000, 20_000, 30_000)
    found = braked.trajectories(releases_us, firsts_us, 4_000.0, 2)
    assert found.shape == (3, 2, 2)
    for row, release_us, first_us in zip(found, releases_us, firsts_us, strict=True):
        braked_s = (release_us + 1_000 - 2_000) * 1e-6
        for k, time_us in enumerate((first_us, first_us + 4_000.0)):
            phase, slip = phase_and_slip(time_us)
            left_s = (time_us - release_us - 1_000) * 1e-6
            lost = BRAKED_RAD_S2 * (braked_s**2 / 2.0 + braked_s * left_s)
            assert row[1, k] == pytest.approx(slip - I_GEAR * BRAKED_RAD_S2 * braked_s, abs=0.02)
            assert row[0, k] == pytest.approx(phase - I_GEAR * lost, abs=1e-3)


def test_one_release_has_one_course() -> None:
    found = predictor(brake=brake_on()).trajectories((9_000,), (40e3,), 4_000.0, 1)
    expected = phase_and_slip(40e3)[1] - I_GEAR * BRAKED_RAD_S2 * 8e-3
    assert found[:, 1].tolist() == [[pytest.approx(expected, abs=0.02)]]


def test_the_release_that_leaves_a_slip_is_told_by_what_the_brake_takes_in_a_second() -> None:
    """Slip at rest without the brake is straight in time, and so it is in the release."""
    made = predictor(brake=brake_on())
    settle_us = 50_000.0

    def left(release_us: float) -> float:
        slip = phase_and_slip(release_us + settle_us)[1]
        return slip - I_GEAR * BRAKED_RAD_S2 * (release_us + 1_000.0 - 2_000.0) * 1e-6

    for release_us in (5_000, 13_000, 18_000):
        found = made.release_time_us(4_000, 20_000, left(release_us), settle_us)
        assert found == pytest.approx(release_us, abs=30)
    assert made.release_time_us(4_000, 20_000, left(3_000), settle_us) == 4_000
    assert made.release_time_us(4_000, 20_000, left(21_000), settle_us) == 20_000


def test_slip_falls_by_drag_alone_to_a_value_at_a_time() -> None:
    made = predictor()
    for time_us in (9_000, 33_000):
        slip = phase_and_slip(time_us)[1]
        assert made.slip_falls_to_us(slip, 5_000, 40_000) == pytest.approx(time_us, abs=10)
    assert made.slip_falls_to_us(phase_and_slip(4_000)[1], 5_000, 40_000) == 5_000
    assert made.slip_falls_to_us(phase_and_slip(50_000)[1], 5_000, 40_000) == 40_000


def asking(first: int, last: int, *said: float) -> tuple[int, list[int]]:
    """The root between two times if these are the values found, and where they were asked for."""
    at: list[int] = []
    values = iter(said)

    def over(time_us: int) -> float:
        at.append(time_us)
        return next(values)

    return _falling_root(over, first, last), at


def test_an_end_that_is_kept_twice_has_half_its_weight() -> None:
    """False position between (0, 3) and (1000, -1): at 750. There it is 1, so between that and
    -1: 875. Again 1, and the end at 1000 counts half: 2/3 of the way, 958. There -2; a third of the
    way from 875: 903. Again -2: the end at 875 counts half, a fifth of the way to 903."""
    found, at = asking(0, 1_000, 3.0, -1.0, 1.0, 1.0, -2.0, -2.0, 0.0)
    assert at == [0, 1_000, 750, 875, 958, 903, 881]
    assert found == 881


def test_an_end_that_was_kept_before_the_other_has_its_whole_weight() -> None:
    """From 0 to 1000, 1 and -1: 500. There -1, then at 250 +1, at 375 -1 again: no end is kept
    twice running, so the middle is taken each time."""
    found, at = asking(0, 1_000, 1.0, -1.0, -1.0, 1.0, -1.0, 0.0)
    assert at == [0, 1_000, 500, 250, 375, 312]
    assert found == 312


@pytest.mark.parametrize(("above", "below", "asked"), [(1.0, -1e9, 10), (1e9, -1.0, 9_990)])
def test_no_step_is_shorter_than_a_thousandth(above: float, below: float, asked: int) -> None:
    assert asking(0, 10_000, above, below, 0.0) == (asked, [0, 10_000, asked])


@pytest.mark.parametrize(("near", "count"), [(0.99e-4, 3), (-0.99e-4, 3), (1e-4, 4), (-1e-4, 4)])
def test_less_than_a_tenth_of_a_milliradian_a_second_is_close_enough(
    near: float, count: int
) -> None:
    _, at = asking(0, 10_000, 1.0, -1.0, near, 0.0)
    assert len(at) == count


def test_there_is_nothing_to_look_for_between_two_microseconds() -> None:
    assert asking(5, 6, 3.0, -1.0, 1.0)[1] == [5, 6, 6]
    assert asking(5, 7, 1.0, -1.0, 1.0, 1.0)[1] == [5, 7, 6, 6]


def test_an_end_is_the_answer_where_the_root_is_not_between_them() -> None:
    for above, below, expected in ((0.0, -1.0, 5), (-1.0, -2.0, 5), (1.0, 0.0, 9), (2.0, 1.0, 9)):
        assert asking(5, 9, above, below)[0] == expected


def test_the_search_gives_up_after_forty_steps() -> None:
    """To halve ten to the fifteen microseconds forty times leaves 909 of them."""
    signs = [(-1.0) ** k for k in range(60)]
    found, at = asking(0, 10**15, 1.0, -1.0, *signs)
    assert len(at) == 2 + 40
    assert found == at[-1]
