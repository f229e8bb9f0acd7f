"""Small statements about the estimators that no longer run would make by accident."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.estimation.brake_model import Carried
from meshpoint.controller.estimation.crossing_tracker import STRUCK_RAD_S, CrossingTracker
from meshpoint.controller.estimation.cruise import CruiseTracker
from meshpoint.controller.estimation.lash_start import StartWatch
from meshpoint.controller.estimation.likelihood import Learned, _step, learn
from meshpoint.controller.estimation.main_tracker import MainTracker
from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.kernels import (
    DISTURBANCE,
    DRAG,
    GAIN,
    OMEGA,
    PRESSURE,
    THETA,
)
from meshpoint.controller.motion.swing import ModeRates, ShaftState, Swing, SwingMotion
from meshpoint.controller.motion.swing_kernels import STEADY
from meshpoint.controller.observer import CLUTCH_BITES_SHARE, Observer
from meshpoint.controller.phase.locked_gear import PULL_RAD_S2
from meshpoint.controller.sensing.pressure_samples import NO_SAMPLES
from meshpoint.controller.sensing.wheel_edges import EdgeBatch
from meshpoint.controller.settings import (
    ControllerSettings,
    CrossingFilterTuning,
    CruiseFilterTuning,
    Estimator,
)
from meshpoint.gearbox import MainGear, Split, load_sheet
from meshpoint.units import US


def test_an_acceleration_that_is_not_known_moves_an_angle_by_half_its_square_of_time() -> None:
    """Ahead and back by the same time, what is not known of the speed at the newest edge cancels
    with how it goes with the angle."""
    most_rad_s2, pitch = 40.0, 2.0 * math.pi / 45
    tracker = CruiseTracker(CruiseFilterTuning(acceleration_rad_s2=most_rad_s2), pitch)
    number = np.arange(60)
    times = number * pitch / 60.0 / US
    for k in range(0, 60, 6):
        part = slice(k, k + 6)
        tracker.edges(EdgeBatch(times[part], pitch * number[part], number[part], 0 * number[part]))
    seconds = 0.05
    now, ahead, back = (tracker.at(times[-1] + t / US) for t in (0.0, seconds, -seconds))
    assert now and ahead and back
    both = ahead.theta_sd_rad**2 + back.theta_sd_rad**2 - 2.0 * now.theta_sd_rad**2
    of_speed = 2.0 * seconds**2 * now.omega_sd_rad_s**2
    moved_rad = most_rad_s2 * seconds**2 / 2.0
    assert both - of_speed == pytest.approx(2.0 * moved_rad**2)
    assert ahead.omega_sd_rad_s**2 - now.omega_sd_rad_s**2 == pytest.approx(
        (most_rad_s2 * seconds) ** 2
    )


def test_a_misfit_that_is_a_parabola_is_at_its_minimum_after_a_step() -> None:
    one = Learned(0.0, 0.5, -5.0, 5.0, 0.5, 0.01)

    def misfit(figures: Sequence[float]) -> float:
        return 1.0 + 9.0 * (figures[0] - 0.4) ** 2

    at, found, sd = _step([0.0], misfit([0.0]), 0, one, misfit)
    assert at == pytest.approx([0.4])
    assert found == pytest.approx(1.0)
    assert sd == pytest.approx(1.0 / 3.0), "the square root of 2 over the curvature, which is 18"


def test_two_edges_in_gear_are_enough_for_the_vehicle_s_speed() -> None:
    """Where they are far enough apart; of one alone the shaft's own speed is taken."""
    for waits_us, is_told in (((0.0, 200e3), True), ((0.0, 100e3), False), ((200e3,), False)):
        watch = StartWatch()
        for time_us in waits_us:
            watch.take_in_gear(np.array([[time_us], [60.0 * time_us * US]]))
        watch.released(200e3)
        later = 200e3 + 1e3 * np.arange(1, 20)
        start = watch.take_out(np.array((later, 61.0 * later * US)), (0.5, 3.0))
        assert start is not None
        assert (start.vehicle_rad_s == pytest.approx(60.0, abs=0.5)) is is_told


def test_a_swinging_shaft_s_speed_is_how_its_angle_goes() -> None:
    """Ahead by any time; and its state there says the same."""
    motion = SwingMotion(0.5, 20.0, [ModeRates(70.0, 3.0, 2.0), ModeRates(25.0, 1.0, 0.5)])
    state = np.array([1.0, 63.0, 0.0, 0.01, 1.0, 0.02, -0.5])
    swing = Swing(state, np.diag(np.linspace(0.1, 2.0, 7)), motion)
    for wait_s in (0.005, 0.02, 0.05):
        angle, speed = swing.ahead(wait_s)
        before, after = swing.ahead(wait_s - 1e-5)[0], swing.ahead(wait_s + 1e-5)[0]
        assert speed == pytest.approx((after - before) / 2e-5, abs=1e-3)
        assert swing.spread_ahead(wait_s)[0][0] == pytest.approx(angle)


def test_a_figure_of_which_a_shift_tells_nothing_is_known_less_well_behind_it() -> None:
    """Its variance grows by a tenth, up to what was known before anything was learned."""
    one = Learned(0.3, 0.1, -5.0, 5.0, 0.5, 0.01)
    (found,) = learn([one], lambda _: 0.0).figures
    assert found.log == pytest.approx(0.3)
    assert found.sd**2 == pytest.approx(1.1 * 0.1**2)
    for _ in range(60):
        (found,) = learn([found], lambda _: 0.0).figures
    assert found.sd == pytest.approx(0.5)


