"""The driveline with a gear in mesh, step by step: each against an independent calculation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import norm

from meshpoint.controller.estimation.loaded_driveline import (
    Load,
    LoadedDriveline,
    Shafts,
)
from meshpoint.controller.estimation.loaded_kernels import (
    GEAR,
    GEAR_SPEED,
    HILL,
    LOADED_MODEL,
    LOADED_STATES,
    TWIST,
    TYRE,
    VEHICLE,
    VEHICLE_INVERSE,
    WHEELS,
    WRONG,
    beyond_flanks,
    loaded_ahead,
)
from meshpoint.controller.records import Vector, filled
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET = load_sheet("truck12")
AXLE = SHEET.axle
GEAR_5 = DRIVE_GEARS[5]
SHAFTS = Shafts(20e3, math.radians(1.0))
BEHIND = SHEET.range_mesh(GEAR_5.range_).ratio
TO_OUTPUT = BEHIND * SHEET.main_mesh(GEAR_5.main).ratio
"""Angle of the propeller shaft over that of the layshaft."""
RATIO = SHEET.overall_ratio(GEAR_5)


class Stiff(NamedTuple):
    """A driveline that swings by a third of a radian within a step."""

    geared_kgm2: float = 2.0
    driving_nm: float = 450.0
    tooth_rad: float = 4e-3
    shaft_nm_rad: float = 150e3
    shaft_nms: float = 40.0
    half_lash_rad: float = 0.02
    wheels_kgm2: float = 3.0
    tyre_nm_rad: float = 260e3
    tyre_nms: float = 70.0
    relaxation_rad: float = 0.05
    wrong_nm: float = 30.0
    wrong_s: float = 4e-3
    gear_rad2_s3: float = 5.0
    wheels_rad2_s3: float = 7.0
    hill_rad2_s5: float = 11.0
    fading_s: float = 13.0

    def flat(self) -> Vector:
        return filled(LOADED_MODEL, **self._asdict())

    def rates(self, x: Vector, flanks: tuple[float, float], at: Vector) -> Vector:
        """The equations at the head of `loaded_kernels`. What bends is taken as it is in the state
        `at`: the twist beyond the flanks with its slope, and how fast a tyre's twist fades."""
        mean, slope = flanks
        twist = mean + slope * (x[TWIST] - at[TWIST])
        slip = x[GEAR_SPEED] - x[WHEELS]
        shafts = self.shaft_nm_rad * twist + self.shaft_nms * slope * slip
        fading = abs(at[VEHICLE]) / self.relaxation_rad
        # y' = slip of carcass and contact: (w_A - w_V) less what the tyre's torque lets slip.
        held = 1.0 + fading * self.tyre_nms / self.tyre_nm_rad
        twisting = (x[WHEELS] - x[VEHICLE] - fading * x[TYRE]) / held
        tyre = self.tyre_nm_rad * x[TYRE] + self.tyre_nms * twisting
        found = np.zeros(LOADED_STATES)
        found[GEAR] = x[GEAR_SPEED]
        found[GEAR_SPEED] = (self.driving_nm + x[WRONG] - shafts) / self.geared_kgm2
        found[TWIST] = slip
        found[WHEELS] = (shafts - tyre) / self.wheels_kgm2
        found[TYRE] = twisting
        found[VEHICLE] = x[VEHICLE_INVERSE] * tyre + x[HILL]
        found[WRONG] = -x[WRONG] / self.wrong_s
        return found

    def flanks(self, x: Vector, sd: float) -> tuple[float, float]:
        """The twist beyond them, and its slope."""
        return mean_beyond(x[TWIST] + self.tooth_rad, sd, self.half_lash_rad)

    def slopes(self, x: Vector, flanks: tuple[float, float]) -> Vector:
        """Their derivatives, by differences: but for the vehicle's inertia they are linear."""
        scales = np.array((1.0, 1.0, 1e-3, 1.0, 1e-3, 1.0, 1.0, 10.0, 1e-4))
        columns = [
            (self.rates(x + s * e, flanks, x) - self.rates(x - s * e, flanks, x)) / (2.0 * s)
            for s, e in zip(scales, np.eye(LOADED_STATES), strict=True)
        ]
        return np.stack(columns, axis=1)

    def noise(self, x: Vector) -> Vector:
        """Densities of what drives the states."""
        found = np.zeros(LOADED_STATES)
        faded = x[VEHICLE] / self.relaxation_rad * x[TYRE]
        found[GEAR_SPEED], found[WHEELS] = self.gear_rad2_s3, self.wheels_rad2_s3
        found[TYRE], found[HILL] = self.fading_s * faded**2, self.hill_rad2_s5
        found[WRONG] = 2.0 * self.wrong_nm**2 / self.wrong_s
        return found


