"""Predictions of a run's last speed: what counts as an error, and of which runs they are made."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_identification import SHEET

from meshpoint.controller.records import Vector
from meshpoint.testbench.identify.brake_course import COUNT, P
from meshpoint.testbench.identify.held_out import _end_errors, check_runs, check_samples

LEAD, NODES, BINS = 4, 40, 17
NODE = LEAD + 2 * np.arange(BINS)
"""The first of the two nodes that a bin's mean comes from; they are a millisecond apart."""


def course_of(rest: Vector, angles: Vector, speeds: Vector) -> Any:
    """Measured angles that are off what is told by `rest`: a bin's mean is three tenths of one
    node's angle and seven of the next one's, and 2 ms of one speed less 1 ms of the other."""
    weights = np.zeros((BINS, NODES, 2))
    rows = np.arange(BINS)
    weights[rows, NODE, 0], weights[rows, NODE + 1, 0] = 0.3, 0.7
    weights[rows, NODE, 1], weights[rows, NODE + 1, 1] = 0.002, -0.001
    told = 0.3 * angles[NODE] + 0.7 * angles[NODE + 1]
    told = told + 0.002 * speeds[NODE] - 0.001 * speeds[NODE + 1]
    return SimpleNamespace(weights=weights, nodes=NODES, first_node=LEAD, angle=told + rest)


def slope_of(rest: Vector) -> float:
    """Of the line of least squares through equally spaced values, 2 ms apart."""
    at = 2e-3 * (np.arange(rest.size) - (rest.size - 1) / 2.0)
    return float(at @ rest / (at @ at))


def test_an_error_is_how_much_faster_the_last_six_bins_are_off_than_the_first_six() -> None:
    """By lines of least squares through what is left of them; a constant speed is no error."""
    rng = np.random.default_rng(5)
    angles, speeds = rng.standard_normal((NODES + 6, 3)), rng.standard_normal((NODES + 6, 3))
    rest = 1e-3 * rng.standard_normal(BINS)
    rest[[6, -7]] += 0.5
    course = course_of(rest, angles[:, 1], speeds[:, 1])
    found = _end_errors(course, angles, speeds)
    assert found.shape == (3,)
    assert found[1] == pytest.approx(slope_of(rest[-6:]) - slope_of(rest[:6]), rel=1e-9)
    turning = course_of(rest + 5.0 * 2e-3 * np.arange(BINS), angles[:, 1], speeds[:, 1])
    assert _end_errors(turning, angles, speeds)[1] == pytest.approx(found[1], rel=1e-9)


class Model:
    """Shafts that turn faster from half of a run on: by a speed in rad/s that is 10 times their
    viscous drag, their touch pressure and their first speed together."""

    def run(self, parameters: Vector, omega: Vector) -> tuple[Vector, Vector, None]:
        s = 10.0 * parameters[:, P.VISCOUS] + parameters[:, P.TOUCH]
        late = 1e-3 * np.maximum(np.arange(NODES) - NODES / 2.0, 0.0)
        angles = late[:, None, None] * (s[:, None] + omega)
        return angles, np.zeros_like(angles), None


def test_each_run_s_last_speed_is_predicted_without_it_and_by_the_sheet() -> None:
    """A sheet's brake is taken to touch at no pressure, and its friction is 0.06 Nms. Runs that
    were left out of the fit are left out here, too."""
    none = np.zeros(NODES)
    courses = [course_of(np.zeros(BINS), none, none) for _ in range(2)]
    without = np.zeros((2, COUNT))
    without[:, P.VISCOUS], without[:, P.TOUCH] = (0.1, 0.2), (0.5, -0.5)
    best: Any = SimpleNamespace(
        omega_rad_s=np.array([3.0, 99.0, -1.0]), used=np.array([True, False, True]),
        without=without,
    )  # fmt: skip
    model: Any = Model()
    found = check_runs(model, courses, best, SHEET)
    friction = SHEET.shafts.friction_nms
    rpm = 60.0 / (2.0 * math.pi)
    assert found.identified == pytest.approx(rpm * math.sqrt((4.5**2 + 0.5**2) / 2.0))
    by_sheet = (10.0 * friction + 3.0, 10.0 * friction - 1.0)
    assert found.by_sheet == pytest.approx(rpm * math.hypot(*by_sheet) / math.sqrt(2.0))
    assert (found.unit, found.samples) == ("rpm", 2)
    assert found.name == "layshaft speed at the end of a run"


def test_samples_are_told_by_the_roots_of_their_mean_squares() -> None:
    found = check_samples("delay", "ms", np.array([3.0, -4.0, 0.0]), np.array([6.0, 8.0, 0.0]))
    assert (found.name, found.unit, found.samples) == ("delay", "ms", 3)
    assert found.identified == pytest.approx(5.0 / math.sqrt(3.0))
    assert found.by_sheet == pytest.approx(10.0 / math.sqrt(3.0))
