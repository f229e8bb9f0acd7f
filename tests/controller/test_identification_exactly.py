"""Fits of a log, where what they must find can be worked out on paper."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_identification import SHEET, TEETH, braked

from meshpoint.controller.records import Vector
from meshpoint.dbc.messages import GearboxSensors, ValveAction, ValveCommand
from meshpoint.gearbox import MainGear, Split
from meshpoint.testbench.identify.brake_course import (
    Course,
    P,
    make_course,
    time_constant_s,
)
from meshpoint.testbench.identify.brake_figures import _drag
from meshpoint.testbench.identify.brake_fit import CHANCE_RAD2_S3, fit, whitening
from meshpoint.testbench.identify.clutch_fit import (
    AFTER_S,
    LEAST_BEND_RAD_S,
    MOST_REST_SHARE,
    touch_of,
    touches,
)
from meshpoint.testbench.identify.identify import identify
from meshpoint.testbench.identify.log_reader import (
    Closing,
    LogContent,
    LogReader,
    Stroke,
    _ClosingTrack,
)
from meshpoint.testbench.identify.sleeve_fit import (
    LEAST_CORRELATION,
    MOST_CORRELATION,
    SleeveFit,
    contact_of,
    sleeve_fit,
)
from meshpoint.units import RPM

ATMOSPHERE_PA = SHEET.air.atmosphere_pa
SUPPLY_PA = SHEET.air.supply_gauge_pa + ATMOSPHERE_PA
KISS, TRAVEL_S = 0.35, 0.2


def fit_of(*delays: list[float]) -> SleeveFit:
    gears = (MainGear.FIRST, MainGear.SECOND, MainGear.THIRD)
    by_gear = {gear: np.array(own) for gear, own in zip(gears, delays, strict=False)}
    return SleeveFit(by_gear, SUPPLY_PA, sum(map(len, delays)), sum(map(len, delays)))


def test_strokes_that_drift_go_together() -> None:
    """One to five: their deviations' products with the one before are 2, 0, 0 and 2 over squares
    of 10; and a mean of five takes a fifth."""
    assert fit_of([1.0, 2.0, 3.0, 4.0, 5.0]).correlation == pytest.approx(0.4 + 0.2)
    # With a gear of three strokes: products of 4 over 12, and eight strokes have two means.
    both = fit_of([1.0, 2.0, 3.0, 4.0, 5.0], [7.0, 8.0, 9.0])
    assert both.correlation == pytest.approx(4.0 / 12.0 + 2.0 / 8.0)
    # A pair says nothing: about their mean any two are opposite.
    paired = fit_of([1.0, 2.0, 3.0, 4.0, 5.0], [7.0, 8.0])
    assert paired.correlation == pytest.approx(0.6)


def test_neither_a_delay_nor_a_unit_changes_how_strokes_go_together() -> None:
    rng = np.random.default_rng(1)
    strokes = np.cumsum(rng.standard_normal(12))
    once = fit_of(strokes.tolist()).correlation
    assert LEAST_CORRELATION < once < MOST_CORRELATION
    assert fit_of((45.0 - 1e-3 * strokes).tolist()).correlation == pytest.approx(once)
    assert fit_of(strokes[::-1].tolist()).correlation == pytest.approx(once)


@pytest.mark.parametrize("delays", [[1.0, 3.0] * 5, [2.0, 2.0, 2.0], [1.0]])
def test_few_strokes_cannot_show_that_they_do_not_go_together(delays: list[float]) -> None:
    assert fit_of(delays).correlation == LEAST_CORRELATION


def test_strokes_never_go_together_so_much_that_nothing_is_known_of_their_spread() -> None:
    assert fit_of(list(range(40))).correlation == MOST_CORRELATION


def test_the_spread_is_right_on_average_for_strokes_that_go_together_as_they_are_said_to() -> None:
    """What eight strokes' sum of squares is divided by is what such a sum is on average, of strokes
    of variance 1 that remember as much of the one before: here of 20,000 gears."""
    strokes = np.arange(8.0)
    found = fit_of(strokes.tolist())
    remembered = found.correlation
    assert LEAST_CORRELATION < remembered < MOST_CORRELATION
    rng = np.random.default_rng(2)
    many = rng.standard_normal((8, 20_000))
    for k in range(1, 8):
        many[k] = remembered * many[k - 1] + math.sqrt(1.0 - remembered**2) * many[k]
    on_average = float(np.mean(8.0 * many.var(axis=0)))
    assert found.spread_s**2 == pytest.approx(8.0 * strokes.var() / on_average, rel=0.03)


def test_strokes_that_go_together_count_as_fewer() -> None:
    """The variance of a variance of strokes that remember r is (1 + r^2) / (1 - r^2) times as
    large."""
    found = fit_of([1.0, 2.0, 3.0, 4.0, 5.0])
    assert found.freedom == 4
    assert found.effective_freedom == pytest.approx(4.0 * (1.0 - 0.36) / (1.0 + 0.36))
    assert fit_of([1.0]).effective_freedom == 1.0
    assert math.isnan(fit_of([1.0]).spread_s)


def pushed(delay_s: float, supply_pa: float = SUPPLY_PA) -> Stroke:
    """A sleeve under a constant force from its valve's opening on, without noise."""
    at, valve = np.arange(0.0, 0.1, 1e-3), SHEET.sleeve.valve_delay_s
    share = np.maximum((at - valve) / (delay_s - valve), 0.0) ** 2
    way = SHEET.sleeve.to_contact_m * np.minimum(share, 1.0)
    return Stroke(MainGear.SECOND, 0, at * 1e6, way, supply_pa, None)


