"""What identification tells of the teeth, of runs kept out, and in which order it goes about it."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import linregress
from scipy.stats import t as student_law
from test_identification import SHEET

from meshpoint.controller.records import Vector
from meshpoint.testbench.identify import held_out, identify
from meshpoint.testbench.identify.brake_course import P, prior_of
from meshpoint.testbench.identify.brake_figures import _reference
from meshpoint.testbench.identify.held_out import _end_errors, check_runs
from meshpoint.testbench.identify.identified import Identified
from meshpoint.testbench.identify.log_reader import LogContent
from meshpoint.testbench.identify.tooth_fit import ToothFit
from meshpoint.units import RPM

BINS, NODES, MORE, FIRST = 20, 80, 5, 7


def course() -> Any:
    """Each bin is the mean of two nodes, and a little of the speed at a third; edges at equal times
    but for the ends, where they are not."""
    rng = np.random.default_rng(5)
    weights = np.zeros((BINS, NODES, 2))
    for k in range(BINS):
        for node in rng.choice(np.arange(4 * k, 4 * k + 4), 2, replace=False):
            weights[k, node, 0] = 0.5
        weights[k, 4 * k + 1, 1] = 2e-4
    angle = np.linspace(0.0, 9.0, BINS) + 0.02 * rng.standard_normal(BINS)
    return SimpleNamespace(weights=weights, nodes=NODES, first_node=FIRST, angle=angle)


def test_a_run_s_error_is_the_speed_at_its_end_less_predicted_beyond_that_at_its_begin() -> None:
    """Of six bins each, by lines of least squares through what the prediction leaves; of each
    lane. What is predicted beyond the run's nodes is of a longer one."""
    rng, own = np.random.default_rng(6), course()
    angles = np.cumsum(rng.uniform(0.05, 0.2, (NODES + MORE, 2)), axis=0)
    speeds = rng.uniform(80.0, 120.0, (NODES + MORE, 2))
    found = _end_errors(own, angles, speeds)
    assert found.shape == (2,)
    for lane in range(2):
        left, at = [], []
        for k in range(BINS):
            mean = sum(own.weights[k, n, 0] * angles[n, lane] for n in range(NODES))
            mean += sum(own.weights[k, n, 1] * speeds[n, lane] for n in range(NODES))
            left.append(own.angle[k] - mean)
            at.append(1e-3 * sum(own.weights[k, n, 0] * n for n in range(NODES)))
        begin = linregress(at[:6], left[:6]).slope
        end = linregress(at[-6:], left[-6:]).slope
        assert found[lane] == pytest.approx(end - begin, rel=1e-6)


