"""Brake, drag and inertias as figures: by which law, with which interval, and when they are not
told. The fit itself is a double here."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student_law
from test_identification import SHEET

from meshpoint.controller.records import Vector
from meshpoint.gearbox import Split
from meshpoint.testbench.identify import brake_figures as module
from meshpoint.testbench.identify.brake_course import P, prior_of
from meshpoint.testbench.identify.brake_fit import BrakeFit
from meshpoint.testbench.identify.identified import Identified
from meshpoint.testbench.identify.log_reader import LogContent
from meshpoint.units import RPM

COUNT = len(P)
OMEGA = 90.0


def test_runs_are_placed_in_the_log_from_minus_to_plus_one_half(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By when they began, from five runs on; one of which nothing can be made is left out."""
    shares: list[float] = []

    def made(run: Any, _sheet: Any, errors: str, zero_pa: float, share: float) -> Any:
        assert (errors, zero_pa) == ("errors", 9e4)
        shares.append(share)
        return None if run.start_us == 4_000_000 else run

    monkeypatch.setattr(module, "make_course", made)
    content, errors = LogContent(), "errors"
    any_errors: Any = errors
    for k, start_us in enumerate((2_000_000, 3_000_000, 4_000_000, 7_000_000, 10_000_000)):
        assert module._courses(content, SHEET, any_errors, 9e4) == []
        run: Any = SimpleNamespace(start_us=start_us, number=k)
        content.runs.add(run)
    assert len(module._courses(content, SHEET, any_errors, 9e4)) == 4
    assert shares == pytest.approx([-0.5, -0.375, -0.25, 0.125, 0.5])