def mean_beyond(angle: float, sd: float, half: float) -> tuple[float, float]:
    """Mean of an angle beyond the flanks and the share that lies there, by a sum."""
    if sd == 0.0:
        return angle - min(max(angle, -half), half), float(abs(angle) > half)
    at = angle + sd * np.linspace(-8.0, 8.0, 200_001)
    law = np.exp(-0.5 * ((at - angle) / sd) ** 2)
    beyond = at - np.clip(at, -half, half)
    share = norm.cdf(-half, angle, sd) + norm.sf(half, angle, sd)
    return float(law @ beyond / law.sum()), float(share)


def a_state(twist: float, vehicle: float = 19.0) -> Vector:
    x = np.zeros(LOADED_STATES)
    x[GEAR], x[GEAR_SPEED], x[TWIST], x[WHEELS] = 0.4, 20.0, twist, 21.5
    x[TYRE], x[VEHICLE], x[HILL], x[WRONG] = 0.007, vehicle, -0.6, 25.0
    x[VEHICLE_INVERSE] = 1.0 / 40.0
    return x


def a_spread(twist_sd: float) -> Vector:
    root = np.eye(LOADED_STATES) + 0.2 * np.random.default_rng(4).standard_normal((9, 9))
    whole = root @ root.T
    sd = np.sqrt(np.diag(whole))
    scales = np.array((0.01, 0.3, twist_sd, 0.4, 2e-3, 0.2, 0.5, 20.0, 3e-3))
    found: Vector = whole / np.outer(sd, sd) * np.outer(scales, scales)
    return found


@pytest.mark.parametrize(("seconds", "parts"), [(1.3e-3, 1), (0.9e-3, 1), (1.4e-3, 2),
                                                (2.5e-3, 2), (2.7e-3, 3), (0.0, 1)])  # fmt: skip
@pytest.mark.parametrize(("twist", "sd"), [(0.03, 0.0), (-0.05, 0.0), (0.015, 0.004)])
@pytest.mark.parametrize("vehicle", [19.0, -17.0])
def test_a_step_is_the_exponential_up_to_its_third_power_and_none_is_longer_than_1_3_ms(
    seconds: float, parts: int, twist: float, sd: float, vehicle: float
) -> None:
    """Noise is added at each step's end."""
    stiff = Stiff()
    x, p = a_state(twist, vehicle), a_spread(sd)
    if sd == 0.0:
        p[TWIST], p[:, TWIST] = 0.0, 0.0
    found, spread = x.copy(), p.copy()
    loaded_ahead(found, spread, seconds, stiff.flat())
    dt = seconds / parts
    for _ in range(parts):
        seen_sd = math.sqrt(max(p[TWIST, TWIST], 0.0))
        if seen_sd < 1e-3:
            seen_sd = 0.0  # far from the flanks nothing bends
        flanks = stiff.flanks(x, seen_sd)
        rate, a = stiff.rates(x, flanks, x), stiff.slopes(x, flanks) * dt
        series = np.eye(LOADED_STATES) + a / 2.0 + a @ a / 6.0
        x = x + dt * series @ rate
        f = np.eye(LOADED_STATES) + a @ series
        p = f @ p @ f.T + dt * np.diag(stiff.noise(x))
    scale = np.maximum(np.abs(x), 1e-3)
    assert found / scale == pytest.approx(x / scale, rel=1e-6, abs=1e-6)
    sds = np.sqrt(np.diag(p)) + 1e-9
    assert spread / np.outer(sds, sds) == pytest.approx(p / np.outer(sds, sds), abs=2e-5)


