"""Sleeves' strokes and closings of the clutch: which tell a delay or a kiss point, and what."""

from __future__ import annotations

import math

import numpy as np
import pytest
from logged_gearbox import SHEET
from scipy.stats import chi2
from scipy.stats import t as student_law

from meshpoint.gearbox import MainGear
from meshpoint.testbench.identify.clutch_fit import touch_of, touches
from meshpoint.testbench.identify.identified import Identified
from meshpoint.testbench.identify.identify import identify
from meshpoint.testbench.identify.log_reader import Closing, LogContent, Stroke
from meshpoint.testbench.identify.sleeve_fit import SleeveFit, contact_of, sleeve_fit

AIR_PA = SHEET.air.atmosphere_pa
SUPPLY_PA = SHEET.air.supply_gauge_pa + AIR_PA
WAY_M = SHEET.sleeve.to_contact_m
FIRED_US = 5_000_000
VALVE_S, DELAY_S = SHEET.sleeve.valve_delay_s, SHEET.sleeve.delay_s


def stroke_of(shares: list[float], at_ms: list[float], gear: MainGear = MainGear.FIRST) -> Stroke:
    """A sleeve that was at these shares of its way so long after it was fired."""
    at_us = FIRED_US + 1e3 * np.array(at_ms)
    return Stroke(gear, FIRED_US, at_us, WAY_M * np.array(shares), SUPPLY_PA, None)


def steady(
    roots: list[float], valve_s: float = VALVE_S, delay_s: float = DELAY_S,
    gear: MainGear = MainGear.FIRST,
) -> Stroke:  # fmt: skip
    """A sleeve under a constant force, seen where the roots of its shares are these."""
    at = [1e3 * (valve_s + root * (delay_s - valve_s)) for root in roots]
    return stroke_of([root**2 for root in roots], at, gear)


def pushed(delay_s: float, gear: MainGear = MainGear.FIRST, supply_pa: float = SUPPLY_PA) -> Stroke:
    stroke = steady(np.linspace(0.0, 1.0, 40).tolist(), delay_s=delay_s, gear=gear)
    return stroke._replace(supply_pa=supply_pa)


def crossing_of(shares: list[float], at_ms: list[float]) -> float:
    """When the root is one by the line of least squares through these, weighed by their shares,
    from its normal equations."""
    share, at = np.array(shares), np.array(at_ms)
    basis = np.stack((np.ones(share.size), at))
    offset, slope = np.linalg.solve((basis * share) @ basis.T, (basis * share) @ np.sqrt(share))
    return float((1.0 - offset) / slope) * 1e-3


def test_the_line_goes_through_the_samples_between_six_and_ninety_percent_of_the_way() -> None:
    """The others are off the line: each that is taken too much, or left out, moves the contact."""
    shares = [0.0, 0.03, 0.058, 0.065, 0.10, 0.17, 0.25, 0.35, 0.47, 0.60, 0.74, 0.89, 0.91, 1.0]
    off_ms = [0.0, 0.7, -0.9, 0.6, -0.3, 0.2, 0.1, -0.2, 0.3, -0.1, 0.2, -0.3, 0.9, 2.0]
    at_ms = [
        12.0 + 33.0 * math.sqrt(share) + off for share, off in zip(shares, off_ms, strict=True)
    ]
    found = contact_of(stroke_of(shares, at_ms), SHEET)
    assert found is not None
    assert found.delay_s == pytest.approx(crossing_of(shares[3:12], at_ms[3:12]), abs=1e-9)
    assert found.supply_pa == SUPPLY_PA


def test_a_sleeve_that_fell_back_is_timed_from_its_last_start_on() -> None:
    """What it did before it came back to below six percent was another move."""
    shares = [0.0, 0.2, 0.05, 0.10, 0.17, 0.25, 0.35, 0.47, 0.60, 0.74, 0.89, 0.95]
    at_ms = [10.0, 12.0, 19.0, *[12.0 + 33.0 * math.sqrt(share) for share in shares[3:]]]
    found = contact_of(stroke_of(shares, at_ms), SHEET)
    assert found is not None
    assert found.delay_s == pytest.approx(0.045, abs=1e-9)


def test_a_sleeve_that_a_tooth_stops_half_way_or_that_never_came_there_is_not_timed() -> None:
    held = stroke_of([0.0, *np.linspace(0.1, 0.5, 9), *[0.5] * 12, *np.linspace(0.6, 1.0, 5)],
                     np.linspace(12.0, 60.0, 27).tolist())  # fmt: skip
    assert contact_of(held, SHEET) is None
    assert contact_of(steady(np.linspace(0.0, 0.94, 20).tolist()), SHEET) is None
    assert contact_of(steady(np.linspace(0.0, 0.96, 20).tolist()), SHEET) is not None


