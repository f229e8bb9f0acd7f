"""From a controller to its calibration and back: what it has learned, gathered and handed out."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.calibration.learned import (
    CALIBRATION_FORMAT,
    Calibration,
    End,
    Provenance,
    ReferenceRecords,
    SwingRecords,
    WheelRecord,
    WheelRecords,
)
from meshpoint.controller.estimation.tooth_match import ToothPattern
from meshpoint.controller.header import RunHeader
from meshpoint.controller.observer import Observer
from meshpoint.controller.phase.reference_recovery import SavedReferences
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.sleeve.sleeves import Sleeves
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
            _pattern(wheels.layshaft),
            _pattern(wheels.main),
            calibration.references.offsets_rad,
        )
    )


def collect(
    header: RunHeader, observer: Observer, context: ShiftContext, shifts: int, written: str
) -> Calibration:
    """What is known now, at a time that the caller says in `written`.

    What this run cannot learn stays as it was read."""
    before = header.calibration
    earlier = before.provenance.shifts if before is not None else 0
    provenance = Provenance(
        header.version, header.sheet.name, header.sheet.sha256, written, earlier + shifts
    )
    recovery = observer.recovery
    if recovery is None:
        wheels = before.wheels if before is not None else WheelRecords()
        references = before.references if before is not None else ReferenceRecords()
        brake = before.brake if before is not None else None
        noise = before.noise if before is not None else None
        swings = before.swings if before is not None else SwingRecords()
    else:
        saved = recovery.saved()
        wheels = WheelRecords(_record(saved.layshaft), _record(saved.main))
        references = _references(saved, header.sheet.dog.pitch_rad)
        brake = observer.brake.record()
        noise, swings = observer.noise(), observer.swings()
    return Calibration(
        format_=CALIBRATION_FORMAT,
        provenance=provenance,
        wheels=wheels,
        references=references,
        brake=brake,
        noise=noise,
        swings=swings,
        sleeves=context.sleeves.records(),
        sleeve_laws=context.sleeves.laws(),
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
