"""Messages that come in parts: all with one counter, in order."""

from __future__ import annotations

from typing import Any, Final

from meshpoint.bus.classic.inner import InnerChannel
from meshpoint.dbc.classic.codecs import ClassicEar, ClassicSender, Heard
from meshpoint.dbc.classic.contract import PARTED
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS

_PARTS: Final = {parts.name: parts for parts in PARTED}


class PartsSender:
    """Sends one message of meshpoint.dbc in its parts."""

    def __init__(self, name: str) -> None:
        self._senders = [ClassicSender(part) for part in _PARTS[name].parts]

    def frames(self, message: Any) -> list[Frame]:
        """The frames of all parts."""
        values = message._asdict()
        frames = []
        for sender in self._senders:
            fields = sender.message_type._fields
            frames.append(sender.frame(sender.message_type._make([values[f] for f in fields])))
        return frames


class PartsIntake:
    """Puts one message together again. What has lost a part is not put together at all."""

    def __init__(self, name: str) -> None:
        ears = [ClassicEar(part) for part in _PARTS[name].parts]
        self._ears = {ear.can_id: (number, ear) for number, ear in enumerate(ears)}
        self._last = len(ears) - 1
        self._type = CODECS[name].message_type
        self._out = InnerChannel(name)
        self._counter = self._next = 0
        self._values: dict[str, Any] = {}

    @property
    def ids(self) -> frozenset[int]:
        """Identifiers of the parts."""
        return frozenset(self._ears)

    def take(self, frame: Frame) -> list[Frame]:
        """The message with its last part; a damaged one for a part that is damaged."""
        number, ear = self._ears[frame.can_id]
        hearing = ear.hear(frame)
        if hearing.heard is Heard.DAMAGED:
            self._next = 0
            return [self._out.damaged()]
        if hearing.heard is Heard.REPEATED:
            return []
        if number == 0:
            self._counter, self._values = hearing.counter, {}
        elif number != self._next or hearing.counter != self._counter:
            self._next = 0
            return []
        self._values |= hearing.message._asdict()
        self._next = number + 1
        if number != self._last:
            return []
        self._next = 0
        return [self._out.frame(self._type(**self._values))]
