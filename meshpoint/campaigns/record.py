"""One judged shift as a row of the campaign's table."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Final

from meshpoint.bench.bench import PlannedShift
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.results.kinematic_bound import kinematic_bound_ms
from meshpoint.results.rows import ShiftRow
from meshpoint.results.shift_figures import NO_OUTCOME, REFUSED, ShiftFigures
from meshpoint.results.shift_parts import ShiftParts
from meshpoint.units import MM, RPM

GAP: Final = "gap"
"""Of a first contact, in records."""
SHARED: Final = tuple(field.name for field in fields(ShiftFigures))


@dataclass(frozen=True, kw_only=True)
class JudgedShift(ShiftFigures):
    """A shift with what was drawn for it. None: it did not come to that, or was not drawn."""

    sweep: str
    sweep_value: float
    seed: int
    shift: int
    """Number among the judged shifts of its run."""
    from_gear: int
    to_gear: int
    main_gear: str
    ratio: float
    """Main shaft torque over layshaft torque, 1 / i_gear."""
    layshaft_rpm: float
    """In the old gear."""
    reference_known: bool
    """Whether the gear's phase reference was known when the sleeve was fired."""
    duration_ms: float | None
    """From request to outcome."""
    backlash_percent: float
    gap_share: float
    """Of all phases at contact, the share at which it would be in a gap (`gap_share()`)."""
    delay_sd_ms: float
    oil_c: float | None
    slope_percent: float | None
    mass_kg: float | None
    supply_offset_bar: float | None
    ramp_ms: float | None
    parting_ms: float | None
    pull_out_ms: float | None
    raising_ms: float | None
    brake_on_ms: float | None
    braking_ms: float | None
    release_ms: float | None
    entry_ms: float | None
    seen_ms: float | None
    closing_ms: float | None
    """Where the time went, as `results.shift_parts` has it."""

    @property
    def is_gap(self) -> bool:
        """Whether the first contact was in a gap."""
        return self.contact == GAP

    @property
    def engaged(self) -> bool:
        """Whether the gear is in."""
        return self.result == "engaged"

    @property
    def is_refused(self) -> bool:
        """Whether the controller has not begun it."""
        return self.result == REFUSED

    def to_row(self) -> dict[str, Any]:
        """By name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def gap_share(sheet: GearboxSheet, backlash_factor: float, chamfer_m: float) -> float:
    """Share of a pitch at which a first contact is in a gap: the gap, and on the side from which
    the tooth comes its chamfer as well. What a strategy hits that knows nothing of the phase."""
    dog = sheet.dog
    width_rad = dog.backlash_rad * backlash_factor + chamfer_m / dog.radius_m
    return min(1.0, width_rad / dog.pitch_rad)


class Conditions:
    """What all shifts of a run have in common."""

    def __init__(self, sheet: GearboxSheet, as_built: dict[str, Any]) -> None:
        def built(group: str, key: str) -> float | None:
            return as_built[group][key] if group in as_built else None

        factor = built("sheet", "backlash_factor") or 1.0
        chamfer_mm = built("dog", "chamfer_mm") or 0.0
        sd_ms = built("sleeve", "noise_sd_ms")
        self.columns: dict[str, Any] = {
            "backlash_percent": 100.0 * sheet.dog.backlash_share * factor,
            "gap_share": gap_share(sheet, factor, chamfer_mm * MM),
            "delay_sd_ms": sheet.sleeve.delay_sd_s * 1e3 if sd_ms is None else sd_ms,
            "oil_c": built("oil", "temperature_c"),
            "slope_percent": built("vehicle", "slope_percent"),
            "mass_kg": built("vehicle", "mass_kg"),
            "supply_offset_bar": built("air", "supply_offset_bar"),
        }
        self._sheet = sheet
        self._as_built = as_built

    def record(
        self, planned: PlannedShift, row: ShiftRow | None, refusal: str | None = None, **key: Any
    ) -> JudgedShift:
        """The record of a shift; `row` None: there was no outcome, or the request was refused for
        the fault `refusal`. `key`: sweep to strategy."""
        gear = DRIVE_GEARS[planned.to].main
        old = self._sheet.main_mesh(DRIVE_GEARS[planned.from_].main).ratio
        none = ShiftFigures(
            strategy="",
            pitch_deg=math.degrees(self._sheet.dog.pitch_rad),
            result=NO_OUTCOME if refusal is None else REFUSED,
            fault=refusal or "none",
        )
        shared = {name: getattr(row or none, name) for name in SHARED}
        bound_ms = kinematic_bound_ms(
            self._sheet, self._as_built, (planned.from_, planned.to), planned.main_rad_s
        )
        return JudgedShift(
            **shared | key | {"bound_ms": bound_ms},
            from_gear=planned.from_,
            to_gear=planned.to,
            main_gear=gear.name.lower(),
            ratio=1.0 / self._sheet.main_mesh(gear).ratio,
            layshaft_rpm=planned.main_rad_s / old / RPM,
            reference_known=row is not None and row.reference == "known",
            duration_ms=None if row is None else row.duration_ms,
            **vars(ShiftParts() if row is None else row.phases),
            **self.columns,
        )
