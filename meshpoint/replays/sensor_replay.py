"""Open loop on sensor frames alone: a log that our controller has not made.

A controller that is asked for nothing takes the log's sensor frames and steps each 10 ms by the
log's own time: it estimates and learns. At each request in the log a copy of it gets the request,
and is fed the same frames until its shift has ended; what it commands reaches nobody. So each
request is judged from the recorded state, whatever was decided before. What the log does not hold
is named, with what cannot be said for lack of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, Final

from meshpoint.controller.core.core import OWN_ADDRESS, ControllerCore
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import canonical
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    ETC1,
    ControllerEstimates,
    ControllerStatus,
    ShiftOutcome,
    ShiftResult,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox.gears import MainGear
from meshpoint.logs.bus_map import BusMap, pgn
from meshpoint.logs.captures import READ_US
from meshpoint.logs.gear_track import GearTrack, RatioTrack
from meshpoint.logs.seen_shift import SeenShift
from meshpoint.replays.copies import copied
from meshpoint.report.trajectory import said
from meshpoint.units import DEG, RPM, SECOND_US

LONG_US: Final = 1_000_000
"""A log that is silent for longer is reported; in it the controller makes one step."""
ETC1_CODEC: Final = CODECS[ETC1.__name__]
ETC1_PGN: Final = pgn(ETC1_CODEC.spec.can_id)
NAMES: Final = {codec.spec.can_id: codec.spec.name for codec in CODECS.values()}
REQUEST: Final = "TC1"
START_US: Final = 10_000_000
UNKNOWN_RAD_S: Final = 20.0
"""A speed whose standard deviation is greater, near its largest on the wire, is not known."""

NEEDS: Final = (
    (("EdgesLayshaftRise",), "no layshaft edges: no layshaft speed, and no tooth is predicted"),
    (("EdgesMainRise",), "no main shaft edges: no slip, and no tooth is predicted"),
    (("EdgesInputRise", "EdgesPropellerRise"), "no edges of input and propeller shaft: splitter "
     "and range are known by their sleeves alone"),
    (("SleevesMain", "SleevesAux"), "no sleeve positions: neither the gear nor an engagement is "
     "known, so no phase reference is learned and no shift is begun"),
    (("GearboxSensors",), "no pressures: the brake's trajectory is its model's alone"),
    (("ValveStatus",), "no status of the valves: no shift is begun"),
    (("TC1",), "no request (TC1): no decision is asked for"),
)  # fmt: skip
"""Messages, and what cannot be said where none of them is in the log."""


class LogTime:
    """The log's time made steady: from 10 s on in us, never back. A clock that was set back
    (daylight saving, another file's start) is reported and stands still until it is past."""

    def __init__(self) -> None:
        self._last_s: float | None = None
        self.now_us = START_US
        self.set_back: list[tuple[float, float]] = []
        """Where, in s since the first frame, and by how many s."""
        self.silent: list[tuple[float, float]] = []

    def take(self, time_s: float) -> int:
        """The next frame's time."""
        if self._last_s is not None:
            passed_us = round((time_s - self._last_s) * SECOND_US)
            since_s = self.since_s
            if passed_us < -READ_US:
                self.set_back.append((since_s, -passed_us / SECOND_US))
            elif passed_us > LONG_US:
                self.silent.append((since_s, passed_us / SECOND_US))
            self.now_us += max(passed_us, 0)
        self._last_s = time_s
        return self.now_us

    @property
    def since_s(self) -> float:
        """Since the first frame."""
        return (self.now_us - START_US) / SECOND_US


class SensorReplay:
    """Feeds a log's sensor frames to a controller of this header; `bus_map`: another bus's."""

    def __init__(
        self,
        header: RunHeader,
        bus_map: BusMap | None = None,
        on_event: Callable[[float, str], None] | None = None,
        on_value: Callable[[str, float, float], None] | None = None,
    ) -> None:
        """on_event: s since the log's first frame and a line; on_value: what of (a shaft's speed in
        rpm, `gear by sleeves`, `gear by ratio`), s, and the value."""
        self._core = ControllerCore(header)
        self._map = bus_map
        self._on_event = on_event
        self._on_value = on_value
        self._made = Receiver(Node.BENCH)
        self._mapped_us: int | None = None
        self.time = LogTime()
        self.inputs: Counter[str] = Counter()
        self.foreign: Counter[int] = Counter()
        self.controllers: Counter[int] = Counter()
        """Frames of whoever controls the gearbox in this log, by identifier; they are not used."""
        self.steps = 0
        self._asked: ControllerCore | None = None
        """A copy that has been asked for a gear, until its shift has ended."""
        self._gear: MainGear | None = None
        self._asked_s = 0.0
        self.outcomes: list[tuple[float, ShiftOutcome]] = []
        """When it was asked, s since the first frame, and what was decided."""
        self.unfinished = 0
        """Requests whose shift had not ended at the next one, or at the log's end."""
        self.ratio = RatioTrack(header.sheet)
        self.gears = GearTrack()
        self.status: ControllerStatus | None = None
        self.ranges_rpm: dict[str, tuple[float, float]] = {}

    def take(self, time_s: float, frame: Frame) -> None:
        """A frame of the log, in its order."""
        now_us = self.time.take(time_s)
        frame = canonical(frame)
        self._step_to(now_us)
        if self._map is not None and self._map.take(now_us, frame):
            for shaft, rpm in self._map.speeds_rpm:
                self._speed(shaft, rpm, now_us)
            return
        if frame.is_extended and pgn(frame.can_id) == ETC1_PGN and len(frame.data) == 8:
            self._speeds(ETC1_CODEC.decode(frame.data), now_us)
        if frame.is_extended and frame.can_id & 0xFF == OWN_ADDRESS:
            self.controllers[frame.can_id] += 1
            return
        name = NAMES.get(frame.can_id) if frame.is_extended else None
        if name is None:
            self.foreign[frame.can_id] += 1
        else:
            self.inputs[name] += 1
        if name == REQUEST:
            self._ask(frame)
        else:
            self._receive(frame)

    def finish(self) -> None:
        """The log has ended: what came last is taken in."""
        self._step_to(self.time.now_us + 2 * READ_US)
        self.unfinished += int(self._asked is not None)

    def _receive(self, frame: Frame) -> None:
        self._core.receive(frame)
        if self._asked is not None:
            self._asked.receive(frame)

    def _ask(self, frame: Frame) -> None:
        self.unfinished += int(self._asked is not None)
        self._asked = copied(self._core)
        self._asked_s = self.time.since_s
        self._asked.receive(frame)

    def _speeds(self, message: ETC1 | None, now_us: int) -> None:
        if message is None:
            return
        speeds = (
            ("input", message.input_shaft_speed_rad_s),
            ("propeller", message.output_shaft_speed_rad_s),
        )
        for shaft, rad_s in speeds:
            if rad_s is not None:
                self.inputs[f"ETC1 {shaft} speed"] += 1
                self._speed(shaft, rad_s / RPM, now_us)

    def _speed(self, shaft: str, rpm: float, now_us: int) -> None:
        """A speed that the log's bus says."""
        self.ratio.take(shaft, rpm, now_us - START_US)
        self._value(f"{shaft}, as said", now_us, rpm)
        gear = self.ratio.gear(now_us - START_US)
        if gear is not None:
            self._value("gear by ratio", now_us, gear)

    def _step_to(self, now_us: int) -> None:
        due_us = self._core.next_step_us or self.time.now_us
        if now_us - due_us > LONG_US:
            self._step(now_us)
            return
        while due_us <= now_us:
            self._step(due_us)
            due_us = self._core.next_step_us

    def _step(self, now_us: int) -> None:
        if self._map is not None and (
            self._mapped_us is None or now_us - self._mapped_us >= READ_US
        ):
            self._mapped_us = now_us
            for frame in self._map.frames(now_us):
                self.inputs[NAMES[frame.can_id]] += 1
                self._receive(frame)
        self._step_asked(now_us)
        made = self._core.step(now_us)
        self.steps += 1
        self._see_gear()
        for line in made.events:
            self._tell(now_us, line)
        for frame in made.frames:
            message = self._made.receive(frame).message
            if isinstance(message, ControllerStatus):
                self.status = message
                gear = message.current_gear if message.current_gear > 0 else None
                self.gears.take(gear, now_us - START_US)
                if gear is not None:
                    self._value("gear by sleeves", now_us, gear)
            elif isinstance(message, ControllerEstimates):
                layshaft = message.layshaft_speed_rad_s, message.layshaft_speed_sd_rad_s
                self._range("layshaft", now_us, *layshaft)
                main = message.main_speed_rad_s, message.main_speed_sd_rad_s
                self._range("main", now_us, *main)

    def _see_gear(self) -> None:
        """A gear that another controller has engaged is watched for its phase reference."""
        gear, before = self._core.observer.view.main_gear, self._gear
        self._gear = gear
        if gear not in (before, None, MainGear.NEUTRAL):
            self._core.engaged_by_another(gear)

    def _step_asked(self, now_us: int) -> None:
        if self._asked is None:
            return
        made = self._asked.step(now_us)
        for line in made.events:
            self._tell(now_us, line)
        outcome = said(now_us, made.frames).outcome
        if outcome is None:
            self._see_engaged_sooner(self._asked)
        else:
            self.outcomes.append((self._asked_s, outcome))
            self._asked = None

    def _see_engaged_sooner(self, asked: ControllerCore) -> None:
        """The gear asked for may be in before this controller would have fired: then it has decided
        to wait, and no more is to be learned of it."""
        shift = asked.running_shift
        if shift is None or shift.attempts or self._core.observer.view.gear_number is None:
            return
        if self._core.observer.view.gear_number == shift.to_number != shift.from_number:
            waited = ShiftOutcome(
                from_gear=shift.from_number,
                to_gear=shift.to_number,
                request_time_us=shift.request_us & 0xFFFF_FFFF,
                strategy=shift.strategy,
            )
            self.outcomes.append((self._asked_s, waited))
            self._asked = None

    def _tell(self, now_us: int, line: str) -> None:
        if self._on_event is not None:
            self._on_event((now_us - START_US) / SECOND_US, line)

    def _value(self, name: str, now_us: int, value: float) -> None:
        if self._on_value is not None:
            self._on_value(name, (now_us - START_US) / SECOND_US, value)

    def _range(self, shaft: str, now_us: int, rad_s: float, sd_rad_s: float) -> None:
        if sd_rad_s > UNKNOWN_RAD_S:
            return
        rpm = rad_s / RPM
        self._value(shaft, now_us, rpm)
        least, most = self.ranges_rpm.get(shaft, (rpm, rpm))
        self.ranges_rpm[shaft] = min(least, rpm), max(most, rpm)

    @property
    def cannot(self) -> list[str]:
        """What this log does not allow to say, and why."""
        said = [why for names, why in NEEDS if not any(self.inputs[name] for name in names)]
        if not self.ratio.ranges_rpm:
            said.append("no speeds of input and output shaft (ETC1): no gears by their ratio")
        return said

    @property
    def seen(self) -> tuple[list[SeenShift], str]:
        """The shifts that the log shows, and by what."""
        if self.gears.shifts:
            return self.gears.shifts, "sleeves"
        return self.ratio.track.shifts, "the ratio of speeds"

    def decided(self) -> list[dict[str, Any]]:
        """What the controller decided of each request, on frames that answered to another one."""
        return [
            {
                "asked_s": round(asked_s, 3),
                "from": o.from_gear,
                "to": o.to_gear,
                "request_us": o.request_time_us,
                "status": _status(o),
                "fault": o.fault.name.lower(),
                "strategy": o.strategy.name.lower(),
                "reference": o.reference.name.lower(),
                "attempts": o.attempts,
                "aborts": o.aborts,
                "fired_ms": _after_ms(o.fire_time_us, o.request_time_us) if o.attempts else None,
                "predicted_phase_deg": (
                    round(o.predicted_phase_rad / DEG, 3)
                    if o.attempts and o.reference.name != "UNKNOWN"
                    else None
                ),
                "contact": None,
                "contact_why": "the gearbox of this log answered to another controller",
            }
            for asked_s, o in self.outcomes
        ]

    def to_json(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "seconds": round(self.time.since_s, 3),
            "steps": self.steps,
            "inputs": dict(sorted(self.inputs.items())),
            "mapped": dict(self._map.used) if self._map is not None else {},
            "undecoded": self._map.undecoded if self._map is not None else 0,
            "foreign_frames": {f"{i:08X}": n for i, n in sorted(self.foreign.items())},
            "controller_frames": {f"{i:08X}": n for i, n in sorted(self.controllers.items())},
            "speeds_rpm": _rounded(self.ratio.ranges_rpm | self.ranges_rpm),
            "gears_by_ratio_s": {g: round(s, 2) for g, s in sorted(self.ratio.track.gears.items())},
            "shifts_by_ratio": [shift.to_json() for shift in self.ratio.track.shifts],
            "gears_by_sleeves_s": {g: round(s, 2) for g, s in sorted(self.gears.gears.items())},
            "shifts_by_sleeves": [shift.to_json() for shift in self.gears.shifts],
            "clock_set_back_s": self.time.set_back,
            "silent_s": self.time.silent,
            "unfinished_requests": self.unfinished,
            "cannot": self.cannot,
        }


def _status(outcome: ShiftOutcome) -> str:
    """What was decided; how the shift ended is the log's."""
    if outcome.result is ShiftResult.REFUSED:
        return "refused"
    if outcome.attempts:
        return "fired"
    return "aborted" if outcome.aborts else "not fired"


def _after_ms(time_us: int, since_us: int) -> float:
    """Sensor times have 32 bits."""
    return round(((time_us - since_us) & 0xFFFF_FFFF) * 1e-3, 3)


def _rounded(ranges: dict[str, tuple[float, float]]) -> dict[str, list[float]]:
    return {shaft: [round(v, 2) for v in pair] for shaft, pair in sorted(ranges.items())}