@pytest.mark.parametrize("delay_s", [0.04, 0.0475, 0.055])
def test_a_stroke_without_noise_is_timed_exactly(delay_s: float) -> None:
    found = contact_of(pushed(delay_s), SHEET)
    assert found is not None
    assert found.delay_s == pytest.approx(delay_s, abs=1e-9)
    assert found.gear is MainGear.SECOND


def test_delays_are_told_as_if_all_strokes_had_the_same_air() -> None:
    """A sleeve under p times the force takes 1 / sqrt(p) of the time from its valve's opening."""
    valve = SHEET.sleeve.valve_delay_s
    gauges = np.array((6e5, 7e5, 8e5, 9e5))
    mean = gauges.mean()
    strokes = [
        pushed(valve + 0.03 * math.sqrt(mean / gauge), gauge + ATMOSPHERE_PA) for gauge in gauges
    ]
    found = sleeve_fit(strokes, SHEET)
    assert found is not None
    assert found.supply_pa == pytest.approx(mean + ATMOSPHERE_PA)
    assert found.delays_s[MainGear.SECOND] == pytest.approx([valve + 0.03] * 4, abs=1e-9)
    assert (found.used, found.seen) == (4, 4)


def closing(bend_rad_s: float, noise_rad_s: float = 0.0) -> Closing:
    """The engine slows down steadily and, from the touch on, with the square of the time: by
    `bend_rad_s` more at the end of the time that is looked at. Noise goes up and down."""
    at = np.arange(0.0, TRAVEL_S + 0.01, 0.01)
    engine = np.arange(-0.1, TRAVEL_S, 0.005)
    since = engine - KISS * TRAVEL_S
    speed = 140.0 - 70.0 * engine - bend_rad_s / AFTER_S**2 * np.maximum(since, 0.0) ** 2
    speed += noise_rad_s * np.where(np.arange(engine.size) % 2, 1.0, -1.0)
    return Closing(at * 1e6, at / TRAVEL_S, engine * 1e6, speed)


def test_a_kink_without_noise_is_found_where_it_is() -> None:
    found = touch_of(closing(4.0), SHEET)
    assert found == pytest.approx(KISS, abs=0.0013)
    assert touches([closing(4.0), closing(0.0), closing(3.0)], SHEET).size == 2


