"""The price of a contact and the trajectory up to it, by normal law and constant deceleration."""

from __future__ import annotations

import math

import normal_law
import numpy as np
import pytest

from meshpoint.controller.models.layshaft import BrakeInput, MotionModel, first_order_law
from meshpoint.controller.plan.gear_predictor import MEETING, trajectories, trajectory
from meshpoint.controller.plan.target_phase import CONTACT_SERIES, TERMS, best_trajectory, cheapest
from meshpoint.kernels.records import Vector, filled

PITCH, HALF, TARGET = 0.13, 0.02, 0.004
OVERLAP_S, DELAY_SD_S = 2e-3, 1.5e-3
MISS_S, BLOCK_S, BLOCK_SLIP = 0.3, 0.7, 1.25
ENERGY, AIM_S, LOW, HIGH = 0.002, 0.06, -2.0, 5.0


def terms(**changed: float) -> Vector:
    values = {
        "pitch_rad": PITCH, "half_gap_rad": HALF, "target_rad": TARGET, "overlap_s": OVERLAP_S,
        "delay_sd_s": DELAY_SD_S, "miss_s": MISS_S, "block_s": BLOCK_S,
        "block_slip_rad_s": BLOCK_SLIP, "energy_s3_rad2": ENERGY, "aim_s": AIM_S,
        "slip_low_rad_s": LOW, "slip_high_rad_s": HIGH,
    }  # fmt: skip
    return filled(TERMS, **(values | changed))


FREE = {"miss_s": 0.0, "block_s": 0.0, "energy_s3_rad2": 0.0, "aim_s": 0.0}
"""Nothing has a price but time, and slips that are not allowed."""


def series(wait_s: float = 0.0, step_s: float = 0.0) -> Vector:
    return filled(CONTACT_SERIES, wait_s=wait_s, step_s=step_s)


def price(phase: float, slip: float, variance: float, of: Vector, wait_s: float = 0.0) -> float:
    """Of one contact alone."""
    at, moves, known = (np.array([each]) for each in (phase, slip, variance))
    index, cost = cheapest(at, moves, known, series(wait_s, 9.0), of)
    assert index == 0
    return float(cost)


@pytest.mark.parametrize("slip", [-3.0, -1.0, -0.2, 0.0, 0.3, 2.0, 4.0, 21.0])
@pytest.mark.parametrize("phase", [-0.05, -0.018, 0.0, 0.011, 0.024, 0.06])
def test_a_hit_is_as_likely_as_the_normal_law_says(phase: float, slip: float) -> None:
    """The tooth passes the overlap if it meets neither flank at its begin nor at its end: with no
    other price than 1 s for a miss, what is paid is the share of those that meet one."""
    variance = 1e-4
    paid = price(phase, slip, variance, terms(**FREE | {"miss_s": 1.0}, slip_low_rad_s=-99.0,
                                              slip_high_rad_s=99.0))  # fmt: skip
    moved = slip * OVERLAP_S
    low, high = max(-HALF, -HALF - moved), min(HALF, HALF - moved)
    sd = math.sqrt(variance + (slip * DELAY_SD_S) ** 2)
    centre = TARGET - moved / 2.0
    at = centre + math.remainder(phase - centre, PITCH)
    hit = max(0.0, float(normal_law.cdf(high, at, sd) - normal_law.cdf(low, at, sd)))
    assert paid == pytest.approx(1.0 - hit, abs=2e-6)


def test_a_phase_that_is_known_for_sure_is_still_off_by_a_hundredth_of_a_milliradian() -> None:
    """A standard deviation of 1e-5 rad: that far within the flank, five of six meet the gap."""
    paid = price(HALF - 1e-5, 0.0, 0.0, terms(**FREE | {"miss_s": 1.0}))
    assert paid == pytest.approx(float(normal_law.cdf(-1.0)), rel=1e-6)
    wide = price(HALF - 5e-3, 0.0, 25e-6, terms(**FREE | {"miss_s": 1.0}))
    assert wide == pytest.approx(float(normal_law.cdf(-1.0)), rel=1e-4)


