"""Section 7.2: Euler's step against accuracy; precomputed matrices against the closed form."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.studies.counting import Counter, plain_code
from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Style,
    Table,
    ThesisVerdict,
)
from benchmarks.studies.sensitivity import Release
from benchmarks.studies.thesis_predictions import predict_euler
from meshpoint.controller.models import thesis as kernels
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.gearbox import Split
from meshpoint.gearbox.tables import count, quantity
from meshpoint.kernels.records import Vector
from meshpoint.units import US

WORD_BYTES: Final = 8
PHI, GAMMA, MODEL = 5, 3, 4
"""Numbers that a prediction needs: of Phi and Gamma that are not 0 or 1, and of the model."""
RESOLUTIONS: Final = (("10 ms", 10_000), ("1 ms", 1_000), ("1 us", 1))


@dataclass(frozen=True)
class Settings:
    """Euler's steps, what accuracy is wanted, and the horizons that would be stored."""

    shortest_s: float = quantity("shortest_ms", 0.001, 45.0, 1e-3)
    longest_s: float = quantity("longest_ms", 0.001, 45.0, 1e-3)
    points: int = count("points", 2, 100)
    wanted_pct: float = quantity("wanted_percent_of_pitch", 0.001, 50.0)
    horizon_s: float = quantity("longest_horizon_ms", 1.0, 1000.0, 1e-3)


class Cost(NamedTuple):
    """Operations of one prediction over the sleeve's delay."""

    arithmetic: int
    functions: int


def _conclude(given: Given[Settings]) -> Finding:
    own = given.own
    steps_s = np.geomspace(own.shortest_s, own.longest_s, own.points)
    euler = _Euler(given)
    errors = np.array([abs(euler.error_pct(step)) for step in steps_s.tolist()])
    enough_s = _longest_step(euler, own)
    costs = {
        f"Euler, steps of {1e3 * enough_s:.2g} ms": euler.cost(enough_s),
        "ZOH in closed form": _closed_form(given),
        "ZOH from stored matrices": _stored(given),
    }
    chart = Chart(
        "step",
        "Euler's method: angle of the layshaft 45 ms after the brake has begun to release",
        "step, ms",
        (
            Panel(
                "error, % of pitch",
                (Line("Euler (5.15) against ZOH", 1e3 * steps_s, errors, Style.JOINED),),
                levels={f"{own.wanted_pct:g} % of pitch": own.wanted_pct},
                log_y=True,
            ),
        ),
        log_x=True,
    )
    storage = {name: _storage_bytes(own, unit_us) for name, unit_us in RESOLUTIONS}
    order = _order(steps_s, errors)
    values = {
        "step_for_wanted_accuracy_ms": 1e3 * enough_s,
        "operations": {name: cost._asdict() for name, cost in costs.items()},
        "order_of_convergence": order,
        "stored_matrices_bytes": storage,
        "closed_form_bytes": _model_bytes(),
    }
    statements = (
        _euler_statement(own, costs, enough_s, order),
        _storage_statement(own, costs, storage),
    )
    return Finding(statements, values, (chart,), (_cost_table(costs), _storage_table(storage)))


class _Euler:
    """Euler's method over the sleeve's delay with the brake off, against the exact hold."""

    def __init__(self, given: Given[Settings]) -> None:
        release = Release(given)
        self._pitch_rad = given.sheet.dog.pitch_rad
        self._model = layshaft_model(given.sheet, Split.HIGH)
        off_us = float(release.switches[0][1])
        self._start = release.after((off_us - release.state.time_us) * US)
        self._end_us = off_us + release.delay_s / US
        self._exact = release.after((self._end_us - release.state.time_us) * US)

    def error_pct(self, step_s: float) -> float:
        """Angle error at the end, % of pitch."""
        found = predict_euler(self._start, self._end_us, 0.0, self._model, step_s)
        return 100.0 * (found.theta_rad - self._exact.theta_rad) / self._pitch_rad

    def cost(self, step_s: float) -> Cost:
        """Operations of a prediction with this step."""
        counter = Counter()
        number: Any = counter.number
        state = LayshaftState(
            self._start.time_us,
            number(self._start.theta_rad),
            number(self._start.omega_rad_s),
            number(self._start.pressure_pa),
        )
        model: Any = [number(float(value)) for value in self._model]
        predict_euler(state, self._end_us, 0.0, model, step_s)
        # what is left of the functions is the result's conversion to floats
        return Cost(counter.arithmetic, 0)


def _closed_form(given: Given[Settings]) -> Cost:
    """`kernels.advance`, which works out Phi and Gamma and applies them."""
    counter = Counter()
    values = layshaft_model(given.sheet, Split.HIGH).tolist()
    names = kernels.LINEAR.names or ()
    linear = SimpleNamespace(**dict(zip(names, map(counter.number, values), strict=True)))
    x = [counter.number(value) for value in (1.0, 100.0, 1e5)]
    hold = plain_code(kernels.hold)
    advance = plain_code(kernels.advance, hold=hold)
    advance(x, given.sheet.sleeve.delay_s, 0.0, linear, SimpleNamespace())
    return Cost(counter.arithmetic, counter.functions)