@pytest.mark.parametrize(("share", "seen"), [(0.8, False), (1.4, True)])
def test_plates_that_hardly_bend_the_engine_s_speed_have_not_been_seen(
    share: float, seen: bool
) -> None:
    assert (touch_of(closing(share * LEAST_BEND_RAD_S), SHEET) is not None) is seen


@pytest.mark.parametrize(("share", "seen"), [(0.5, True), (1.3, False)])
def test_an_engine_that_does_not_go_by_the_kink_shows_no_touch(share: float, seen: bool) -> None:
    noisy = closing(8.0, share * MOST_REST_SHARE * 8.0)
    assert (touch_of(noisy, SHEET) is not None) is seen


def test_whitened_angles_of_a_shaft_that_chance_drives_are_independent() -> None:
    """A torque of white noise from the run's beginning on moves the angle by the integral of its
    age times the noise, and every edge has an error of its own."""
    seconds = np.array((0.02, 0.05, 0.09, 0.2))
    variances = np.array((1e-7, 4e-7, 1e-7, 9e-7))
    grid = (np.arange(20_000) + 0.5) * 1e-5
    ages = np.maximum(seconds[:, None] - grid, 0.0)
    covariance = CHANCE_RAD2_S3 * (ages @ ages.T) * 1e-5 + np.diag(variances)
    white = whitening(seconds, variances)
    assert white @ covariance @ white.T == pytest.approx(np.eye(4), abs=1e-4)


@pytest.fixture(scope="module")
def courses() -> list[Course]:
    runs = [
        braked(1_000_000 * (k + 1), 1100.0 + 40.0 * k, 0.09 + 0.01 * k, Split(k % 2))
        for k in range(6)
    ]
    none = np.zeros(2 * TEETH)
    found = [make_course(run, SHEET, none, ATMOSPHERE_PA, k / 5 - 0.5)
             for k, run in enumerate(runs)]  # fmt: skip
    return [course for course in found if course is not None]


def moved(course: Course) -> Course:
    """In the middle of the run a sleeve gives the shaft a push."""
    push: Vector = 0.3 * np.maximum(np.linspace(-1.0, 1.0, course.angle.size), 0.0)
    return replace(course, angle=course.angle + push)


def test_a_run_in_which_something_else_moved_the_shaft_is_as_if_it_were_not_there(
    courses: list[Course],
) -> None:
    among = [*courses[:3], moved(courses[2]), *courses[3:]]
    found, alone = (fit(each, SHEET, False, 900.0 * RPM) for each in (among, courses))
    assert found.used.tolist() == [True] * 3 + [False] + [True] * 3
    assert alone.used.all()
    off = np.abs(found.parameters - alone.parameters) / alone.prior.sd
    assert off.max() < 2e-3
    assert found.misfit == pytest.approx(alone.misfit, rel=0.01)
    assert found.covariance == pytest.approx(alone.covariance, rel=0.05, abs=1e-12)
    assert found.without.shape == (6, found.parameters.size)


def test_what_is_found_without_a_run_is_what_the_others_alone_tell(courses: list[Course]) -> None:
    whole = fit(courses, SHEET, False, 900.0 * RPM)
    for k in (0, 5):
        others = fit([*courses[:k], *courses[k + 1 :]], SHEET, False, 900.0 * RPM)
        off = np.abs(whole.without[k] - others.parameters) / whole.prior.sd
        assert off.max() < 0.1


def test_air_that_flows_choked_all_the_way_takes_as_long_as_at_its_first_rate() -> None:
    """The brake fills at the rate times the supply's absolute pressure, up to 63.2 % of the gauge
    pressure: that share of it, over the rate."""
    gauge_pa, atmosphere_pa = 8e5, 1e5
    (filling_s,) = time_constant_s(np.array([20.0]), gauge_pa, atmosphere_pa, np.array([0.8]), True)
    gone_pa = (1.0 - math.exp(-1.0)) * gauge_pa
    assert filling_s == pytest.approx(gone_pa / (gauge_pa + atmosphere_pa) / 20.0, rel=1e-6)