@pytest.mark.parametrize(
    ("slip", "share"),
    [(0.0, 1.0), (1.0, 1.0), (1.25, 1.0), (2.5, 0.5), (-2.5, 0.5), (-5.0, 0.25), (12.5, 0.1)],
)
def test_a_miss_costs_more_the_slower_the_tooth_is_since_it_may_block(
    slip: float, share: float
) -> None:
    """In the middle of a tooth every contact misses."""
    of = terms(**FREE | {"miss_s": MISS_S, "block_s": BLOCK_S}, slip_low_rad_s=-99.0,
               slip_high_rad_s=99.0, delay_sd_s=0.0)  # fmt: skip
    assert price(PITCH / 2.0, slip, 0.0, of) == pytest.approx(MISS_S + BLOCK_S * share)


def test_below_a_microradian_a_second_no_slip_is_slower_than_that() -> None:
    """So that standing still has a price, too."""
    of = terms(**FREE | {"block_s": 1.0}, block_slip_rad_s=0.5e-6)
    for slip, share in ((0.0, 0.5), (0.5e-6, 0.5), (-2e-6, 0.25)):
        assert price(PITCH / 2.0, slip, 0.0, of) == pytest.approx(share)


@pytest.mark.parametrize(
    ("slip", "outside_s"),
    [(5.0, 0.0), (5.5, 0.05 + 0.05), (9.0, 0.05 + 0.4), (-2.0, 0.0), (-2.5, 0.05 + 0.05),
     (-6.0, 0.05 + 0.4), (0.0, 0.0)],
)  # fmt: skip
def test_a_slip_that_is_not_allowed_costs_50_ms_and_100_ms_for_each_rad_s_beyond(
    slip: float, outside_s: float
) -> None:
    assert price(0.0, slip, 0.0, terms(**FREE)) == pytest.approx(outside_s, abs=1e-12)


@pytest.mark.parametrize("slip", [-1.5, 0.0, 4.0])
@pytest.mark.parametrize("share", [-1.0, -0.44, 0.0, 0.3, 0.49])
@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_time_energy_and_aim_add_up(slip: float, share: float, turns: int) -> None:
    """Off the target by a share of the pitch, whatever the number of pitches; the target is where
    the tooth has half of its way through the overlap behind it."""
    of = terms(miss_s=0.0, block_s=0.0)
    off = PITCH * share
    phase = TARGET - 0.5 * slip * OVERLAP_S + off + turns * PITCH
    nearest = 0.0 if share == -1.0 else off
    expected = 0.25 + ENERGY * slip**2 + AIM_S * (nearest / HALF) ** 2
    assert price(phase, slip, 1e-5, of, wait_s=0.25) == pytest.approx(expected, abs=1e-12)


def test_a_miss_is_paid_beside_all_else() -> None:
    of, phase, slip = terms(delay_sd_s=0.0), 0.4 * PITCH, 7.0
    off = math.remainder(phase - (TARGET - 0.5 * slip * OVERLAP_S), PITCH)
    expected = 0.1 + MISS_S + BLOCK_S * BLOCK_SLIP / slip + ENERGY * slip**2
    expected += AIM_S * (off / HALF) ** 2 + 0.05 + 0.1 * (slip - HIGH)
    assert price(phase, slip, 1e-8, of, 0.1) == pytest.approx(expected)