def test_a_step_begun_where_rounding_made_a_variance_negative_is_one_of_a_known_twist() -> None:
    x, p = a_state(0.03), np.zeros((LOADED_STATES, LOADED_STATES))
    other, same = x.copy(), p.copy()
    p[TWIST, TWIST] = -1e-18
    loaded_ahead(x, p, 1e-3, Stiff().flat())
    loaded_ahead(other, same, 1e-3, Stiff().flat())
    assert x == pytest.approx(other)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_backlash_s_corner_is_as_round_as_an_angle_known_to_a_hundred_thousandth(
    side: float,
) -> None:
    """At the flank itself: sd / sqrt(2 pi) beyond it, and half of it pressed."""
    mean, slope = beyond_flanks(side * 0.02, 0.0, 0.02)
    assert mean == pytest.approx(side * 1e-5 / math.sqrt(2.0 * math.pi))
    assert slope == pytest.approx(0.5)
    assert beyond_flanks(side * 0.02, 3e-5, 0.02)[0] == pytest.approx(3.0 * mean)


def even(first_us: float, rad_s: float, count: int = 4, off: float = 0.0) -> Vector:
    """Edges of a shaft at an even speed."""
    times = first_us + 1000.0 * np.arange(count)
    return np.array((times, off + rad_s * 1e-6 * times))


LOAD = Load(torque_nm=250.0, carries=True, drag_nm=6.0)
SPEED = 30.0
"""Of the propeller shaft."""


def take(
    loaded: LoadedDriveline, k: int, load: Load = LOAD, off: float = 0.0, tooth: float = 0.0
) -> None:
    """The k-th step of 4 ms: a look at 4 k + 1.5 ms; both shafts off by so much, the main shaft
    by its tooth, too."""
    layshaft = even(4000.0 * k, SPEED / TO_OUTPUT, off=off / TO_OUTPUT)
    main = even(4000.0 * k + 500.0, SPEED / BEHIND, off=(off + tooth) / BEHIND)
    loaded.take(GEAR_5, layshaft, main, load, SHAFTS)


def a_loaded(steps: int = 8, load: Load = LOAD) -> LoadedDriveline:
    loaded = LoadedDriveline(SHEET)
    for k in range(steps):
        take(loaded, k, load)
    return loaded


def test_what_the_filter_takes_as_known_is_the_sheet_s_as_felt_at_the_propeller_shaft() -> None:
    """Torques over the ratio in front of it, inertias over its square; with the clutch closed the
    engine turns, too."""
    loaded = LoadedDriveline(SHEET)
    layshaft = RATIO * SHEET.split_mesh(GEAR_5.split).ratio
    still = AXLE.propeller_kgm2 + AXLE.main_kgm2 / BEHIND**2 + SHEET.geared_kgm2(GEAR_5)
    drag_nm = layshaft * 6.0 + AXLE.pinion_nm + AXLE.loose_nm / BEHIND
    for carries in (False, True):
        take(loaded, 0, LOAD._replace(carries=carries))
        found = loaded._model.view(LOADED_MODEL)[0]
        turned = still + (SHEET.engine.inertia_kgm2 * RATIO**2 if carries else 0.0)
        expected = {
            "geared_kgm2": turned,
            "driving_nm": (RATIO * 250.0 if carries else 0.0) - drag_nm,
            "tooth_rad": 0.0,
            "shaft_nm_rad": 20e3,
            "shaft_nms": 10.0,
            "half_lash_rad": math.radians(1.0),
            "wheels_kgm2": AXLE.wheels_kgm2,
            "tyre_nm_rad": AXLE.tyre_nm_rad,
            "tyre_nms": AXLE.tyre_nms,
            "relaxation_rad": AXLE.relaxation_rad,
            "wrong_nm": RATIO * (SHEET.engine.error_nm if carries else 2.0),
            "wrong_s": 0.2,
            # A torque of memory tau and deviation s is white noise of density 2 s^2 tau.
            "gear_rad2_s3": 2.0 * (AXLE.propeller_chance_nm / turned) ** 2 * AXLE.chance_s,
            "wheels_rad2_s3": 2.0 * (AXLE.road_chance_nm / AXLE.wheels_kgm2) ** 2
            * AXLE.road_chance_s,
            # One that is forgotten in 40 s is driven by 2 s^2 / 40 s.
            "hill_rad2_s5": 2.0 * AXLE.vehicle_rad_s2**2 / 40.0,
            "fading_s": 2.0 * 0.4**2 * 1.0,
        }  # fmt: skip
        assert {name: float(found[name]) for name in expected} == pytest.approx(expected)