def test_a_gear_that_strikes_moves_the_layshaft_by_half_a_pitch_and_its_speed_at_once() -> None:
    """What is not known of them grows by that, apart from how the two go together; and before a
    gear has come out nothing is left in the shafts."""
    truck12 = load_sheet("truck12")
    settings = ControllerSettings()
    delay_us = round(truck12.brake.valve_delay_s / US)
    observer = Observer(truck12, settings, BrakeInput(delay_us), Estimator.CROSSING)
    assert observer.pressed_nm == 0.0
    tracker, teeth = observer.layshaft, truck12.wheels.layshaft.teeth
    assert isinstance(tracker, CrossingTracker)
    half_pitch = math.pi / teeth

    def turn(first: int, last: int) -> None:
        for number in range(first, last, 6):
            edges = np.arange(number, number + 6)
            angle = half_pitch * edges
            batch = EdgeBatch(angle / 100.0 / US, angle, edges // 2 % teeth, edges % 2)
            tracker.edges(batch, NO_SAMPLES)

    turn(0, 60)
    now_us = tracker._filter.time_us
    tracker.set_free(True, now_us, [])
    turn(60, 72)
    before = tracker._filter.p.copy()
    tracker.set_free(False, tracker._filter.time_us, [])
    after = tracker._filter.p
    assert after[0, 0] - before[0, 0] == pytest.approx(half_pitch**2)
    assert after[1, 1] - before[1, 1] == pytest.approx(STRUCK_RAD_S**2)
    assert after[0, 1] == before[0, 1]


def test_a_shaft_of_which_only_angle_and_speed_were_seen_may_do_what_the_settings_allow() -> None:
    """Its angle is off by two unlearned teeth, and nothing goes with anything else."""
    tuning = CrossingFilterTuning()
    x, p = MainTracker(tuning, 45, range_ratios=(0.27, 1.0))._first_state(5.0)
    assert not x.any()
    assert p[THETA, THETA] == pytest.approx((2.0 * tuning.tooth_error_rad) ** 2)
    assert p[OMEGA, OMEGA] == 25.0
    assert p[STEADY, STEADY] == pytest.approx(tuning.main_start_rad_s2**2)
    assert np.count_nonzero(p) == 3


def test_a_layshaft_that_becomes_free_begins_with_what_is_known_of_brake_and_drag() -> None:
    """Torques over its inertia, each as sure as was learned and as may have changed in a pause."""
    sheet, settings = load_sheet("truck12"), ControllerSettings()
    delay_us = round(sheet.brake.valve_delay_s / US)
    observer = Observer(sheet, settings, BrakeInput(delay_us), Estimator.CROSSING)
    tracker, teeth = observer.layshaft, sheet.wheels.layshaft.teeth
    assert isinstance(tracker, CrossingTracker)
    for number in range(0, 60, 6):
        edges = np.arange(number, number + 6)
        angle = math.pi / teeth * edges
        batch = EdgeBatch(angle / 100.0 / US, angle, edges // 2 % teeth, edges % 2)
        tracker.edges(batch, NO_SAMPLES)
    tuning, known, inertia = settings.crossing_filter, tracker._known, tracker._inertia_kgm2
    tracker.set_free(True, tracker._filter.time_us, [])
    x, p = tracker._filter.x, tracker._filter.p
    assert (x[PRESSURE], x[DISTURBANCE]) == (0.0, 0.0)
    assert x[GAIN] == known.gain.value
    assert x[DRAG] == pytest.approx(known.drag_nm.value / inertia)
    assert p[PRESSURE, PRESSURE] == pytest.approx(tuning.pressure_start_sd_pa**2)
    assert p[DISTURBANCE, DISTURBANCE] == pytest.approx(
        (tracker.disturbance.torque_nm / inertia) ** 2
    )
    assert p[GAIN, GAIN] == pytest.approx(known.gain.sd**2 + tuning.gain_pause**2)
    drag_nm2 = known.drag_nm.sd**2 + tuning.drag_pause_nm**2
    assert p[DRAG, DRAG] == pytest.approx(drag_nm2 / inertia**2)
    assert not p[2:, :2].any()


@pytest.mark.parametrize(
    ("drag_nm", "swing_rad_s", "closed", "pulls"),
    [(-8.0, 0.0, 0.0, True), (-0.5, 0.0, 0.0, False), (-8.0, 2.0, 0.0, False),
     (-8.0, 0.0, CLUTCH_BITES_SHARE, False), (-8.0, 0.0, 0.99 * CLUTCH_BITES_SHARE, True)],
)  # fmt: skip
def test_drag_holds_a_tooth_at_its_lower_flank_where_it_slows_down_more_than_the_main_shaft(
    drag_nm: float, swing_rad_s: float, closed: float, pulls: bool
) -> None:
    """By 5 rad/s2, at the gear; on a driveline that swings the main shaft does at times, too. And
    nothing else may turn the layshaft."""
    sheet = load_sheet("truck12")
    brake = BrakeInput(round(sheet.brake.valve_delay_s / US))
    observer: Any = Observer(sheet, ControllerSettings(), brake, Estimator.CROSSING)
    observer._split = Split.HIGH
    observer.brake.drag_nm = Carried(drag_nm, 0.1)
    observer.view.clutch.closed = closed
    gear = MainGear.THIRD
    slows = sheet.main_mesh(gear).ratio * drag_nm / sheet.inertia_kgm2(Split.HIGH)
    assert (slows < -PULL_RAD_S2) is (drag_nm < -1.0)
    found = []
    for k in range(12):
        speed = 90.0 + swing_rad_s * math.sin(0.9 * k)
        main = ShaftState(1e4 * k, 0.0, speed, 1e-3, 0.05)
        found.append(observer._locked._drag_pulls(gear, main, observer._coasting_rad_s2))
    assert found[-1] is pulls
