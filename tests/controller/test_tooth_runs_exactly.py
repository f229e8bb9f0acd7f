"""Runs for the teeth: how many groups they make, and the teeth by the brake's model as one set of
least squares."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_tooth_fit_exactly import EDGES, PITCH, TOOTH_COUNT, errors_of, turned

from meshpoint.controller.records import Vector
from meshpoint.testbench.identify.brake_fit import whitening
from meshpoint.testbench.identify.tooth_fit import (
    JUDDER,
    ToothFit,
    _judder_shape,
    teeth_by_model,
    tooth_fit,
)

LEAD, NODES = 5, 240


@pytest.mark.parametrize(("runs", "groups"), [(3, 3), (20, 20), (21, 20), (23, 20)])
def test_runs_are_left_out_one_by_one_or_in_twenty_groups(runs: int, groups: int) -> None:
    wheels = [turned(errors_of(1), 80.0 + 2.0 * k, turns=3.2, first=k) for k in range(runs)]
    found = tooth_fit(wheels, TOOTH_COUNT)
    assert found is not None
    assert found.without.shape == (groups, EDGES)


def test_a_fit_says_nothing_of_runs_that_it_was_not_given() -> None:
    fit = ToothFit(np.zeros(2), np.zeros((2, 2)), np.zeros(JUDDER))
    assert (fit.held_out_rad, fit.nominal_rad, fit.spans) == (0.0, 0.0, 0)


def test_what_is_left_of_a_perfect_wheel_is_more_than_what_is_left_of_the_one_that_is_known() -> (
    None
):
    """Teeth 3 mrad off, edges 0.1 mrad: by the others' teeth little more than that is left."""
    rng = np.random.default_rng(6)
    wheels = [
        turned(errors_of(1), 90.0, -5.0 * k, 5.2, k, 1e-4 * rng.standard_normal(400))
        for k in range(5)
    ]
    found = tooth_fit(wheels, TOOTH_COUNT)
    assert found is not None
    assert 0.7e-4 < found.held_out_rad < 1.5e-4
    assert 1.5e-3 < found.nominal_rad < 4e-3
    assert found.spans == 10


class Motion:
    """What the brake's model says of two runs: angles, speeds and felt pressures at its nodes."""

    def __init__(self) -> None:
        at = 1e-3 * (np.arange(NODES) - LEAD)
        self.angles = np.stack((100.0 * at - 20.0 * at**2, 80.0 * at), axis=1)[:, None, :]
        self.speeds = np.stack((100.0 - 40.0 * at, np.full(NODES, 80.0)), axis=1)[:, None, :]
        self.felts = np.stack((8.5e5 * np.clip(at / 0.1, 0.0, 1.0), np.full(NODES, 4e5)), axis=1)
        self.felts = self.felts[:, None, :]

    def run(self, parameters: Vector, omega: Vector) -> tuple[Vector, Vector, Vector]:
        assert (parameters.tolist(), omega.tolist()) == ([[1.0, 2.0]], [100.0, 80.0])
        return self.angles, self.speeds, self.felts


def true_angle(number: int, seconds: Vector) -> Vector:
    return np.asarray(100.0 * seconds - 20.0 * seconds**2 if number == 0 else 80.0 * seconds)


def course_of(number: int, rng: np.random.Generator) -> Any:
    """Edges of a wheel with errors, noise and a line on top of the model's motion."""
    edges = 3 + np.arange(110)
    place = edges % EDGES
    angle = PITCH * np.arange(110) + errors_of(4)[place] - errors_of(4)[place[0]]
    seconds = np.interp(angle, true_angle(number, np.linspace(0.0, 0.23, 9_000)),
                        np.linspace(0.0, 0.23, 9_000))  # fmt: skip
    theta = PITCH * np.arange(110) + 4e-4 * rng.standard_normal(110)
    theta = theta + 0.01 + 0.05 * seconds
    return SimpleNamespace(
        nodes_of_edges=LEAD + seconds / 1e-3, first_node=LEAD, theta_rad=theta,
        place=place.astype(np.float64),
    )  # fmt: skip