def test_eight_looks_begin_it_with_a_line_through_them_and_what_the_sheet_leaves_open() -> None:
    loaded = LoadedDriveline(SHEET)
    for k in range(8):
        assert not loaded._running
        take(loaded, k, off=2e-3 * (-1.0) ** k)
    assert loaded._running
    at_us = 4000.0 * np.arange(8) + 1500.0
    angles = SPEED * 1e-6 * at_us + 2e-3 * (-1.0) ** np.arange(8)
    # The line by its two sums.
    waits = at_us - at_us.mean()
    slope = (waits @ angles) / (waits @ waits)
    x, p = loaded._x, loaded._p
    assert x[GEAR] == pytest.approx(angles.mean() + slope * (at_us[-1] - at_us.mean()))
    assert x[[GEAR_SPEED, WHEELS, VEHICLE]] == pytest.approx(slope * 1e6)
    assert not x[[TWIST, TYRE, HILL, WRONG]].any()
    light, heavy = SHEET.driveline.vehicle_kgm2
    assert x[VEHICLE_INVERSE] == pytest.approx((1.0 / light + 1.0 / heavy) / 2.0)
    # An even law between two limits has their distance over the root of 12.
    sds = {GEAR: 0.02, GEAR_SPEED: 0.4, WHEELS: 0.4, VEHICLE: 0.4,
           TWIST: math.radians(1.0) + 1000.0 / 20e3, TYRE: 1000.0 / AXLE.tyre_nm_rad,
           HILL: AXLE.vehicle_rad_s2, WRONG: RATIO * SHEET.engine.error_nm,
           VEHICLE_INVERSE: (1.0 / light - 1.0 / heavy) / math.sqrt(12.0)}  # fmt: skip
    assert p == pytest.approx(np.diag([sds[i] ** 2 for i in range(LOADED_STATES)]))
    assert (loaded._time_us, loaded._began_us, loaded._doubt) == (at_us[-1], at_us[-1], 1.0)


@pytest.mark.parametrize("sds", [0.5, 3.9, -6.0, 8.0])
def test_a_look_is_kalman_s_and_one_that_is_far_off_counts_as_four_deviations(sds: float) -> None:
    """Its gain falls with the square of how far off it is: so far the correction is that of a
    variance that makes it four. Doubt is the mean square, an old one counting nine tenths."""
    loaded = a_loaded()
    loaded._doubt = 3.0
    x, p = loaded._x.copy(), loaded._p.copy()
    loaded_ahead(x, p, 4e-3, loaded._model)
    variance = p[GEAR, GEAR] + (math.radians(0.1) * BEHIND) ** 2
    off = sds * math.sqrt(variance)
    take(loaded, 8, off=off - (SPEED * 1e-6 * 33_500.0 - x[GEAR]))
    whole = variance * max(1.0, (sds / 4.0) ** 2)
    gain = p[:, GEAR] / whole
    x = x + gain * off
    light, heavy = SHEET.driveline.vehicle_kgm2
    x[VEHICLE_INVERSE] = np.clip(x[VEHICLE_INVERSE], 1.0 / heavy, 1.0 / light)
    assert loaded._x == pytest.approx(x, rel=1e-6, abs=1e-9)
    after = p - np.outer(gain, p[GEAR])
    assert loaded._p == pytest.approx((after + after.T) / 2.0, rel=1e-9, abs=1e-12)
    assert loaded._doubt == pytest.approx(0.9 * 3.0 + 0.1 * sds**2)
    assert loaded._time_us == 33_500.0


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_a_vehicle_is_one_of_the_sheet_s(way: float) -> None:
    loaded = a_loaded()
    loaded._p[VEHICLE_INVERSE, GEAR] = loaded._p[GEAR, VEHICLE_INVERSE] = 1e-2
    before = loaded._x[GEAR] + 0.004 * SPEED
    take(loaded, 8, off=before - SPEED * 1e-6 * 33_500.0 + way * 0.01)
    light, heavy = SHEET.driveline.vehicle_kgm2
    assert loaded._x[VEHICLE_INVERSE] == pytest.approx(1.0 / (light if way > 0.0 else heavy))


