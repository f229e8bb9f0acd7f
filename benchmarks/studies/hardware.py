"""Beyond the thesis (1.3): what other hardware would buy.

On the truck, sensor errors included, in closed loop: the phase error at contact, how many contacts
are in a gap, and the estimate of the layshaft from neutral to contact. Valves, parked sleeves and
rings on the wheels are judged by campaigns (`hardware_trucks`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from benchmarks.studies import hardware_trucks
from benchmarks.studies.excitation import Figures, figures
from benchmarks.studies.hardware_trucks import Trucks
from benchmarks.studies.jobs import AsBuilt, LoopJob, LoopResult, Scores
from benchmarks.studies.record import (
    Chart,
    Finding,
    Given,
    Line,
    Panel,
    Statement,
    Study,
    StudyJob,
    Style,
    Table,
    ThesisVerdict,
    rms,
)
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import count, group, quantity
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.settings import Preset

BASE = "as the data sheet"
MOST_TEETH = 120
"""A sheet allows no more on a wheel."""


@dataclass(frozen=True)
class Settings:
    """What the better hardware is like, and how many shifts are looked at."""

    teeth_factor: float = quantity("teeth_factor", 1.0, 3.0)
    tick_ms: int = count("tick_ms", 1, 100)
    delay_sd_ms: float = quantity("delay_sd_ms", 0.0, 20.0)
    """Chance in the sleeve's delay; the truck has about 1.2 ms."""
    gearboxes: int = count("gearboxes", 2, 100)
    shifts: int = count("shifts", 2, 10_000)
    learning_shifts: int = count("learning_shifts", 0, 1000)
    """Of each gearbox, that do not count: the controller learns teeth, brake and delays."""
    trucks: Trucks = group(Trucks)


class Variant(NamedTuple):
    """A gearbox and a controller."""

    sheet: GearboxSheet
    settings: ControllerSettings
    as_built: AsBuilt = ()


class Bought(NamedTuple):
    """What a variant came to."""

    phase_deg2: tuple[float, ...]
    """Mean square of the phase error at contact, by gearbox."""
    gap: int
    known: int
    duration_ms: float
    estimate: Figures

    @property
    def phase_rms_deg(self) -> float:
        """Every gearbox counts as much."""
        return math.sqrt(float(np.mean(self.phase_deg2)))

    @property
    def phase_sd_deg(self) -> float:
        """Standard error of the RMS. Shifts of one gearbox are not independent, gearboxes are."""
        return _standard_error(np.array(self.phase_deg2)) / (2.0 * self.phase_rms_deg)


def _standard_error(values: Vector) -> float:
    return float(values.std(ddof=1)) / math.sqrt(values.size)


def _variants(given: Given[Settings]) -> dict[str, Variant]:
    own, sheet, settings = given.own, given.sheet, ControllerSettings()
    wheels = sheet.wheels
    more = {
        shaft: replace(wheel, teeth=min(MOST_TEETH, round(wheel.teeth * own.teeth_factor)))
        for shaft, wheel in (("layshaft", wheels.layshaft), ("main", wheels.main))
    }
    finer = replace(sheet, wheels=replace(wheels, **more))
    steadier: AsBuilt = (("sleeve.noise_sd_ms", own.delay_sd_ms),)
    ticking = replace(settings, timing=replace(settings.timing, tick_ms=own.tick_ms))
    opposite: AsBuilt = (("hall.runout_mm", 0.0),)
    return {
        BASE: Variant(sheet, settings),
        f"{more['layshaft'].teeth} teeth on layshaft and main wheel": Variant(finer, settings),
        "second sensor, opposite the first": Variant(finer, settings, opposite),
        f"tick of {own.tick_ms} ms": Variant(sheet, ticking),
        f"delay scatter {own.delay_sd_ms:g} ms": Variant(sheet, settings, steadier),
    }


def _run(given: Given[Settings], variant: Variant, number: int) -> LoopJob:
    own = given.own
    return LoopJob(
        variant.sheet,
        variant.settings,
        Preset.TRUCK,
        given.common.seed + number,
        own.learning_shifts + own.shifts,
        as_built=variant.as_built,
        profile=given.profile,
    )


def _jobs(given: Given[Settings]) -> tuple[StudyJob, ...]:
    sensors = tuple(
        _run(given, variant, number)
        for variant in _variants(given).values()
        for number in range(given.own.gearboxes)
    )
    return (*sensors, *hardware_trucks.jobs(given))