def test_teeth_by_the_model_are_least_squares_with_a_line_a_run_and_a_torque_of_chance() -> None:
    """All in one: errors and judder behind a prior of 20 mrad, two lines, and whitened angles of
    half a milliradian's jitter. Without each run, the other's alone."""
    model: Any = Motion()
    rng = np.random.default_rng(8)
    courses = [course_of(number, rng) for number in range(2)]
    best: Any = SimpleNamespace(
        parameters=np.array([1.0, 2.0]), omega_rad_s=np.array([100.0, 80.0])
    )
    first = ToothFit(np.zeros(EDGES), np.zeros((2, EDGES)), np.zeros(JUDDER), 0.1, 0.2, 7)
    found = teeth_by_model(first, courses, model, best)
    assert found is not None

    def solved(numbers: list[int]) -> Vector:
        rows, rights = [], []
        for k in numbers:
            course = courses[k]
            seconds = 1e-3 * (course.nodes_of_edges - LEAD)
            node = course.nodes_of_edges.astype(int)
            share = model.felts[node, 0, k] / 8.5e5
            block = np.zeros((seconds.size, EDGES + JUDDER + 4))
            block[np.arange(seconds.size), course.place.astype(int)] = -1.0
            block[:, EDGES : EDGES + JUDDER] = _judder_shape(
                share, model.speeds[node, 0, k], course.place, EDGES
            )
            block[:, EDGES + JUDDER + 2 * k] = 1.0
            block[:, EDGES + JUDDER + 2 * k + 1] = seconds
            white = whitening(seconds, np.full(seconds.size, 2.5e-7))
            rows.append(white @ block)
            rights.append(white @ (course.theta_rad - true_angle(k, seconds)))
        prior = np.eye(EDGES + JUDDER, EDGES + JUDDER + 4) / 0.02
        right = np.concatenate([*rights, np.zeros(EDGES + JUDDER)])
        own = np.linalg.lstsq(np.vstack([*rows, prior]), right, rcond=None)[0]
        own[:EDGES] -= own[:EDGES].mean()
        return np.asarray(own[: EDGES + JUDDER])

    expected = solved([0, 1])
    assert found.error_rad == pytest.approx(expected[:EDGES], abs=1e-7)
    assert found.judder == pytest.approx(expected[EDGES:], abs=1e-7)
    for k in range(2):
        assert found.without[k] == pytest.approx(solved([1 - k])[:EDGES], abs=1e-7)
    assert (found.held_out_rad, found.nominal_rad, found.spans) == (0.1, 0.2, 7)


def test_by_the_model_runs_are_left_out_in_twenty_groups_and_an_edge_must_be_seen() -> None:
    model: Any = Motion()
    rng = np.random.default_rng(8)
    whole = vars(course_of(1, rng)) | {"first_node": LEAD}
    course: Any = SimpleNamespace(
        **{name: part[:48] if name != "first_node" else part for name, part in whole.items()}
    )
    model.angles, model.speeds, model.felts = (
        np.repeat(each[:, :, 1:], 22, axis=2) for each in (model.angles, model.speeds, model.felts)
    )
    model.run = lambda *_: (model.angles, model.speeds, model.felts)
    best: Any = SimpleNamespace(parameters=np.zeros(2), omega_rad_s=np.zeros(22))
    first = ToothFit(np.zeros(EDGES), np.zeros((2, EDGES)), np.zeros(JUDDER))
    found = teeth_by_model(first, [course] * 22, model, best)
    assert found is not None
    assert found.without.shape == (20, EDGES)
    blind: Any = SimpleNamespace(
        **(vars(course) | {"place": np.minimum(course.place, EDGES - 2.0)})
    )
    assert teeth_by_model(first, [blind] * 22, model, best) is None
