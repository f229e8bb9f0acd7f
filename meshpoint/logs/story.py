"""A run in plain words, one line an event, from the frames of the bus alone.

What only the rig knows (contact, locking, injected faults) is marked as the truth: on a real
gearbox these lines are not there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.controller.shift.table import NEUTRAL_WANTED
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    TC1,
    TSC1,
    BenchAction,
    BenchCommand,
    BenchFault,
    ClutchAction,
    ClutchCommand,
    ControllerState,
    ControllerStatus,
    Engagement,
    EngagementEvent,
    FaultCode,
    Message,
    PhaseReference,
    ReferenceEngagement,
    RigFault,
    ShiftDecision,
    ShiftOutcome,
    ShiftPrediction,
    ShiftResult,
    TscOverrideMode,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.logs.heard import Heard
from meshpoint.logs.xcp_writes import XcpWrites
from meshpoint.results.aborts import aborts_words, halt_mm
from meshpoint.results.road_speed import span_us
from meshpoint.results.rows import CONTACT_KINDS
from meshpoint.units import DEG, RPM

STATES: Final = {
    ControllerState.STARTING: "starts: commands nothing before every input is valid",
    ControllerState.IN_GEAR: "in gear, at rest",
    ControllerState.NEUTRAL: "in neutral, at rest",
    ControllerState.CLUTCH_OPENING: "opens the clutch",
    ControllerState.CLUTCH_PARTING: "waits for the clutch plates to part",
    ControllerState.DISENGAGING: "pulls the old gear's sleeve out",
    ControllerState.SYNCHRONISING: "out of gear: brings the layshaft to the new gear's speed",
    ControllerState.COASTING: "brake released: the speeds close by themselves",
    ControllerState.ENGAGING: "the sleeve is on its way",
    ControllerState.HALTED: "the sleeve would meet a tooth: stops it before the teeth",
    ControllerState.RETRACTING: "takes the sleeve back, to try again",
    ControllerState.CLUTCH_CLOSING: "closes the clutch",
    ControllerState.STEPS_CHANGING: "changes splitter or range",
    ControllerState.SPEED_RAISING: "asks the engine to raise the layshaft's speed",
    ControllerState.FAULTED: "has given up: all valves off",
    ControllerState.SPLITTER_CHANGING: "changes the splitter",
}
BY_CLUTCH: Final = (ControllerState.CLUTCH_OPENING, ControllerState.CLUTCH_CLOSING)
"""Known from the clutch's command already."""
TRUTHS: Final = {
    EngagementEvent.READY: "at the start of a run",
    EngagementEvent.GAP_CONTACT: "tooth meets gap",
    EngagementEvent.TOOTH_CONTACT: "tooth meets tooth",
    EngagementEvent.TOOTH_PASSED: "the tooth has slid into the gap",
    EngagementEvent.LOCKED: "sleeve and gear are locked",
    EngagementEvent.RELEASED: "the sleeve has left its gear",
    EngagementEvent.BLOCKED: "sleeve and gear stick, tooth on tooth",
    EngagementEvent.GIVEN_UP: "the sleeve turns back",
    EngagementEvent.CLUTCH_OPENS: "the clutch begins to open",
    EngagementEvent.PLATES_PARTED: "the clutch's plates have parted",
    EngagementEvent.BRAKE_FILLS: "air flows to the brake",
    EngagementEvent.BRAKE_EMPTIES: "air leaves the brake",
    EngagementEvent.CLUTCH_CLOSES: "the clutch begins to close",
    EngagementEvent.PLATES_MET: "the clutch's plates have met",
}
RESULTS: Final = {
    ShiftResult.NONE: "no shift",
    ShiftResult.ENGAGED: "gear {to} is in",
    ShiftResult.ENDED_IN_NEUTRAL: "shift to gear {to} ended in neutral",
    ShiftResult.ENDED_IN_OLD_GEAR: "shift to gear {to} ended in the old gear",
    ShiftResult.REFUSED: "gear {to} is refused",
    ShiftResult.ENDED_BETWEEN_GEARS: "shift to gear {to} ended between gears",
}
VALVES: Final = {valve.name.lower(): f"{valve.name.lower()}_energised" for valve in ValveName}
AT_TIMES: Final = (TSC1, BenchCommand)
"""Sent in a rhythm, but only while there is something to ask for."""
CYCLIC: Final = {
    codec.spec.name: codec.message_type
    for codec in CODECS.values()
    if codec.spec.is_cyclic and codec.message_type not in AT_TIMES
}