@pytest.mark.parametrize(("doubt", "lost"), [(27.0, False), (27.8, True)])
def test_a_driveline_that_looks_deny_is_lost(doubt: float, lost: bool) -> None:
    """At a mean square of 25 variances: here 0.9 times what was doubted before."""
    loaded = a_loaded()
    loaded._doubt = doubt
    take(loaded, 8, off=loaded._x[GEAR] - SPEED * 1e-6 * 29_500.0)
    assert loaded._running is not lost
    assert loaded._doubt == (1.0 if lost else pytest.approx(0.9 * doubt, rel=0.01))
    loaded = a_loaded()
    take(loaded, 8, off=math.nan)
    assert not loaded._running


def test_a_look_that_is_not_newer_than_the_state_tells_nothing() -> None:
    loaded = a_loaded()
    x, p = loaded._x.copy(), loaded._p.copy()
    for k in (7, 5):
        take(loaded, k, off=0.01)
    assert loaded._x.tolist() == x.tolist()
    assert loaded._p.tolist() == p.tolist()


def test_edges_within_four_milliseconds_are_one_look() -> None:
    loaded = LoadedDriveline(SHEET)
    layshaft = even(0.0, SPEED / TO_OUTPUT, count=10)
    loaded.take(GEAR_5, layshaft, even(0.0, SPEED / BEHIND, count=10), LOAD, SHAFTS)
    assert [look[0] for look in loaded._first] == [1500.0, 5500.0, 8500.0]
    angles = [look[1] for look in loaded._first]
    assert angles == pytest.approx([SPEED * 1e-6 * t for t in (1500.0, 5500.0, 8500.0)])


@pytest.mark.parametrize(("layshaft", "main", "taken"), [(4, 4, True), (3, 4, False),
                                                         (4, 3, False)])  # fmt: skip
def test_less_than_four_edges_of_a_shaft_say_nothing_of_its_speed(
    layshaft: int, main: int, taken: bool
) -> None:
    loaded = LoadedDriveline(SHEET)
    parts = even(0.0, SPEED / TO_OUTPUT, layshaft), even(0.0, SPEED / BEHIND, main)
    loaded.take(None, *parts, LOAD, SHAFTS)
    assert not loaded._first
    loaded.take(GEAR_5, *parts, LOAD, SHAFTS)
    assert len(loaded._first) == int(taken)


def test_a_tooth_lies_off_by_how_far_the_main_shaft_has_moved_from_the_layshaft_s_line() -> None:
    """Where it lay in the first step counts as nothing; the second one's edges need not be even."""
    loaded = LoadedDriveline(SHEET)
    take(loaded, 0, tooth=0.3)
    assert loaded._model.view(LOADED_MODEL)["tooth_rad"][0] == 0.0
    times = np.array([4000.0, 4600.0, 5800.0, 7000.0, 8200.0])
    bent = np.array([2e-3, -1e-3, 0.0, 3e-3, -2e-3])
    layshaft = np.array((times, (SPEED * 1e-6 * times + bent) / TO_OUTPUT))
    main_us = np.array([4100.0, 5000.0, 6300.0, 7900.0])
    main = np.array((main_us, (0.31 + SPEED * 1e-6 * main_us) / BEHIND))
    loaded.take(GEAR_5, layshaft, main, LOAD, SHAFTS)
    line = np.polyfit(times, SPEED * 1e-6 * times + bent, 1)
    expected = np.mean(0.31 + SPEED * 1e-6 * main_us - np.polyval(line, main_us)) - 0.3
    assert loaded._model.view(LOADED_MODEL)["tooth_rad"][0] == pytest.approx(expected)