def _bought(given: Given[Settings], variant: Variant) -> Bought:
    phase_deg2: list[float] = []
    durations: list[float] = []
    trucks: list[list[Scores]] = []
    gap = known = 0
    first = given.own.learning_shifts
    for number in range(given.own.gearboxes):
        result: LoopResult = given.results[_run(given, variant, number)]
        aimed = [row for row in result.rows[first:] if row.reference == "known"]
        errors = [row.phase_error_deg for row in aimed if row.phase_error_deg is not None]
        phase_deg2.append(rms(errors) ** 2)
        durations += [row.duration_ms for row in aimed if row.result == "engaged"]
        gap += sum(row.contact == "gap" for row in aimed)
        known += len(aimed)
        trucks.append(result.scores[first:])
    estimator = ControllerSettings().estimator_name
    mean = sum(durations) / max(1, len(durations))
    return Bought(tuple(phase_deg2), gap, known, mean, figures(trucks, estimator))


def _conclude(given: Given[Settings]) -> Finding:
    bought = {name: _bought(given, variant) for name, variant in _variants(given).items()}
    names = list(bought)
    statements = tuple(_statement(name, bought[name], bought[BASE]) for name in names[1:])
    values: dict[str, Any] = {
        name: {
            "phase_rms_deg": b.phase_rms_deg,
            "phase_rms_standard_error_deg": b.phase_sd_deg,
            "into_the_gap": b.gap,
            "aimed": b.known,
            "duration_ms": b.duration_ms,
            "angle_rms_deg": b.estimate.angle_deg,
            "speed_rms_rpm": b.estimate.speed_rpm,
        }
        for name, b in bought.items()
    }
    columns = (
        "hardware", "phase error RMS, deg", "standard error, deg", "into the gap", "aimed",
        "duration, ms", "estimate: angle RMS, deg", "estimate: speed RMS, rpm",
    )  # fmt: skip
    rows = tuple(
        (name, b.phase_rms_deg, b.phase_sd_deg, b.gap, b.known, b.duration_ms, *b.estimate)
        for name, b in bought.items()
    )
    table = Table("variants", "What each would buy", columns, rows)
    trucks = hardware_trucks.compared(given)
    return Finding(
        (*statements, *trucks.statements),
        values | {"trucks": trucks.values},
        (_chart(bought), trucks.chart),
        (table, trucks.table),
    )


REASONS = {
    "teeth": "twice the edges, each with the same error of its own",
    "second": "it gives as many edges as a wheel of twice the teeth, and two sensors opposite each "
    "other cancel eccentricity; so it is modelled as that wheel without runout",
    "tick": "activations carry times, so a coarse tick does not quantise them; a fast one plans "
    "later, with newer edges",
    "delay": "slip times the delay's scatter is phase that nothing can take back once the valve "
    "is open",
}


def _statement(name: str, ours: Bought, base: Bought) -> Statement:
    key = next(key for key in REASONS if key in name)
    return Statement(
        f"(1.3 asks what added hardware would allow) {name}",
        f"phase error {ours.phase_rms_deg:.3f} +- {ours.phase_sd_deg:.3f} deg RMS against "
        f"{base.phase_rms_deg:.3f} +- {base.phase_sd_deg:.3f} (standard errors), "
        f"{ours.gap} of {ours.known} into the gap against {base.gap} of {base.known}, "
        f"{ours.duration_ms:.0f} ms against {base.duration_ms:.0f}; estimated angle "
        f"{ours.estimate.angle_deg:.3f} deg against {base.estimate.angle_deg:.3f}, speed "
        f"{ours.estimate.speed_rpm:.2f} rpm against {base.estimate.speed_rpm:.2f}",
        ThesisVerdict.NOT_COMPARABLE,
        f"{REASONS[key]}. {certainty(ours, base)}. The thesis announces such an analysis and has "
        "none",
    )


def certainty(ours: Bought, base: Bought) -> str:
    """Whether the phase errors differ: Student's t on the pairs of equal gearboxes, 95 %."""
    changes = np.array(ours.phase_deg2) - np.array(base.phase_deg2)
    change = float(changes.mean())
    if abs(change) <= float(stdtrit(changes.size - 1, 0.975)) * _standard_error(changes):
        return "At contact the difference is within what chance gives from gearbox to gearbox"
    return f"At contact it is {'better' if change < 0.0 else 'worse'} by more than chance gives"


def _chart(bought: dict[str, Bought]) -> Chart:
    numbers = list(range(1, len(bought) + 1))

    def bars(name: str, values: list[float]) -> tuple[Line, ...]:
        return (Line(name, numbers, values, Style.BARS),)

    every = list(bought.values())
    return Chart(
        "hardware",
        "What hardware would buy",
        "",
        (
            Panel("phase error, deg RMS", bars("closed loop", [b.phase_rms_deg for b in every])),
            Panel("angle, deg RMS", bars("estimate", [b.estimate.angle_deg for b in every])),
            Panel("speed, rpm RMS", bars("estimate", [b.estimate.speed_rpm for b in every])),
        ),
        x_names=tuple(bought),
    )


STUDY = Study("hardware", "What hardware would buy", ("section 1.3",), Settings, _conclude, _jobs)
