"""Sleeves' strokes and closings of the clutch: which tell a delay or a kiss point, and what."""

from __future__ import annotations

import math

import numpy as np
import pytest
from logged_gearbox import SHEET
from scipy.stats import chi2
from scipy.stats import t as student_law

from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.controller.sleeve.tracked import Contact
from meshpoint.gearbox import MainGear
from meshpoint.identify.clutch_fit import touch_of, touches
from meshpoint.identify.identified import Identified
from meshpoint.identify.identify import identify
from meshpoint.identify.log_reader import Closing, LogContent
from meshpoint.identify.sleeve_fit import SleeveFit, sleeve_fit

FIRED_US, DELAY_MS = 5_000_000, 1e3 * SHEET.sleeve.delay_s
Seen = tuple[MainGear, Contact]


def met(delay_ms: float, gear: MainGear = MainGear.FIRST, expected_ms: float = DELAY_MS) -> Seen:
    """A contact so long after its firing; the law, without the stroke's chance, says the sheet's
    delay."""
    measured_us, usual_us = FIRED_US + 1e3 * delay_ms, FIRED_US + 1e3 * DELAY_MS
    expected_us = FIRED_US + 1e3 * expected_ms
    return gear, Contact(1, FIRED_US, 0.0, measured_us, expected_us, usual_us, None)


def content_of(contacts: list[Seen]) -> LogContent:
    content = LogContent(sleeves=Sleeves(SHEET))
    content.messages["ValveCommand"] = 1
    for contact in contacts:
        content.contacts.add(contact)
    return content


def test_delays_are_the_law_s_and_what_it_leaves_of_each_contact() -> None:
    """A contact 20 ms from what was expected was held up by something else."""
    found = sleeve_fit(content_of([met(44.0), met(47.0), met(64.0), met(66.0, expected_ms=44.0)]))
    assert found is not None
    assert found.delays_s[MainGear.FIRST] == pytest.approx([0.044, 0.047, 0.064], abs=2e-5)
    assert len(found.errors_s) == 3
    assert sleeve_fit(content_of([])) is None


def fit_of(*delays: list[float]) -> SleeveFit:
    by_gear = dict(zip(MainGear, map(np.array, delays), strict=False))
    return SleeveFit(by_gear, {}, np.zeros(0), np.zeros(0))


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


def reported(contacts: list[Seen]) -> Identified:
    return identify(content_of(contacts), SHEET)


def test_a_gear_s_delay_is_its_mean_with_what_few_strokes_that_go_together_leave_unknown() -> None:
    """First and second have squares of 5 and 2 about their means and products of -0.75 and -1:
    less than the 0.3 that is taken. What the law itself does not know comes on top."""
    first, second = [44.0, 46.0, 47.0, 45.0], [50.0, 52.0, 51.0]
    found = reported([met(ms, expected_ms=44.0) for ms in first]
                     + [met(ms, MainGear.SECOND, 52.0) for ms in second])  # fmt: skip
    law_ms = 1e3 * Sleeves(SHEET).law_figures(MainGear.FIRST).contact_s.sd
    r = 0.3
    expected = 4 - 1 - 2 * (3 / 4 * r + 2 / 4 * r**2 + 1 / 4 * r**3)
    expected += 3 - 1 - 2 * (2 / 3 * r + 1 / 3 * r**2)
    spread_ms, wider = math.sqrt(7.0 / expected), math.sqrt(1.3 / 0.7)
    for name, delays in (("first", first), ("second", second)):
        figure, mean = found.figure(f"sleeve delay {name}"), sum(delays) / len(delays)
        half = student_law.ppf(0.975, 5) * spread_ms * wider / math.sqrt(len(delays))
        half = math.hypot(half, 1.96 * law_ms)
        assert figure.value == pytest.approx(mean, abs=0.02)
        assert (figure.low, figure.high) == (
            pytest.approx(mean - half, abs=0.02), pytest.approx(mean + half, abs=0.02),
        )  # fmt: skip
    assert found.figure("sleeve delay third").why == "the log has no stroke into this gear"
    spread, freedom = found.figure("sleeve delay spread"), 5.0 * (1.0 - r**2) / (1.0 + r**2)
    assert spread.value == pytest.approx(spread_ms)
    assert spread.low == pytest.approx(spread_ms * math.sqrt(freedom / chi2.ppf(0.975, freedom)))
    assert spread.high == pytest.approx(spread_ms * math.sqrt(freedom / chi2.ppf(0.025, freedom)))
    check = next(each for each in found.held_out if each.name == "sleeve delay")
    off = np.array([ms - 44.0 for ms in first] + [ms - 52.0 for ms in second])
    assert check.identified == pytest.approx(math.sqrt(np.mean(np.square(off))))
    by_sheet = np.array(first + second) - 45.0
    assert check.by_sheet == pytest.approx(math.sqrt(np.mean(np.square(by_sheet))))


def test_two_strokes_tell_nothing_and_three_of_one_gear_do() -> None:
    few = reported([met(45.0), met(46.0)])
    assert few.value("sleeve delay first") is None
    assert few.figure("sleeve delay spread").why == "too few strokes into one gear"
    three = reported([met(45.0), met(46.0), met(44.0)])
    assert three.value("sleeve delay first") == pytest.approx(45.0, abs=0.02)
    none = reported([]).figure("sleeve delay spread").why
    assert none == "no contact of a main sleeve in the log"


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
