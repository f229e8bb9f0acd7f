"""The controller: frames in, frames out, one visible function between (sans-I/O).

    receive(frame)      keeps the frame for the next step; never raises
    step(now_us)        the whole decision: edges -> observer -> predictor -> sequence -> valves
    next_step_us        when to be called again

A frame takes effect at the step that consumes it. Frames of one step are taken in order of
identifier, so the order in which different senders got onto the bus changes nothing.
"""

from __future__ import annotations

import zlib
from dataclasses import replace
from operator import itemgetter
from typing import Final, NamedTuple

from bus.core import Step
from controller.brake_input import BrakeInput
from controller.guard import Guard, Seen
from controller.header import RunHeader
from controller.inputs import StepInputs
from controller.observer import Observer
from controller.report import Reporter
from controller.sequence import Moment, OutlookSource, ShiftSequence
from controller.settings import ControllerSettings, ValveTiming
from controller.valves import ValveBoard
from dbc.frame import Frame
from dbc.link import Receiver, Transmitter, Verdict
from dbc.messages import (
    ClutchCommand,
    EdgesLayshaftRise,
    EdgesMainRise,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveCommand,
)
from dbc.node import Node
from gearbox import Sleeve

OWN_ADDRESS: Final = 0x03
INBOX_LIMIT: Final = 20_000
"""A babbling bus cannot eat the memory: this is two seconds of a full bus."""
FOREIGN: Final = Verdict.FOREIGN
_identifier = itemgetter(0)
NEEDED: Final = (SleevesMain, SleevesAux, GearboxSensors, EdgesLayshaftRise, EdgesMainRise)
"""Channels without which nothing may be shifted."""


class Consumed(NamedTuple):
    """What a step consumed: number of frames of our DBC and the CRC-32 over them."""

    frames: int
    crc: int


