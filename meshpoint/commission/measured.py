"""The data sheet and the calibration that a commissioned gearbox gets, from what was recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from statistics import median, stdev
from typing import Any, Final

import numpy as np

from meshpoint.commission.edge_log import EdgeLog, State
from meshpoint.commission.finding import Finding, Verdict
from meshpoint.commission.kiss import kiss_points
from meshpoint.commission.roles import GROUP, RANGE_STATES, rate
from meshpoint.commission.running import RunningCore
from meshpoint.commission.shafts import Shaft
from meshpoint.commission.standing import standing_figures
from meshpoint.commission.wheels import (
    GEAR_STATES,
    SPLIT_STATES,
    Measured,
    ratio,
    tooth_count,
)
from meshpoint.commission.whole import WholeCommission
from meshpoint.controller.settings.learned import (
    CALIBRATION_FORMAT,
    Calibration,
    End,
    Provenance,
    WheelRecord,
    WheelRecords,
)
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import MAIN_GEARS, Range, Split
from meshpoint.gearbox.keys import groups_of, to_toml
from meshpoint.gearbox.tables import merged_tables, parse_toml, read_group
from meshpoint.gearbox.wheels import Mesh
from meshpoint.identify.identified import Figure, Identified
from meshpoint.identify.identify import identify
from meshpoint.identify.jackknife import student
from meshpoint.identify.log_reader import LogContent, LogReader
from meshpoint.identify.overlay import Entry, entries
from meshpoint.identify.sleeve_law import LAW_FIGURES
from meshpoint.identify.tooth_fit import ToothFit
from meshpoint.units import MS

START_US: Final = 10_000_000
"""A log's time, which begins anywhere, is counted from here."""
LEAST_WHEEL, MOST_WHEEL = 8, 200
"""Teeth that a gear wheel of a sheet may have."""
NEAR_COUNT: Final = 0.1
"""The engine's speed gives the input wheel's teeth to within this many."""
LEAST_TOUCHES: Final = 5
LEAST_SAMPLES: Final = 4
"""Of a duty or a time: with fewer their scatter is not known."""
LEAST_TIME_MS: Final = 0.1
"""Half the interval of a time by steps of a position sensor, however alike all travels are."""
MEDIAN_SHARE: Final = math.sqrt(math.pi / 2.0)
"""Standard deviation of a median over that of the mean."""
LEAST_KISS: Final = 0.02
"""A kiss point is known no better than so: it moves with wear and heat."""


@dataclass
class Commissioned:
    """What was measured."""

    sheet: GearboxSheet
    entries: list[Entry] = field(default_factory=list)
    """Keys of the sheet that were measured, in the units of the file."""
    findings: list[Finding] = field(default_factory=list)
    """What stays unknown, or contradicts itself."""
    identified: Identified | None = None
    calibration: Calibration | None = None

    @property
    def sleeve_law(self) -> list[Figure]:
        """What is known of the main sleeves' laws."""
        figures = self.identified.figures if self.identified is not None else []
        return [one for one in figures if one.name in LAW_FIGURES and one.value is not None]

    def add(self, table: str, key: str, value: float, why: str, half: float | None = None) -> None:
        """A measured value. half: of its 95 % interval; a count has none."""
        ends = (None, None) if half is None else (value - half, value + half)
        self.entries.append(Entry(table, key, value, why, *ends))

    def unknown(self, subject: str, text: str) -> None:
        """Something that was not measured."""
        self.findings.append(Finding(GROUP, subject, Verdict.UNKNOWN, text))


def commissioned(
    core: WholeCommission, sheet: GearboxSheet, version: str, written: str
) -> Commissioned:
    """From a box on which nothing was found miswired. What was not measured stays the sheet's."""
    measured, bounds = standing_figures(sheet, core.standing)
    standing = with_entries(sheet, measured)
    found = Commissioned(standing, measured)
    running = core.running
    if running is not None and running.log.windows:
        _wheels(found, running.log)
        _meshes(found, running.log)
        _clutch(found, running)
        found.sheet = with_entries(standing, found.entries)
        _kiss(found, running)
        found.sheet = with_entries(standing, found.entries)
        _identify(found, core.recorded)
        _calibrate(found, core.recorded, version, written)
    known = {f"{entry.table}.{entry.key}" for entry in found.entries}
    found.findings += [bound for bound in bounds if bound.subject not in known]
    return found