class Line(NamedTuple):
    """One event."""

    at_s: float
    """Seconds since the first frame, by the clock of the log."""
    of_request_ms: float | None
    """Milliseconds since the gear was asked for, by the sensor clock; None outside a shift."""
    who: str
    """One of driver, controller, gearbox, tool, truth, bus or bench."""
    words: str

    def to_json(self) -> dict[str, object]:
        """By name, times rounded to microseconds."""
        ms = self.of_request_ms
        return {
            "at_s": round(self.at_s, 6),
            "of_request_ms": None if ms is None else round(ms, 3),
            "who": self.who,
            "words": self.words,
        }


class Story:
    """Takes frames in bus order and gives the lines that each of them adds."""

    def __init__(self) -> None:
        self.heard = Heard()
        self.message: Message | None = None
        """Of the newest frame; None where it did not pass every check."""
        self._begin_s: float | None = None
        self._request_us: int | None = None
        self._asked: int | None = None
        self._moved_by_bench = False
        """The bench is putting the gearbox back: what sleeves and gears do is its doing."""
        self._newest: dict[type[object], Message] = {}
        self._xcp = XcpWrites()
        self._valve_on_us: dict[str, int] = {}
        self._valid: set[str] = set()
        self._lost: set[str] = set()
        self._lines: list[Line] = []
        self._tellers: dict[type[object], Callable[[Any], None]] = {
            TC1: self._request,
            ClutchCommand: self._clutch,
            TSC1: self._engine,
            ValveStatus: self._valves,
            ControllerStatus: self._status,
            ShiftPrediction: self._plan,
            ShiftOutcome: self._outcome,
            ReferenceEngagement: self._truth,
            BenchFault: self._fault,
            BenchCommand: self._bench,
        }

    def receive(self, time_s: float, frame: Frame) -> list[Line]:
        """One frame, heard at `time_s`; the lines that it gives."""
        if self._begin_s is None:
            self._begin_s = time_s
        self._lines = []
        message = self.message = self.heard.receive(time_s, frame)
        for words in self._xcp.take(frame):
            self._tell("tool", f"{words} (XCP)")
        if message is not None:
            teller = self._tellers.get(type(message))
            if teller is not None:
                teller(message)
            self._newest[type(message)] = message
        self._silences()
        return self._lines

    def _tell(self, who: str, words: str, sensor_us: int | None = None) -> None:
        """`sensor_us`: when it was, where the message says so; else now."""
        sensor_us = self.heard.sensor_us if sensor_us is None else sensor_us
        since_ms = None
        if self._request_us is not None and sensor_us is not None:
            since_ms = span_us(sensor_us, self._request_us) / 1000
        at_s = self.heard.now_s - (self._begin_s or 0.0)
        self._lines.append(Line(at_s, since_ms, who, words))

    def _request(self, message: TC1) -> None:
        gear = message.requested_gear
        if gear is None or gear == self._asked:
            return
        self._asked = gear
        self._request_us = self.heard.sensor_us
        self._moved_by_bench = False
        self._tell("driver", "asks for neutral" if gear == 0 else f"asks for gear {gear}")

    def _clutch(self, message: ClutchCommand) -> None:
        before = self._newest.get(ClutchCommand)
        if before is not None and before != message:
            opens = message.action is ClutchAction.OPEN
            self._tell("controller", f"{'opens' if opens else 'closes'} the clutch")

    def _engine(self, message: TSC1) -> None:
        before = self._newest.get(TSC1)
        mode = message.override_control_mode
        if isinstance(before, TSC1) and before.override_control_mode is mode:
            return
        if mode is TscOverrideMode.SPEED_CONTROL and message.requested_speed_rad_s is not None:
            self._tell("controller", f"engine: {message.requested_speed_rad_s / RPM:.0f} rpm")
        elif mode is TscOverrideMode.OVERRIDE_DISABLED:
            self._tell("controller", "engine: back to the driver")
        elif message.requested_torque_fraction is not None:
            percent = 100 * message.requested_torque_fraction
            self._tell("controller", f"engine: torque {percent:.0f} %")

    def _valves(self, message: ValveStatus) -> None:
        before = self._newest.get(ValveStatus)
        for name, field in VALVES.items():
            is_on = bool(getattr(message, field))
            if before is None or is_on == bool(getattr(before, field)):
                continue
            if is_on:
                self._valve_on_us[name] = message.sample_time_us
                self._tell("gearbox", f"valve {name} on")
            else:
                on_us = self._valve_on_us.pop(name, None)
                lasted = ""
                if on_us is not None:
                    lasted = f" after {span_us(message.sample_time_us, on_us) / 1000:.0f} ms"
                self._tell("gearbox", f"valve {name} off{lasted}")
        if isinstance(before, ValveStatus):
            refused, expired = message.refused_count, message.expired_count
            self._count(before.refused_count, refused, "valve command rejected, late or too early")
            self._count(before.expired_count, expired, "all valves off: no command")

    def _count(self, before: int, now: int, words: str) -> None:
        if now > before:
            self._tell("gearbox", f"{words} ({now - before})")

    def _status(self, message: ControllerStatus) -> None:
        before = self._newest.get(ControllerStatus)
        if not isinstance(before, ControllerStatus):
            gear = message.current_gear
            where = "neutral" if gear == 0 else f"gear {gear}" if gear > 0 else "no known gear"
            self._tell("controller", f"{STATES[message.state]}; {where}")
            return
        if message.step_number < before.step_number:
            self._tell("controller", "has started anew")
        if message.state is not before.state and message.state not in BY_CLUTCH:
            self._tell("controller", _entered(before.state, message.state))
        if message.active_fault is not before.active_fault:
            ended = message.active_fault is FaultCode.NONE
            self._tell("controller", "no fault any more" if ended else _fault(message.active_fault))
        if message.guard_blocks > before.guard_blocks:
            blocks = message.guard_blocks - before.guard_blocks
            self._tell("controller", f"the guard has blocked a command ({blocks} x)")

    def _plan(self, message: ShiftPrediction) -> None:
        before = self._newest.get(ShiftPrediction)
        if isinstance(before, ShiftPrediction) and before.decision is message.decision:
            return
        if message.decision is ShiftDecision.RELEASE:
            ahead_ms = span_us(message.release_time_us, message.decision_time_us) / 1000
            self._tell("controller", f"releases the brake in {ahead_ms:.1f} ms")
        elif message.decision is ShiftDecision.COMMITTED:
            contact_ms = span_us(message.contact_time_us, message.decision_time_us) / 1000
            self._tell(
                "controller",
                f"has fired: contact in {contact_ms:.1f} ms at {message.slip_rad_s / RPM:+.1f} rpm"
                + _phase(message),
            )
        elif message.decision is ShiftDecision.WAIT_FOR_GAP:
            self._tell("controller", "waits for the next gap")

    def _outcome(self, message: ShiftOutcome) -> None:
        words = RESULTS[message.result].format(to=message.to_gear)
        if message.result is not ShiftResult.REFUSED:
            took_ms = span_us(message.end_time_us, message.request_time_us) / 1000
            words += f": {took_ms:.0f} ms, {message.attempts} firing"
            words += "" if message.attempts == 1 else "s"
            if message.aborts:
                words += f", aborted {aborts_words(message.aborts, halt_mm(message))}"
            is_main = message.engagement is Engagement.MAIN_GEAR
            if is_main and message.attempts:  # no splitter is aimed
                known = message.reference is PhaseReference.KNOWN
                words += ", aimed" if known else ", phase reference not known yet"
        if message.fault is not FaultCode.NONE:
            words += f" ({_fault(message.fault)})"
        self._tell("controller", words)
        self._asked = self._request_us = None

    def _truth(self, message: ReferenceEngagement) -> None:
        if message.event is EngagementEvent.READY:
            self._moved_by_bench = False
            return
        words = TRUTHS[message.event]
        if message.event in CONTACT_KINDS:
            words += f", {message.phase_rad / DEG:+.2f} deg from the middle of the gap"
            words += f" at {message.slip_rad_s / RPM:+.1f} rpm"
        elif message.event is EngagementEvent.LOCKED and message.impact_energy_j > 0.0:
            words += f", {message.impact_energy_j:.2f} J lost in the impact"
        words += " (moved by the bench)" if self._moved_by_bench else ""
        self._tell("truth", words, message.event_time_us)

    def _fault(self, message: BenchFault) -> None:
        before = self._newest.get(BenchFault)
        if isinstance(before, BenchFault) and before.sequence == message.sequence:
            return
        if message.fault is RigFault.NO_FAULT:
            self._tell("bench", "ends all faults")
            return
        lasts = f" for {message.duration_us / 1e6:g} s" if message.duration_us else ""
        self._tell(
            "bench",
            f"injects {message.fault.name.lower()}, target {message.target}, "
            f"value {message.value:g}{lasts}",
        )

    def _bench(self, message: BenchCommand) -> None:
        before = self._newest.get(BenchCommand)
        again = isinstance(before, BenchCommand) and before.sequence == message.sequence
        if message.action is BenchAction.RETURN_TO_GEAR and not again:
            self._tell("bench", f"puts the gearbox back into gear {message.gear}")
            self._moved_by_bench = True

    def _silences(self) -> None:
        """Cyclic messages that were in order and are not any more, and those that are again; all
        of one sender in one line."""
        lost: dict[Node, list[str]] = {}
        back: dict[Node, list[str]] = {}
        for name, kind in CYCLIC.items():
            valid = self.heard.valid(kind)
            if valid and name not in self._valid:
                self._valid.add(name)
                if name in self._lost:
                    self._lost.discard(name)
                    back.setdefault(CODECS[name].spec.sender, []).append(name)
            elif not valid and name in self._valid:
                self._valid.discard(name)
                self._lost.add(name)
                lost.setdefault(CODECS[name].spec.sender, []).append(name)
        for sender, names in lost.items():
            self._tell("bus", f"{_of(sender, names)} lost: silent, or wrong CRC or counter")
        for sender, names in back.items():
            self._tell("bus", f"{_of(sender, names)} in order again")


def _of(sender: Node, names: list[str]) -> str:
    if len(names) == 1:
        return f"{names[0]} is"
    return f"{len(names)} messages of {sender} are"


def _entered(before: ControllerState, state: ControllerState) -> str:
    """What it does in a state, by the state that it comes from."""
    if state is ControllerState.DISENGAGING and before in NEUTRAL_WANTED:
        return "a sleeve has left neutral: brings it back"
    return STATES[state]


def _fault(code: FaultCode) -> str:
    return f"fault: {code.name.lower().replace('_', ' ')}"


def _phase(message: ShiftPrediction) -> str:
    if message.phase_sd_rad == 0.0 and message.phase_rad == 0.0:
        return ", phase not known"
    return f", phase {message.phase_rad / DEG:+.2f} +- {message.phase_sd_rad / DEG:.2f} deg"
