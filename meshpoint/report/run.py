"""What a report is about, in words: its runs, and each shift's prediction against its outcome."""

from __future__ import annotations

from dataclasses import dataclass, field

from meshpoint.gearbox import GearboxSheet
from meshpoint.report.collect import Firing, ReportShift
from meshpoint.report.html import NUMBER_CLASS, Cell
from meshpoint.results.aborts import aborts_words
from meshpoint.units import DEG, RPM


@dataclass(frozen=True)
class ReportRun:
    """The shifts of one strategy, as it was asked for."""

    name: str
    shifts: list[ReportShift]
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """All that a page shows. Texts may hold anything; the page escapes them."""

    title: str
    subtitle: str
    sheet: GearboxSheet
    runs: list[ReportRun]
    provenance: dict[str, str]
    asked: str | None = None
    """The strategy that was asked what it decides on these frames; None: as recorded."""


def shift_title(run: str, number: int, shift: ReportShift) -> str:
    """One line that says which shift this is and what came of it."""
    row = shift.row
    met = "no contact" if row.contact is None else f"tooth met {row.contact}"
    if row.phase_error_pct_of_pitch is not None and row.slip_rpm is not None:
        met += (
            f" at {row.slip_rpm:+.1f} rpm, phase error "
            f"{row.phase_error_pct_of_pitch:+.1f} % of pitch"
        )
    return f"{run}, shift {number}: gear {row.from_} to {row.to}, {met}"


def account(shift: ReportShift) -> list[list[str]]:
    """Prediction against outcome: quantity, predicted when fired, seen by the controller, truth."""
    outcome, row = shift.outcome, shift.row
    to_pct = 100 / row.pitch_deg
    firing, is_last = _first_firing(shift)
    measured = is_last and outcome.measured_contact_time_us != 0
    measured_ms = shift.ms(outcome.measured_contact_time_us) if measured else None
    predicted = seen = "–"
    if firing and firing.sd_deg:
        sd = to_pct * firing.sd_deg
        predicted = f"{_text(to_pct * firing.phase_deg, signed=True)} ± {sd:.1f}"
    if measured and row.reference == "known":
        seen = _text(to_pct * outcome.estimated_phase_rad / DEG, signed=True)
    true_pct = None if shift.contact_phase_deg is None else to_pct * shift.contact_phase_deg
    slip = firing.slip_rpm if firing else None
    predicted_ms = firing.contact_ms if firing else None
    rows = [
        ["contact, ms after the request", _text(predicted_ms), _text(measured_ms),
         _text(shift.contact_ms)],
        ["phase at contact, % of pitch", predicted, seen, _text(true_pct, signed=True)],
        ["slip at contact, rpm", _text(slip, signed=True), "–", _text(row.slip_rpm, signed=True)],
    ]  # fmt: skip
    if row.aborts:
        rows.append(["aborted", "–", aborts_words(row.aborts, row.halt_mm), "–"])
    return rows


def _first_firing(shift: ReportShift) -> tuple[Firing | None, bool]:
    """The firing that made the first contact, and whether it is the last one: of that one alone
    the outcome says what the controller saw."""
    outcome, row = shift.outcome, shift.row
    if not row.attempts:
        return None, False
    fire_ms = shift.ms(outcome.fire_time_us)
    met_ms = shift.contact_ms
    if met_ms is not None and (row.attempts > 1 or met_ms < fire_ms):
        return shift.fired_before(met_ms), False
    last = Firing(
        decided_ms=fire_ms,
        fire_ms=fire_ms,
        contact_ms=shift.ms(outcome.predicted_contact_time_us),
        phase_deg=outcome.predicted_phase_rad / DEG,
        sd_deg=outcome.predicted_phase_sd_rad / DEG if row.reference == "known" else 0.0,
        slip_rpm=outcome.predicted_slip_rad_s / RPM,
    )
    return last, True


def _text(value: float | None, signed: bool = False) -> str:
    if value is None:
        return "–"
    return figure(value, 1, signed)


def figure(value: float, digits: int, signed: bool = False) -> str:
    """A number as text; what rounds to zero has no sign of its own but plus."""
    rounded = round(value, digits) + 0.0
    return f"{rounded:+.{digits}f}" if signed else f"{rounded:.{digits}f}"


def number_cell(value: float | None, digits: int, signed: bool = False) -> Cell:
    """The same as a table's cell; a dash where there is none."""
    return "–" if value is None else figure(value, digits, signed), NUMBER_CLASS