def _stored(given: Given[Settings]) -> Cost:
    """The same with Phi and Gamma looked up."""
    counter = Counter()
    x = [counter.number(value) for value in (1.0, 100.0, 1e5)]

    def look_up(_dt: float, _linear: Any, held: SimpleNamespace) -> None:
        for name in kernels.HOLD.names or ():
            setattr(held, name, counter.number(0.5))

    advance = plain_code(kernels.advance, hold=look_up)
    advance(x, given.sheet.sleeve.delay_s, 0.0, None, SimpleNamespace())
    return Cost(counter.arithmetic, counter.functions)


def _longest_step(euler: _Euler, own: Settings) -> float:
    """The longest step of whole divisions of the delay that is accurate enough."""
    parts = 1
    horizon_s = own.longest_s
    while abs(euler.error_pct(horizon_s / parts)) > own.wanted_pct and parts < 1 << 20:
        parts *= 2
    low, high = parts // 2, parts
    while high - low > 1:
        middle = (low + high) // 2
        enough = abs(euler.error_pct(horizon_s / middle)) <= own.wanted_pct
        low, high = (low, middle) if enough else (middle, high)
    return horizon_s / high


def _order(steps_s: Vector, errors: Vector) -> float:
    """Slope of the error over the step, both logarithmic, over the shorter half of the steps."""
    half = max(2, steps_s.size // 2)
    slope = np.polyfit(np.log(steps_s[:half]), np.log(errors[:half]), 1)[0]
    return float(slope)


def _storage_bytes(own: Settings, unit_us: int) -> int:
    """Phi and Gamma for every horizon up to the longest, for both splits."""
    horizons = max(1, round(own.horizon_s / US / unit_us))
    return horizons * (PHI + GAMMA) * WORD_BYTES * len(Split)


def _model_bytes() -> int:
    return MODEL * WORD_BYTES * len(Split)


def _euler_statement(
    own: Settings, costs: dict[str, Cost], enough_s: float, order: float
) -> Statement:
    euler, closed, _ = costs.values()
    total = sum(closed)
    return Statement(
        "with a small enough step Euler comes close, but with unnecessary calculation; the ZOH "
        "needs fewer",
        f"{own.wanted_pct:g} % of pitch needs steps of {1e3 * enough_s:.2g} ms: {sum(euler)} "
        f"operations, against {total} for the ZOH in closed form; the error goes with the step to "
        f"the power of {order:.2f}",
        ThesisVerdict.AGREES if sum(euler) > total else ThesisVerdict.DIFFERS,
        "counted by running the product's predictors on numbers that count; an exp counts as one, "
        "though it takes as long as some tens of multiplications",
    )


def _storage_statement(own: Settings, costs: dict[str, Cost], storage: dict[str, int]) -> Statement:
    euler, closed, stored = costs.values()
    sizes = ", ".join(f"{_size(size)} at a resolution of {name}" for name, size in storage.items())
    return Statement(
        "the ZOH's drawback: its matrices are needed for every horizon, difficult to work out "
        "live, and could take excessive storage",
        f"worked out live in closed form: {closed.arithmetic} operations and {closed.functions} "
        f"exponentials, {_model_bytes()} bytes; stored for horizons up to "
        f"{1e3 * own.horizon_s:g} ms: {stored.arithmetic} operations, {sizes}",
        ThesisVerdict.DIFFERS if sum(closed) <= sum(euler) else ThesisVerdict.AGREES,
        "difficult is taken as more operations than Euler's method at the wanted accuracy. The "
        "model's matrix is triangular, so its exponential has a closed form "
        "(controller/models/thesis.py): nothing is difficult to work out live, and "
        "nothing is stored. "
        "The thesis computes it with c2d. At a fixed tick storing would be cheap as well; at the "
        "microsecond of our activation times it would indeed be excessive",
    )


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1_000_000 else f"{size / 1e3:.1f} kB"


def _cost_table(costs: dict[str, Cost]) -> Table:
    rows = tuple((name, cost.arithmetic, cost.functions) for name, cost in costs.items())
    return Table("costs", "One prediction over 45 ms", ("", "+ - * /", "exp, expm1"), rows)


def _storage_table(storage: dict[str, int]) -> Table:
    rows = (*storage.items(), ("closed form", _model_bytes()))
    return Table("storage", "Stored matrices", ("resolution of the horizon", "bytes"), rows)


STUDY = Study("step", "Euler's step, and the ZOH's matrices", ("section 7.2",), Settings, _conclude)
