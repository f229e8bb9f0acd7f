"""A driveline's swing: what is known of it at first, what a window may teach, by hand; and the
figures of a start in neutral."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation import driveline_swing as module
from meshpoint.controller.estimation import lash_start
from meshpoint.controller.estimation.crossing_filter import NO_PRESSURES, CrossingFilter
from meshpoint.controller.estimation.driveline_swing import DrivelineSwing, EdgeRun, MainWindow
from meshpoint.controller.estimation.lash import Lash
from meshpoint.controller.estimation.lash_start import StartWatch
from meshpoint.controller.estimation.likelihood import Found, prior
from meshpoint.controller.estimation.swing_filter import MAIN_FILTER
from meshpoint.controller.motion.swing import ModeRates, SwingMotion
from meshpoint.controller.records import Vector
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.gearbox.driveline import Axle
from meshpoint.units import TURN

TUNING = CrossingFilterTuning()


def test_each_figure_of_a_swing_is_known_at_first_within_its_factor_and_range() -> None:
    """A frequency within 2.5 deviations of the settings'; never better known than by so much."""
    noise = (TUNING.swing_noise_rad2_s3, 8.0, 1e-6, 1e5, 0.2)
    expected = []
    for hertz, factor, speed in (
        (TUNING.near_hz, TUNING.near_factor, TUNING.near_rad_s),
        (TUNING.far_hz, TUNING.far_factor, TUNING.far_rad_s),
    ):
        most, w = factor**2.5, TURN * hertz
        expected += [(w, factor, w / most, w * most, 0.005),
                     (TUNING.swing_damping, 2.0, 1e-3, 0.9, 0.05),
                     (speed, 4.0, 1e-3, 50.0, 0.3), noise]  # fmt: skip
    expected += [noise, (TUNING.main_start_rad_s2, 4.0, 1e-2, 1e3, 0.3)]
    found = [
        (math.exp(one.log), math.exp(one.sd), math.exp(one.least_log), math.exp(one.most_log),
         one.least_sd)
        for one in DrivelineSwing(TUNING)._figures
    ]  # fmt: skip
    assert np.array(found) == pytest.approx(np.array(expected))


def test_a_mode_is_damped_by_nine_tenths_at_most_and_the_vehicle_s_acceleration_wanders() -> None:
    swing = DrivelineSwing(TUNING)
    logs = [one.log for one in swing._figures]
    logs[1], logs[5] = math.log(2.0), math.log(0.3)
    motion = swing._motion(logs)
    natural = motion.part("modes")["natural_rad_s"]
    assert motion.part("modes")["decay_per_s"] == pytest.approx(natural * (0.9, 0.3))
    assert motion.part("walk_rad2_s5")[0] == pytest.approx(TUNING.main_walk_rad_s2**2)


def test_a_gear_that_comes_out_may_swing_half_as_far_again_as_was_learned() -> None:
    swing = DrivelineSwing(TUNING)
    x, p = np.zeros(7), np.zeros((7, 7))
    swing.start(x, p)
    assert p[2, 2] == pytest.approx((1.5 * TUNING.main_start_rad_s2) ** 2)
    assert p[3, 3] == pytest.approx((1.5 * TUNING.near_rad_s / (TURN * TUNING.near_hz)) ** 2)
    assert p[5, 5] == pytest.approx((1.5 * TUNING.far_rad_s / (TURN * TUNING.far_hz)) ** 2)


def test_a_swing_that_was_kept_moves_as_it_did() -> None:
    """Each noise with a deviation of its own."""
    swing, other = DrivelineSwing(TUNING), DrivelineSwing(TUNING)
    swing._figures = [
        prior(one.value * 1.1, 1.2 + 0.1 * k, (1e-9, 1e9), 1e-6)
        for k, one in enumerate(swing._figures)
    ]
    swing.shifts, swing.motion = 2, swing._doubting()
    lash = Lash(Axle(), TUNING.lash_rad, TUNING.lash_factor, 1.0)
    record = swing.record(lash.known, False)
    assert record is not None
    assert [len(each) for each in (record.natural_rad_s, record.damping, record.speed_rad_s)] == [
        2, 2, 2]  # fmt: skip
    assert record.noise_sd == tuple(swing._figures[k].sd for k in (3, 7, 8))
    other.restore(record)
    for k in (0, 3, 7, 8, 9):
        most = other._figures[k].prior_sd
        assert other._figures[k].sd == pytest.approx(min(swing._figures[k].sd, most))
    assert other.motion.flat.tolist() == other._doubting().flat.tolist()
    assert other.motion.part("white_rad2_s3")[0] == pytest.approx(swing._figures[8].value)


