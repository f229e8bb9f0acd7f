"""The fit's equations and its steps, on runs so simple that both can be written down."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_identification import SHEET

from meshpoint.controller.records import Vector
from meshpoint.testbench.identify import brake_fit as module
from meshpoint.testbench.identify.brake_course import COUNT, prior_of
from meshpoint.testbench.identify.brake_fit import BrakeFit, RunFit, fit, whitening

PRIOR = prior_of(SHEET)
WEIGHT = np.diag(1.0 / PRIOR.sd**2)


def test_a_run_s_misfit_is_its_squares_over_their_number_and_a_share_of_it_weighs_a_share() -> None:
    part = RunFit(np.eye(2), np.array([1.0, 2.0]), 12.0, 8)
    assert part.misfit == 1.5
    less = part.weighed(0.25)
    assert less.normal.tolist() == [[0.25, 0.0], [0.0, 0.25]]
    assert less.right.tolist() == [0.25, 0.5]
    assert (less.squares, less.values) == (3.0, 8)


class Runs:
    """Runs whose misfit is a parabola about a target of their own: each says where the others'
    parameters are off from it. Takes the place of the motion."""

    def __init__(self, targets: list[Vector], squares: list[float]) -> None:
        rng = np.random.default_rng(7)
        self.targets, self.squares = targets, squares
        half = [rng.standard_normal((COUNT, COUNT)) / PRIOR.sd for _ in targets]
        self.normals = [each.T @ each for each in half]
        self.asked: list[Vector] = []
        self.slopes = [rng.standard_normal(COUNT) / PRIOR.sd for _ in targets]

    def equations(self, _model: Any, _courses: Any, white: list[str], at: Vector, omega: Vector,
                  prior: Any) -> tuple[list[RunFit], list[Any]]:  # fmt: skip
        assert white == ["white"] * len(self.targets)
        assert prior.sd.tolist() == PRIOR.sd.tolist()
        self.asked.append(at.copy())
        parts = [
            RunFit(normal, normal @ (target - at), squares, 10)
            for normal, target, squares in zip(
                self.normals, self.targets, self.squares, strict=True
            )
        ]
        return parts, [lambda step, own=own: float(own @ step) for own in self.slopes]

    def best(self, shares: list[float]) -> Vector:
        """Where all parabolas together, so weighed, and the prior's are least."""
        normal, right = WEIGHT.copy(), WEIGHT @ PRIOR.mean
        for share, own, target in zip(shares, self.normals, self.targets, strict=True):
            normal, right = normal + share * own, right + share * own @ target
        return np.asarray(np.linalg.solve(normal, right))

    def fitted(self, monkeypatch: pytest.MonkeyPatch) -> BrakeFit:
        model: Any = SimpleNamespace(omega_ref=None)
        monkeypatch.setattr(module, "BrakeCourses", lambda *_: model)
        monkeypatch.setattr(module, "_whitening", lambda _: "white")
        monkeypatch.setattr(module, "_equations", self.equations)
        courses: Any = [SimpleNamespace(omega_rad_s=100.0 + k) for k in range(len(self.targets))]
        found = fit(courses, SHEET, True, 77.0)
        assert model.omega_ref == 77.0
        return found


def targets(count: int, share: float = 0.2) -> list[Vector]:
    rng = np.random.default_rng(3)
    return [
        np.asarray(PRIOR.mean + share * PRIOR.sd * rng.uniform(-1.0, 1.0, COUNT))
        for _ in range(count)
    ]


def test_the_best_parameters_are_where_all_runs_and_the_prior_together_are_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And without each run, where the others are; a run's own speed goes with the steps."""
    runs = Runs(targets(4), [10.0, 12.0, 9.0, 11.0])
    found = runs.fitted(monkeypatch)
    assert found.parameters == pytest.approx(runs.best([1.0] * 4), rel=1e-9, abs=1e-12)
    assert found.without.shape == (4, COUNT)
    for k in range(4):
        others = runs.best([float(j != k) for j in range(4)])
        assert found.without[k] == pytest.approx(others, rel=1e-6, abs=1e-9)
    assert found.misfit == pytest.approx(42.0 / 40.0)
    normal = WEIGHT + sum(runs.normals)
    assert found.covariance @ normal == pytest.approx(np.eye(COUNT), abs=1e-8)
    gone = found.parameters - PRIOR.mean
    speeds = [100.0 + k + runs.slopes[k] @ gone for k in range(4)]
    assert found.omega_rad_s == pytest.approx(speeds)
    assert found.used.tolist() == [True] * 4
    assert found.prior.mean.tolist() == PRIOR.mean.tolist()
    assert len(runs.asked) == 7, "a fit that has come to rest is over with its seventh iteration"


