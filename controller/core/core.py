"""The controller without I/O: frames in, frames out, with the whole decision in one function.

    receive(frame)      keeps the frame for the next step; never raises
    step(now_us)        the whole decision: edges -> observer -> predictor -> sequence -> valves
    next_step_us        when to be called again

A frame takes effect at the step that consumes it. Frames of one step are taken in order of
identifier, so the order in which different senders got onto the bus changes nothing.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection
from dataclasses import replace
from operator import itemgetter
from typing import Final, NamedTuple

from meshpoint.bus.core import Step
from meshpoint.controller.core.carry_over import ByName, collect, learned_by, restore
from meshpoint.controller.core.commands import GuardedCommands
from meshpoint.controller.core.reporter import Reporter, decision_line, outcome_line
from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.measure.clock import ClockProbe, RefusedLead, StepTiming
from meshpoint.controller.measure.inputs import ShaftSpeedMeter, ShaftSpeeds, StepInputs
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import ControllerSettings, ValveTiming
from meshpoint.controller.settings.valve_name import driven_or_pending
from meshpoint.controller.shift.context import PredictorSource
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.step_snapshot import WHEEL_FAULTS, StepSnapshot
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.controller.shift.valve_board import ValveBoard
from meshpoint.controller.sleeve.sleeves import Sleeves
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, canonical, torque_share
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    ClutchCommand,
    EdgesLayshaftRise,
    EdgesMainRise,
    FaultCode,
    GearboxSensors,
    Message,
    ShiftDecision,
    SleevesAux,
    SleevesMain,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import MainGear

OWN_ADDRESS: Final = 0x03
INBOX_LIMIT: Final = 20_000
"""Frames kept between two steps, at most: two seconds of a full bus. It bounds the memory."""
FOREIGN: Final = FrameVerdict.FOREIGN
_identifier = itemgetter(0)
FRESH_US: Final = 45_000
"""A sample older than this counts as lost, even if frames with valid counters repeat it."""
FRAME_WAIT_US: Final = 8_000
"""A step's last frames may wait for this long behind the sensors' frames for the bus."""
UNARMED: Final = (
    "outputs not armed: all valves stay off, clutch and engine are not commanded, requests are "
    "refused (--arm)"
)
"""Logged once, at the first step."""
SPEEDS: Final = (EdgesLayshaftRise, EdgesMainRise)
POSITIONS: Final = (SleevesMain, SleevesAux, GearboxSensors)
"""Channels without which nothing may be shifted; and the valve side's own status."""


class Consumed(NamedTuple):
    """What a step consumed: number of frames of our DBC and the CRC-32 over them."""

    frames: int
    crc: int


NOTHING: Final = Consumed(0, 0)


