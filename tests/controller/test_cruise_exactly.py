"""Constant speed and the baselines by hand: what they begin with, and begin anew by."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation.baseline_tracker import BaselineTracker
from meshpoint.controller.estimation.cruise import CruiseTracker, WindowSpeed
from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.sensing.pressure_samples import NO_SAMPLES
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import ControllerSettings, CruiseFilterTuning
from meshpoint.dbc.messages import Estimator

PITCH = 2.0 * math.pi / 45
SETTINGS = ControllerSettings()


def batch(times_us: list[float], angles: list[float]) -> EdgeBatch:
    none = np.zeros(len(times_us), np.int64)
    return EdgeBatch(np.array(times_us), np.array(angles), none, none)


@pytest.mark.parametrize(
    ("times", "from_"),
    [([0.0, 2e3, 9e3, 10.5e3, 20e3], 2), ([0.0, 5e3, 10e3, 20e3], 2), ([0.0, 5e3], 0)],
)
def test_the_production_speed_is_from_the_newest_edge_that_is_ten_milliseconds_old(
    times: list[float], from_: int
) -> None:
    angles = [(t * 1e-3) ** 2 for t in times]
    window = WindowSpeed()
    window.edges(batch(times, angles))
    turned = angles[-1] - angles[from_]
    assert window.omega_rad_s == pytest.approx(turned / ((times[-1] - times[from_]) * 1e-6))
    assert len(window._times) == len(times) - from_


@pytest.mark.parametrize("rad_s", [60.0, -60.0])
def test_a_shaft_is_first_known_to_a_tenth_of_a_pitch_and_a_twentieth_of_its_speed(
    rad_s: float,
) -> None:
    """And 1 rad/s. One edge alone tells no speed."""
    tuning = CruiseFilterTuning(acceleration_rad_s2=30.0, edge_time_us=7.0)
    tracker = CruiseTracker(tuning, PITCH)
    assert tracker._filter.part("acceleration_rad_s2")[0] == 30.0
    assert tracker._filter.part("edge_time_s")[0] == pytest.approx(7e-6)
    tracker.edges(batch([0.0], [0.0]))
    assert tracker.at(0.0) is None
    tracker.edges(batch([2e3], [rad_s * 2e-3]))
    now = tracker.at(2e3)
    assert now is not None
    assert (now.theta_rad, now.omega_rad_s) == pytest.approx((rad_s * 2e-3, rad_s))
    assert (now.theta_sd_rad, now.omega_sd_rad_s) == pytest.approx((0.1 * PITCH, 4.0))


def a_cruise() -> CruiseTracker:
    tracker = CruiseTracker(CruiseFilterTuning(acceleration_rad_s2=0.0), PITCH)
    tracker.edges(batch([0.0, 2e3], [0.0, 0.12]))
    return tracker


def test_an_angle_ahead_is_as_unsure_as_angle_and_speed_and_how_they_go_together() -> None:
    tracker = a_cruise()
    tracker._filter.p[:] = np.array(((4e-4, 3e-3), (3e-3, 0.9)))
    later = tracker.at(2e3 + 20e3)
    assert later is not None
    ahead = np.array((1.0, 0.02))
    variance = ahead @ np.array(((4e-4, 3e-3), (3e-3, 0.9))) @ ahead
    assert later.theta_sd_rad == pytest.approx(math.sqrt(variance))
    assert later.theta_rad == pytest.approx(0.12 + 60.0 * 0.02)


def test_a_speed_is_told_for_sixty_milliseconds_from_the_newest_edge() -> None:
    tracker = a_cruise()
    for wait_us, told in ((60_000.0, True), (60_001.0, False), (-60_000.0, True),
                          (-60_001.0, False)):  # fmt: skip
        assert (tracker.at(2e3 + wait_us) is not None) is told


@pytest.mark.parametrize("how", ["restart", "lose_speed"])
def test_a_speed_that_was_lost_is_known_again_after_two_more_edges(how: str) -> None:
    tracker = a_cruise()
    getattr(tracker, how)()
    assert tracker.at(2e3) is None
    tracker.edges(batch([4e3], [0.4]))
    assert tracker.at(4e3) is None
    tracker.edges(batch([6e3], [0.6]))
    now = tracker.at(6e3)
    assert now is not None
    assert now.omega_rad_s == pytest.approx(100.0)


def a_baseline(estimator: Estimator) -> Any:
    return BaselineTracker(estimator, SETTINGS, BrakeInput(0), PITCH)


@pytest.mark.parametrize("estimator", [Estimator.THESIS, Estimator.WINDOW])
def test_a_free_layshaft_begins_with_what_cruising_knew_and_a_pressure_of_nearly_none(
    estimator: Estimator,
) -> None:
    """0.2 bar is its deviation, free or not; noises are those of the settings."""
    tracker, tuning = a_baseline(estimator), SETTINGS.thesis_filter
    noises = tuning.w_angle_rad_s, tuning.w_speed_rad_s2, tuning.w_pressure_pa_s
    assert tracker._filter.part("w").tolist() == list(noises)
    assert tracker._filter.part("r_rad2")[0] == pytest.approx(tuning.r_angle_rad**2)
    assert not tracker.free
    tracker.edges(batch([0.0, 2e3], [0.0, 0.12]), NO_SAMPLES)
    cruising = tracker.at(5e3)
    assert cruising is not None
    assert (cruising.pressure_pa, cruising.pressure_sd_pa) == (0.0, 2e4)
    tracker._filter.x[2] = 9e4
    tracker.set_free(True, 5e3, [])
    assert tracker.free
    assert tracker._filter.time_us[0] == 5e3
    sds = cruising.theta_sd_rad, cruising.omega_sd_rad_s, 2e4
    assert tracker._filter.p == pytest.approx(np.diag(np.square(sds)))
    latest = tracker.latest()
    found = latest.theta_sd_rad, latest.omega_sd_rad_s, latest.pressure_sd_pa
    assert found == pytest.approx(sds)
    assert tracker._filter.x.tolist() == [cruising.theta_rad, cruising.omega_rad_s, 0.0]
    tracker._filter.p[:] = -1e-12 * np.eye(3)
    latest = tracker.latest()
    assert (latest.theta_sd_rad, latest.omega_sd_rad_s, latest.pressure_sd_pa) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("how", ["restart", "lose_speed", "gear"])
def test_a_baseline_begins_anew_when_edges_are_lost_or_a_gear_comes_in(how: str) -> None:
    tracker = a_baseline(Estimator.WINDOW)
    tracker.edges(batch([0.0, 2e3], [0.0, 0.12]), NO_SAMPLES)
    tracker.set_free(True, 2e3, [])
    if how == "gear":
        tracker.set_free(False, 2e3, [])
    else:
        getattr(tracker, how)()
    assert not tracker.free
    assert tracker.at(2e3) is None
    assert (tracker._window.newest is None) is (how != "gear")
    assert tracker._cruise._seed.newest is None


def test_a_held_speed_is_that_of_edges_that_are_newer_than_the_state() -> None:
    """Its pressure goes on by the brake's commands alone: here there are none."""
    tracker = a_baseline(Estimator.WINDOW)
    tracker._hold_window()
    assert tracker._filter.time_us[0] == 0.0
    tracker.edges(batch([1e3], [0.1]), NO_SAMPLES)
    tracker._hold_window()
    assert tracker._filter.time_us[0] == 0.0, "one edge tells no speed"
    tracker.edges(batch([2e3], [0.2]), NO_SAMPLES)
    tracker._filter.time_us[0], tracker._filter.x[:] = 2e3, (7.0, 8.0, 9.0)
    tracker._hold_window()
    assert tracker._filter.x.tolist() == [7.0, 8.0, 9.0]
    tracker._filter.time_us[0] = 1.9e3
    tracker._hold_window()
    assert tracker._filter.time_us[0] == 2e3
    assert tracker._filter.x[:2] == pytest.approx((0.2, 100.0))
