"""Section 8.2: what the Hall sensors of input and propeller shaft would add, with and without
backlash."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from meshpoint.gearbox.tables import count
from meshpoint.rig_sim.truck.as_built import linear
from meshpoint.testbench.studies.excitation import Figures, figures
from meshpoint.testbench.studies.fusion_run import (
    AHEAD_SUFFIX,
    LAYSHAFT,
    MAIN,
    WITH_INPUT,
    WITH_PROPELLER,
    Fused,
    FusionRun,
)
from meshpoint.testbench.studies.jobs import AsBuilt
from meshpoint.testbench.studies.record import (
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

TIGHT: Final[AsBuilt] = tuple(sorted((k, v) for k, v in linear().items() if k.startswith("lash.")))
PERFECT: Final[AsBuilt] = tuple(
    sorted((k, v) for k, v in linear().items() if k.startswith("hall."))
)
GEARBOX_CASES: Final[dict[str, AsBuilt]] = {
    "backlash, wheels as built": (),
    "no backlash, wheels as built": TIGHT,
    "backlash, perfect wheels": PERFECT,
    "no backlash, perfect wheels": (*TIGHT, *PERFECT),
}
VARIANTS: Final = (LAYSHAFT, WITH_INPUT, MAIN, WITH_PROPELLER)
FUSION_CLAIM: Final = "the Hall sensor of the {0} could improve the {1}'s angle and speed (8.2)"


@dataclass(frozen=True)
class Settings:
    """How many trucks and shifts."""

    trucks: int = count("trucks", 1, 100)
    learning_shifts: int = count("learning_shifts", 0, 100)
    """Before these the wheels' teeth are not known."""
    shifts: int = count("shifts", 1, 1000)


def _run(given: Given[Settings], as_built: AsBuilt, truck: int) -> FusionRun:
    own = given.own
    return FusionRun(
        given.sheet,
        given.common.seed + truck,
        own.learning_shifts,
        own.shifts,
        as_built,
        given.profile,
    )


def _jobs(given: Given[Settings]) -> tuple[FusionRun, ...]:
    return tuple(
        _run(given, as_built, truck)
        for as_built in GEARBOX_CASES.values()
        for truck in range(given.own.trucks)
    )


def _conclude(given: Given[Settings]) -> Finding:
    found: dict[str, dict[str, Figures]] = {}
    for case, as_built in GEARBOX_CASES.items():
        runs: list[Fused] = [
            given.results[_run(given, as_built, truck)] for truck in range(given.own.trucks)
        ]
        names = (*VARIANTS, *(name + AHEAD_SUFFIX for name in VARIANTS))
        found[case] = {name: figures([[run] for run in runs], name) for name in names}
    statements = (
        *_statements(found, LAYSHAFT, WITH_INPUT, "input shaft", "layshaft"),
        *_statements(found, MAIN, WITH_PROPELLER, "propeller shaft", "main shaft"),
    )
    values: dict[str, Any] = {
        case: {name: f._asdict() for name, f in by_name.items()} for case, by_name in found.items()
    }
    rows = tuple(
        (case, name, *by_name[name], by_name[name + AHEAD_SUFFIX].angle_deg)
        for case, by_name in found.items()
        for name in VARIANTS
    )
    columns = ("gearbox", "sensors", "angle RMS, deg", "speed RMS, rpm", "45 ms ahead, deg")
    table = Table("sensors", "With and without each further sensor", columns, rows)
    return Finding(statements, values, (_chart(found),), (table,))


def _statements(
    found: dict[str, dict[str, Figures]], alone: str, fused: str, further: str, own: str
) -> list[Statement]:
    statements: list[Statement] = []
    for case, by_name in found.items():
        without, with_ = by_name[alone], by_name[fused]
        better = with_.angle_deg < without.angle_deg, with_.speed_rpm < without.speed_rpm
        verdict = ThesisVerdict.AGREES if all(better) else ThesisVerdict.DIFFERS
        statements.append(
            Statement(
                FUSION_CLAIM.format(further, own),
                f"{case}: angle {without.angle_deg:.3f} to {with_.angle_deg:.3f} deg RMS, "
                f"{by_name[alone + AHEAD_SUFFIX].angle_deg:.3f} to "
                f"{by_name[fused + AHEAD_SUFFIX].angle_deg:.3f} "
                f"45 ms ahead, speed {without.speed_rpm:.3f} to {with_.speed_rpm:.3f} rpm",
                verdict,
                _reason(better, further, first=not statements),
            )
        )
    return statements


def _reason(better: tuple[bool, bool], further: str, first: bool) -> str:
    gained = {
        (True, True): "both are better with it",
        (True, False): "the angle is better with it, the speed worse",
        (False, True): "the speed is better with it, the angle worse",
        (False, False): "both are worse with it",
    }[better]
    if not first:
        return gained
    return (
        f"{gained}. The {further}'s edges are further edges of the shaft by the exact ratio, in "
        "the controller's own filter: the offset between the wheels is a state, and both wheels' "
        "teeth are learned"
    )


def _chart(found: dict[str, dict[str, Figures]]) -> Chart:
    cases = list(found)
    numbers = list(range(1, len(cases) + 1))

    def lines(index: int, after: str = "") -> tuple[Line, ...]:
        return tuple(
            Line(name, numbers, [found[case][name + after][index] for case in cases], Style.JOINED)
            for name in VARIANTS
        )

    return Chart(
        "fusion",
        "Estimation with further sensors",
        "gearbox",
        (
            Panel("angle, deg RMS", lines(0), log_y=True),
            Panel("angle 45 ms ahead, deg RMS", lines(0, AHEAD_SUFFIX), log_y=True),
            Panel("speed, rpm RMS", lines(1), log_y=True),
        ),
        x_names=tuple(cases),
    )


STUDY = Study("fusion", "Sensor fusion", ("section 8.2",), Settings, _conclude, _jobs)
