"""The clutch's closing in a log: which speeds tell where the plates touch, and what is told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student_law
from test_identification import SHEET

from meshpoint.controller.records import Vector
from meshpoint.gearbox import GearboxSheet
from meshpoint.testbench.identify.clutch_fit import _bend, touch_of
from meshpoint.testbench.identify.identified import Identified
from meshpoint.testbench.identify.identify import _clutch
from meshpoint.testbench.identify.log_reader import Closing, LogContent

CLOSED_AT = ((0.0, 0.0), (0.1, 20_000.0), (0.3, 50_000.0), (0.5, 90_000.0), (1.0, 200_000.0))
"""Shares of the travel and times (us) at which the clutch was seen: it is not steady."""
TOUCH_US = 70_000.0
"""When it is at 0.4 of its travel: half-way between 0.3 and 0.5."""


def seen(offsets_ms: list[float], speeds: Vector, last: int = len(CLOSED_AT)) -> Closing:
    """Engine speeds at times from that of the touch on."""
    closed, at_us = np.array(CLOSED_AT[:last]).T
    return Closing(at_us, closed, TOUCH_US + 1e3 * np.array(offsets_ms), speeds)


def test_a_bend_is_what_is_left_when_a_line_and_a_parabola_from_the_touch_on_are_taken() -> None:
    """By the normal equations of the speeds within 50 ms before and 35 ms after. What is left is
    told as three figures' fit leaves it; the bend is that at the latest of these speeds."""
    ms = [-60.0, -51.0, -49.0, -33.0, -21.0, -8.0, 3.0, 11.0, 24.0, 34.0, 36.0, 43.0, 70.0]
    own = np.array([3, -4, 0.02, -0.03, 0.05, -0.01, 0.04, -0.06, 0.02, 0.03, 5, -6, 7.0])
    at = 1e-3 * np.array(ms)
    closing = seen(ms, 140.0 - 70.0 * at - 2000.0 * np.maximum(at, 0.0) ** 2 + own)
    found = _bend(closing, 0.4)
    assert found is not None
    near, y = at[2:10], closing.engine_rad_s[2:10]
    basis = np.stack((np.ones(8), near, np.where(near > 0.0, near**2, 0.0)))
    solved = np.linalg.solve(basis @ basis.T, basis @ y)
    left = y - solved @ basis
    assert found[0] == pytest.approx(math.sqrt(float(left @ left) / (8 - 3)), rel=1e-6)
    assert found[1] == pytest.approx(abs(solved[2]) * 0.034**2, rel=1e-6)
    assert solved[2] == pytest.approx(-2000.0, abs=200.0)


@pytest.mark.parametrize(
    ("offsets_ms", "is_told"),
    [
        ([-40, -30, -20, -10, 10, 20, 30], True),
        ([-30, -20, -10, 10, 20, 30], False),
        ([-40, -30, -20, -10, 5, 10, 20, 30], True),
        ([-40, -30, -20, -15, -10, 10, 20], False),
        ([-40, -30, -20, -10, 0, 10, 20], False),
        ([-60, -55, -30, -20, -10, 10, 20, 30], False),
        ([-40, -30, -20, -10, 10, 20, 36, 40], False),
        ([5, 10, 15, 20, 25, 30, 34], True),
    ],
)
def test_seven_speeds_near_the_touch_three_of_them_after_it_tell_of_a_bend(
    offsets_ms: list[float], is_told: bool
) -> None:
    speeds = 140.0 + 0.1 * np.arange(len(offsets_ms))
    assert (_bend(seen(offsets_ms, speeds), 0.4) is not None) is is_told


@pytest.mark.parametrize(
    ("share", "last", "is_told"),
    [
        (0.0, 5, False),  # there from the first sample on: nobody knows since when
        (0.05, 5, True),
        (0.5, 4, True),  # the last sample is the very share
        (0.51, 4, False),
        (1.0, 5, True),
    ],
)
def test_a_touch_is_between_two_samples_of_the_clutch(
    share: float, last: int, is_told: bool
) -> None:
    ms = np.arange(-130.0, 180.0, 5.0)
    speeds = 140.0 + 0.1 * np.arange(ms.size)
    assert (_bend(seen(ms.tolist(), speeds, last), share) is not None) is is_told