class ControllerCore:
    """The node under test, without clock and bus."""

    def __init__(self, header: RunHeader) -> None:
        sheet, settings = header.sheet, header.settings
        self.header = header
        self._inbox: list[Frame] = []
        self._heard: list[Frame] = []
        self._dropped = 0
        self._receiver = Receiver(Node.TRANSMISSION_CONTROL)
        self._transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
        self._observer = Observer(sheet, settings, settings.estimator)
        self._board = ValveBoard(ValveTiming(settings.valve_timing), settings.timing.wire_us)
        self._probe = ClockProbe()
        self._refused = RefusedLead(settings.timing.tick_us)
        self._timing = StepTiming(settings.timing.tick_us)
        self._sequence = ShiftSequence(
            sheet, settings, self._board, self._observer.references, header.armed
        )
        self._speed_meter = ShaftSpeedMeter(sheet)
        self._guarded = GuardedCommands(header, self._transmitter, self._sequence)
        self._decided = ShiftDecision.NONE
        self._reporter = Reporter(header, self._observer, self._sequence)
        self._due_us: int | None = None
        self._wake_us: int | None = None
        self.snapshot: StepSnapshot | None = None
        """The inputs of the newest decision; read-only. Estimates in it are live."""
        self.shifts = 0
        """How many shifts have ended since the start."""
        self.strategy_errors: dict[str, int] = {}
        """What was wrong with a user's strategy, and how many shifts ended of it."""
        self.xcp_commands: list[Frame] = []
        """What an XCP master has sent and the newest step has consumed; read-only."""
        if header.calibration is not None:
            restore(header.calibration, self._observer, self._sequence.sleeves)

    @property
    def calibration_revision(self) -> tuple[int, int, int]:
        """Changes when there is more to keep: shifts that have ended, what has been learned from
        them, references that are known."""
        return self.shifts, self._observer.learned, self._observer.references.mask

    @property
    def running_shift(self) -> ShiftRecord | None:
        """The shift under way, or the one that this step has ended; read-only."""
        return self._sequence.shift or self._sequence.finished

    @property
    def sequence(self) -> ShiftSequence:
        """The shift sequence; read-only."""
        return self._sequence

    @property
    def observer(self) -> Observer:
        """The estimates; read-only."""
        return self._observer

    def calibration(self, written: str) -> Calibration:
        """What has been learned, earlier runs included; written: date and time as text for the
        file."""
        return collect(self.learned, self._sequence.sleeves, written)

    @property
    def learned(self) -> ByName:
        """What has been learned by now; each figure is worked out where it is asked for."""
        return learned_by(self.header, self._observer, self._sequence, self.shifts)

    @property
    def blocked_row(self) -> int | None:
        """The guard's row that blocked the newest step's valve command; None: none did."""
        return self._guarded.guard.blocked_row

    def change_settings(self, settings: ControllerSettings) -> None:
        """As `tune`, for a run of its own: the run hash changes."""
        self.header = replace(self.header, settings=settings)
        self.tune(settings)
        self._reporter.change_header(self.header)

    def tune(self, settings: ControllerSettings) -> None:
        """Other engagement settings from the next step on; what was learned stays. Call it between
        shifts; the estimators keep the settings they were built with. StrategyError where a user's
        own strategy cannot be made from them: the one before goes on."""
        self._sequence.change_settings(settings)

    def note_external_engagement(self, gear: MainGear) -> None:
        """This gear was engaged, but not by this controller: its reference is learned from how
        its tooth moves alone. For replays of another controller's log."""
        self._observer.references.locked(gear, 0.0)

    def adopt_estimator(
        self,
        header: RunHeader,
        observer: Observer,
        *,
        speed_meter: ShaftSpeedMeter,
        sleeves: Sleeves,
    ) -> None:
        """Goes on with these estimates and the header's data sheet and settings: they are this
        controller's from here on. The guard stays the one of the own data sheet. For replays."""
        self.header = header
        self._observer, self._speed_meter = observer, speed_meter
        sequence = self._sequence
        sequence.sheet, sequence.references = header.sheet, observer.references
        sequence.sleeves = sleeves
        sequence.change_settings(header.settings)
        self._reporter = Reporter(header, observer, sequence)

    def take_predictor_from(self, source: PredictorSource) -> None:
        """From now on decisions use this source's predictions instead of the estimates. For studies
        of what a strategy could do with perfect knowledge."""
        self._sequence.predictor_source = source

    def skip_unsubscribed(self, messages: Collection[type[Message]]) -> None:
        """Nobody on this bus reads these messages: of those that take time to work out, empty
        frames are sent."""
        self._transmitter.skip_unsubscribed(messages)

    def receive(self, frame: Frame) -> None:
        """Keeps a frame for the next step."""
        frame = canonical(frame)
        if self._probe.is_armed:
            self._probe.receive(frame)
        if len(self._inbox) < INBOX_LIMIT:
            self._inbox.append(frame)
        else:
            self._dropped += 1

    @property
    def next_step_us(self) -> int:
        """The next tick, or an activation for hardware that cannot schedule; 0 before the first."""
        if self._due_us is None or self._probe.is_due:
            return 0
        return self._due_us if self._wake_us is None else min(self._due_us, self._wake_us)

    def step(self, now_us: int) -> Step:
        """The whole decision at `now_us` of the controller's clock; between ticks, for a valve side
        that keeps times, only the end of a pulse that has begun."""
        lateness_us = self._lateness_us(now_us)
        events: list[str] = (
            [UNARMED] if self._due_us is None and not self._guarded.guard.is_armed else []
        )
        if self.snapshot is not None and self._is_for_an_end(now_us):
            consumed, self._heard, self.xcp_commands = NOTHING, [], []
            snapshot = self.snapshot = self._later(self.snapshot, now_us)
        else:
            snapshot, consumed = self._take_and_decide(now_us, events)
        frames = self._commands(now_us, snapshot, events)
        sequence = self._sequence
        changes, is_shifting = sequence.take_mesh_changes(), sequence.shift is not None
        self._observer.take_commands(sequence.brake, changes, is_shifting)
        if snapshot.takes_in:
            self._observer.learn(events)
        frames += self._reporter.frames(self._transmitter, snapshot)
        blocks = self._guarded.blocks
        status = self._reporter.status(
            now_us, lateness_us, consumed.frames, consumed.crc, self._receiver, blocks
        )
        frames.append(self._transmitter.encode(status))
        # In order of bus priority; the status frame comes last and completes the step.
        frames.sort(key=_identifier)
        self._plan_next_step(now_us, snapshot.now_us)
        return Step(frames, events)

    def _is_for_an_end(self, now_us: int) -> bool:
        """Whether this step is there for the end of a pulse alone: it takes nothing in."""
        is_asked = self._is_tick(now_us) or self._probe.is_due
        return not is_asked and self._board.keeps_times

    def _later(self, snapshot: StepSnapshot, now_us: int) -> StepSnapshot:
        """The same as it is known at a later moment."""
        sensor_us = self._observer.clock.now_us(now_us)
        earliest_us = sensor_us + self._lead_us
        return replace(snapshot, now_us=sensor_us, earliest_us=earliest_us, takes_in=False)

    def _take_and_decide(self, now_us: int, events: list[str]) -> tuple[StepSnapshot, Consumed]:
        """What has arrived, what it says, and what is to be done."""
        inputs, consumed = self._consume(now_us, events)
        read_us = self._probe.stamp(inputs, now_us)
        if self._refused.take(inputs.valve_status, now_us):
            self._probe.repeat()
        if read_us is not None:
            self._observer.clock.stamp(read_us, now_us)
        self._observer.take(inputs, now_us, events)
        speeds = self._speed_meter.take(inputs, self._observer.clock.now_us(now_us))
        newest_engine = inputs.engine[-1] if inputs.engine else None
        snapshot = self._snapshot(now_us, speeds, newest_engine)
        take = self._timing.take if self._is_tick(now_us) else self._timing.between
        take(inputs, snapshot.now_us)
        self.snapshot = snapshot
        self._decide(inputs.requested_gear, snapshot, events)
        return snapshot, consumed

    def shutdown(self, now_us: int) -> Step:
        """The last frames: all valves off. What is left to be learned is learned at once."""
        self._board.all_off()
        frames = [self._transmitter.encode(ValveCommand())]
        if self._guarded.guard.is_armed:
            frames.append(self._transmitter.encode(ClutchCommand()))
        self._observer.finish_learning()
        return Step(frames, [f"valves off at {now_us / 1e6:.6f} s of its clock"])

    def _lateness_us(self, now_us: int) -> int:
        """Delay of this step after the time it was due (us); 0 for a probe of the clock."""
        if self._due_us is None or self._probe.is_due:
            return 0
        return max(0, now_us - self.next_step_us)

    def _consume(self, now_us: int, events: list[str]) -> tuple[StepInputs, Consumed]:
        """Decodes the inbox in order of identifier."""
        self._receiver.tick(now_us)
        inputs = StepInputs()
        consumed: list[bytes] = []
        self._heard = heard = []
        self.xcp_commands = xcp_commands = []
        inbox, self._inbox = sorted(self._inbox, key=_identifier), []
        receive = self._receiver.receive
        for frame in inbox:
            can_id = frame[0]
            if can_id & 0xFF == OWN_ADDRESS and frame.is_extended:
                continue
            if can_id == XCP_COMMAND_ID:
                consumed += (can_id.to_bytes(4, "little"), frame[1])
                xcp_commands.append(frame)
                continue
            heard.append(frame)
            verdict, message = receive(frame)
            if verdict is not FOREIGN:
                consumed += (can_id.to_bytes(4, "little"), frame[1])
            if message is not None:
                inputs.take(message)
        if self._dropped:
            events.append(f"{self._dropped} frames dropped: more than {INBOX_LIMIT} in one step")
            self._dropped = 0
        return inputs, Consumed((len(consumed) // 2) & 0xFFFF, zlib.crc32(b"".join(consumed)))

    def _snapshot(self, now_us: int, speeds: ShaftSpeeds, engine: EEC1 | None) -> StepSnapshot:
        observer = self._observer
        sensor_us = observer.clock.now_us(now_us)
        torque = torque_share(None, None)
        if engine is not None:
            fine = engine.actual_engine_torque_fine_fraction
            torque = torque_share(engine.actual_engine_torque_fraction, fine)
        return StepSnapshot(
            sensor_us,
            sensor_us + self._lead_us,
            observer.view,
            observer.layshaft,
            observer.main_at,
            speeds,
            self._lost(sensor_us, speeds),
            driven_or_pending(observer.valves),
            observer.view.supply_pa,
            None if engine is None else engine.engine_speed_rad_s,
            *torque,
            is_self_tested=self._guarded.guard.is_proven,
            more_lead_us=self._refused.more_us,
            loaded=observer.loaded,
            brake_delays_us=observer.brake_delays_us,
        )

    @property
    def _lead_us(self) -> int:
        """The least lead of an activation; a step's own frames must be through before the moment of
        a command that cannot be scheduled."""
        lead_us = self._sequence.settings.timing.lead_us + self._refused.more_us
        return max(lead_us, FRAME_WAIT_US) if self._board.ahead_us else lead_us

    def _lost(self, sensor_us: int, speeds: ShaftSpeeds) -> FaultCode:
        """The most serious fault among inputs that a shift needs and that are missing or
        contradicted; NONE if all are there."""
        receiver, view = self._receiver, self._observer.view
        if (
            not (view.complete and receiver.all_valid(POSITIONS))
            or sensor_us - view.oldest_us > FRESH_US
            or self._guarded.guard.gear_is_denied
        ):
            return FaultCode.POSITION_STALE
        if in_doubt := self._guarded.in_doubt:
            return WHEEL_FAULTS[in_doubt[0]] if len(in_doubt) == 1 else FaultCode.WHEELS_DISAGREE
        if not receiver.all_valid(SPEEDS) or not self._turns_as_wanted(speeds):
            return FaultCode.SPEED_STALE
        return FaultCode.NONE if receiver.valid(ValveStatus) else FaultCode.VALVE_LINK_LOST

    def _turns_as_wanted(self, speeds: ShaftSpeeds) -> bool:
        """Whether the speeds are known that a shift needs. In neutral, a splitter that stands
        between its steps leaves the layshaft to itself, and it stops: to bring the step in, no
        speed of it is needed; the propeller's says how fast the new gear would be."""
        view, tracker = self._observer.view, self._observer.layshaft
        if view.main_gear is MainGear.NEUTRAL and None in (view.split, view.range_):
            return speeds.propeller is not None
        if tracker.free and not tracker.latest().is_finite:
            return False
        return speeds.layshaft is not None and speeds.main is not None

    def _decide(self, requested: int | None, snapshot: StepSnapshot, events: list[str]) -> None:
        sequence = self._sequence
        before = sequence.state
        refusal = sequence.request(requested, snapshot) if requested is not None else None
        if refusal is not None:
            events.append(refusal)
            return
        sequence.step(snapshot)
        self._log_decision(snapshot, events)
        if sequence.strategy_error is not None:
            line = sequence.strategy_error
            self.strategy_errors[line] = self.strategy_errors.get(line, 0) + 1
            events.append(f"own strategy: {line}")
        if sequence.state is not before:
            events.append(f"{before.name.lower()} -> {sequence.state.name.lower()}")
        if sequence.finished is not None:
            self.shifts += 1
            events.append(outcome_line(sequence.finished))

    def _log_decision(self, snapshot: StepSnapshot, events: list[str]) -> None:
        """A log line if the decision differs from the one before."""
        plan = self._sequence.decision
        decided = ShiftDecision.NONE if plan is None else plan.decision
        if plan is not None and decided is not self._decided:
            line = decision_line(plan, snapshot.now_us)
            events += [] if line is None else [line]
        self._decided = decided

    def _commands(self, now_us: int, snapshot: StepSnapshot, events: list[str]) -> list[Frame]:
        valves = self._board.message(snapshot.now_us)
        return self._guarded.frames(valves, self._heard, now_us, snapshot, events)

    def _is_tick(self, now_us: int) -> bool:
        """Whether a step is a tick's, and not one between for the clock or for a valve."""
        return self._due_us is None or now_us >= self._due_us

    def _plan_next_step(self, now_us: int, sensor_us: int) -> None:
        tick_us = self._sequence.tick_us
        due_us = self._due_us if self._due_us is not None else now_us
        if self._is_tick(now_us):
            due_us += tick_us * (1 + (now_us - due_us) // tick_us)
            due_us = max(now_us + 1, due_us - self._timing.sooner_us)
        switch_us = self._board.next_switch_us(sensor_us)
        self._wake_us = None if switch_us is None else now_us + switch_us - sensor_us
        # Of hardware that cannot schedule, which a frame's delay makes late.
        moment_us = None if self._board.keeps_times else self._wake_us
        if moment_us is not None and due_us < moment_us < due_us + FRAME_WAIT_US:
            # The tick's own frames would still stand before the command: leave this one out.
            due_us += tick_us
        self._due_us = due_us
        self._probe.plan(now_us, moment_us)
