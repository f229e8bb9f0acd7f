"""Estimates along another controller's trajectory.

A replay with other settings, calibration, estimator or data sheet needs estimates that know the
recorded trajectory from the start of the run. Here they consume the frames that the recorded
controller consumes, with that one's brake commands for their filters; nothing is decided. What a
sequence learns from its own shifts (the flank on which a gear locks) is learned from the recorded
one's.
"""

from __future__ import annotations

import math
from dataclasses import replace

from meshpoint.controller.core.carry_over import restore
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.measure.clock import ClockProbe
from meshpoint.controller.measure.inputs import ShaftSpeedMeter, StepInputs
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.node import Node


class ReplayEstimator:
    """Estimates by `header`, along another controller's trajectory."""

    def __init__(self, header: RunHeader) -> None:
        sheet, settings = header.sheet, header.settings
        self.header = header
        self.observer = Observer(sheet, settings, settings.estimator)
        self._speed_meter = ShaftSpeedMeter(sheet)
        self._speeds = self._speed_meter.take(StepInputs(), 0)
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
        self._speeds = self._speed_meter.take(inputs, observer.clock.now_us(now_us))
        snapshot = self._snapshot(now_us, seen)
        if math.isfinite(snapshot.supply_pa):
            self.sleeves.supply_pa = snapshot.supply_pa - self.header.sheet.air.atmosphere_pa
        self.sleeves.take(observer.view, snapshot.now_us)
        self._learn_from(first, snapshot.now_us)
        observer.learn(events)
        self._probe.plan(now_us, None)
        return snapshot

    def hand_over(self, to: ControllerCore) -> None:
        """That controller goes on with these estimates, which are its own from here on."""
        to.adopt_estimator(
            self.header,
            self.observer,
            speed_meter=self._speed_meter,
            sleeves=self.sleeves,
        )

    def _snapshot(self, now_us: int, seen: StepSnapshot) -> StepSnapshot:
        observer = self.observer
        sensor_us = observer.clock.now_us(now_us)
        return StepSnapshot(
            sensor_us,
            sensor_us + seen.earliest_us - seen.now_us,
            observer.view,
            observer.layshaft,
            observer.main_at,
            self._speeds,
            seen.lost,
            seen.driven,
            observer.view.supply_pa,
        )

    def _learn_from(self, first: ShiftSequence, now_us: int) -> None:
        """The first controller's valve commands and its lock."""
        self.observer.take_commands(first.brake, [], first.shift is not None)
        first.board.publish_to(self.sleeves, now_us)
        watched = first.references.watched
        if watched is not None and watched is not self._watched:
            self.observer.references.locked(watched.gear, float(watched.flank))
        self._watched = watched