def test_no_parameter_goes_further_in_a_step_than_its_prior_s_deviation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    far = np.asarray(PRIOR.mean + 3.6 * PRIOR.sd)
    runs = Runs([far, far], [10.0, 10.0])
    runs.normals = [1e4 * WEIGHT, 1e4 * WEIGHT]
    found = runs.fitted(monkeypatch)
    ways = [np.max(np.abs(b - a) / PRIOR.sd)
            for a, b in zip(runs.asked, runs.asked[1:], strict=False)]  # fmt: skip
    assert ways[:4] == pytest.approx([1.0, 1.0, 1.0, 0.6], abs=1e-3)
    assert found.parameters == pytest.approx(runs.best([1.0, 1.0]), rel=1e-6)


def test_a_run_that_hardly_fits_weighs_less_at_first_and_as_much_as_any_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Four times the usual misfit: by the square of three fourths."""
    runs = Runs(targets(4), [10.0, 10.0, 40.0, 10.0])
    found = runs.fitted(monkeypatch)
    assert runs.asked[1] == pytest.approx(runs.best([1.0, 1.0, 9.0 / 16.0, 1.0]), rel=1e-9)
    assert runs.asked[5] == pytest.approx(runs.best([1.0, 1.0, 9.0 / 16.0, 1.0]), rel=1e-9)
    assert runs.asked[6] == pytest.approx(runs.best([1.0] * 4), rel=1e-9)
    assert found.used.all()
    assert found.misfit == pytest.approx(70.0 / 40.0)


@pytest.mark.parametrize(("squares", "is_used"), [(80.0, True), (81.0, False)])
def test_a_run_beyond_eight_times_the_usual_misfit_is_left_out(
    squares: float, is_used: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = Runs(targets(5), [10.0, squares, 10.0, 10.0, 10.0])
    found = runs.fitted(monkeypatch)
    share = float(is_used)
    assert found.used.tolist() == [True, is_used, True, True, True]
    assert found.parameters == pytest.approx(runs.best([1.0, share, 1.0, 1.0, 1.0]), rel=1e-9)
    assert len(found.without) == 4 + is_used
    assert found.misfit == pytest.approx((40.0 + share * squares) / (40.0 + 10.0 * share))
    first = runs.best([1.0, (3.0 / (squares / 10.0)) ** 2, 1.0, 1.0, 1.0])
    assert runs.asked[1] == pytest.approx(first, rel=1e-9)


@pytest.mark.parametrize(("share", "iterations"), [(0.9e-3, 7), (1.1e-3, 12)])
def test_a_fit_goes_on_for_twelve_iterations_while_a_step_is_a_thousandth_of_a_deviation(
    share: float, iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = Runs(targets(2), [10.0, 10.0])
    runs.normals = [1e9 * WEIGHT, 1e9 * WEIGHT]

    def wandering(*arguments: Any) -> tuple[list[RunFit], list[Any]]:
        runs.targets = [np.asarray(arguments[3] + share * PRIOR.sd)] * 2
        return runs.equations(*arguments)

    model: Any = SimpleNamespace()
    monkeypatch.setattr(module, "BrakeCourses", lambda *_: model)
    monkeypatch.setattr(module, "_whitening", lambda _: "white")
    monkeypatch.setattr(module, "_equations", wandering)
    courses: Any = [SimpleNamespace(omega_rad_s=100.0)] * 2
    fit(courses, SHEET, True, 77.0)
    assert len(runs.asked) == iterations


NODES, LEAD, BINS = 60, 10, 14


class Line:
    """Motions that are straight in the parameters and in the first speed."""

    def __init__(self) -> None:
        rng = np.random.default_rng(11)
        self.by = [rng.standard_normal((NODES + 3, COUNT, 2)) / PRIOR.sd[:, None] for _ in range(3)]
        self.base = rng.standard_normal((3, NODES + 3, 2))
        self.at_s = 1e-3 * (np.arange(NODES + 3) - LEAD)[:, None]

    def run(self, lanes: Vector, omega: Vector) -> tuple[Vector, Vector, Vector]:
        out = [
            self.base[k][:, None, :] + np.einsum("npr,lp->nlr", self.by[k], lanes) for k in range(3)
        ]
        out[0] = out[0] + (self.at_s * (omega + 0.02 * omega * np.abs(self.at_s)))[:, None, :]
        return out[0], out[1], 1e5 * out[2]


def course_of(seed: int, nodes: int = NODES) -> Any:
    rng = np.random.default_rng(seed)
    weights = np.zeros((BINS, nodes, 2))
    first = LEAD + 3 * np.arange(BINS)
    weights[np.arange(BINS), first, 0], weights[np.arange(BINS), first + 1, 0] = 0.25, 0.75
    weights[:, :, 1] = 1e-3 * rng.standard_normal((BINS, nodes))
    return SimpleNamespace(
        weights=weights, nodes=nodes, first_node=LEAD, angle=rng.standard_normal(BINS),
        edges=rng.integers(1, 6, BINS).astype(np.float64),
        pressure_s=np.array([-0.001, 0.0, 0.0105, 0.02, 1e-3 * (nodes - 1), 0.3]),
        pressure_pa=1e5 * rng.standard_normal(6),
    )  # fmt: skip


def test_a_run_s_equations_are_least_squares_with_its_own_angle_and_speed_eliminated() -> None:
    """By the Schur complement of the joint normal equations; pressures within the run's nodes stand
    beside the angles, 0.06 bar each. Its speed follows the parameters as the joint solution's."""
    model: Any = Line()
    courses = [course_of(1), course_of(2, NODES - 5)]
    rng = np.random.default_rng(5)
    white = [np.asarray(rng.standard_normal((BINS, BINS)) + 3.0 * np.eye(BINS)) for _ in courses]
    at = np.asarray(PRIOR.mean + 0.1 * PRIOR.sd)
    omega = np.array([100.0, 120.0])
    parts, own = module._equations(model, courses, white, at, omega, PRIOR)
    angles, speeds, felts = (each[:, 0] for each in model.run(at[None], omega))
    for k, course in enumerate(courses):
        n, w = course.nodes, course.weights
        slopes = w[:, :, 0] @ model.by[0][:n, :, k] + w[:, :, 1] @ model.by[1][:n, :, k]
        told = w[:, :, 0] @ angles[:n, k] + w[:, :, 1] @ speeds[:n, k]
        at_s = model.at_s[:n, 0]
        by_omega = w[:, :, 0] @ (at_s * (1.0 + 0.02 * np.abs(at_s)))
        loose = white[k] @ np.stack((np.ones(BINS), by_omega), axis=1)
        fixed, rest = white[k] @ slopes, white[k] @ (course.angle - told)
        keep = np.eye(BINS) - loose @ np.linalg.inv(loose.T @ loose) @ loose.T
        node = course.pressure_s[2:4] / 1e-3
        by_felt = np.array([np.interp(node, np.arange(NODES + 3), column)
                            for column in 1e5 * model.by[2][:, :, k].T]).T / 6e3  # fmt: skip
        felt = np.interp(node, np.arange(NODES + 3), felts[:, k])
        off = (course.pressure_pa[2:4] - felt) / 6e3
        normal = fixed.T @ keep @ fixed + by_felt.T @ by_felt
        scale = np.abs(normal).max()
        assert parts[k].normal / scale == pytest.approx(normal / scale, abs=1e-6)
        right = fixed.T @ keep @ rest + by_felt.T @ off
        assert parts[k].right / np.abs(right).max() == pytest.approx(
            right / np.abs(right).max(), abs=1e-6
        )
        assert parts[k].squares == pytest.approx(float(rest @ keep @ rest + off @ off), rel=1e-6)
        assert parts[k].values == BINS + 2
        step = 0.3 * PRIOR.sd
        joint = np.linalg.lstsq(loose, rest - fixed @ step, rcond=None)[0]
        assert own[k](step) == pytest.approx(joint[1], rel=1e-4)


def test_a_bin_s_angle_is_as_sure_as_its_edges_are_many_and_never_surer_than_a_tenth_mrad() -> None:
    """0.6 mrad an edge; its time is that of its weights. Chance moves the shaft by 0.25 rad2/s3."""
    assert module.CHANCE_RAD2_S3 == 0.25
    course = course_of(3)
    seconds: Vector = (1e-3 * (3.0 * np.arange(BINS) + 0.75)).astype(np.float64)
    expected = whitening(seconds, 3.6e-7 / course.edges + 1e-8)
    assert module._whitening(course) == pytest.approx(expected)