@pytest.mark.parametrize(
    ("valve_ms", "delay_ms", "is_timed"),
    [
        (12.0, 63.0, True),
        (12.0, 67.0, False),
        (5.0, 27.0, True),
        (5.0, 23.0, False),
        (0.5, 45.0, True),
        (-0.5, 45.0, False),
        (-0.5, 67.0, False),
    ],
)
def test_a_contact_is_within_20_ms_of_the_sheet_s_and_begins_after_the_command(
    valve_ms: float, delay_ms: float, is_timed: bool
) -> None:
    """The data sheet has 45 ms. A sleeve that moved before it was fired was moved by another."""
    roots = np.linspace(0.3, 1.0, 20).tolist()
    found = contact_of(steady(roots, 1e-3 * valve_ms, 1e-3 * delay_ms), SHEET)
    assert (found is not None) is is_timed


def test_delays_are_reported_as_if_all_strokes_had_the_same_air() -> None:
    """A sleeve under p times the force takes 1 / sqrt(p) of the time from its valve's opening."""
    gauges = np.array((6e5, 7e5, 8e5, 9e5))
    strokes = [
        pushed(VALVE_S + 0.03 * math.sqrt(gauges.mean() / gauge), supply_pa=gauge + AIR_PA)
        for gauge in gauges
    ]
    found = sleeve_fit([*strokes, pushed(0.09)], SHEET)
    assert found is not None
    assert found.supply_pa == pytest.approx(gauges.mean() + AIR_PA)
    assert found.delays_s[MainGear.FIRST] == pytest.approx([VALVE_S + 0.03] * 4, abs=1e-9)
    assert (found.used, found.seen) == (4, 5)
    assert sleeve_fit([], SHEET) is None


def fit_of(*delays: list[float]) -> SleeveFit:
    by_gear = dict(zip(MainGear, map(np.array, delays), strict=False))
    return SleeveFit(by_gear, SUPPLY_PA, sum(map(len, delays)), 99)


def test_strokes_that_drift_go_together() -> None:
    """One to five: their deviations' products with the one before are 2, 0, 0 and 2 over squares
    of 10; and a mean of five takes a fifth. A pair says nothing: about their mean any two are
    opposite. Neither a delay nor a unit changes it, and it is 0.3 to 0.8."""
    line = [1.0, 2.0, 3.0, 4.0, 5.0]
    assert fit_of(line).correlation == pytest.approx(0.4 + 0.2)
    assert fit_of(line, [7.0, 8.0, 9.0]).correlation == pytest.approx(4.0 / 12.0 + 2.0 / 8.0)
    assert fit_of(line, [7.0, 8.0]).correlation == pytest.approx(0.6)
    assert fit_of([45.0 - 1e-3 * each for each in line]).correlation == pytest.approx(0.6)
    assert fit_of([1.0, 3.0] * 5).correlation == fit_of([1.0]).correlation == 0.3
    assert fit_of([float(k) for k in range(40)]).correlation == 0.8


def test_the_spread_is_right_on_average_for_strokes_that_go_together_as_they_are_said_to() -> None:
    """What eight strokes' sum of squares is divided by is what such a sum is on average, of strokes
    of variance 1 that remember as much of the one before: here of 20,000 gears."""
    strokes = np.arange(8.0)
    found = fit_of(strokes.tolist())
    r, rng = found.correlation, np.random.default_rng(2)
    many = rng.standard_normal((8, 20_000))
    for k in range(1, 8):
        many[k] = r * many[k - 1] + math.sqrt(1.0 - r**2) * many[k]
    on_average = float(np.mean(8.0 * many.var(axis=0)))
    assert found.spread_s**2 == pytest.approx(8.0 * strokes.var() / on_average, rel=0.03)
    assert found.effective_freedom == pytest.approx(7.0 * (1.0 - r**2) / (1.0 + r**2))


def reported(strokes: list[Stroke]) -> Identified:
    content = LogContent()
    content.messages["ValveCommand"] = 1
    for stroke in strokes:
        content.strokes.add(stroke)
    return identify(content, SHEET)