def test_each_run_is_predicted_by_the_others_and_by_a_sheet_whose_pads_touch_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From its own first speed; runs that were not used have none. Errors are told in rpm."""
    size = len(P)
    without = np.arange(2.0 * size).reshape(2, size)
    best: Any = SimpleNamespace(
        without=without, used=np.array([1.0, 0.0, 1.0]), omega_rad_s=np.array([90.0, 55.0, 110.0])
    )
    asked, given = list[tuple[Vector, Vector]](), list[Any]()

    def run(both: Vector, omega: Vector) -> tuple[Vector, Vector, None]:
        asked.append((both, omega))
        cube = np.arange(2.0)[None, None, :] + np.zeros((4, 2, 2))
        return cube, 10.0 + cube, None

    def ends(course: Any, angles: Vector, speeds: Vector) -> Vector:
        given.append((course, float(angles[0, 0]), float(speeds[0, 0])))
        return np.array([3.0 * RPM, 5.0 * RPM]) * (1.0 if course == "a" else -2.0)

    monkeypatch.setattr(held_out, "_end_errors", ends)
    model: Any = SimpleNamespace(run=run)
    courses: Any = ["a", "b"]
    found = check_runs(model, courses, best, SHEET)
    assert given == [("a", 0.0, 10.0), ("b", 1.0, 11.0)]
    by_sheet = prior_of(SHEET).mean.copy()
    assert by_sheet[P.TOUCH] != 0.0
    for k, (both, omega) in enumerate(asked):
        assert omega.tolist() == [90.0, 110.0]
        assert both[0].tolist() == without[k].tolist()
        expected = [0.0 if p == P.TOUCH else by_sheet[p] for p in range(size)]
        assert both[1].tolist() == expected
    assert (found.unit, found.samples) == ("rpm", 2)
    assert found.identified == pytest.approx(math.sqrt((3.0**2 + 6.0**2) / 2.0))
    assert found.by_sheet == pytest.approx(math.sqrt((5.0**2 + 10.0**2) / 2.0))


TEETH = SHEET.wheels.main.teeth
TURN = 2.0 * math.pi


def errors(wider_rad: float, ripple_rad: float, odd_rad: float) -> Vector:
    """Teeth wider by an angle, a wheel that is eccentric, and every tooth off to the other side."""
    found = np.empty(2 * TEETH)
    for k in range(TEETH):
        off = ripple_rad * math.cos(TURN * k / TEETH)
        off += odd_rad * math.cos(TURN * 5 * k / TEETH)
        found[2 * k], found[2 * k + 1] = off - wider_rad / 2.0, off + wider_rad / 2.0
    return found


def test_teeth_are_told_with_what_leaving_out_groups_of_runs_changes() -> None:
    """Three groups: duty 50 % and 100 z / 2 pi of what the teeth are wider by; the jackknife's
    deviation of three is sqrt(2 / 3 of the sum of squares), Student's law has two degrees. No
    eccentricity is negative. The layshaft's wheel was not fitted."""
    each = [(1e-3, 2e-3, 1e-3), (2e-3, 2.5e-3, 1e-3), (3e-3, 0.9e-3, 1.3e-3)]
    fit = ToothFit(
        errors(2e-3, 1e-3, 1.2e-3), np.array([errors(*one) for one in each]), np.zeros(4),
        math.radians(0.02), math.radians(0.3), 17,
    )  # fmt: skip
    found, content = Identified(), LogContent()
    found.teeth["main"] = fit
    for _ in range(6):
        run: Any = SimpleNamespace()
        content.runs.add(run)
    identify._teeth(found, content, SHEET)
    share = 100.0 * TEETH / TURN
    wanted = (
        ("main wheel duty", "%", [50.0 + share * w for w, _, _ in each], 50.0 + share * 2e-3, 50.0),
        ("main wheel eccentricity", "deg", np.degrees([r for _, r, _ in each]),
         math.degrees(1e-3), None),
        ("main wheel pitch error RMS", "deg", np.degrees([o for *_, o in each]) / math.sqrt(2.0),
         math.degrees(1.2e-3) / math.sqrt(2.0), None),
    )  # fmt: skip
    for name, unit, without, value, by_sheet in wanted:
        figure = found.figure(name)
        spread = np.sum((np.array(without) - np.mean(without)) ** 2)
        half = float(student_law.ppf(0.975, 2)) * math.sqrt(2.0 / 3.0 * float(spread))
        assert figure.value == pytest.approx(value)
        assert figure.low == pytest.approx(max(value - half, 0.0), abs=1e-12)
        assert figure.high == pytest.approx(value + half)
        assert (figure.unit, figure.samples) == (unit, 6)
        assert figure.sheet == (None if by_sheet is None else pytest.approx(by_sheet))
    assert found.figure("main wheel eccentricity").low == 0.0
    assert (found.figure("main wheel duty").low or 0.0) > 1.0
    (check,) = found.held_out
    assert (check.name, check.unit, check.samples) == ("main wheel: angle of an edge", "deg", 17)
    assert (check.identified, check.by_sheet) == (pytest.approx(0.02), pytest.approx(0.3))
    duty = found.figure("layshaft wheel duty")
    assert (duty.value, duty.sheet) == (None, pytest.approx(50.0))
    assert duty.why == "no layshaft edges in the log"
    lacking = replace(SHEET.wheels.layshaft, missing=(3,))
    sheet = replace(SHEET, wheels=replace(SHEET.wheels, layshaft=lacking))
    again = Identified()
    identify._teeth(again, content, sheet)
    assert again.figure("layshaft wheel eccentricity").why == "the wheel has missing teeth"
    assert again.figure("main wheel eccentricity").why == "no layshaft edges in the log"


