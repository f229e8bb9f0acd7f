"""What a controller has learned: read from its calibration at the start, and gathered for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.estimate.reference_recovery import SavedReferences
from meshpoint.controller.estimate.teeth import ToothPattern
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.learned import (
    CALIBRATION_FORMAT,
    BrakeRecord,
    Calibration,
    End,
    NoiseRecord,
    Provenance,
    ReferenceRecords,
    SwingRecords,
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
            _pattern(wheels.layshaft),
            _pattern(wheels.main),
            calibration.references.offsets_rad,
        )
    )


class Learned:
    """What a controller knows now, by the groups of a calibration file: each is worked out where it
    is asked for, and once. What this run cannot learn stays as it was read."""

    def __init__(
        self, header: RunHeader, observer: Observer, context: ShiftContext, shifts: int
    ) -> None:
        self._header, self._observer, self._context = header, observer, context
        self._shifts = shifts
        self._learns = observer.recovery is not None
        self._before = header.calibration

    @property
    def provenance(self) -> Provenance:
        """Whose figures these are; without the time of their writing."""
        version, sheet = self._header.version, self._header.sheet
        earlier = 0 if self._before is None else self._before.provenance.shifts
        return Provenance(version, sheet.name, sheet.sha256, "", earlier + self._shifts)

    @cached_property
    def _saved(self) -> SavedReferences | None:
        recovery = self._observer.recovery
        return None if recovery is None else recovery.saved()

    @property
    def wheels(self) -> WheelRecords:
        """The teeth."""
        if self._saved is None:
            return WheelRecords() if self._before is None else self._before.wheels
        return WheelRecords(_record(self._saved.layshaft), _record(self._saved.main))

    @property
    def references(self) -> ReferenceRecords:
        """The phase references."""
        if self._saved is None:
            return ReferenceRecords() if self._before is None else self._before.references
        return _references(self._saved, self._header.sheet.dog.pitch_rad)

    @cached_property
    def brake(self) -> BrakeRecord | None:
        """The layshaft brake."""
        if self._learns:
            return self._observer.brake.record()
        return None if self._before is None else self._before.brake

    @cached_property
    def noise(self) -> NoiseRecord | None:
        """Scatter and disturbance."""
        if self._learns:
            return self._observer.noise()
        return None if self._before is None else self._before.noise

    @cached_property
    def swings(self) -> SwingRecords:
        """The driveline's swing."""
        if self._learns:
            return self._observer.swings()
        return SwingRecords() if self._before is None else self._before.swings

    @cached_property
    def sleeves(self) -> ByName:
        """The delays of the gears, each by its name."""
        return ByName(lambda name: self._context.sleeves.record(MainGear[name.upper()]))

    @cached_property
    def sleeve_laws(self) -> ByName:
        """The laws of the sleeves, each by its name."""
        return ByName(lambda name: self._context.sleeves.law(Sleeve[name.upper()]))


class ByName:
    """Attributes that are worked out where they are asked for, and once."""

    def __init__(self, work_out: Callable[[str], Any]) -> None:
        self._work_out = work_out

    def __getattr__(self, name: str) -> Any:
        value = self._work_out(name)
        setattr(self, name, value)
        return value


def collect(learned: Learned, sleeves: Sleeves, written: str) -> Calibration:
    """All of it, with that of the sleeves, at a time that the caller says in `written`."""
    return Calibration(
        format_=CALIBRATION_FORMAT,
        provenance=replace(learned.provenance, written=written),
        wheels=learned.wheels,
        references=learned.references,
        brake=learned.brake,
        noise=learned.noise,
        swings=learned.swings,
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
