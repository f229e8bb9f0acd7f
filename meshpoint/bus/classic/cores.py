"""Controller, rig and bench on a classic bus: what stands around their cores."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Final

from meshpoint.bus.classic.commands import (
    OrderIntake,
    OrderSender,
    OrdersPassedOn,
    orders_say,
)
from meshpoint.bus.classic.parts import PartsIntake, PartsSender
from meshpoint.bus.classic.sensors import SensorIntake, SensorSender
from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.dbc.classic.codecs import CLASSIC_CODECS, CLASSIC_IDS
from meshpoint.dbc.classic.contract import COMMAND_CYCLE_MS, STATUS_CYCLE_MS
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ValveCommand
from meshpoint.gearbox import GearboxSheet

COUNTER_BYTE: Final = 2
CHANGED_LEAST_US: Final = 50_000
"""The controller's status is sent sooner than its cycle where state or gear has changed, but not
sooner than this after the one before."""
PREDICTION_CYCLE_US: Final = 200_000
"""A prediction that comes to the same decision as the one before is sent this often at most."""
PARTS_A_STEP: Final = 2
"""A node's transmit queue is first in, first out: more frames of the lowest priority at once would
hold up its next commands or reads."""
_NAMES: Final = {codec.spec.can_id: name for name, codec in CODECS.items()}
_J1939: Final = frozenset(
    codec.spec.can_id for codec in CLASSIC_CODECS.values() if not codec.spec.is_protected
)
_PACKED: Final = CLASSIC_IDS - _J1939
_LAST_OF_A_READ: Final = "ReferencePhase"


def _message(frame: Frame) -> Any:
    """What one of our cores has sent."""
    return CODECS[_NAMES[frame.can_id]].decode(frame.data)


class Unpacker:
    """Makes frames of meshpoint.dbc again: hands each to whoever takes its identifier."""

    def __init__(
        self,
        *takers: OrderIntake | OrdersPassedOn | PartsIntake | SensorIntake,
        passes_fd: bool = False,
    ) -> None:
        self._passes_fd = passes_fd
        self._takers: dict[int, Callable[[Frame], list[Frame]]] = {
            can_id: taker.take for taker in takers for can_id in taker.ids
        }

    def take(self, frame: Frame) -> Iterable[Frame]:
        """What a frame comes to. J1939 and what is not of our contract pass as they are; packed
        ones for others do not, nor CAN FD (but with `passes_fd`)."""
        if not frame.is_extended:
            return (frame,)
        taker = self._takers.get(frame.can_id)
        if taker is not None:
            return taker(frame)
        if frame.is_fd:
            return (frame,) if self._passes_fd else ()
        return () if frame.can_id in _PACKED else (frame,)


class _Paced:
    """A message in parts that is sent when it is due, or says something new."""

    def __init__(self, name: str, cycle_us: int, least_us: int, *watched: str) -> None:
        """watched: fields whose change makes it due `least_us` after the one before."""
        self._sender = PartsSender(name)
        self._cycle_us, self._least_us, self._watched = cycle_us, least_us, watched
        self._sent: tuple[int, tuple[Any, ...]] | None = None

    def frames(self, message: Any, now_us: int) -> list[Frame]:
        """Its frames, or none."""
        content = tuple(getattr(message, field) for field in self._watched)
        if self._sent is not None:
            sent_us, before = self._sent
            if now_us - sent_us < (self._cycle_us if content == before else self._least_us):
                return []
        self._sent = (now_us, content)
        return self._sender.frames(message)


class _PartsQueue:
    """Parts wait here, and go out a few a step."""

    def __init__(self) -> None:
        self._waiting: deque[Frame] = deque()

    def add(self, frames: Iterable[Frame]) -> None:
        """Frames of parts, in order."""
        self._waiting.extend(frames)

    def take(self, most: int = PARTS_A_STEP) -> list[Frame]:
        """The next ones."""
        return [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]

    def take_all(self) -> list[Frame]:
        """Whatever waits, before the node ends."""
        return self.take(len(self._waiting))


class _UnpackingCore(AroundCore[Core]):
    """A core that hears a classic bus."""

    def __init__(self, core: Core, unpacker: Unpacker) -> None:
        super().__init__(core)
        self.unpacker = unpacker

    def receive(self, frame: Frame) -> None:
        """Hands on what the frame comes to."""
        for inner in self.unpacker.take(frame):
            self._core.receive(inner)


class _PackingCore(_UnpackingCore):
    """One that sends on it, too; parts of its long messages wait for their turn."""

    def __init__(self, core: Core, unpacker: Unpacker) -> None:
        super().__init__(core, unpacker)
        self._parts = _PartsQueue()

    def step(self, now_us: int) -> Step:
        """The core's step, packed."""
        step = self._packed(self._core.step(now_us), now_us)
        return Step([*step.frames, *self._parts.take()], step.events)

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames, packed, and the parts that wait."""
        step = self._packed(self._core.shutdown(now_us), now_us)
        return Step([*step.frames, *self._parts.take_all()], step.events)

    @abstractmethod
    def _packed(self, step: Step, now_us: int) -> Step:
        """A step of the core inside with its frames packed; parts are added to those that wait."""


class ClassicControllerCore(_PackingCore):
    """A controller on a classic bus.

    The guard has passed the command of meshpoint.dbc. Its packed frames are read back from their
    bytes and compared with it; where they say anything else, all valves off are sent instead."""

    def __init__(self, core: Core, sheet: GearboxSheet) -> None:
        self._sensors = SensorIntake(sheet)
        super().__init__(core, Unpacker(self._sensors))
        self._orders = OrderSender()
        self._filled = 0
        self._status = _Paced(
            "ControllerStatus", STATUS_CYCLE_MS * 1000, CHANGED_LEAST_US, "state", "current_gear",
            "active_fault", "reference_known",
        )  # fmt: skip
        self._prediction = _Paced("ShiftPrediction", PREDICTION_CYCLE_US, 0, "decision")
        self._outcome = PartsSender("ShiftOutcome")

    def _packed(self, step: Step, now_us: int) -> Step:
        named = {_NAMES.get(frame.can_id, ""): frame for frame in step.frames}
        events = list(step.events)
        frames: list[Frame] = []
        if "ValveCommand" in named:
            frames += self._valves(named, events)
        if "TSC1" in named:
            frames += self._orders.engine(named["TSC1"], now_us)
        # Garage diagnosis and other J1939 are as they are; ETC1 comes from the sensors here.
        frames += [
            frame
            for frame in step.frames
            if not frame.is_fd and _NAMES.get(frame.can_id) not in ("TSC1", "ETC1")
        ]
        for name, sender in (
            ("ControllerStatus", self._status),
            ("ShiftPrediction", self._prediction),
        ):
            if name in named:
                self._parts.add(sender.frames(_message(named[name]), now_us))
        if "ShiftOutcome" in named:
            self._parts.add(self._outcome.frames(_message(named["ShiftOutcome"])))
        self._tell_filled(events)
        return Step(frames, events)

    def _valves(self, named: dict[str, Frame], events: list[str]) -> list[Frame]:
        command = _message(named["ValveCommand"])
        clutch = _message(named["ClutchCommand"]) if "ClutchCommand" in named else None
        frames = self._orders.valves(command, clutch)
        if orders_say(frames, command, clutch):
            return frames
        events.append("packed valve orders do not read back as commanded: all valves off")
        return self._orders.valves(ValveCommand(), None)

    def _tell_filled(self, events: list[str]) -> None:
        filled = self._sensors.filled
        if filled != self._filled:
            lost, self._filled = filled - self._filled, filled
            events.append(f"{lost} edges lost with a frame, put evenly between their neighbours")


class ClassicRigCore(_PackingCore):
    """A rig on a classic bus. The last status of its valves alone has no frame.

    has_board: the gearbox's node in it hears and sends classic frames itself."""

    def __init__(self, core: Core, sheet: GearboxSheet, *, has_board: bool = False) -> None:
        orders = OrdersPassedOn() if has_board else OrderIntake()
        super().__init__(core, Unpacker(orders, PartsIntake("BenchCommand")))
        self._sensors = SensorSender(sheet)
        self._engagement = PartsSender("ReferenceEngagement")
        self._read: dict[str, Any] = {}
        self._counter: int | None = None

    def _packed(self, step: Step, now_us: int) -> Step:  # noqa: ARG002
        frames: list[Frame] = []
        for frame in step.frames:
            name = _NAMES.get(frame.can_id)
            if name is None:
                frames += [] if frame.is_fd else [frame]
            elif name == "ReferenceEngagement":
                self._parts.add(self._engagement.frames(_message(frame)))
            else:
                frames += self._add(name, frame)
        self._read = {}
        return Step(frames, step.events)

    def _add(self, name: str, frame: Frame) -> list[Frame]:
        if name == "EdgesInputRise":
            counter = frame.data[COUNTER_BYTE]
            if self._counter is not None and counter != (self._counter + 1) % 256:
                self._sensors.restart()
            self._counter = counter
        if name != _LAST_OF_A_READ:
            self._read[name] = _message(frame)
            return []
        read, self._read = self._read, {}
        return self._sensors.pack(read)


