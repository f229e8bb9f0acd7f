"""The last part of a shift as it is drawn in slow motion: where tooth and sleeve are.

Angles are those of the gear's tooth from the middle of the sleeve's gap, by the rig's truth; they
go on over the pitches, and the contact lies in the pitch around zero.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN
from meshpoint.report.collect import ReportShift
from meshpoint.report.layout import SLEEVE_NAME
from meshpoint.report.phase import true_trajectory

BEFORE_MS: Final = 120.0
"""The motion begins this long before the first contact."""


def motion(shift: ReportShift, sheet: GearboxSheet) -> dict[str, Any] | None:
    """`at_ms` and `phase_deg` of the tooth, every 2 ms and at the contact, `sleeve_from_ms` and
    `sleeve_mm` each millisecond, towards the gear positive. None without a contact or its truth."""
    contact_ms, contact_deg = shift.contact_ms, shift.contact_phase_deg
    after = DRIVE_GEARS[shift.row.to].main
    trajectory = true_trajectory(shift, after.name.lower(), sheet.main_mesh(after).ratio)
    if contact_ms is None or contact_deg is None or trajectory is None:
        return None
    at_ms, phase_deg = trajectory
    kept = at_ms >= contact_ms - BEFORE_MS
    beyond = np.searchsorted(at_ms[kept], contact_ms)
    times = np.insert(at_ms[kept], beyond, contact_ms)
    phases = np.insert(phase_deg[kept], beyond, contact_deg)
    target = SLEEVE_OF_MAIN[after]
    sleeve_ms, sleeve_mm = shift.points(SLEEVE_NAME[target.sleeve])
    from_ms = float(np.ceil(times[0]))
    grid = np.arange(from_ms, times[-1])
    travel = target.direction * np.interp(grid, sleeve_ms, sleeve_mm) if sleeve_ms else grid * 0.0
    return {
        "at_ms": np.round(times, 3).tolist(),
        "phase_deg": np.round(phases, 4).tolist(),
        "contact_ms": round(contact_ms, 3),
        "contact": shift.row.contact,
        "sleeve_from_ms": from_ms,
        "sleeve_mm": np.round(travel, 2).tolist(),
    }


def geometry(sheet: GearboxSheet) -> dict[str, float]:
    """What the teeth look like: pitch and gap in degrees, the sleeve's way in mm."""
    return {
        "pitch_deg": float(np.degrees(sheet.dog.pitch_rad)),
        "gap_deg": float(np.degrees(sheet.dog.backlash_rad)),
        "contact_mm": 1e3 * sheet.sleeve.to_contact_m,
        "stroke_mm": 1e3 * sheet.sleeve.stroke_m,
    }