def a_window(edges: int) -> MainWindow:
    times = 1e3 * np.arange(1.0, edges + 1.0)
    angles: Vector = 60e-6 * times + 4e-3 * np.sin(0.2 * np.arange(edges))
    x = np.array([0.0, 60.0, *[9.0] * 5])
    return MainWindow(np.array((times, angles)), 0.0, x, np.diag([1e-4, 4.0, *[9.0] * 5]), 2e-3)


@pytest.mark.parametrize("teeth_known", [False, True])
def test_a_window_s_misfit_is_that_of_a_filter_with_the_figures_that_are_tried(
    teeth_known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An edge's time is one of them where the teeth are known. Frequencies may have several
    minima."""
    swing, edge_time, asked = DrivelineSwing(TUNING), prior(9e-6, 2.0, (1e-6, 2e-4), 0.03), []

    def learn(*given: Any) -> Found:
        asked.append(given)
        return Found([one.__class__(one.log + 0.01, *[0.1] * 5) for one in given[0]], 1.0)

    monkeypatch.setattr(module, "learn", learn)
    before, window = list(swing._figures), a_window(60)
    answer = swing.learn(window, edge_time, teeth_known)
    ((known, misfit, scanned),) = asked
    assert known == ([*before, edge_time] if teeth_known else before)
    assert scanned == (0,)
    assert swing.shifts == 1
    assert [one.log for one in swing._figures] == [one.log + 0.01 for one in before]
    assert swing.motion.flat.tolist() == swing._doubting().flat.tolist()
    assert answer.log == pytest.approx(edge_time.log + (0.01 if teeth_known else 0.0))
    logs = [one.log + 0.05 for one in known]
    w, damping, speed, noise = np.exp(np.reshape(logs[:8], (2, 4))).T
    rates = [ModeRates(*each) for each in zip(w, damping * w, noise, strict=True)]
    model = SwingMotion(math.exp(logs[8]), TUNING.main_walk_rad_s2**2, rates)
    x, swings = np.array([0.0, 60.0, *[0.0] * 5]), (speed / w, speed)
    sds = [1e-2, 2.0, math.exp(logs[9]), swings[0][0], speed[0], swings[0][1], speed[1]]
    run = CrossingFilter(TUNING, MAIN_FILTER)
    run.set_edge_time(math.exp(logs[10]) if teeth_known else 9e-6)
    run.begin(0.0, x, np.diag(np.square(sds)))
    run.take(window.edges, 2e-3, NO_PRESSURES, np.empty((2, 0)), model)
    assert misfit(logs) == pytest.approx(run.misfit(60))
    assert math.isfinite(run.misfit(60))
    assert window.x[2] == 9.0, "the window stays as it is"


def test_a_window_of_less_than_sixty_edges_teaches_nothing() -> None:
    swing, edge_time = DrivelineSwing(TUNING), prior(9e-6, 2.0, (1e-6, 2e-4), 0.03)
    before = list(swing._figures)
    assert swing.learn(a_window(59), edge_time, True) is edge_time
    assert (swing.shifts, swing._figures) == (0, before)


def test_a_run_that_begins_anew_has_no_places() -> None:
    run = EdgeRun()
    run.add(np.array([1.0]), np.array([0.1]), np.array([5]))
    run.begin()
    assert run.places.size == 0


def test_a_start_in_neutral_is_found_by_these_figures() -> None:
    """Twelve strengths of a swing from 1 mrad to half a radian, remembered for 0.2 s; edges to
    2.5 mrad; a vehicle that changes its acceleration within a third of a second."""
    found = lash_start.SWINGS_RAD
    assert found == pytest.approx(np.exp(np.linspace(math.log(1e-3), math.log(0.5), 12)))
    figures = lash_start.BROAD, lash_start.CHANGE_S, lash_start.EDGE_RAD, lash_start.SWING_S
    assert figures == (10.0, 0.33, 2.5e-3, 0.2)


def test_of_a_batch_in_gear_the_newest_edge_is_kept_and_a_watch_begins_with_none() -> None:
    """What was seen in gear is of one gear alone."""
    watch = StartWatch()
    assert watch.waiting.shape == (2, 0)
    watch.take_in_gear(np.array([[1.0, 2.0, 3.0], [0.1, 0.2, 0.3]]))
    assert list(watch._in_gear) == [(3.0, 0.3)]
    later = 1e3 * np.arange(1.0, 14.0)
    start = watch.take_out(np.array((later, 60e-6 * later)), (0.3, 8.0))
    assert start is not None
    assert (start.time_us, start.pressed_nm, start.behind) == (0.0, 0.0, None)
    assert not watch._in_gear
