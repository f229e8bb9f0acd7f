"""Two recorded buses beside each other: message by message, and the first step at which the two
controllers part.

Frames are paired by identifier and place: the k-th frame of a message with the k-th. Both logs are
read at the same pace, and what one is ahead of the other is all that is kept.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any, Final, NamedTuple

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerEstimates, ControllerStatus, ShiftPrediction
from meshpoint.replays.replay import OWN
from meshpoint.results.difference import Allowed, Difference, differences

BY_ID: Final = {codec.spec.can_id: (name, codec) for name, codec in CODECS.items()}
STATUS_ID: Final = CODECS[ControllerStatus.__name__].spec.can_id
OF_A_RUN: Final = frozenset({"status_alive", "run_hash_low", "run_hash_high"})
LOOK_BACK: Final = 400
"""Steps that one log may be ahead of the other in what it shows of the controller."""


@dataclass
class MessageDifference:
    """One message of both logs."""

    name: str
    frames: list[int] = field(default_factory=lambda: [0, 0])
    differing: int = 0
    first: tuple[int, list[Difference]] | None = None
    """The first pair that differs, counted from 0, and its signals."""
    largest: dict[str, float] = field(default_factory=dict)
    """By signal, how far apart it was at most."""

    @property
    def is_same(self) -> bool:
        """Whether nothing differs."""
        return self.differing == 0 and self.frames[0] == self.frames[1]


class StepSaid(NamedTuple):
    """What a controller sent in one step, its own frames by identifier, and what it knew."""

    number: int
    time_us: int
    consumed_crc: int
    frames: dict[int, bytes]
    knew: dict[str, Any]


@dataclass
class CoreParting:
    """Where the two controllers part."""

    inputs: int | None = None
    """The first step whose consumed frames differ."""
    step: int | None = None
    """The first step that sent something else; None: they never do."""
    messages: tuple[str, ...] = ()
    a: StepSaid | None = None
    b: StepSaid | None = None


class LogDifference:
    """Takes both logs, pair by pair."""

    def __init__(self, allowed: Allowed) -> None:
        self._allowed = allowed
        self._waiting: dict[int, deque[tuple[int, bytes]]] = defaultdict(deque)
        """By identifier, frames of the log that is ahead, each with its side."""
        self._steps: tuple[deque[StepSaid], deque[StepSaid]] = (deque(), deque())
        self._sending: tuple[dict[int, bytes], dict[int, bytes]] = ({}, {})
        self.messages: dict[int, MessageDifference] = {}
        self.parting = CoreParting()

    def run(self, a: Iterable[Frame], b: Iterable[Frame]) -> None:
        """The whole of both."""
        for pair in zip_longest(a, b):
            for side, frame in enumerate(pair):
                if frame is not None:
                    self._take(side, frame)

    @property
    def is_same(self) -> bool:
        """Whether nothing differs beyond what is allowed."""
        return all(message.is_same for message in self.messages.values())

    def _take(self, side: int, frame: Frame) -> None:
        message = self.messages.get(frame.can_id)
        if message is None:
            name, _ = BY_ID.get(frame.can_id, (f"{frame.can_id:08X}", None))
            if self._allowed.ignores(name):
                return
            message = self.messages[frame.can_id] = MessageDifference(name)
        message.frames[side] += 1
        waiting = self._waiting[frame.can_id]
        if waiting and waiting[0][0] != side:
            self._compare(message, frame.can_id, side, waiting.popleft()[1], frame.data)
        else:
            waiting.append((side, frame.data))
        if frame.can_id in OWN:
            self._sent(side, frame)

    def _compare(
        self, message: MessageDifference, can_id: int, side: int, other: bytes, data: bytes
    ) -> None:
        if other == data:
            return
        a, b = (other, data) if side == 1 else (data, other)
        found = list(differences(_values(can_id, a), _values(can_id, b), self._allowed, ""))
        found = [one for one in found if not self._allowed.ignores(f"{message.name}.{one.path}")]
        if not found:
            return
        if message.first is None:
            message.first = min(message.frames) - 1, found
        message.differing += 1
        for one in found:
            size = one.size
            if size is not None:
                kept = message.largest.get(one.path, 0.0)
                message.largest[one.path] = max(kept, abs(size))

    def _sent(self, side: int, frame: Frame) -> None:
        """A frame of the controller; its status closes the step."""
        sending = self._sending[side]
        sending[frame.can_id] = frame.data
        if frame.can_id != STATUS_ID or self.parting.step is not None:
            return
        status = _values(frame.can_id, frame.data)
        steps = self._steps[side]
        steps.append(
            StepSaid(
                int(status.get("step_number", -1)),
                int(status.get("step_time_us", 0)),
                int(status.get("consumed_crc", 0)),
                dict(sending),
                known_in(sending),
            )
        )
        sending.clear()
        while all(self._steps) and self.parting.step is None:
            self._part(*(steps.popleft() for steps in self._steps))
        if len(steps) > LOOK_BACK:
            steps.popleft()

    def _part(self, a: StepSaid, b: StepSaid) -> None:
        parting = self.parting
        if parting.inputs is None and a.consumed_crc != b.consumed_crc:
            parting.inputs = a.number
        differing = differing_messages(a.frames, b.frames, self._allowed)
        if differing:
            parting.step, parting.messages = a.number, differing
            parting.a, parting.b = a, b


def differing_messages(
    a: dict[int, bytes], b: dict[int, bytes], allowed: Allowed
) -> tuple[str, ...]:
    """Names of what two controllers sent differently in a step, beyond what is allowed; frames by
    identifier. The status says what was consumed and sent, and is not compared."""
    return tuple(
        BY_ID[can_id][0]
        for can_id in sorted(set(a) | set(b))
        if a.get(can_id) != b.get(can_id)
        and _differs(can_id, a.get(can_id), b.get(can_id), allowed)
    )


def _differs(can_id: int, was: bytes | None, now: bytes | None, allowed: Allowed) -> bool:
    name = BY_ID[can_id][0]
    if allowed.ignores(name) or can_id == STATUS_ID:
        return False
    if was is None or now is None:
        return True
    found = differences(_values(can_id, was), _values(can_id, now), allowed)
    return any(not allowed.ignores(f"{name}.{one.path}") for one in found)


def _values(can_id: int, data: bytes) -> dict[str, Any]:
    """A frame's signals by name; its bytes where the DBC does not have it."""
    _, codec = BY_ID.get(can_id, ("", None))
    if codec is None or len(data) != codec.spec.length:
        return {"bytes": data.hex()}
    return {
        name: getattr(value, "name", value) for name, value in codec.decode(data)._asdict().items()
    }


def known_in(frames: dict[int, bytes]) -> dict[str, Any]:
    """Estimates, prediction and state of a step, from a controller's frames by identifier."""
    knew: dict[str, Any] = {}
    for kind in (ControllerEstimates, ShiftPrediction, ControllerStatus):
        can_id = CODECS[kind.__name__].spec.can_id
        if can_id in frames:
            knew |= _values(can_id, frames[can_id])
    return {name: value for name, value in knew.items() if name not in OF_A_RUN}