def _tables(sheet: GearboxSheet) -> dict[str, Any]:
    return parse_toml(to_toml(groups_of(GearboxSheet, sheet), ""), sheet.name)


def value_of(sheet: GearboxSheet, table: str, key: str) -> float:
    """A sheet's value of a key, in the unit of its file."""
    place = _tables(sheet)
    for part in table.split("."):
        place = place[part]
    return float(place[key])


def with_entries(sheet: GearboxSheet, reported: list[Entry]) -> GearboxSheet:
    """The sheet with measured keys in place of its own. TableError where they do not fit."""
    above: dict[str, Any] = {}
    for entry in reported:
        place = above
        for part in entry.table.split("."):
            place = place.setdefault(part, {})
        place[entry.key] = entry.value
    return read_group(GearboxSheet, merged_tables(_tables(sheet), above), sheet.name)


def _wheels(found: Commissioned, log: EdgeLog) -> None:
    """Teeth and duty of each sensor wheel."""
    for shaft in Shaft:
        subject = f"{shaft} wheel"
        reported = tooth_count(*(log.edges(shaft, window)[0] for window in log.windows))
        if shaft is Shaft.INPUT:
            reported = _by_engine(found, log, reported)
        if reported is None:
            found.unknown(subject, "its teeth are too even to be distinguished: count them")
            continue
        found.add(f"wheels.{shaft}", "teeth", reported, "by their pattern")
        shares = [100.0 * share for share in _duty(log, shaft)]
        if len(shares) >= LEAST_SAMPLES:
            found.add(f"wheels.{shaft}", "duty_percent", median(shares), "", _half(shares))


def _by_engine(found: Commissioned, log: EdgeLog, by_pattern: int | None) -> int | None:
    """The input wheel turns with the engine, whose speed is known."""
    counted = median(rate(log, Shaft.INPUT, window) for window in log.windows)
    teeth = round(counted)
    if teeth < LEAST_WHEEL or abs(counted - teeth) > NEAR_COUNT:
        return by_pattern
    if by_pattern is not None and by_pattern != teeth:
        text = f"{teeth} teeth by the engine's speed, {by_pattern} by their pattern"
        found.findings.append(Finding(GROUP, "input wheel", Verdict.BAD, text))
        return None
    return teeth


def _half(samples: list[float]) -> float:
    """Half the 95 % interval of a median of normal samples."""
    scatter = stdev(samples) / math.sqrt(len(samples))
    return student(len(samples) - 1) * MEDIAN_SHARE * scatter


def _duty(log: EdgeLog, shaft: Shaft) -> list[float]:
    """The share of a pitch from rising to falling edge, on the average of all teeth, by window."""
    shares = []
    for window in log.windows:
        rise, _ = log.edges(shaft, window)
        fall, _ = log.edges(shaft, window, falling=1)
        fall = fall[(fall > rise[0]) & (fall < rise[-1])] if rise.size > 1 else fall[:0]
        if fall.size:
            at = np.interp(fall, rise, np.arange(rise.size))
            turned = complex(np.exp(2j * np.pi * at).mean())
            shares.append(float(np.angle(turned)) / (2.0 * np.pi) % 1.0)
    return shares


def _meshes(found: Commissioned, log: EdgeLog) -> None:
    """Gear ratios, as teeth without a common factor."""
    teeth = {
        Shaft(entry.table.removeprefix("wheels.")): int(entry.value)
        for entry in found.entries
        if entry.key == "teeth" and entry.table.startswith("wheels.")
    }
    for table, pair, states, mesh in _steps(found.sheet):
        reported = [
            one
            for window in log.windows
            if window.state in states and (one := ratio(log, pair, teeth, window)) is not None
        ]
        best = min(reported, key=lambda one: one.tolerance, default=None)
        if best is None or best.fraction is None:
            found.unknown(table, "its ratio is not known well enough to know its teeth")
            continue
        driving, driven = _whole_teeth(best, mesh)
        found.add(table, "teeth_driving", driving, "down to a common factor")
        found.add(table, "teeth_driven", driven, "")