@pytest.mark.parametrize(("carried", "carries", "running"), [
    (True, False, True), (True, True, True), (False, False, True), (True, False, False),
])  # fmt: skip
def test_a_clutch_that_opens_takes_away_what_the_engine_was_taken_for_wrongly(
    carried: bool, carries: bool, running: bool
) -> None:
    """What the open plates drag is left, 2 Nm at the crankshaft."""
    loaded = a_loaded(8, LOAD._replace(carries=carried))
    loaded._running = running
    loaded._x[WRONG] = 40.0
    loaded._p[WRONG], loaded._p[:, WRONG] = 0.2, 0.2
    parts = carried and not carries and running
    loaded._load(GEAR_5, LOAD._replace(carries=carries), SHAFTS, 0.0)
    assert loaded._x[WRONG] == (0.0 if parts else 40.0)
    row = np.zeros(LOADED_STATES)
    row[WRONG] = (RATIO * 2.0) ** 2
    expected = row if parts else np.full(LOADED_STATES, 0.2)
    assert loaded._p[WRONG] == pytest.approx(expected)
    assert loaded._p[:, WRONG] == pytest.approx(expected)


NEWEST_US = 29_500.0 + 300e3


def long_followed(began_us: float = 29_500.0) -> LoadedDriveline:
    loaded = a_loaded()
    loaded._time_us, loaded._began_us = NEWEST_US, began_us
    loaded._p = a_spread(0.01)
    loaded._x = a_state(0.03)
    loaded._load(GEAR_5, LOAD, SHAFTS, 2.5e-3)
    return loaded


@pytest.mark.parametrize("what", ["_x", "_p"])
def test_a_driveline_whose_figures_are_no_numbers_is_not_told(what: str) -> None:
    loaded = long_followed()
    getattr(loaded, what)[HILL] = math.nan
    assert loaded.behind(NEWEST_US + 20e3) is None


@pytest.mark.parametrize(("wait_us", "began_us", "told"), [
    (0.0, 29_500.0, True), (99_900.0, 29_500.0, True), (100_100.0, 29_500.0, False),
    (-1.0, 29_500.0, False), (5e3, 29_600.0, False),
])  # fmt: skip
def test_the_driveline_behind_is_told_after_three_tenths_of_a_second_and_for_one_tenth(
    wait_us: float, began_us: float, told: bool
) -> None:
    loaded = long_followed(began_us)
    assert (loaded.behind(NEWEST_US + wait_us) is not None) is told
    loaded._running = False
    assert loaded.behind(NEWEST_US + wait_us) is None


def test_what_is_told_of_the_driveline_behind_is_the_state_ahead_half_as_unsure_again() -> None:
    """The twist from the middle of the backlash, so with the tooth's part of it."""
    loaded = long_followed()
    x, p = loaded._x.copy(), loaded._p.copy()
    loaded_ahead(x, p, 0.02, loaded._model)
    found = loaded.behind(NEWEST_US + 20e3)
    assert found is not None
    rows = [TWIST, WHEELS, TYRE, VEHICLE, HILL]
    expected = x[rows]
    expected[0] += 2.5e-3
    assert found.mean == pytest.approx(expected)
    shared = 1.5 * p[np.ix_(rows, rows)]
    assert found.root @ found.root.T == pytest.approx(shared, rel=1e-6, abs=1e-9)
    assert found.half_lash_rad == pytest.approx(math.radians(1.0))
    assert loaded._x.tolist() == a_state(0.03).tolist(), "asking moves nothing"


def test_a_spread_that_rounding_made_negative_counts_as_none() -> None:
    loaded = long_followed()
    loaded._p = -1e-12 * np.eye(LOADED_STATES)
    found = loaded.behind(NEWEST_US)
    assert found is not None
    assert not found.root.any()


def test_another_gear_and_lost_teeth_begin_anew() -> None:
    loaded = a_loaded()
    take(loaded, 8)
    assert loaded._running
    loaded.take(DRIVE_GEARS[7], even(36e3, 20.0), even(36e3, 20.0), LOAD, SHAFTS)
    assert (loaded._running, len(loaded._first), loaded._doubt) == (False, 1, 1.0)
    loaded.lose()
    assert (loaded._first, loaded._time_us, loaded._began_us) == ([], 0.0, 0.0)
    assert math.isnan(loaded._apart)