class ControllerCore:
    """The node under test, without clock and bus."""

    def __init__(self, header: RunHeader) -> None:
        sheet, settings = header.sheet, header.settings
        self.header = header
        self._settings = settings
        self._inbox: list[Frame] = []
        self._dropped = 0
        self._receiver = Receiver(Node.TRANSMISSION_CONTROL)
        self._transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
        brake = BrakeInput(round(sheet.brake.valve_delay_s * 1e6))
        self._observer = Observer(sheet, settings, brake, settings.estimator)
        self._board = ValveBoard(ValveTiming(settings.valve_timing))
        self._sequence = ShiftSequence(
            sheet, settings, self._board, brake, self._observer.references
        )
        self._guard = Guard(settings.limits.valve_on_ms * 1000)
        self._reporter = Reporter(header, self._observer, self._sequence)
        self._due_us: int | None = None
        self._wake_us: int | None = None

    def change_settings(self, settings: ControllerSettings) -> None:
        """Other engagement settings from the next step on; what was learned stays. Call it between
        shifts; the estimators keep the settings they were built with. The run hash changes."""
        self.header = replace(self.header, settings=settings)
        self._settings = settings
        self._sequence.change_settings(settings)
        self._reporter.change_header(self.header)

    def take_outlook_from(self, source: OutlookSource) -> None:
        """Decisions are made on this source's predictions from now on, not on the estimates: how a
        study sees what a strategy would do that knew everything."""
        self._sequence.outlook_source = source

    def receive(self, frame: Frame) -> None:
        """Keeps a frame for the next step."""
        if len(self._inbox) < INBOX_LIMIT:
            self._inbox.append(frame)
        else:
            self._dropped += 1

    @property
    def next_step_us(self) -> int:
        """The next tick, or an activation for hardware that cannot schedule; 0 before the first."""
        if self._due_us is None:
            return 0
        return self._due_us if self._wake_us is None else min(self._due_us, self._wake_us)

    def step(self, now_us: int) -> Step:
        """The whole decision at `now_us` of the controller's clock."""
        lateness_us = max(0, now_us - self.next_step_us) if self._due_us is not None else 0
        events: list[str] = []
        inputs, consumed = self._consume(now_us, events)
        self._observer.take(inputs, now_us, events)
        moment = self._moment(now_us)
        self._observer.learn(events)
        self._decide(inputs.requested_gear, moment, events)
        frames = self._commands(moment, events)
        frames += self._reporter.frames(self._transmitter, moment)
        status = self._reporter.status(
            now_us, lateness_us, consumed.frames, consumed.crc, self._receiver, self._guard.blocks
        )
        frames.append(self._transmitter.encode(status))
        # In the order in which they will win the bus; the status frame closes the step.
        frames.sort(key=_identifier)
        self._plan_next_step(now_us, moment.now_us)
        return Step(frames, events)

    def shutdown(self, now_us: int) -> Step:
        """Everything off, said once more."""
        self._board.all_off()
        commands = (ValveCommand(), ClutchCommand())
        frames = [self._transmitter.encode(command) for command in commands]
        return Step(frames, [f"valves off at {now_us} us"])

    def _consume(self, now_us: int, events: list[str]) -> tuple[StepInputs, Consumed]:
        """Decodes the inbox in order of identifier."""
        self._receiver.tick(now_us)
        inputs = StepInputs()
        consumed: list[bytes] = []
        inbox, self._inbox = sorted(self._inbox, key=_identifier), []
        receive = self._receiver.receive
        for frame in inbox:
            can_id = frame[0]
            if can_id & 0xFF == OWN_ADDRESS and frame.is_extended:
                continue
            verdict, message = receive(frame)
            if verdict is not FOREIGN:
                consumed += (can_id.to_bytes(4, "little"), frame[1])
            if message is not None:
                inputs.take(message)
        if self._dropped:
            events.append(f"{self._dropped} frames dropped: more than {INBOX_LIMIT} in one step")
            self._dropped = 0
        return inputs, Consumed((len(consumed) // 2) & 0xFFFF, zlib.crc32(b"".join(consumed)))

    def _moment(self, now_us: int) -> Moment:
        observer = self._observer
        sensor_us = observer.clock.now_us(now_us)
        valves = observer.valves
        brake = valves is not None and (valves.brake_energised or valves.brake_pending)
        return Moment(
            sensor_us,
            sensor_us + self._settings.timing.lead_us,
            observer.view,
            observer.layshaft,
            observer.main_at(sensor_us),
            observer.view.complete and all(self._receiver.valid(kind) for kind in NEEDED),
            brake,
        )

    def _decide(self, requested: int | None, moment: Moment, events: list[str]) -> None:
        sequence = self._sequence
        before = sequence.state
        refusal = sequence.request(requested, moment) if requested is not None else None
        if refusal is not None:
            events.append(refusal)
            return
        sequence.step(moment)
        if sequence.state is not before:
            events.append(f"{before.name.lower()} -> {sequence.state.name.lower()}")
        if sequence.finished is not None:
            shift = sequence.finished
            events.append(
                f"shift {shift.from_number} -> {shift.to_number}: {shift.result.name.lower()}"
                f", {shift.attempts} fired, fault {shift.fault.name.lower()}"
            )

    def _commands(self, moment: Moment, events: list[str]) -> list[Frame]:
        """Valve and clutch commands; the valve frame goes out only past the guard."""
        frame = self._transmitter.encode(self._board.message(moment.now_us))
        if not self._guard.passes(frame.data, self._seen(moment)):
            events.append(f"guard blocked a valve command: row {self._guard.blocked_row}")
            self._board.all_off()
            frame = self._transmitter.encode(ValveCommand())
        clutch = self._transmitter.encode(ClutchCommand(action=self._sequence.clutch))
        return [frame, clutch]

    def _seen(self, moment: Moment) -> Seen:
        view = moment.view
        if not view.complete:
            return Seen(moment.now_us, 0.0, 0.0, 1.0, False)
        return Seen(
            moment.now_us,
            view.position_m(Sleeve.FIRST_SECOND),
            view.position_m(Sleeve.CRAWL_THIRD),
            view.clutch_closed if view.clutch_closed is not None else 1.0,
            self._receiver.valid(SleevesMain),
        )

    def _plan_next_step(self, now_us: int, sensor_us: int) -> None:
        tick_us = self._settings.timing.tick_us
        due_us = self._due_us if self._due_us is not None else now_us
        while due_us <= now_us:
            due_us += tick_us
        self._due_us = due_us
        switch_us = self._board.next_switch_us(sensor_us)
        self._wake_us = None if switch_us is None else now_us + max(0, switch_us - sensor_us)
