"""Beyond the thesis (1.3): impact and wear against the angle that is aimed at.

The thesis names it as a use of its strategy, not as a goal: to explore the effect that different
engagement angles have on wear. Impact is the energy lost on flanks until the gear is locked; wear
is taken as the time for which tooth rubs on tooth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.studies.jobs import LoopJob, LoopResult
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
)
from benchmarks.studies.teeth import Engagements, Tried
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox.tables import count, quantity
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import RPM

TARGET_CLAIM = (
    "chosen angles could be used to explore the effect on wear (1.3; not a goal of the thesis)"
)


@dataclass(frozen=True)
class Settings:
    """Slips and phases for the teeth alone; targets and shifts for the closed loop."""

    slip_low_rad_s: float = quantity("slip_low_rpm", 1.0, 200.0, RPM)
    slip_high_rad_s: float = quantity("slip_high_rpm", 1.0, 200.0, RPM)
    slips: int = count("slips", 2, 10)
    phases: int = count("phases", 10, 10_000)
    patience_s: float = quantity("patience_ms", 50.0, 10_000.0, 1e-3)
    widest_share: float = quantity("widest_percent_of_gap", 1.0, 90.0, 0.01)
    targets: int = count("targets", 3, 41)
    trucks: int = count("trucks", 1, 100)
    shifts: int = count("shifts", 2, 10_000)
    """Of each truck with each target."""
    aim_s: float = quantity("aim_ms", 0.0, 10_000.0, 1e-3)
    """What half a gap away from the target costs the strategy (`Prices.aim_s`): far more than by
    default, so that it aims at nothing else."""


def _targets(own: Settings) -> list[float]:
    return [float(v) for v in np.linspace(-own.widest_share, own.widest_share, own.targets)]


def _slips(own: Settings) -> tuple[float, ...]:
    return tuple(np.linspace(own.slip_low_rad_s, own.slip_high_rad_s, own.slips).tolist())


def _teeth_job(given: Given[Settings]) -> Engagements:
    own = given.own
    return Engagements(given.sheet, (), _slips(own), own.phases, 1e6 * own.patience_s)


def _loop_jobs(given: Given[Settings], target: float) -> list[LoopJob]:
    settings = ControllerSettings()
    return [
        LoopJob(
            given.sheet,
            replace(
                settings,
                aim=replace(settings.aim, target_rad_share=target),
                prices=replace(settings.prices, aim_s=given.own.aim_s),
            ),
            Preset.TRUCK,
            given.common.seed + truck,
            given.own.shifts,
            profile=given.profile,
        )
        for truck in range(given.own.trucks)
    ]


def _jobs(given: Given[Settings]) -> tuple[StudyJob, ...]:
    loops = (job for target in _targets(given.own) for job in _loop_jobs(given, target))
    return (_teeth_job(given), *loops)


@dataclass(frozen=True)
class _Row:
    """The closed loop with one target."""

    target_pct: float
    known: int
    gap_share: float | None
    impact_j: float | None
    face_ms: float | None
    error_deg: float | None


def _row(target: float, results: list[LoopResult]) -> _Row:
    rows = [row for result in results for row in result.known if row.contact is not None]
    if not rows:
        return _Row(100.0 * target, 0, None, None, None, None)
    mean = 1.0 / len(rows)
    return _Row(
        100.0 * target,
        len(rows),
        mean * sum(row.contact == "gap" for row in rows),
        mean * sum(row.impact_j for row in rows),
        mean * sum(row.face_ms for row in rows),
        mean * sum(row.phase_error_deg or 0.0 for row in rows),
    )


def _conclude(given: Given[Settings]) -> Finding:
    teeth: dict[float, list[Tried]] = given.results[_teeth_job(given)]
    rows = [
        _row(target, [given.results[job] for job in _loop_jobs(given, target)])
        for target in _targets(given.own)
    ]
    aimed = [row for row in rows if row.impact_j is not None and row.face_ms is not None]
    half_gap_deg = np.degrees(given.sheet.dog.backlash_rad) / 2.0
    statements = (_teeth_statement(teeth, half_gap_deg), _loop_statement(aimed))
    values: dict[str, Any] = {
        "closed_loop": [vars(row) for row in rows],
        "teeth_alone_mean_by_slip_rpm": {
            f"{slip / RPM:.3g}": {
                "impact_in_gap_j": _mean(tried, "impact_j", gap=True),
                "impact_on_tooth_j": _mean(tried, "impact_j", gap=False),
                "face_on_tooth_ms": _mean(tried, "face_ms", gap=False),
            }
            for slip, tried in teeth.items()
        },
    }
    columns = (
        "target, % of half a gap", "aimed shifts", "into the gap", "impact, J", "on a face, ms",
        "mean phase error, deg",
    )  # fmt: skip
    table = Table(
        "targets",
        "Closed loop by target",
        columns,
        tuple(
            (r.target_pct, r.known, r.gap_share, r.impact_j, r.face_ms, r.error_deg) for r in rows
        ),
    )
    charts = (_teeth_chart(teeth, half_gap_deg), _loop_chart(aimed))
    return Finding(statements, values, charts, (table,))


def _mean(tried: list[Tried], what: str, gap: bool) -> float | None:
    values = [getattr(each, what) for each in tried if each.locked and each.gap is gap]
    return float(np.mean(values)) if values else None


def _teeth_statement(teeth: dict[float, list[Tried]], half_gap_deg: float) -> Statement:
    words = []
    for slip, tried in teeth.items():
        gap, tooth = (_mean(tried, "impact_j", gap=there) for there in (True, False))
        face = _mean(tried, "face_ms", gap=False)
        blocked = sum(not each.locked for each in tried) / len(tried)
        words.append(
            f"{slip / RPM:.0f} rpm: {_figure(gap, 2)} J in the gap, {_figure(tooth, 2)} J after "
            f"{_figure(face, 0)} ms on a tooth, {100 * blocked:.0f} % not engaged"
        )
    return Statement(
        TARGET_CLAIM,
        f"the teeth alone, phases spread evenly: {'; '.join(words)}",
        ThesisVerdict.NOT_COMPARABLE,
        f"the thesis has no figure. In the gap (+-{half_gap_deg:.2f} deg) the flank takes what the "
        "slip brings, J dw^2 (1 - e^2) / 2, wherever in the gap the tooth came in; on a tooth the "
        "faces take some of the slip first. The angle decides whether faces rub, how long, and "
        "whether a gear engages at all",
    )


def _figure(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _loop_statement(rows: list[_Row]) -> Statement:
    if not rows:
        return Statement(
            TARGET_CLAIM,
            "no shift could aim",
            ThesisVerdict.NOT_COMPARABLE,
            "the reference stayed unknown",
        )
    shown = (rows[0], rows[len(rows) // 2], rows[-1])
    words = (
        f"at {row.target_pct:+.0f} % of half a gap {100.0 * (row.gap_share or 0.0):.0f} % into the "
        f"gap, {_figure(row.impact_j, 2)} J, {_figure(row.face_ms, 1)} ms on faces"
        for row in shown
    )
    known = min(row.known for row in rows)
    return Statement(
        TARGET_CLAIM,
        f"closed loop: {'; '.join(words)}",
        ThesisVerdict.NOT_COMPARABLE,
        f"over the shifts of each target that could aim, {known} at least, so that one shift is "
        f"{100.0 / known:.0f} %; the strategy is set to hold the target before all else. Near the "
        "gap's edges the spread of delay and estimate puts teeth on faces",
    )


def _teeth_chart(teeth: dict[float, list[Tried]], half_gap_deg: float) -> Chart:
    def lines(what: str) -> tuple[Line, ...]:
        return tuple(
            Line(
                f"{slip / RPM:.0f} rpm",
                [each.phase_deg for each in tried],
                [getattr(each, what) if each.locked else float("nan") for each in tried],
                Style.POINTS,
            )
            for slip, tried in teeth.items()
        )

    moments = {"gap": -half_gap_deg, "gap's end": half_gap_deg}
    return Chart(
        "teeth",
        "The dog teeth alone: what the phase at contact costs",
        "phase at contact, deg (blocked engagements have no point)",
        (
            Panel("flank impact, J", lines("impact_j"), moments=moments),
            Panel("tooth on tooth, ms", lines("face_ms"), moments=moments),
        ),
    )


def _loop_chart(rows: list[_Row]) -> Chart:
    x = [row.target_pct for row in rows]

    def line(name: str, values: list[float | None], scale: float = 1.0) -> tuple[Line, ...]:
        return (Line(name, x, [scale * (value or 0.0) for value in values], Style.JOINED),)

    return Chart(
        "closed_loop",
        "Closed loop: what the target costs",
        "target, % of half a gap",
        (
            Panel("into the gap, %", line("aimed shifts", [r.gap_share for r in rows], 100.0)),
            Panel("flank impact, J", line("mean", [r.impact_j for r in rows])),
            Panel("tooth on tooth, ms", line("mean", [r.face_ms for r in rows])),
        ),
    )


STUDY = Study(
    "target", "Impact and wear against the target angle", ("section 1.3",), Settings, _conclude,
    _jobs,
)  # fmt: skip
