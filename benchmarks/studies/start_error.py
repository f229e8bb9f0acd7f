"""Figures 6.9 and 6.10: what an error in the layshaft's angle or speed at the start costs, by
gear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    Table,
    ThesisVerdict,
)
from benchmarks.studies.sensitivity import CAP, Release, capped, easiest_first, gear_name
from meshpoint.gearbox import MainGear
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.tables import count, quantity
from meshpoint.kernels.records import Vector
from meshpoint.units import DEG, RPM

Effect = Callable[[Release, float], float]
"""From an error (in the unit of the figure) to the layshaft's angle after the delay, % of pitch."""
EASY: Final = ("crawl", "first")


def _by_gear(
    given: Given[Any],
    name: str,
    unit: str,
    errors: Vector,
    effect: Effect,
    thesis: tuple[float, float, float],
) -> Finding:
    """The finding. `thesis`: its filter's RMS error, and what that costs in % of pitch for the
    easiest and the hardest gear by its section 7.4."""
    release = Release(given)
    layshaft = np.array([effect(release, float(error)) for error in errors])
    per_gear = {gear: release.gear_share(gear) * layshaft for gear in MAIN_GEARS}
    rms_error, low, high = thesis
    cost = effect(release, rms_error)
    costs = {gear: abs(cost * release.gear_share(gear)) for gear in MAIN_GEARS}
    order = easiest_first(costs)
    first = Statement(
        "the error scales with the gear; aiming is easiest on crawl and first gear (7.3)",
        f"from easiest to hardest: {', '.join(order)}",
        ThesisVerdict.BY_CONSTRUCTION if tuple(order[:2]) == EASY else ThesisVerdict.DIFFERS,
        "a gear turns i_gear times the layshaft's angle, and the data sheet's i_gear rises from "
        "crawl to third",
    )
    easiest, hardest = costs[MAIN_GEARS[0]], costs[MAIN_GEARS[-1]]
    second = Statement(
        f"the filter's {rms_error:g} {unit} costs {low:g} to {high:g} % of a cog gap (7.4)",
        f"{easiest:.1f} to {hardest:.1f} %; hardest over easiest {hardest / easiest:.2f}, "
        f"thesis {high / low:.2f}",
        ThesisVerdict.NOT_COMPARABLE,
        f"ours is {easiest / low:.2f} and {hardest / high:.2f} times the thesis's: the tooth "
        "counts and ratios of its gearbox are not published, ours are chosen so that crawl "
        "against third comes near",
    )
    rows = tuple((gear_name(gear), release.gear_share(gear), costs[gear]) for gear in MAIN_GEARS)
    columns = ("gear", "i_gear", f"cost of {rms_error:g} {unit}, % of pitch")
    values = {
        "easiest_first": order,
        f"cost_of_{rms_error:g}_{unit}_percent_of_pitch": {
            gear_name(gear): value for gear, value in costs.items()
        },
    }
    chart = _chart(name, unit, errors, per_gear)
    return Finding((first, second), values, (chart,), (Table("gears", "By gear", columns, rows),))


def _chart(name: str, unit: str, errors: Vector, per_gear: dict[MainGear, Vector]) -> Chart:
    lines = tuple(Line(gear_name(g), errors, capped(values)) for g, values in per_gear.items())
    return Chart(
        name,
        "Phase 45 ms after the brake's signal went off, by gear",
        f"initial error, {unit}",
        (Panel(f"% of pitch, capped at {CAP:g}", lines, y_range=(0.0, CAP)),),
    )


@dataclass(frozen=True)
class StartError:
    """An error in one quantity of the state."""

    of_state: str
    """Its field in the layshaft's state."""
    widest: str
    """The study's setting that holds the largest error drawn (SI)."""
    unit: str
    si: float
    """From the figure's unit to SI."""
    thesis: tuple[float, float, float]
    """The thesis's filter's RMS error, and what that costs in % of pitch for the easiest and the
    hardest gear."""


def _study(
    name: str, title: str, figure: str, settings: type[Any], error: StartError
) -> Study[Any]:
    """The study of such an error."""

    def effect(release: Release, size: float) -> float:
        state = release.state
        wrong = getattr(state, error.of_state) + size * error.si
        return release.angle_error_pct(state=state._replace(**{error.of_state: wrong}))

    def conclude(given: Given[Any]) -> Finding:
        widest = getattr(given.own, error.widest) / error.si
        sizes = np.linspace(0.0, widest, given.own.points)
        return _by_gear(given, name, error.unit, sizes, effect, error.thesis)

    return Study(name, title, (figure,), settings, conclude)


THESIS_ANGLE = (0.53, 1.5, 7.0)
"""RMS angle error of tables 6.2 (mean of the two shifts), and its cost by section 7.4."""


@dataclass(frozen=True)
class AngleSettings:
    """The largest error drawn."""

    widest_rad: float = quantity("widest_deg", 0.1, 90.0, DEG)
    points: int = count("points", 2, 1000)


ANGLE = _study(
    "start_angle", "Sensitivity: initial angle", "figure 6.9", AngleSettings,
    StartError("theta_rad", "widest_rad", "deg", DEG, THESIS_ANGLE),
)  # fmt: skip


THESIS_SPEED = (4.32, 4.0, 18.0)
"""RMS speed error of table 6.1 (mean of the two shifts), and its cost by section 7.4."""


@dataclass(frozen=True)
class SpeedSettings:
    """The largest error drawn."""

    widest_rad_s: float = quantity("widest_rpm", 0.1, 500.0, RPM)
    points: int = count("points", 2, 1000)


SPEED = _study(
    "start_speed", "Sensitivity: initial speed", "figure 6.10", SpeedSettings,
    StartError("omega_rad_s", "widest_rad_s", "rpm", RPM, THESIS_SPEED),
)  # fmt: skip
