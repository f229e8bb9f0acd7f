"""A crossing-time filter and its memory of the newest batches: what is late, what is told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm

from meshpoint.controller.estimation.crossing_filter import (
    NO_PRESSURES,
    CrossingFilter,
    Pressures,
)
from meshpoint.controller.estimation.swing_filter import MAIN_FILTER
from meshpoint.controller.motion.models import MotionModel, diagonal, first_order_law
from meshpoint.controller.motion.swing import ModeRates, SwingMotion
from meshpoint.controller.records import Vector
from meshpoint.controller.settings import CrossingFilterTuning

TUNING = CrossingFilterTuning()
SWITCHES = np.array([[14e3, 22e3], [1.0, 0.0]])
LAW = first_order_law(12.0, 6e5)
MODEL = MotionModel(np.array([0.8, 4e-4, 30.0]), LAW, np.array([900.0, 1e8, 1e-3, 4.0]))
X = np.array([0.0, 120.0, 0.0, 3.0, 1.05, -4.0])
P = diagonal(5e-3, 1.5, 2e4, 5.0, 0.06, 3.0)


def begun(time_us: float = 0.0) -> CrossingFilter:
    crossing = CrossingFilter(TUNING)
    crossing.begin(time_us, X, P)
    return crossing


def own(*times_us: float) -> Vector:
    times = np.array(times_us)
    return np.array((times, 120.0 * 1e-6 * times + 2e-3 * np.sin(times)))


def pressures(*times_us: float) -> Pressures:
    times = np.array(times_us)
    return Pressures(times, 2e3 * np.cos(times))


def same(one: CrossingFilter, other: CrossingFilter) -> None:
    sd = np.sqrt(np.diag(other.p))
    assert one.time_us == other.time_us
    assert one.x / sd == pytest.approx(other.x / sd, rel=1e-9, abs=1e-9)
    both = np.outer(sd, sd)
    assert one.p / both == pytest.approx(other.p / both, rel=1e-9, abs=1e-9)


IN_ORDER = [
    (own(1e3, 3e3, 5e3, 7e3, 9e3), pressures(4e3, 8e3)),
    (own(11e3, 13e3, 15e3, 17e3, 19e3), pressures(14e3, 18e3)),
    (own(21e3, 23e3, 25e3, 27e3, 29e3), pressures(24e3, 28e3)),
    (own(31e3, 33e3, 35e3, 37e3, 39e3), pressures(34e3, 38e3)),
]
LATE = [
    # One edge a batch late; then two, and one of three batches before.
    [(own(1e3, 3e3, 5e3, 9e3), pressures(4e3, 8e3)),
     (own(7e3, 11e3, 13e3, 15e3, 17e3, 19e3), pressures(14e3, 18e3)),
     IN_ORDER[2], IN_ORDER[3]],
    [(own(1e3, 3e3, 5e3, 7e3, 9e3), pressures(4e3, 8e3)),
     (own(11e3, 13e3, 19e3), pressures(14e3, 18e3)),
     (own(15e3, 17e3, 21e3, 25e3, 27e3, 29e3), pressures(24e3, 28e3)),
     (own(23e3, 31e3, 33e3, 35e3, 37e3, 39e3), pressures(34e3, 38e3))],
    [(own(1e3, 3e3, 5e3, 9e3), pressures(4e3, 8e3)),
     IN_ORDER[1], IN_ORDER[2],
     (own(7e3, 31e3, 33e3, 35e3, 37e3, 39e3), pressures(34e3, 38e3))],
]  # fmt: skip


@pytest.mark.parametrize("batches", LATE)
def test_edges_that_come_late_end_in_the_state_of_those_that_do_not(
    batches: list[tuple[Vector, Pressures]],
) -> None:
    found, wanted = begun(), begun()
    for edges, measured in batches:
        found.take(edges, 3e-3, measured, SWITCHES, MODEL)
    for edges, measured in IN_ORDER:
        wanted.take(edges, 3e-3, measured, SWITCHES, MODEL)
    same(found, wanted)


def test_what_is_older_than_four_batches_is_left_out() -> None:
    found, wanted = begun(), begun()
    ticks = [own(*(10e3 * k + 2e3 * np.arange(1.0, 5.0))) for k in range(6)]
    for crossing in (found, wanted):
        for edges in ticks[:5]:
            crossing.take(edges, 3e-3, NO_PRESSURES, SWITCHES, MODEL)
    late = np.concatenate((own(3e3), ticks[5]), axis=1)
    found.take(late, 3e-3, NO_PRESSURES, SWITCHES, MODEL)
    wanted.take(ticks[5], 3e-3, NO_PRESSURES, SWITCHES, MODEL)
    same(found, wanted)


@pytest.mark.parametrize("how", ["forget", "begin"])
def test_nothing_is_gone_back_to_behind_a_new_beginning(how: str) -> None:
    """Late edges are left out then."""
    found = begun()
    found.take(IN_ORDER[0][0], 3e-3, IN_ORDER[0][1], SWITCHES, MODEL)
    if how == "forget":
        found.forget_past()
    else:
        found.begin(9e3, X, P)
    x, p = found.x.copy(), found.p.copy()
    wanted = begun(9e3)
    wanted.begin(9e3, x, p)
    found.take(own(4.5e3, 11e3), 3e-3, NO_PRESSURES, SWITCHES, MODEL)
    wanted.take(own(11e3), 3e-3, NO_PRESSURES, SWITCHES, MODEL)
    same(found, wanted)


def test_an_edge_is_as_sure_as_its_time_and_its_tooth_are_then() -> None:
    """At 120 rad/s: (120 sigma_t)^2 + tooth^2, as set before that batch."""
    found = begun()
    held = diagonal(0.05, 0.0, 0.0, 0.0, 0.0, 0.0)
    still = MotionModel(np.array([0.0, 0.0, 1.0]), LAW, np.zeros(4))
    for edge_s, tooth in ((TUNING.edge_time_s, TUNING.tooth_error_rad),
                          (TUNING.edge_time_s, 7e-3), (3e-5, 7e-3), (3e-5, 2e-3)):  # fmt: skip
        found.begin(0.0, np.array([0.0, 120.0, 0.0, 0.0, 1.0, 0.0]), held)
        found.set_edge_time(edge_s)
        found.take(own(1e3), tooth, NO_PRESSURES, SWITCHES, still)
        r = (120.0 * edge_s) ** 2 + tooth**2
        assert found.p[0, 0] == pytest.approx(1.0 / (1.0 / 0.05**2 + 1.0 / r))


def test_a_model_holds_until_another_is_given() -> None:
    found = begun()
    braked = MODEL.with_friction(9.0)
    for model, a in ((MODEL, 0.8), (braked, 9.0), (MODEL, 0.8)):
        found.begin(0.0, np.array([0.0, 120.0, 0.0, 0.0, 1.0, 0.0]), diagonal(*[0.0] * 6))
        found.take(np.array([[10e3], [0.0]]), 3e-3, NO_PRESSURES, SWITCHES, model)
        found.take(np.array([[20e3], [0.0]]), 3e-3, NO_PRESSURES, np.empty((2, 0)), model)
        assert found.x[1] == pytest.approx(120.0 * math.exp(-0.02 * a))


def test_a_misfit_is_twice_the_negative_logarithm_of_the_likelihood() -> None:
    """But for log 2 pi of each edge: here of four edges of a shaft at rest, one after another."""
    found = begun()
    still = MotionModel(np.array([0.0, 0.0, 1.0]), LAW, np.zeros(4))
    found.begin(0.0, np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), diagonal(0.0, *[0.0] * 5))
    angles = np.array((2e-3, -3e-3, 5e-3, 1e-3))
    found.take(np.array((1e3 * np.arange(1.0, 5.0), angles)), 3e-3, NO_PRESSURES, SWITCHES, still)
    logs = norm.logpdf(angles, 0.0, 3e-3).sum() + 4.0 * 0.5 * math.log(2.0 * math.pi)
    assert found.misfit(4) == pytest.approx(-2.0 * logs)
    assert found.nis.tolist() == pytest.approx([np.sum((angles / 3e-3) ** 2), 4.0])


@pytest.mark.parametrize(
    ("count", "edges", "misfit"),
    [(18.0, 18, 7.0 - 90.0), (18.0, 17, 7.0 - 90.0), (18.0, 20, 7.0 - 90.0 + 2.0 * (36.0 - 5.0)),
     (17.0, 20, math.inf), (0.0, 1, math.inf), (0.0, 0, 0.0)],
)  # fmt: skip
def test_an_edge_that_was_refused_counts_as_one_at_the_gate_and_a_tenth_of_them_as_no_fit(
    count: float, edges: int, misfit: float
) -> None:
    """With the gate at 6 deviations, and variances whose mean logarithm is -5."""
    found = CrossingFilter(TUNING.__class__(gate_sd=6.0))
    found._memory.nis[:] = 7.0, count
    found._memory.log_variance[0] = -90.0
    assert found.misfit(edges) == pytest.approx(misfit)


def test_a_new_beginning_has_seen_nothing() -> None:
    found = begun()
    found.take(IN_ORDER[0][0], 3e-3, IN_ORDER[0][1], SWITCHES, MODEL)
    assert found.nis.all()
    found.begin(50e3, X, P)
    assert (found.time_us, found.nis.tolist(), found.misfit(0)) == (50e3, [0.0, 0.0], 0.0)
    assert found._memory.log_variance[0] == 0.0
    assert found.x.tolist() == X.tolist()
    assert found.p.tolist() == P.tolist()
    assert found.x is not X


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_how_noise_follows_what_is_seen_begins_with_the_model_s(share: float) -> None:
    found = begun()
    found._memory.part("restless")[0] = 9.0
    found.heed(share)
    assert found._memory.part("heed")[0] == share
    assert found._memory.part("restless")[0] == 1.0


def test_the_newest_state_is_a_copy_and_one_ahead_has_moved_and_spread() -> None:
    """With the brake on until 22 ms: pressure as tau has it."""
    found = begun()
    found.take(own(10e3, 15e3), 3e-3, NO_PRESSURES, SWITCHES, MODEL)
    newest = found.latest()
    assert newest.time_us == 15e3
    assert newest.vector.tolist() == found.x.tolist()
    assert newest.covariance is not None
    assert newest.covariance.tolist() == found.p.tolist()
    assert newest.theta_sd_rad == math.sqrt(found.p[0, 0])
    later = found.at(20e3, SWITCHES, MODEL)
    assert later.time_us == 20e3
    left = math.exp(-12.0 * 5e-3)
    assert later.pressure_pa == pytest.approx(6e5 * (1.0 - left) + left * newest.pressure_pa)
    assert later.covariance is not None
    gain, drag = later.covariance[4, 4], later.covariance[5, 5]
    assert gain == pytest.approx(newest.covariance[4, 4] + 1e-3 * 5e-3)
    assert drag == pytest.approx(newest.covariance[5, 5] + 4.0 * 5e-3)
    found.p[0, 0] = 7.0
    assert newest.covariance[0, 0] != 7.0


def test_a_main_shaft_s_filter_has_the_seven_states_of_one_that_swings() -> None:
    """It is set up as the layshaft's: edges at 60 rad/s here."""
    found = CrossingFilter(TUNING, MAIN_FILTER)
    still = SwingMotion(0.0, 0.0, [ModeRates(9.0, 1.0, 0.0)] * 2)
    found.begin(0.0, np.array([0.0, 60.0, *[0.0] * 5]), np.diag((0.05**2, *[0.0] * 6)))
    found.take(np.array([[1e3], [0.06]]), TUNING.tooth_error_rad, NO_PRESSURES, SWITCHES, still)
    r = (60.0 * TUNING.edge_time_s) ** 2 + TUNING.tooth_error_rad**2
    assert found.p[0, 0] == pytest.approx(1.0 / (1.0 / 0.05**2 + 1.0 / r))
    names = ("gate_sd", "pressure_sd_pa", "edge_time_s")
    set_to = [float(found._memory.part(name)[0]) for name in names]
    assert set_to == [getattr(TUNING, name) for name in names]