def test_the_cheapest_of_a_trajectory_has_its_index_and_its_time() -> None:
    """Contacts come step by step."""
    of = terms(**FREE | {"aim_s": 1.0}, target_rad=0.0)
    phase, still = np.array([0.02, 0.018, 0.004, 0.004, -0.019]), np.zeros(5)
    known = np.full(5, 1e-6)
    index, cost = cheapest(phase, still, known, series(0.5, 0.125), of)
    assert (index, cost) == pytest.approx((2, 0.5 + 2 * 0.125 + 0.04))
    index, cost = cheapest(phase + 0.019, still, known, series(0.5, 0.0), of)
    assert (index, cost) == pytest.approx((4, 0.5))
    index, cost = cheapest(phase - 0.02, still, known, series(0.5, 9.0), of)
    assert (index, cost) == pytest.approx((0, 0.5))
    index, _ = cheapest(phase - 0.004, still, known, series(), of)
    assert index == 2, "of two that cost the same, the first"


def test_a_sure_miss_soon_costs_more_than_a_hit_later() -> None:
    """The first misses, the second hits, the third is worse by its time alone."""
    of = terms(energy_s3_rad2=0.0, aim_s=0.0, block_s=0.0)
    phase = np.array([PITCH / 2.0, 0.0, 0.0, 0.0])
    found = cheapest(phase, np.zeros(4), np.full(4, 1e-8), series(0.1, 0.2), of)
    assert found == pytest.approx((1, 0.3))
    assert cheapest(phase, np.zeros(4), np.full(4, 1e-8), series(0.1, 0.4), of)[0] == 0


def test_of_no_contact_at_all_there_is_no_price() -> None:
    none = np.empty(0)
    assert cheapest(none, none, none, series(), terms()) == (0, math.inf)
    no_trajectory = np.empty((0, 2, 1))
    assert best_trajectory(no_trajectory, none, none, series(), terms(), 0.0) == (0, 0)


def test_of_several_trajectories_the_cheapest_is_named_with_its_contact() -> None:
    of = terms(**FREE | {"aim_s": 1.0}, target_rad=0.0)
    off = np.array([[0.02, 0.01, 0.02], [0.02, 0.02, 0.006], [0.006, 0.02, 0.02]])
    found = np.zeros((3, 2, 3))
    found[:, 0] = off
    contacts, known = series(77.0, 0.0), np.full(3, 1e-6)
    for waits, best in (
        ([0.5, 0.5, 0.5], (1, 2)),  # of two that cost the same, the first
        ([0.5, 0.25, 0.125], (2, 0)),
        ([0.0, 0.25, 0.25], (0, 1)),
    ):
        assert best_trajectory(found, known, np.array(waits), contacts, of, 0.0) == best


@pytest.mark.parametrize(("comes_sd_rad", "chosen"), [(0.0, 0), (0.3 * HALF, 0), (1.5 * HALF, 1)])
def test_a_gap_in_which_the_tooth_hardly_moves_is_not_counted_on_while_its_phase_may_move(
    comes_sd_rad: float, chosen: int
) -> None:
    """At no slip one contact is as good as another, until the phase comes out beside the gap: then
    all of them miss. A tooth that moves through the gap later meets it sooner or later."""
    of = terms(**FREE | {"miss_s": 1.0}, target_rad=0.0)
    found = np.zeros((2, 2, 13))
    found[1, 0] = np.linspace(-3.0 * HALF, 3.0 * HALF, 13)
    waits, known = np.array([0.1, 0.2]), np.full(13, 1e-6)
    best = best_trajectory(found, known, waits, series(0.0, 1e-3), of, comes_sd_rad)
    assert best[0] == chosen


I_GEAR, REFERENCE = 0.8, 0.3
G, SUPPLY = 2e-3, 5e5


def motion(friction: float = 0.0) -> Vector:
    """A layshaft that nothing but its brake and a steady drag slow down; pressure comes at once."""
    rates = np.array([friction, G, 1.0])
    return MotionModel(rates, first_order_law(1e5, SUPPLY), np.zeros(4)).flat


def meeting(first_us: float, step_us: float = 4_000.0) -> Vector:
    return filled(MEETING, layshaft_us=1_000.0, first_us=first_us, step_us=step_us, i_gear=I_GEAR,
                  reference_rad=REFERENCE)  # fmt: skip


