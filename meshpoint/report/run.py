"""What a report is about, in words: its runs, and each shift's prediction against its outcome."""

from __future__ import annotations

from dataclasses import dataclass, field

from meshpoint.gearbox import GearboxSheet
from meshpoint.report.collect import ReportShift
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
    fired = row.attempts > 0
    measured = fired and outcome.measured_contact_time_us != 0
    known = fired and row.reference == "known"
    predicted_ms = shift.ms(outcome.predicted_contact_time_us) if fired else None
    measured_ms = shift.ms(outcome.measured_contact_time_us) if measured else None
    predicted = seen = "–"
    if known:
        sd = to_pct * outcome.predicted_phase_sd_rad / DEG
        predicted = f"{_text(to_pct * outcome.predicted_phase_rad / DEG, signed=True)} ± {sd:.1f}"
    if known and measured:
        seen = _text(to_pct * outcome.estimated_phase_rad / DEG, signed=True)
    true_pct = None if shift.contact_phase_deg is None else to_pct * shift.contact_phase_deg
    slip = outcome.predicted_slip_rad_s / RPM if fired else None
    rows = [
        ["contact, ms after the request", _text(predicted_ms), _text(measured_ms),
         _text(shift.contact_ms)],
        ["phase at contact, % of pitch", predicted, seen, _text(true_pct, signed=True)],
        ["slip at contact, rpm", _text(slip, signed=True), "–", _text(row.slip_rpm, signed=True)],
    ]  # fmt: skip
    if row.aborts:
        rows.append(["aborted", "–", aborts_words(row.aborts, row.halt_mm), "–"])
    return rows


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