@pytest.mark.parametrize(
    ("choked", "first_order", "is_choked", "fits"),
    [(1.99, 0.5, True, 1), (2.0, 2.5, True, 2), (2.6, 2.5, False, 2), (2.5, 2.5, True, 2),
     (2.2, 1.0, False, 2)],
)  # fmt: skip
def test_a_first_order_valve_is_tried_where_a_choked_one_leaves_twice_the_noise(
    choked: float, first_order: float, is_choked: bool, fits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def fit(courses: Any, _sheet: Any, by_choked: bool, omega: float) -> Any:
        assert (courses, omega) == ("courses", OMEGA)
        asked.append(by_choked)
        return SimpleNamespace(misfit=choked if by_choked else first_order, choked=by_choked)

    monkeypatch.setattr(module, "fit", fit)
    courses: Any = "courses"
    best, found = module._fitted(courses, SHEET, OMEGA)
    told: Any = best
    assert found is told.choked is is_choked
    assert asked == [True, False][:fits]


def vector(**values: float) -> Vector:
    found = np.zeros(COUNT)
    for name, value in values.items():
        found[P[name]] = value
    return found


PARAMETERS = {
    "GAIN": math.log(0.9), "BY_SPEED": 0.04, "ON_DELAY": 0.013, "OFF_DELAY": 0.016,
    "FILLING": math.log(1.5), "EMPTYING": math.log(0.75), "CRITICAL": 0.3, "TOUCH": 0.2,
    "DRAG": 5.0, "VISCOUS": 0.03, "INERTIA": math.log(1.2), "PLATES": 0.7,
}  # fmt: skip
FIGURES = {
    "brake torque": 90.0, "brake torque by speed": 4.0, "brake valve on delay": 13.0,
    "brake valve off delay": 16.0, "brake filling time": 30.0, "brake emptying time": 60.0,
    "brake touch pressure": 0.2, "drag": 5.0 + 0.03 * OMEGA, "inertia ratio": 1.2 * 0.11 / 0.24,
    "open clutch drag": 0.7,
}  # fmt: skip


def test_figures_are_the_sheet_s_times_what_was_fitted_in_their_own_units() -> None:
    """The sheet has 100 Nm, 45 ms, and inertias of 0.11 and 0.24."""
    found = module._derived(vector(**PARAMETERS)[None], False, SHEET, OMEGA)
    assert {name: float(value[0]) for name, value in found.items()} == pytest.approx(FIGURES)
    assert tuple(found) == module.BRAKE_FIGURES


@pytest.mark.parametrize(("critical", "clipped"), [(0.3, 0.3), (0.7, 0.6), (-0.2, 0.0)])
def test_a_choked_valve_s_times_are_those_of_its_rates_and_critical_ratio(
    critical: float, clipped: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []

    def constant(rates: Vector, gauge: float, air: float, ratio: Vector, on: bool) -> Vector:
        asked.append((float(rates[0]), gauge, air, float(ratio[0]), on))
        return np.array([0.02 if on else 0.05])

    monkeypatch.setattr(module, "time_constant_s", constant)
    values = vector(**(PARAMETERS | {"CRITICAL": critical}))
    found = module._derived(values[None], True, SHEET, OMEGA)
    air = (SHEET.air.supply_gauge_pa, SHEET.air.atmosphere_pa)
    assert asked == [
        (pytest.approx(1.5 / 0.045), *air, clipped, True),
        (pytest.approx(0.75 / 0.045), *air, clipped, False),
    ]
    assert found["brake filling time"] == pytest.approx([20.0])
    assert found["brake emptying time"] == pytest.approx([50.0])


def told(
    spread: float = 0.01, own: float = 1e-9, splits: tuple[float, ...] = (0.9, 1.3, 1.3),
) -> Identified:  # fmt: skip
    """Three runs. Left out, each moves every parameter by its share of what was known before; the
    equations' own deviations are `own` of that."""
    prior = prior_of(SHEET)
    best: Any = SimpleNamespace(
        parameters=vector(**PARAMETERS),
        without=vector(**PARAMETERS) + spread * prior.sd * np.array([[-1.0], [0.0], [1.0]]),
        covariance=np.diag((own * prior.sd) ** 2),
    )
    courses: Any = [SimpleNamespace(i_split=each) for each in splits]
    found = Identified(omega_ref_rad_s=OMEGA)
    of_sheet: Any = {name: float(k) for k, name in enumerate(module.BRAKE_FIGURES)}
    module._tell_brake(found, best, False, courses, SHEET, of_sheet)
    return found


HALF = float(student_law.ppf(0.975, 2))
JACK = math.sqrt(2.0 / 3.0 * 2.0)
"""The jackknife's deviation of -1, 0 and 1."""


def test_an_interval_is_student_s_of_what_leaving_a_run_out_changes() -> None:
    """Of three runs: two degrees of freedom. The torque's has 1 % of its sensor beside it."""
    found, sd = told(), prior_of(SHEET).sd
    for k, name in enumerate(module.BRAKE_FIGURES):
        figure = found.figure(name)
        assert (figure.value, figure.sheet) == (pytest.approx(FIGURES[name]), float(k))
        assert (figure.samples, figure.unit) == (3, module.BRAKE_UNITS[name])
    for name, by in (("brake valve on delay", 1e3 * sd[P.ON_DELAY]),
                     ("brake valve off delay", 1e3 * sd[P.OFF_DELAY]),
                     ("brake touch pressure", sd[P.TOUCH]),
                     ("brake torque by speed", 100.0 * sd[P.BY_SPEED])):  # fmt: skip
        figure = found.figure(name)
        half = HALF * JACK * 0.01 * by
        assert figure.low == pytest.approx(FIGURES[name] - half)
        assert figure.high == pytest.approx(FIGURES[name] + half)
    torque = found.figure("brake torque")
    half = HALF * math.hypot(JACK * 0.01 * sd[P.GAIN] * 90.0, 0.9)
    assert torque.low == pytest.approx(90.0 - half, rel=1e-3)
    assert torque.high == pytest.approx(90.0 + half, rel=1e-3)


def test_where_the_equations_leave_more_open_than_the_runs_differ_that_is_the_interval() -> None:
    figure, sd = told(0.01, 0.1).figure("brake valve on delay"), prior_of(SHEET).sd
    assert figure.high is not None
    expected = HALF * 0.1 * 1e3 * sd[P.ON_DELAY]
    assert figure.high - 13.0 == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(("share", "is_told"), [(0.62, True), (0.79, False)])
def test_what_is_known_hardly_better_than_before_is_not_told(share: float, is_told: bool) -> None:
    """70 % of what the sheet leaves open is the limit."""
    found = told(share / JACK)
    assert [each.name for each in found.figures] == list(module.BRAKE_FIGURES)
    figure = found.figure("brake valve on delay")
    assert (figure.value is not None) is is_told
    if not is_told:
        assert figure.why == "the runs tell no more of it than the data sheet"
        assert (figure.low, figure.high, figure.samples, figure.sheet) == (None, None, 3, 2.0)


def test_in_one_step_of_the_splitter_both_inertias_are_seen_as_one() -> None:
    figure = told(splits=(1.3, 1.3, 1.3)).figure("inertia ratio")
    assert figure.value is None
    assert figure.why == "all runs in one step of the splitter: inertias are seen as one"
    assert told(splits=(1.3, 1.3, 1.3)).value("drag") is not None
    assert told(splits=(1.3, 0.9, 0.7)).value("inertia ratio") is not None


class Model:
    """What stands for the model of the courses."""

    made: list[Any]
    omega_ref = 0.0

    def __init__(self, *args: Any) -> None:
        type(self).made.append((self, *args))


def told_of(
    monkeypatch: pytest.MonkeyPatch, runs: int, used: list[bool], is_choked: bool = True,
    teeth: Any = "by the model", contradict: bool = False,
) -> tuple[Identified, list[Any]]:  # fmt: skip
    content, found = LogContent(), Identified()
    content.messages.update(["ValveCommand", "EdgesLayshaftRise", "SleevesMain", "SleevesAux",
                             "GearboxSensors"])  # fmt: skip
    found.teeth["layshaft"] = errors = SimpleNamespace(error_rad="errors")  # type: ignore[assignment]
    given: list[Any] = [errors]
    courses = [SimpleNamespace(angle=np.linspace(0.0, 913.0 * RPM * 0.195, 40), number=k)
               for k in range(runs)]  # fmt: skip
    monkeypatch.setattr(module, "_courses", lambda *_: courses)

    def fitted(*_: Any) -> Any:
        if contradict:
            raise np.linalg.LinAlgError
        return best, is_choked

    size = dict.fromkeys(BrakeFit.__dataclass_fields__)
    best: Any = BrakeFit(**(size | {"used": np.array(used), "misfit": 1.234,
                                    "omega_rad_s": np.arange(float(len(used)))}))  # type: ignore[arg-type]  # fmt: skip
    Model.made = []
    monkeypatch.setattr(module, "_fitted", fitted)
    monkeypatch.setattr(module, "BrakeCourses", Model)
    monkeypatch.setattr(
        module, "teeth_by_model", lambda *args: given.append(("teeth", *args)) or teeth
    )
    monkeypatch.setattr(module, "check_runs", lambda *args: given.append(("runs", *args)) or "kept")
    monkeypatch.setattr(module, "_tell_brake", lambda *args: given.append(("tell", *args)))
    module.brake_figures(found, content, SHEET, 9e4)
    return found, given


def test_of_five_runs_and_more_the_figures_are_told_by_those_that_were_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, given = told_of(monkeypatch, 6, [True, True, False, True, True, True])
    assert found.omega_ref_rad_s == pytest.approx(910.0 * RPM)
    assert found.notes == [
        "1 of 6 runs in neutral left out: a sleeve, the clutch or lost teeth moved the shaft",
        "brake pressure: choked flow (ISO 6358); misfit 1.23, 1 is expected",
    ]
    assert found.held_out == ["kept"]
    assert found.teeth["layshaft"] == "by the model"
    calls = {call[0]: call[1:] for call in given[1:]}
    kept = calls["tell"][3]
    assert [course.number for course in kept] == [0, 1, 3, 4, 5]
    ((model, *made),) = Model.made
    assert made == [kept, SHEET, True]
    assert model.omega_ref == found.omega_ref_rad_s
    assert calls["teeth"][:3] == (given[0], kept, model)
    assert calls["teeth"][3].omega_rad_s.tolist() == [0.0, 1.0, 3.0, 4.0, 5.0]
    assert calls["runs"][:2] == (model, kept)
    friction = SHEET.shafts.friction_nms
    drag = calls["tell"][5]["drag"]
    prior = prior_of(SHEET).mean
    i2 = SHEET.split_mesh(Split.HIGH).ratio ** -2
    viscous = prior[P.VISCOUS] + prior[P.INPUT_VISCOUS] * i2
    assert drag == pytest.approx(prior[P.DRAG] + viscous * 910.0 * RPM)
    assert friction > 0.0


def test_all_runs_used_are_no_note_and_teeth_without_a_better_fit_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, given = told_of(monkeypatch, 5, [True] * 5, is_choked=False, teeth=None)
    assert found.notes == ["brake pressure: first order; misfit 1.23, 1 is expected"]
    assert found.teeth["layshaft"] is given[0]


def test_four_runs_and_runs_that_contradict_each_other_tell_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, given = told_of(monkeypatch, 4, [True] * 4)
    assert len(given) == 1
    assert found.figure("drag").why.endswith("5 are needed")
    assert found.omega_ref_rad_s == 0.0
    found, given = told_of(monkeypatch, 5, [True] * 5, contradict=True)
    assert len(given) == 1
    assert found.figure("drag").why.startswith("the runs contradict each other")
    assert [figure.name for figure in found.figures] == list(module.BRAKE_FIGURES)
