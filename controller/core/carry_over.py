"""What a controller has learned: read from its calibration at the start, and gathered for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any, Final

import numpy as np

from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.estimate.reference_recovery import SavedReferences
from meshpoint.controller.estimate.teeth import ToothPattern
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.learned import (
    CALIBRATION_FORMAT,
    Calibration,
    End,
    Provenance,
    ReferenceRecords,
    WheelRecord,
    WheelRecords,
)
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.gearbox import MainGear, Sleeve
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.kinematics import wrap_to_pitch


def restore(calibration: Calibration, observer: Observer, sleeves: Sleeves) -> None:
    """Starts with what earlier runs learned. Teeth and phase references are memories until the
    wheels show which tooth is which; the baseline estimators take sleeves alone."""
    sleeves.restore(calibration.sleeves, calibration.sleeve_laws)
    recovery = observer.recovery
    if recovery is None:
        return
    if calibration.brake is not None:
        observer.take_brake(calibration.brake)
    if calibration.noise is not None:
        observer.take_noise(calibration.noise)
    observer.take_swings(calibration.swings)
    wheels = calibration.wheels
    recovery.restore(
        SavedReferences(
            _pattern(wheels.layshaft), _pattern(wheels.main), calibration.references.offsets_rad
        )
    )


OF_SHAFTS: Final = ("wheels", "references", "brake", "noise", "swings")
"""Groups of a calibration that the baseline estimators do not learn."""
NOTHING: Final = Calibration(
    format_=CALIBRATION_FORMAT, provenance=Provenance("", "", "", "", 0), end=End(complete=True)
)


class ByName:
    """Attributes that are worked out where they are asked for, and once."""

    def __init__(self, work_out: Callable[[str], Any]) -> None:
        self._work_out = work_out

    def __getattr__(self, name: str) -> Any:
        value = self._work_out(name)
        setattr(self, name, value)
        return value


def learned_by(header: RunHeader, observer: Observer, context: ShiftContext, shifts: int) -> ByName:
    """What a controller knows now, by the groups of a calibration file, without the time of its
    writing. What this run cannot learn stays as it was read."""
    sheet, before, recovery = header.sheet, header.calibration or NOTHING, observer.recovery
    shifts += before.provenance.shifts
    groups: dict[str, Callable[[], Any]] = {
        name: partial(getattr, before, name) for name in OF_SHAFTS
    }
    if recovery is not None:
        saved = cache(recovery.saved)
        groups |= {
            "wheels": lambda: WheelRecords(_record(saved().layshaft), _record(saved().main)),
            "references": lambda: _references(saved(), sheet.dog.pitch_rad),
            "brake": observer.brake.record,
            "noise": observer.noise,
            "swings": observer.swings,
        }
    sleeves = context.sleeves
    groups |= {
        "provenance": lambda: Provenance(header.version, sheet.name, sheet.sha256, "", shifts),
        "sleeves": lambda: ByName(lambda name: sleeves.record(MainGear[name.upper()])),
        "sleeve_laws": lambda: ByName(lambda name: sleeves.law(Sleeve[name.upper()])),
    }
    return ByName(lambda name: groups[name]())


def collect(learned: ByName, sleeves: Sleeves, written: str) -> Calibration:
    """All of it, with that of the sleeves, at a time that the caller says in `written`."""
    return Calibration(
        format_=CALIBRATION_FORMAT,
        provenance=replace(learned.provenance, written=written),
        **{name: getattr(learned, name) for name in OF_SHAFTS},
        sleeves=sleeves.records(),
        sleeve_laws=sleeves.laws(),
        end=End(complete=True),
    )


def _pattern(record: WheelRecord | None) -> ToothPattern | None:
    if record is None:
        return None
    return ToothPattern(np.array(record.error_rad), record.sd_rad, record.edges)


def _record(pattern: ToothPattern | None) -> WheelRecord | None:
    if pattern is None:
        return None
    errors = tuple(pattern.error_rad.tolist())
    return WheelRecord(len(errors) // 2, pattern.edges, pattern.sd_rad, errors)


def _references(saved: SavedReferences, pitch_rad: float) -> ReferenceRecords:
    offsets = saved.offsets_rad
    given = {
        f"{gear.name.lower()}_rad": wrap_to_pitch(offsets[gear], pitch_rad)
        for gear in MAIN_GEARS
        if gear in offsets
    }
    return ReferenceRecords(**given)