def kinked(share: float, bend_rad_s: float = 4.0, sheet: GearboxSheet = SHEET) -> Closing:
    """A steady closing; 31 ms after their touch the plates have bent the engine's speed by so much,
    and 36 ms after it comes the next speed."""
    travel_s = sheet.clutch.close_delay_s
    at = np.arange(0.0, travel_s + 0.001, 0.01)
    touch_s = share * travel_s
    since = np.arange(-12, 13) * 5e-3 + 1e-3
    speeds = 140.0 - 70.0 * since - bend_rad_s / 0.031**2 * np.maximum(since, 0.0) ** 2
    return Closing(at * 1e6, at / travel_s, (touch_s + since) * 1e6, speeds)


@pytest.mark.parametrize("step", [1, 23, 61])
def test_touches_are_looked_for_each_quarter_of_a_percent(step: int) -> None:
    """From two tolerances below the sheet's, 25 %, to two above, 45 %."""
    share = 0.25 + 0.0025 * step
    assert touch_of(kinked(share), SHEET) == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize("share", [0.24, 0.25, 0.46])
def test_a_touch_at_the_end_of_what_is_looked_at_may_lie_beyond_it(share: float) -> None:
    assert touch_of(kinked(share), SHEET) is None


@pytest.mark.parametrize(("bend_rad_s", "is_told"), [(0.45, False), (0.55, True)])
def test_plates_show_by_half_a_radian_a_second_at_the_latest_speed_that_is_looked_at(
    bend_rad_s: float, is_told: bool
) -> None:
    """That is 31 ms after the touch."""
    assert (touch_of(kinked(0.3575, bend_rad_s), SHEET) is not None) is is_told


@pytest.mark.parametrize("kiss", [0.05, 0.95])
def test_a_clutch_that_touches_near_an_end_of_its_travel_is_looked_at_no_further(
    kiss: float,
) -> None:
    sheet = replace(SHEET, clutch=replace(SHEET.clutch, kiss_share=kiss))
    assert touch_of(kinked(kiss, sheet=sheet), sheet) == pytest.approx(kiss, abs=1e-9)


def told(shares: list[float], messages: tuple[str, ...] = ("EEC1",)) -> Identified:
    content, found = LogContent(), Identified()
    content.messages.update(messages)
    for share in shares:
        content.closings.add(kinked(share))
    _clutch(found, content, SHEET)
    return found


def test_the_kiss_point_is_the_mean_of_the_closings_with_what_the_engine_s_message_leaves() -> None:
    """31, 33, 35, 37 and 39 %: a mean of 35 with a standard deviation of sqrt(10). An engine speed
    is 2 ms old, give or take: 1 % of a closing of 200 ms. Each is off the mean of the other four
    by 5 / 4 of its deviation."""
    found = told([0.31, 0.33, 0.35, 0.37, 0.39])
    figure = found.figure("clutch kiss point")
    half = math.hypot(student_law.ppf(0.975, 4) * math.sqrt(10.0 / 5.0), 1.96 * 1.0)
    assert figure.value == pytest.approx(35.0, abs=1e-6)
    assert figure.low == pytest.approx(35.0 - half, abs=1e-6)
    assert figure.high == pytest.approx(35.0 + half, abs=1e-6)
    assert (figure.unit, figure.samples, figure.sheet) == ("%", 5, pytest.approx(35.0))
    (check,) = found.held_out
    assert (check.name, check.unit, check.samples) == ("clutch kiss point", "%", 5)
    assert check.identified == pytest.approx(1.25 * math.sqrt(8.0), abs=1e-6)
    assert check.by_sheet == pytest.approx(math.sqrt(8.0), abs=1e-6)


def test_four_closings_that_show_it_are_too_few() -> None:
    figure = told([0.31, 0.33, 0.35, 0.37, 0.2]).figure("clutch kiss point")
    assert (figure.value, figure.sheet) == (None, pytest.approx(35.0))
    assert figure.why == "4 of 5 closings show where the plates touch"
    without = told([0.31, 0.33], messages=()).figure("clutch kiss point")
    assert without.why == "no engine speed (EEC1) in the log"