class ClassicBenchCore(_UnpackingCore):
    """A bench's operator, or whoever else wants outcomes, events and states, on a classic bus."""

    def __init__(self, core: Core) -> None:
        super().__init__(core, bench_unpacker())
        self._command = _Paced(
            "BenchCommand", COMMAND_CYCLE_MS * 1000, 0, "action", "gear", "sequence",
            "main_speed_rad_s",
        )  # fmt: skip

    def step(self, now_us: int) -> Step:
        """The core's step, packed. Faults cannot be ordered over this bus: it says so."""
        step = self._core.step(now_us)
        frames: list[Frame] = []
        events = list(step.events)
        for frame in step.frames:
            name = _NAMES.get(frame.can_id)
            if name == "BenchCommand":
                frames += self._command.frames(_message(frame), now_us)
            elif frame.is_fd:
                events.append(
                    f"{name or hex(frame.can_id)} is not in the classic profile: not sent"
                )
            else:
                frames.append(frame)
        return Step(frames, events)


def on_classic_bus(
    sheet: GearboxSheet, controller: Core, rig: Core, *benches: Core, has_board: bool = False
) -> list[Core]:
    """These cores, each with what it takes to be on a classic bus; has_board: as `ClassicRigCore`
    takes it."""
    return [
        ClassicControllerCore(controller, sheet),
        ClassicRigCore(rig, sheet, has_board=has_board),
        *map(ClassicBenchCore, benches),
    ]


class ClassicListenerCore(_UnpackingCore):
    """A core that hears everything on a classic bus, commands of another controller too, and sends
    nothing."""

    def __init__(self, core: Core, sheet: GearboxSheet) -> None:
        super().__init__(core, listener_unpacker(sheet))


def listener_unpacker(sheet: GearboxSheet) -> Unpacker:
    """For whoever wants all of a classic bus: sensors, commands, states, outcomes and events."""
    return Unpacker(SensorIntake(sheet), OrderIntake(), *map(PartsIntake, _REPORTED))


_REPORTED: Final = ("ControllerStatus", "ShiftPrediction", "ShiftOutcome", "ReferenceEngagement")


def bench_unpacker() -> Unpacker:
    """For whoever reads outcomes, the rig's events and the controller's state off a bus, whichever
    profile it has."""
    return Unpacker(*map(PartsIntake, _REPORTED), passes_fd=True)