def _steps(sheet: GearboxSheet) -> Iterator[tuple[str, tuple[Shaft, Shaft], tuple[Any, ...], Mesh]]:
    for split in Split:
        pair = (Shaft.INPUT, Shaft.LAYSHAFT)
        states: tuple[State, ...] = (SPLIT_STATES[split],)
        if split is Split.LOW:
            states += tuple(GEAR_STATES.values())
        yield f"splitter.{split.name.lower()}", pair, states, sheet.split_mesh(split)
    for gear in MAIN_GEARS:
        pair = (Shaft.LAYSHAFT, Shaft.MAIN)
        yield f"main.{gear.name.lower()}", pair, (GEAR_STATES[gear],), sheet.main_mesh(gear)
    for range_ in Range:
        pair = (Shaft.MAIN, Shaft.PROPELLER)
        states = (RANGE_STATES[range_],)
        if range_ is Range.HIGH:
            states += tuple(SPLIT_STATES.values())
        yield f"range.{range_.name.lower()}", pair, states, sheet.range_mesh(range_)


def _whole_teeth(measured: Measured, mesh: Mesh) -> tuple[int, int]:
    """The sheet's own wheels where they have this ratio, else the fewest teeth that may be."""
    reported = measured.fraction or Fraction(1)
    if mesh.exact == reported:
        return mesh.driving, mesh.driven
    least = min(reported.numerator, reported.denominator)
    factor = -(-LEAST_WHEEL // least)
    return factor * reported.numerator, factor * reported.denominator


def _clutch(found: Commissioned, running: RunningCore) -> None:
    for key, times_s in (
        ("open_delay_ms", running.opening_s),
        ("close_delay_ms", running.closing_s),
    ):
        times = [one / MS for one in times_s]
        if len(times) < LEAST_SAMPLES:
            found.unknown(f"clutch.{key}", f"{len(times)} travels from end to end show it")
            continue
        half = max(_half(times), LEAST_TIME_MS)
        found.add("clutch", key, median(times), "by its position", half)


def _kiss(found: Commissioned, running: RunningCore) -> None:
    teeth = found.sheet.wheels.input_.teeth
    edges_us = running.log.tracks[Shaft.INPUT, 0].times
    shares = kiss_points(running.closings, edges_us, teeth)
    if shares.size < LEAST_TOUCHES:
        text = f"{shares.size} of {len(running.closings)} closings show it"
        found.unknown("clutch kiss point", text)
        return
    half = max(LEAST_KISS, 2.0 * float(shares.std(ddof=1)))
    kiss, half = 100.0 * float(np.median(shares)), 100.0 * half
    found.add("clutch", "kiss_percent", kiss, "by the input shaft", half)
    found.add("clutch", "kiss_tolerance_percent", half, "two standard deviations")


def _content(sheet: GearboxSheet, recorded: list[tuple[int, Frame]]) -> LogContent:
    reader = LogReader(sheet)
    for time_us, frame in recorded:
        reader.take(START_US + time_us, frame)
    return reader.finish()


def _identify(found: Commissioned, recorded: list[tuple[int, Frame]]) -> None:
    """Brake, drag, inertias, sleeves and duty, by the log of the guided manoeuvres."""
    content = _content(found.sheet, recorded)
    found.identified = identify(content, found.sheet)
    reported = {(entry.table, entry.key): entry for entry in found.entries}
    for entry in entries(found.identified, found.sheet):
        if entry.table != "clutch":
            reported[entry.table, entry.key] = entry
    found.entries = list(reported.values())
    for figure in found.identified.figures:
        is_left_out = figure.name.startswith("clutch") or figure.name in LAW_FIGURES
        if figure.value is None and not is_left_out:
            found.unknown(figure.name, figure.why)
    found.sheet = with_entries(found.sheet, found.entries)


def _calibrate(
    found: Commissioned, recorded: list[tuple[int, Frame]], version: str, written: str
) -> None:
    """What a controller would have to learn in its first shifts: teeth, and each gear's sleeve."""
    if found.identified is None:
        return
    sheet, sleeves = found.sheet, _content(found.sheet, recorded).sleeves
    if sleeves is None:
        return
    fitted = {name: _wheel(fit) for name, fit in found.identified.teeth.items()}
    found.calibration = Calibration(
        format_=CALIBRATION_FORMAT,
        provenance=Provenance(version, sheet.name, sheet.sha256, written, 0),
        wheels=WheelRecords(**fitted),
        sleeves=sleeves.records(),
        sleeve_laws=sleeves.laws(),
        end=End(complete=True),
    )


def _wheel(fit: ToothFit) -> WheelRecord:
    errors = tuple(float(f"{error:.9g}") for error in fit.error_rad)
    sd = max(2e-6, float(np.sqrt(np.mean(fit.sd_rad**2))))
    return WheelRecord(fit.error_rad.size // 2, fit.spans * fit.error_rad.size, sd, errors)
