"""The phase reference of a shift, as its controller knew it: what makes a phase of tooth edges.

    phase = gear_ratio * layshaft angle - main shaft angle + reference        (modulo a pitch)

The angles are (rising edges) * 360 deg / (teeth of the wheel). The controller reports both angles
and the phase in `ControllerEstimates`, and counts teeth from an edge of its own; the whole number
of teeth by which its count differs from that of the edge frames is found from both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.dataset.shift_series import Columns
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import DEG

LOOKS = 20
"""Newest estimates that are looked at."""
Vector = NDArray[np.float64]


class NoReferenceError(ValueError):
    """No estimate of a phase came early enough, or its estimates contradict each other."""


def reference_deg(known: dict[str, Columns], sheet: GearboxSheet, gear: int) -> float:
    """Of the gear that is asked for (deg, within half a pitch), from tables that were known."""
    pitch_deg = sheet.dog.pitch_rad / DEG
    ratio = sheet.main_mesh(DRIVE_GEARS[gear].main).ratio
    estimates = {name: np.array(of) for name, of in known.get("estimates", {}).items()}
    if not estimates:
        raise NoReferenceError("no estimate was known")
    is_good = estimates["phase_known"] & estimates["layshaft_valid"] & estimates["main_valid"]
    rows = np.flatnonzero(is_good)[-LOOKS:]
    if not rows.size:
        raise NoReferenceError("no estimate of the phase was known")
    at_us = estimates["time_us"][rows].astype(float)
    lay_deg, main_deg = (estimates[f"{shaft}_angle_deg"][rows] for shaft in ("layshaft", "main"))
    teeth = {"layshaft": sheet.wheels.layshaft.teeth, "main": sheet.wheels.main.teeth}
    lay_off = _offset_deg(known["edges"], "layshaft", teeth["layshaft"], at_us, lay_deg)
    main_off = _offset_deg(known["edges"], "main", teeth["main"], at_us, main_deg)
    lay_deg, main_deg = lay_deg + lay_off, main_deg + main_off
    found = estimates["phase_deg"][rows] - ratio * lay_deg + main_deg
    off = _wrapped(found - found[-1], pitch_deg)
    return float(_wrapped(found[-1] + np.median(off), pitch_deg))


def _offset_deg(edges: Columns, shaft: str, teeth: int, at_us: Vector, said_deg: Vector) -> Vector:
    """What to add to the controller's angles to have those of the edges' numbers: whole teeth."""
    kinds = zip(edges["shaft"], edges["edge"], strict=True)
    mine = [number for number, kind in enumerate(kinds) if kind == (shaft, "rise")]
    times = np.array([edges["time_us"][number] for number in mine], float)
    tooth_deg = 360.0 / teeth
    angles_deg = np.array([edges["index"][number] for number in mine], float) * tooth_deg
    seen_deg = _at(at_us, times, angles_deg)
    return np.round((seen_deg - said_deg) / tooth_deg) * tooth_deg


def _at(at_us: Vector, times_us: Vector, angles_deg: Vector) -> Vector:
    """The angle between edges, and behind the newest one as between the last two."""
    found = np.interp(at_us, times_us, angles_deg)
    per_us = (angles_deg[-1] - angles_deg[-2]) / (times_us[-1] - times_us[-2])
    behind = at_us > times_us[-1]
    found[behind] = angles_deg[-1] + per_us * (at_us[behind] - times_us[-1])
    return found


def _wrapped(angle_deg: Vector, pitch_deg: float) -> Vector:
    return np.asarray(angle_deg - pitch_deg * np.floor(angle_deg / pitch_deg + 0.5))