def test_each_wheel_that_has_all_its_teeth_is_fitted_the_layshaft_s_beside_the_brake(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Pressures are told over what the sensor shows of an empty brake."""
    asked: list[tuple[Any, int, Any]] = []

    def fitted(wheels: Any, teeth: int, beside: Any) -> str | None:
        asked.append((wheels, teeth, beside))
        return "fit" if teeth == SHEET.wheels.main.teeth else None

    monkeypatch.setattr(identify, "tooth_fit", fitted)
    content, found = LogContent(), Identified()
    pressure = np.array([[10.0, 20.0, 30.0], [1.5e5, 2.5e5, 4e5]])
    run: Any = SimpleNamespace(layshaft="L", main="M", pressure=pressure)
    content.runs.add(run)
    identify._fit_teeth(found, content, SHEET, 1e5)
    (first, second) = asked
    assert first[:2] == (["L"], SHEET.wheels.layshaft.teeth)
    assert first[2][0].tolist() == [[10.0, 20.0, 30.0], [0.5e5, 1.5e5, 3e5]]
    assert second == (["M"], SHEET.wheels.main.teeth, None)
    assert found.teeth == {"main": "fit"}
    asked.clear()
    lacking = replace(SHEET.wheels.main, missing=(3,))
    identify._fit_teeth(
        found, content, replace(SHEET, wheels=replace(SHEET.wheels, main=lacking)), 1e5
    )
    assert [each[1] for each in asked] == [SHEET.wheels.layshaft.teeth]


def test_an_empty_brake_is_at_the_mean_of_what_its_sensor_showed_or_at_the_atmosphere() -> None:
    content = LogContent()
    assert identify._zero_pa(content, SHEET) == SHEET.air.atmosphere_pa
    content.empty_pa.extend([1e5, 1.02e5, 1.04e5])
    assert identify._zero_pa(content, SHEET) == pytest.approx(1.02e5)


def test_who_waits_is_told_of_each_step_and_what_no_log_can_tell_is_said() -> None:
    steps: list[str] = []
    found = identify.identify(LogContent(), SHEET, steps.append)
    assert steps == ["teeth", "brake", "sleeves", "clutch"]
    names = [figure.name for figure in found.figures]
    assert names[-2:] == ["layshaft inertia", "driveline stiffness"]
    assert [found.figure(name).unit for name in names[-2:]] == ["kg m2", "Nm/rad"]
    for name in ("main wheel duty", "layshaft wheel duty", "sleeve delay crawl", "drag"):
        assert name in names
    assert found.figure("sleeve delay crawl").sheet == pytest.approx(45.0)
    assert found.figure("sleeve delay spread").sheet == pytest.approx(2.5)
    assert found.figure("brake filling time").sheet == pytest.approx(45.0)
    assert found.figure("brake emptying time").sheet == pytest.approx(45.0)
    assert found.figure("brake valve on delay").sheet == pytest.approx(12.0)
    assert found.figure("brake valve off delay").sheet == pytest.approx(12.0)
    assert found.figure("inertia ratio").sheet == pytest.approx(0.11 / 0.24)
    assert found.figure("clutch kiss point").sheet == pytest.approx(35.0)


def test_torque_and_drag_are_told_at_the_runs_median_speed_in_whole_tens_of_rpm() -> None:
    """Bins are 5 ms long: 0.195 s from the middle of the first of 40 to that of the last."""
    runs: list[Any] = [
        SimpleNamespace(angle=3.0 + np.linspace(0.0, rpm * RPM * 0.195, 40))
        for rpm in (700, 913, 2000)
    ]
    assert _reference(runs) == pytest.approx(910.0 * RPM)
    assert _reference(runs[1:]) == pytest.approx(1460.0 * RPM)
