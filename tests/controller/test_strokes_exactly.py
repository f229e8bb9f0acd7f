"""Sleeves' strokes in a log: which are timed, from which of their samples, and what is told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import t as student_law
from test_identification import SHEET

from meshpoint.gearbox import MainGear
from meshpoint.testbench.identify.identified import Identified
from meshpoint.testbench.identify.identify import _sleeves
from meshpoint.testbench.identify.log_reader import LogContent, Stroke
from meshpoint.testbench.identify.sleeve_fit import SleeveFit, contact_of, sleeve_fit

SUPPLY_PA = SHEET.air.supply_gauge_pa + SHEET.air.atmosphere_pa
WAY_M = SHEET.sleeve.to_contact_m
FIRED_US = 5_000_000
VALVE_S, DELAY_S = 0.012, 0.045
"""Those of the data sheet, and those of a stroke that is nothing special."""


def stroke_of(shares: list[float], at_ms: list[float]) -> Stroke:
    """A sleeve that was at these shares of its way so long after it was fired."""
    at_us = FIRED_US + 1e3 * np.array(at_ms)
    return Stroke(MainGear.FIRST, FIRED_US, at_us, WAY_M * np.array(shares), SUPPLY_PA, None)


def steady(roots: list[float], valve_s: float = VALVE_S, delay_s: float = DELAY_S) -> Stroke:
    """A sleeve under a constant force, seen where the roots of its shares are these."""
    at = [1e3 * (valve_s + root * (delay_s - valve_s)) for root in roots]
    return stroke_of([root**2 for root in roots], at)


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


def test_a_sleeve_that_was_not_seen_before_six_percent_is_timed_from_its_first_sample_on() -> None:
    shares = [0.08, 0.12, 0.17, 0.25, 0.35, 0.47, 0.60, 0.74, 0.89, 0.95]
    off_ms = [0.8, -0.3, 0.2, 0.1, -0.2, 0.3, -0.1, 0.2, -0.3, 0.0]
    at_ms = [
        12.0 + 33.0 * math.sqrt(share) + off for share, off in zip(shares, off_ms, strict=True)
    ]
    found = contact_of(stroke_of(shares, at_ms), SHEET)
    assert found is not None
    assert found.delay_s == pytest.approx(crossing_of(shares[:9], at_ms[:9]), abs=1e-9)


def test_a_sleeve_that_fell_back_is_timed_from_its_last_start_on() -> None:
    """What it did before it came back to below six percent was another move."""
    shares = [0.0, 0.2, 0.05, 0.10, 0.17, 0.25, 0.35, 0.47, 0.60, 0.74, 0.89, 0.95]
    at_ms = [10.0, 12.0, 19.0, *[12.0 + 33.0 * math.sqrt(share) for share in shares[3:]]]
    found = contact_of(stroke_of(shares, at_ms), SHEET)
    assert found is not None
    assert found.delay_s == pytest.approx(0.045, abs=1e-9)


@pytest.mark.parametrize(("count", "is_timed"), [(7, False), (8, True), (9, True)])
def test_eight_samples_between_make_a_line(count: int, is_timed: bool) -> None:
    """However many there are before and behind."""
    between = np.linspace(0.3, 0.9, count).tolist()
    found = contact_of(steady([0.0, 0.05, 0.1, 0.15, *between, 0.97, 1.0, 1.0]), SHEET)
    assert (found is not None) is is_timed


def test_a_sleeve_that_never_came_to_the_teeth_is_not_timed() -> None:
    assert contact_of(steady(np.linspace(0.0, 0.94, 20).tolist()), SHEET) is None
    assert contact_of(steady(np.linspace(0.0, 0.96, 20).tolist()), SHEET) is not None


@pytest.mark.parametrize(("rest", "is_timed"), [(0.045, True), (0.055, False)])
def test_roots_may_lie_a_twentieth_off_their_line_on_the_mean(rest: float, is_timed: bool) -> None:
    """Up and down by as much: the line goes between them."""
    roots = np.linspace(0.3, 0.9, 60)
    moved = roots + rest * np.where(np.arange(60) % 4 < 2, 1.0, -1.0) * np.where(
        np.arange(60) % 2, 1.0, -1.0
    )
    at_ms = 1e3 * (VALVE_S + roots * (DELAY_S - VALVE_S))
    stroke = stroke_of([*(moved**2).tolist(), 0.99], [*at_ms.tolist(), 45.0])
    inside = np.flatnonzero(moved**2 >= 0.9)
    assert not inside.size
    assert (contact_of(stroke, SHEET) is not None) is is_timed


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


def fit_of(by_gear: dict[MainGear, list[float]], seen: int = 99) -> SleeveFit:
    delays = {gear: np.array(own) for gear, own in by_gear.items()}
    return SleeveFit(delays, SUPPLY_PA, sum(map(len, by_gear.values())), seen)


def test_two_strokes_have_a_spread_for_which_they_are_taken_to_go_together_a_little() -> None:
    """Squares about their mean: 2. Of two values that go together by 0.3 they are 0.7 on average
    where the variance is 1. One degree of freedom is never less than one."""
    found = fit_of({MainGear.FIRST: [1.0, 3.0]})
    assert found.correlation == 0.3
    assert found.freedom == 1
    assert found.spread_s == pytest.approx(math.sqrt(2.0 / 0.7))
    assert found.effective_freedom == 1.0
    assert math.isnan(fit_of({MainGear.FIRST: [1.0], MainGear.SECOND: [2.0]}).spread_s)


def test_a_stroke_of_the_mean_pressure_among_others_is_told_as_it_was() -> None:
    """And one gear's strokes are no other's."""
    roots = np.linspace(0.3, 1.0, 20).tolist()
    first, second = steady(roots), steady(roots, delay_s=0.05)._replace(gear=MainGear.THIRD)
    held_up = steady(roots, delay_s=0.09)
    found = sleeve_fit([first, second, held_up], SHEET)
    assert found is not None
    assert list(found.delays_s) == [MainGear.FIRST, MainGear.THIRD]
    assert found.delays_s[MainGear.FIRST] == pytest.approx([0.045])
    assert found.delays_s[MainGear.THIRD] == pytest.approx([0.05])
    assert (found.used, found.seen) == (2, 3)


def told(fitted: SleeveFit | None) -> Identified:
    found = Identified()
    content = LogContent()
    content.messages["ValveCommand"] = 1
    _sleeves(found, fitted, content, SHEET)
    return found


FIRST_MS = [44.0, 46.0, 47.0, 45.0]
SECOND_MS = [50.0, 52.0, 51.0]


def test_a_gear_s_delay_is_its_mean_with_what_few_strokes_that_go_together_leave_unknown() -> None:
    """First: deviations -1.5, 0.5, 1.5, -0.5, squares 5, products -0.75 + 0.75 - 0.75 = -0.75;
    second: -1, 1, 0, squares 2, products -1. Together -1.75 / 7 + 2 / 7: less than 0.3, which is
    what is taken. The other gears were not seen."""
    by_gear = {
        MainGear.FIRST: [1e-3 * each for each in FIRST_MS],
        MainGear.SECOND: [1e-3 * each for each in SECOND_MS],
    }
    fitted = fit_of(by_gear)
    found = told(fitted)
    assert found.supply_pa == SUPPLY_PA
    r = 0.3
    expected = 4 - 1 - 2 * (3 / 4 * r + 2 / 4 * r**2 + 1 / 4 * r**3)
    expected += 3 - 1 - 2 * (2 / 3 * r + 1 / 3 * r**2)
    spread_ms = math.sqrt(7.0 / expected)
    wider = math.sqrt(1.3 / 0.7)
    for name, delays in (("first", FIRST_MS), ("second", SECOND_MS)):
        figure = found.figure(f"sleeve delay {name}")
        mean = sum(delays) / len(delays)
        half = student_law.ppf(0.975, 5) * spread_ms * wider / math.sqrt(len(delays))
        assert figure.value == pytest.approx(mean)
        assert figure.low == pytest.approx(mean - half)
        assert figure.high == pytest.approx(mean + half)
        assert (figure.sheet, figure.unit) == (pytest.approx(45.0), "ms")
        assert (figure.samples, figure.why) == (len(delays), "")
    for name in ("crawl", "third"):
        figure = found.figure(f"sleeve delay {name}")
        assert (figure.value, figure.samples) == (None, 0)
        assert figure.why == "the log has no stroke into this gear"
    spread = found.figure("sleeve delay spread")
    freedom = 5.0 * (1.0 - r**2) / (1.0 + r**2)
    assert spread.value == pytest.approx(spread_ms)
    assert spread.low == pytest.approx(spread_ms * math.sqrt(freedom / chi2.ppf(0.975, freedom)))
    assert spread.high == pytest.approx(spread_ms * math.sqrt(freedom / chi2.ppf(0.025, freedom)))
    assert (spread.sheet, spread.samples, spread.unit) == (pytest.approx(2.5), 7, "ms")


def test_strokes_are_checked_by_the_mean_of_the_others_of_their_gear_and_by_the_sheet() -> None:
    """Of 44, 46, 47 and 45 each is off the mean of the other three by 4 / 3 of its deviation; a
    gear's only stroke has no others."""
    by_gear = {
        MainGear.FIRST: [1e-3 * each for each in FIRST_MS],
        MainGear.SECOND: [1e-3 * each for each in SECOND_MS],
        MainGear.THIRD: [0.060],
    }
    (check,) = told(fit_of(by_gear)).held_out
    off = [np.array(FIRST_MS)[k] - np.delete(FIRST_MS, k).mean() for k in range(4)]
    off += [np.array(SECOND_MS)[k] - np.delete(SECOND_MS, k).mean() for k in range(3)]
    assert (check.name, check.unit, check.samples) == ("sleeve delay", "ms", 7)
    assert check.identified == pytest.approx(math.sqrt(sum(each**2 for each in off) / 7.0))
    by_sheet = [each - 45.0 for each in FIRST_MS + SECOND_MS]
    assert check.by_sheet == pytest.approx(math.sqrt(sum(each**2 for each in by_sheet) / 7.0))


def test_two_strokes_tell_nothing_and_three_of_one_gear_do() -> None:
    few = told(fit_of({MainGear.FIRST: [0.045, 0.046]}))
    assert few.figure("sleeve delay spread").why == "too few strokes into one gear"
    assert few.value("sleeve delay first") is None
    assert few.figure("sleeve delay first").why == "too few strokes into one gear"
    assert few.figure("sleeve delay third").why == "the log has no stroke into this gear"
    assert not few.held_out
    three = told(fit_of({MainGear.FIRST: [0.045, 0.046, 0.044]}))
    assert three.value("sleeve delay first") == pytest.approx(45.0)
    assert three.value("sleeve delay spread") is not None
    assert three.held_out[0].samples == 3
