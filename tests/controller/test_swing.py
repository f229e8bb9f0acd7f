"""The main shaft on a driveline that swings: closed form, estimator against its bound, learning."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimate.crossing_filter import MAIN_FILTER, CrossingFilter, Pressures
from meshpoint.controller.estimate.driveline_swing import (
    DrivelineSwing,
    MainWindow,
)
from meshpoint.controller.estimate.figures import Figure, prior
from meshpoint.controller.estimate.lash import Lash
from meshpoint.controller.estimate.teeth import WheelTeeth
from meshpoint.controller.models.swing import (
    SWING_STATES,
    ShaftState,
    Swing,
    SwingMotion,
    SwingRates,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.gearbox.driveline import Axle
from meshpoint.kernels.records import Vector

TUNING = CrossingFilterTuning()
NO_PRESSURES = Pressures(np.empty(0), np.empty(0))
NO_SWITCHES = np.empty((2, 0))
EDGES = 90
JITTER_S = 10e-6
OMEGA = 60.0
QUIET = SwingRates(1.0, 0.5, 0.0)


@dataclass(frozen=True)
class TwoMasses:
    """A shaft on a spring and a damper against a much heavier one, both turning; no noise. Nothing
    of this is the controller's: the textbook's free response of the relative motion."""

    light_kgm2: float = 4.0
    heavy_kgm2: float = 900.0
    spring_nm_rad: float = 20_000.0
    damper_nms: float = 20.0

    @property
    def natural_rad_s(self) -> float:
        """Of the relative motion."""
        return math.sqrt(self.spring_nm_rad * self._together)

    @property
    def decay_per_s(self) -> float:
        """Of the relative motion."""
        return 0.5 * self.damper_nms * self._together

    @property
    def _together(self) -> float:
        return 1.0 / self.light_kgm2 + 1.0 / self.heavy_kgm2

    def angle(self, twist: float, slip: float, t: Vector) -> Vector:
        """Angle of the light mass, whose share of the relative motion is the heavy one's inertia
        over both; their common centre turns at OMEGA."""
        w, d = self.natural_rad_s, self.decay_per_s
        v = math.sqrt(w * w - d * d)
        relative = np.exp(-d * t) * (twist * np.cos(v * t) + (slip + d * twist) / v * np.sin(v * t))
        share = self.heavy_kgm2 / (self.light_kgm2 + self.heavy_kgm2)
        return np.asarray(OMEGA * t + share * relative)


def edges_of(angle: Any, until_s: float, rng: np.random.Generator | None) -> Vector:
    """Times (us) and angles at which a shaft passes its edges, interpolated on a fine grid."""
    t = np.linspace(0.0, until_s, 200_001)
    theta = angle(t)
    pitch = 2.0 * math.pi / EDGES
    wanted = pitch * np.arange(math.ceil(theta[0] / pitch) + 1, math.floor(theta[-1] / pitch))
    times = np.interp(wanted, theta, t)
    if rng is not None:
        times = times + rng.normal(0.0, JITTER_S, times.size)
    return np.array((times * 1e6, wanted))


def state_of(masses: TwoMasses, twist: float, slip: float) -> Vector:
    share = masses.heavy_kgm2 / (masses.light_kgm2 + masses.heavy_kgm2)
    q, r = share * twist, share * slip
    return np.array([q, OMEGA + r, 0.0, q, r])


def model_of(masses: TwoMasses, noise: float = 0.0) -> SwingMotion:
    rates = SwingRates(masses.natural_rad_s, masses.decay_per_s, noise)
    return SwingMotion(0.0, 0.0, rates)


def test_two_masses_on_a_spring_are_followed_exactly_however_long_the_step() -> None:
    masses, twist, slip = TwoMasses(), 0.03, -4.0
    swing = Swing(state_of(masses, twist, slip), np.zeros((5, 5)), model_of(masses))
    for t in (1e-4, 0.01, 0.05, 0.4):
        assert swing.ahead(t)[0] == pytest.approx(
            masses.angle(twist, slip, np.array([t]))[0], abs=1e-12
        )


def started(masses: TwoMasses) -> tuple[Vector, Vector]:
    """What is known at the start of a window: nothing but rough angle and speed."""
    p = np.diag([0.03**2, 5.0**2, 1.0, 0.05**2, 4.0**2])
    return np.array([0.0, OMEGA, 0.0, 0.0, 0.0]), p


def test_45_ms_ahead_the_error_is_that_of_the_bound() -> None:
    """The model is linear and its noises are normal, so the least variance that any estimator can
    have (the Cramer-Rao bound for the window) is (P0^-1 + H' R^-1 H)^-1, worked out here with the
    free response of each start, apart from the filter."""
    masses, horizon_s, until_s = TwoMasses(), 0.045, 0.2
    rng = np.random.default_rng(5)
    x0, p0 = started(masses)
    errors, bounds = [], []
    for _ in range(40):
        x = rng.multivariate_normal(x0, p0)

        def angle(t: Vector, x: Vector = x) -> Vector:
            return np.asarray(
                (x[0] - x[3]) + (x[1] - x[4]) * t + 0.5 * x[2] * t * t
                + masses.angle(x[3], x[4], t) * 1.0
                - OMEGA * t
                + (1.0 / share(masses) - 1.0) * (masses.angle(x[3], x[4], t) - OMEGA * t)
            )  # fmt: skip

        edges = edges_of(angle, until_s, rng)
        run = CrossingFilter(TUNING, MAIN_FILTER)
        run.set_edge_time(JITTER_S)
        run.begin(0.0, x0, p0)
        run.take(edges, 1e-6, NO_PRESSURES, NO_SWITCHES, model_of(masses))
        ahead_s = edges[0, -1] * 1e-6 + horizon_s
        found = Swing(run.x, run.p, model_of(masses)).ahead(ahead_s - run.time_us * 1e-6)[0]
        errors.append(found - angle(np.array([ahead_s]))[0])
        rows = responses(masses, edges[0] * 1e-6)
        r = (OMEGA * JITTER_S) ** 2 + 1e-12
        information = np.linalg.inv(p0) + rows.T @ rows / r
        last = responses(masses, np.array([ahead_s]))[0]
        bounds.append(last @ np.linalg.solve(information, last))
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(bounds))
    assert 0.75 < ratio < 1.3, ratio
    assert math.degrees(math.sqrt(np.mean(bounds))) < 0.1


def share(masses: TwoMasses) -> float:
    return masses.heavy_kgm2 / (masses.light_kgm2 + masses.heavy_kgm2)


def responses(masses: TwoMasses, t: Vector) -> Vector:
    """Angle at times by each state at the start."""
    unit = (masses.angle(1.0, 0.0, t) - OMEGA * t) / share(masses)
    push = (masses.angle(0.0, 1.0, t) - OMEGA * t) / share(masses)
    return np.column_stack((np.ones_like(t), t, 0.5 * t * t, unit - 1.0, push - t))


def window_of(angle: Any, seed: int) -> MainWindow:
    edges = edges_of(angle, 0.3, np.random.default_rng(seed))
    p = np.zeros((SWING_STATES, SWING_STATES))
    p[0, 0], p[1, 1] = 0.05**2, 8.0**2
    x = np.zeros(SWING_STATES)
    x[1] = OMEGA
    return MainWindow(edges, 0.0, x, p, 3e-4)


def learned(swing: DrivelineSwing, window: MainWindow, edge_time: Figure) -> Figure:
    search = swing.search(window, edge_time, teeth_known=True)
    while not search.is_over:
        search.step()
    return swing.take(search.found.figures)


def test_frequency_and_damping_are_learned_from_the_ringing_of_three_shifts() -> None:
    masses, swing = TwoMasses(spring_nm_rad=26_000.0), DrivelineSwing(TUNING)
    edge_time, rng = prior(JITTER_S, 2.0, (1e-7, 2e-4), 0.03), np.random.default_rng(1)
    for k in range(3):
        twist, slip = rng.normal(0.0, 0.03), rng.normal(0.0, 3.0)
        window = window_of(lambda t, a=twist, b=slip: masses.angle(a, b, t), k)
        edge_time = learned(swing, window, edge_time)
    natural = swing.motion.part("natural_rad_s")[0]
    assert natural == pytest.approx(masses.natural_rad_s, rel=0.02)
    record = swing.record(Lash(Axle(), 2.0 * math.exp(-4.0), 2.0, 1.0).known, has_lash=True)
    assert record is not None and record.has_lash
    assert record.half_lash_rad == pytest.approx(math.exp(-4.0))
    again = DrivelineSwing(TUNING)
    again.restore(record)
    assert again.motion.flat == pytest.approx(swing.motion.flat, rel=1e-6)


def test_a_driveline_that_does_not_swing_is_not_given_one() -> None:
    swing = DrivelineSwing(TUNING)
    edge_time = prior(JITTER_S, 2.0, (1e-7, 2e-4), 0.03)
    for k in range(6):
        edge_time = learned(swing, window_of(lambda t: OMEGA * t, k), edge_time)
    x, p = np.zeros(SWING_STATES), np.zeros((SWING_STATES, SWING_STATES))
    swing.start(x, p)
    assert math.sqrt(p[4, 4]) < 0.5 * TUNING.swing_rad_s
    assert edge_time.value == pytest.approx(JITTER_S, rel=0.3)


def rattling(slip: float, count: int) -> Vector:
    """Angle of the light one of two masses each 40 us, with a backlash of 8 degrees between them;
    by small steps of the textbook's equations, not by the controller's."""
    masses, half, dt = TwoMasses(spring_nm_rad=12_000.0), math.radians(4.0), 40e-6
    angle, speed, twist, relative = 0.0, OMEGA + slip, half + 0.02, slip
    found = np.empty(count)
    for k in range(count):
        found[k] = angle
        beyond = math.copysign(max(abs(twist) - half, 0.0), twist)
        push = masses.natural_rad_s**2 * beyond
        push += 2.0 * masses.decay_per_s * relative * (beyond != 0.0)
        speed -= push * dt
        relative -= push * dt
        angle += speed * dt
        twist += relative * dt
    return found


def test_a_motion_that_the_model_does_not_have_is_not_taken_for_teeth() -> None:
    """A driveline that knocks about in its backlash, by a model that knows none: what is left over
    is none of the wheel's. By a model of any motion no more is taken for teeth than is theirs."""
    rng = np.random.default_rng(3)
    errors = np.radians(0.1) * rng.standard_normal(EDGES)
    errors -= errors.mean()

    def learned(model: SwingMotion, slips: tuple[float, ...]) -> WheelTeeth:
        teeth = WheelTeeth(EDGES // 2, TUNING, (), MAIN_FILTER)
        for slip in slips:
            found = rattling(slip, 20_001)
            passed = np.arange(1, int(found[-1] / (2.0 * math.pi / EDGES)) - 1)
            places = passed % EDGES
            times = np.interp(
                2.0 * math.pi / EDGES * passed + errors[places], found, np.arange(20_001) * 40.0
            )
            times += 5.0 * rng.standard_normal(times.size)
            edges = np.array((times, passed * 2.0 * math.pi / EDGES))
            x0 = np.array([0.0, OMEGA + slip, 0.0, 0.0, slip])
            p0 = np.diag([0.03**2, 5.0**2, 1.0, 0.05**2, 4.0**2])
            teeth.learner.begin(0.0, x0, p0)
            teeth.learner.take_all(edges, places, model)
            teeth.end_window()
        return teeth

    slips = (-3.0, 2.0, -5.0, 4.0, 1.0, -1.0)
    any_motion = SwingMotion(2.0 * TUNING.follow_rad_s2**2 * TUNING.follow_s, 25.0, QUIET)
    known = learned(any_motion, slips)
    assert known.learned
    assert (known.error_rad - errors).std() < 0.7 * errors.std()
    linear = model_of(TwoMasses(spring_nm_rad=12_000.0), noise=1.0)
    assert not learned(linear, slips).learned


def test_the_outlook_is_that_of_edges_taken_one_tick_after_the_other() -> None:
    motion = SwingMotion(1.0, 25.0, SwingRates(110.0, 5.0, 2.0))
    x, p = np.array([0.3, 52.0, -4.0, 0.008, 2.5]), np.diag([1e-5, 0.3, 20.0, 1e-3, 3.0])
    horizon_s, tick_s, edge_rad2_s, count = 0.045, 0.01, 1e-8, 20
    expected, now = [], Swing(x, p, motion)
    for _ in range(count):
        expected.append(now.spread_ahead(horizon_s)[1][0, 0])
        state, spread = now.spread_ahead(tick_s)
        gain = spread[:, 0] / (spread[0, 0] + edge_rad2_s / tick_s)
        now = Swing(state, spread - np.outer(gain, spread[0]), motion)

    for _ in range(50):  # each time other memory is lying about
        churn = [np.full(size, 1e9) for size in range(1, 200)]
        del churn
        found = Swing(x, p, motion, edge_rad2_s).outlook(horizon_s, tick_s, count)
        assert found == pytest.approx(expected, rel=1e-9)


BARE = ShaftState(2e6, 1.0, 60.0, 3e-3, 0.04, -5.0)


def test_a_shaft_that_does_not_swing_keeps_its_acceleration() -> None:
    """After 0.2 s: 60 - 1, and 1 + 12 - 0.1; what is not known of the speed adds to the angle."""
    assert BARE.theta_at(2.2e6) == pytest.approx(12.9)
    assert BARE.omega_at(2.2e6) == BARE.steady_omega_at(2.2e6) == pytest.approx(59.0)
    assert BARE.theta_at(1.8e6) == pytest.approx(1.0 - 12.0 - 0.1)
    assert BARE.theta_sd_at(2.2e6) == pytest.approx(math.hypot(3e-3, 8e-3))
    expected = [[1.0 + 60.0 * t - 2.5 * t * t for t in (0.1, 0.15, 0.2)], [59.5, 59.25, 59.0]]
    assert BARE.trajectories([2.1e6, 2.15e6], 50e3, 2) == pytest.approx(
        np.array([[row[:2] for row in expected], [row[1:] for row in expected]])
    )
    assert BARE.variances(2.1e6, 2e3, 3) == pytest.approx([9e-6 + 0.01 * 0.0016] * 3)


def test_a_shaft_that_swings_goes_on_as_its_swing_does_and_the_vehicle_without_it() -> None:
    """Counted from the state's own time; variances are straight between ticks of 10 ms."""
    masses, x, p = TwoMasses(), state_of(TwoMasses(), 0.03, -4.0), np.diag([9e-6] + [1e-4] * 4)
    shaft = BARE._replace(swing=Swing(x, p, model_of(masses), 2e-8))
    swing = shaft.swing
    assert isinstance(swing, Swing)
    assert swing.speed_rad_s == pytest.approx(x[4])
    assert shaft.steady_omega_at(2.03e6) == pytest.approx(60.0 - 5.0 * 0.03 - swing.speed_rad_s)
    for wait_s in (0.0, 0.03, 0.1):
        at_us = 2e6 + 1e6 * wait_s
        assert (shaft.theta_at(at_us), shaft.omega_at(at_us)) == pytest.approx(swing.ahead(wait_s))
        variance = swing.spread_ahead(wait_s)[1][0, 0]
        assert shaft.theta_sd_at(at_us) == pytest.approx(math.sqrt(variance))
        each = np.array([swing.ahead(wait_s + 7e-3 * k) for k in range(4)]).T
        assert shaft.trajectories([at_us, at_us + 7e3], 7e3, 3) == pytest.approx(
            np.array([each[:, :3], each[:, 1:]])
        )
        ticks = swing.outlook(wait_s, 0.01, 4)
        between = np.interp(0.5 * np.arange(6), np.arange(4), ticks)
        assert shaft.variances(at_us, 5e3, 6) == pytest.approx(between)