def test_a_gear_s_delay_is_its_mean_with_what_few_strokes_that_go_together_leave_unknown() -> None:
    """First and second have squares of 5 and 2 about their means and products of -0.75 and -1:
    less than the 0.3 that is taken. Each is off the mean of the others of its gear by n / (n - 1)
    of its deviation."""
    first, second = [44.0, 46.0, 47.0, 45.0], [50.0, 52.0, 51.0]
    found = reported([pushed(1e-3 * ms) for ms in first]
                 + [pushed(1e-3 * ms, MainGear.SECOND) for ms in second])  # fmt: skip
    r = 0.3
    expected = 4 - 1 - 2 * (3 / 4 * r + 2 / 4 * r**2 + 1 / 4 * r**3)
    expected += 3 - 1 - 2 * (2 / 3 * r + 1 / 3 * r**2)
    spread_ms, wider = math.sqrt(7.0 / expected), math.sqrt(1.3 / 0.7)
    for name, delays in (("first", first), ("second", second)):
        figure, mean = found.figure(f"sleeve delay {name}"), sum(delays) / len(delays)
        half = student_law.ppf(0.975, 5) * spread_ms * wider / math.sqrt(len(delays))
        assert figure.value == pytest.approx(mean)
        assert (figure.low, figure.high) == (
            pytest.approx(mean - half), pytest.approx(mean + half),
        )  # fmt: skip
    assert found.figure("sleeve delay third").why == "the log has no stroke into this gear"
    spread, freedom = found.figure("sleeve delay spread"), 5.0 * (1.0 - r**2) / (1.0 + r**2)
    assert spread.value == pytest.approx(spread_ms)
    assert spread.low == pytest.approx(spread_ms * math.sqrt(freedom / chi2.ppf(0.975, freedom)))
    assert spread.high == pytest.approx(spread_ms * math.sqrt(freedom / chi2.ppf(0.025, freedom)))
    check = next(each for each in found.held_out if each.name == "sleeve delay")
    off = [d[k] - np.delete(d, k).mean() for d in (first, second) for k in range(len(d))]
    assert check.identified == pytest.approx(math.sqrt(np.mean(np.square(off))))
    by_sheet = np.array(first + second) - 45.0
    assert check.by_sheet == pytest.approx(math.sqrt(np.mean(np.square(by_sheet))))


def test_two_strokes_tell_nothing_and_three_of_one_gear_do() -> None:
    few = reported([pushed(0.045), pushed(0.046)])
    assert few.value("sleeve delay first") is None
    assert few.figure("sleeve delay spread").why == "too few strokes into one gear"
    three = reported([pushed(0.045), pushed(0.046), pushed(0.044)])
    assert three.value("sleeve delay first") == pytest.approx(45.0)
    assert reported([]).figure("sleeve delay spread").why == "no stroke of a main sleeve in the log"


def kinked(share: float, bend_rad_s: float = 4.0, noise_rad_s: float = 0.0) -> Closing:
    """A steady closing of 200 ms: the engine slows down evenly and, from the touch on, with the
    square of the time, by `bend_rad_s` more in 31 ms. Noise goes up and down."""
    at = np.arange(0.0, 0.201, 0.01)
    since = np.arange(-12, 13) * 5e-3 + 1e-3
    speeds = 140.0 - 70.0 * since - bend_rad_s / 0.031**2 * np.maximum(since, 0.0) ** 2
    speeds += noise_rad_s * np.where(np.arange(since.size) % 2, 1.0, -1.0)
    return Closing(at * 1e6, at / 0.2, (share * 0.2 + since) * 1e6, speeds)


@pytest.mark.parametrize(
    ("closing", "share"),
    [
        (kinked(0.2525), 0.2525),  # looked for each quarter of a percent, 10 % about the sheet's 35
        (kinked(0.3575), 0.3575),
        (kinked(0.4025), 0.4025),
        (kinked(0.25), None),  # at the end of what is looked at it may lie beyond it
        (kinked(0.46), None),
        (kinked(0.3575, 0.45), None),  # plates that bend the speed by less than 0.5 rad/s
        (kinked(0.3575, 0.55), 0.3575),
        (kinked(0.3575, 8.0, 1.3), None),  # an engine that does not go by the kink
        (kinked(0.3575, 0.0), None),
    ],
)
def test_the_kiss_point_is_the_kink_in_the_engine_s_speed(
    closing: Closing, share: float | None
) -> None:
    assert touch_of(closing, SHEET) == (None if share is None else pytest.approx(share, abs=1e-9))
    assert touches([closing], SHEET).size == (share is not None)


def test_the_kiss_point_is_the_mean_of_the_closings_with_what_the_engine_s_message_leaves() -> None:
    """31, 33, 35, 37 and 39 %: a mean of 35 with a standard deviation of sqrt(10). An engine speed
    is 2 ms old, give or take: 1 % of a closing of 200 ms."""
    content = LogContent()
    content.messages["EEC1"] = 1
    for share in (0.31, 0.33, 0.35, 0.37):
        content.closings.add(kinked(share))
    why = identify(content, SHEET).figure("clutch kiss point").why
    assert why == "4 of 4 closings show where the plates touch"
    content.closings.add(kinked(0.39))
    figure = identify(content, SHEET).figure("clutch kiss point")
    half = math.hypot(student_law.ppf(0.975, 4) * math.sqrt(10.0 / 5.0), 1.96 * 1.0)
    assert figure.value == pytest.approx(35.0, abs=1e-6)
    assert (figure.low, figure.high) == (
        pytest.approx(35.0 - half, abs=1e-6), pytest.approx(35.0 + half, abs=1e-6),
    )  # fmt: skip