def main_trajectory(count: int) -> Vector:
    return np.array([2.0 + 0.25 * np.arange(count), 64.0 - 0.5 * np.arange(count)])


def layshaft(drag: float = -30.0, disturbance: float = 0.0) -> Vector:
    return np.array([1.5, 100.0, 0.0, disturbance, 1.0, drag])


def test_phase_and_slip_are_those_of_two_shafts_that_slow_down_steadily() -> None:
    """theta + omega t + s t^2 / 2."""
    found, x = main_trajectory(3), layshaft()
    trajectory(x, np.empty((2, 0)), motion(), meeting(6_000.0), found)
    after_s = np.array([5e-3, 9e-3, 13e-3])
    theta = 1.5 + 100.0 * after_s - 15.0 * after_s**2
    omega = 100.0 - 30.0 * after_s
    main = main_trajectory(3)
    assert np.allclose(found[0], I_GEAR * theta - main[0] - REFERENCE, atol=1e-12)
    assert np.allclose(found[1], I_GEAR * omega - main[1], atol=1e-12)
    assert np.array_equal(x, layshaft()), "the estimate itself stays"


def test_a_brake_that_is_released_takes_the_speed_that_its_pressure_lasts_for() -> None:
    """On from 2 ms to the release at 9 ms, 1 ms until the pressure goes: g p all that time. What
    was planned besides is forgotten, and each release begins anew."""
    brake = BrakeInput(0)
    brake.set_delays(off_us=1_000, on_us=500)
    brake.schedule(1_500, True, -1)
    brake.schedule(60_000, False, 1_500)
    x = layshaft(0.0)
    releases_us = [9_000.0, 4_000.0, 30_000.0]
    found = np.array([main_trajectory(2)] * 3)
    releases = np.array([releases_us, [at + 1_000.0 for at in releases_us], [40_000.0] * 3])
    trajectories(x, brake.commanded(), motion(), meeting(5.0), releases, found)
    for row, at_us in zip(found, releases_us, strict=True):
        braked_s = (at_us + 1_000.0 - 2_000.0) * 1e-6
        omega = 100.0 - G * SUPPLY * braked_s
        assert row[1, 0] == pytest.approx(I_GEAR * omega - 64.0, abs=1e-6 * G * SUPPLY)
        assert row[1, 1] == pytest.approx(row[1, 0] + 0.5)
    assert np.array_equal(x, layshaft(0.0))


@pytest.mark.parametrize("release_us", [-5_000.0, 2_000.0, 20_000.0, 20_001.0, 90_000.0])
def test_a_release_leaves_the_same_switches_as_the_brake_s_own_record_of_them(
    release_us: float,
) -> None:
    """On and off, and on twice again: those after the release, and the release that it replaces, do
    not come."""
    brake = BrakeInput(0)
    brake.set_delays(off_us=1_000, on_us=2_500)
    switched = ((2_000, True), (9_000, False), (20_000, True), (70_000, False), (80_000, True))
    for at_us, on in switched:
        brake.schedule(at_us, on, at_us - 1)
    found, alone = np.array([main_trajectory(30)]), main_trajectory(30)
    releases = np.array([[release_us], [release_us + 1_000.0], [3_000.0]])
    trajectories(layshaft(), brake.commanded(), motion(2.0), meeting(5.0), releases, found)
    trajectory(layshaft(), brake.with_release(release_us), motion(2.0), meeting(3_000.0), alone)
    assert np.allclose(found[0], alone, rtol=0.0, atol=1e-12)


def test_a_brake_that_was_never_on_can_be_released() -> None:
    found, alone = np.array([main_trajectory(4)]), main_trajectory(4)
    releases = np.array([[5_000.0], [6_000.0], [3_000.0]])
    commands = BrakeInput(0).commanded()
    trajectories(layshaft(), commands, motion(), meeting(5.0), releases, found)
    trajectory(layshaft(), np.empty((2, 0)), motion(), meeting(3_000.0), alone)
    assert np.array_equal(found[0], alone)
