"""What a controller has learned, handed on: to its calibration and back, and to another controller.

A replay with other settings, calibration, estimator or data sheet needs estimates that know the
recorded trajectory from the start of the run. The follower consumes the frames that the first
controller consumes, with that one's brake commands for its filters; it decides nothing. What a
sequence learns from its own shifts (the flank on which a gear locks) it learns from the first
one's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.estimate.reference_recovery import SavedReferences
from meshpoint.controller.estimate.teeth import ToothPattern
from meshpoint.controller.measure.clock import ClockProbe
from meshpoint.controller.measure.inputs import ShaftSpeedMeter, StepInputs
from meshpoint.controller.models.layshaft import BrakeInput
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
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.node import Node
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


class ReplayEstimator:
    """Estimates by `header`, along another controller's trajectory."""

    def __init__(self, header: RunHeader) -> None:
        sheet, settings = header.sheet, header.settings
        self.header = header
        self.brake = BrakeInput(round(sheet.brake.valve_delay_s * 1e6))
        self.observer = Observer(sheet, settings, self.brake, settings.estimator)
        self.speed_meter = ShaftSpeedMeter(sheet)
        self._speeds = self.speed_meter.take(StepInputs(), 0)
        self.sleeves = Sleeves(sheet)
        self._receiver = Receiver(Node.TRANSMISSION_CONTROL)
        self._probe = ClockProbe()
        self._watched: object = None
        if header.calibration is not None:
            restore(header.calibration, self.observer, self.sleeves)

    def step(
        self, frames: list[Frame], now_us: int, first: ShiftSequence, seen: StepSnapshot
    ) -> StepSnapshot:
        """One step: the frames that the first controller has consumed in it, its sequence after it,
        and what it knew. Returns what this one knows."""
        if not seen.takes_in:
            return replace(self._snapshot(now_us, seen), takes_in=False)
        self._receiver.tick(now_us)
        inputs, events = StepInputs(), list[str]()
        for frame in sorted(frames, key=lambda frame: frame.can_id):
            if self._probe.is_armed:
                self._probe.receive(frame)
            message = self._receiver.receive(frame).message
            if message is not None:
                inputs.take(message)
        observer = self.observer
        read_us = self._probe.stamp(inputs, now_us)
        if read_us is not None:
            observer.clock.stamp(read_us, now_us)
        observer.take(inputs, now_us, events)
        self._speeds = self.speed_meter.take(inputs, observer.clock.now_us(now_us))
        snapshot = self._snapshot(now_us, seen)
        if math.isfinite(snapshot.supply_pa):
            self.sleeves.supply_pa = snapshot.supply_pa - self.header.sheet.air.atmosphere_pa
        self.sleeves.take(observer.view, snapshot.now_us)
        self._learn_from(first, snapshot.now_us)
        observer.learn(events)
        self._probe.plan(now_us, None)
        return snapshot

    def _snapshot(self, now_us: int, seen: StepSnapshot) -> StepSnapshot:
        observer = self.observer
        sensor_us = observer.clock.now_us(now_us)
        return StepSnapshot(
            sensor_us,
            sensor_us + seen.earliest_us - seen.now_us,
            observer.view,
            observer.layshaft,
            observer.main_at(sensor_us),
            self._speeds,
            seen.lost,
            seen.driven,
            observer.view.supply_pa,
        )

    def _learn_from(self, first: ShiftSequence, now_us: int) -> None:
        """The first controller's valve commands and its lock."""
        self.brake.follow(first.brake)
        first.board.publish_to(self.sleeves, now_us)
        watched = first.references.watched
        if watched is not None and watched is not self._watched:
            self.observer.references.locked(watched.gear, float(watched.flank))
        self._watched = watched