def test_air_that_leaves_choked_falls_exponentially_from_its_absolute_pressure() -> None:
    gauge_pa, atmosphere_pa = 8e5, 1e5
    (emptying_s,) = time_constant_s(
        np.array([20.0]), gauge_pa, atmosphere_pa, np.array([0.8]), False
    )
    left_pa = math.exp(-1.0) * gauge_pa + atmosphere_pa
    assert emptying_s == pytest.approx(math.log((gauge_pa + atmosphere_pa) / left_pa) / 20.0, 1e-4)


def test_drag_is_told_at_the_layshaft_with_the_input_shaft_s_over_the_ratio_s_square() -> None:
    """The input shaft turns 1 / i as fast, and its torque is seen as 1 / i as large."""
    parameters = np.zeros((2, len(P)))
    parameters[:, P.DRAG], parameters[:, P.VISCOUS] = 5.0, 0.03
    parameters[1, P.INPUT_VISCOUS] = 0.02
    i = SHEET.split_mesh(Split.HIGH).ratio
    assert _drag(parameters, SHEET, 100.0) == pytest.approx([8.0, 8.0 + 0.02 * 100.0 / i / i])


def test_why_no_sleeve_s_delay_is_told() -> None:
    """Without commands none can be; with some there was no stroke; or nobody knows when."""
    content = LogContent()
    content.messages["ValveCommand"] = 5
    assert identify(content, SHEET).figure("sleeve delay spread").why == (
        "no stroke of a main sleeve in the log"
    )
    content.inexact = 1
    assert "at once" in identify(content, SHEET).figure("sleeve delay spread").why
    empty = identify(LogContent(), SHEET)
    assert empty.figure("sleeve delay second").why == "no valve commands in the log"


def test_a_closing_goes_with_the_engine_s_speeds_since_a_tenth_of_a_second_before_it() -> None:
    content = LogContent()
    track = _ClosingTrack(content)
    begin_us = 2_000_000
    spoken = [begin_us - 100_001, begin_us - 100_000, *range(begin_us, begin_us + 200_000, 10_000)]
    for time_us in spoken:
        track.engine(time_us, 100.0)
    for step in range(21):
        track.clutch(begin_us + 10_000 * step, 0.05 * step)
    (closing,) = content.closings
    assert closing.time_us[0] == begin_us
    assert closing.closed[:3] == pytest.approx([0.0, 0.05, 0.1])
    assert closing.engine_us.tolist() == spoken[1:]


def test_a_clutch_that_turns_back_or_was_seen_too_late_has_not_closed() -> None:
    for shares in ([0.0, 0.2, 0.4, 0.6, 0.5, 0.8, 1.0], [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]):
        content = LogContent()
        track = _ClosingTrack(content)
        for step, share in enumerate(shares):
            track.engine(10_000 * step, 100.0)
            track.clutch(10_000 * step, share)
        assert not list(content.closings)


def test_a_brake_is_empty_ten_time_constants_after_its_valve_went_off() -> None:
    """Then its sensor shows its own zero, and not before; nor while the valve is on."""
    brake = replace(SHEET.brake, time_constant_s=1.0 / 16.0)
    reader, off_us, rest_us = LogReader(replace(SHEET, brake=brake)), 2_000_000, 625_000
    reader._valves.take(
        ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=1_000_000), 900_000
    )
    reader._take_sensors(GearboxSensors(brake_pressure_pa=9e5), off_us - 1)
    reader._valves.take(
        ValveCommand(brake_action=ValveAction.OFF_AT, brake_time_us=off_us), off_us - 1
    )
    for since_us in (0, rest_us - 1, rest_us, rest_us + 1):
        sensors = GearboxSensors(brake_pressure_pa=1e5 + since_us)
        reader._take_sensors(sensors, off_us + since_us)
    assert list(reader.content.empty_pa) == [1e5 + rest_us + 1]
