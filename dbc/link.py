"""A node's two ends of the bus: messages to protected frames, frames to judged messages."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import IntEnum
from typing import Any, Final, NamedTuple

from meshpoint.dbc.e2e import (
    COUNTER_MODULUS,
    DEFAULT_LIMITS,
    ChannelState,
    E2ELimits,
    Silence,
    StateMachine,
    Status,
    check_counter,
    check_crc,
    write_crc,
)
from meshpoint.dbc.fields import why_refused
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS, REFUSALS, Codec
from meshpoint.dbc.messages import Message
from meshpoint.dbc.node import Node

_new = tuple.__new__  # a NamedTuple without its constructor's argument handling: 0.2 us a frame


class EncodeError(ValueError):
    """A message that cannot be sent; names message, signal, value and what is allowed."""


class FrameVerdict(IntEnum):
    """What became of a received frame."""

    OK = 0
    NOT_FOR_US = 1
    """A known identifier, but the DBC does not list this node as its receiver."""
    FOREIGN = 2
    """Not an identifier of the DBC."""
    FORMAT = 3
    """Wrong length or frame format, or a value outside the DBC's range."""
    E2E = 4
    """Wrong CRC."""
    REPEATED = 5
    """The counter of the frame before."""
    WRONG_SEQUENCE = 6
    """Too many frames lost in between, or out of order."""


def read_alone(codec: Codec, frame: Frame) -> Any:
    """The message of a frame that is looked at by itself, whatever its counter: None where it is
    another one, its length or CRC is wrong, or a value is out of the DBC's range."""
    spec = codec.spec
    if frame.can_id != spec.can_id or len(frame.data) != spec.length:
        return None
    if spec.data_id is not None and not check_crc(frame.data, spec.data_id):
        return None
    return codec.decode(frame.data)


class Received(NamedTuple):
    """A verdict; `message` is set for OK alone."""

    verdict: FrameVerdict
    message: Message | None


_REFUSED: Final = {verdict: Received(verdict, None) for verdict in FrameVerdict}
_NOT_FOR_US: Final = _REFUSED[FrameVerdict.NOT_FOR_US]
_FOREIGN: Final = _REFUSED[FrameVerdict.FOREIGN]
_FORMAT: Final = _REFUSED[FrameVerdict.FORMAT]
_OF_STATUS: Final = {
    Status.ERROR: _REFUSED[FrameVerdict.E2E],
    Status.REPEATED: _REFUSED[FrameVerdict.REPEATED],
    Status.WRONG_SEQUENCE: _REFUSED[FrameVerdict.WRONG_SEQUENCE],
}
_OK: Final = FrameVerdict.OK
_KNOWN_IDS: Final = frozenset(codec.spec.can_id for codec in CODECS.values())


class _Sender:
    """One message this node sends, with its counter and the buffer its frames are made in."""

    __slots__ = ("buffer", "can_id", "codec", "counter", "data_id", "encode", "is_fd")

    def __init__(self, codec: Codec) -> None:
        spec = codec.spec
        self.codec = codec
        self.can_id = spec.can_id
        self.is_fd = spec.is_fd
        self.data_id = spec.data_id
        self.encode = codec.encode
        self.buffer = bytearray(spec.length)
        self.counter = COUNTER_MODULUS - 1  # that of the frame before: the first one carries 0


class Transmitter:
    """Encodes what the DBC lists these nodes as senders of; keeps the E2E counters."""

    def __init__(self, node: Node, *more: Node) -> None:
        self._nodes = (node, *more)
        self._senders = {
            codec.message_type: _Sender(codec)
            for codec in CODECS.values()
            if codec.spec.sender in self._nodes
        }
        self._unread: dict[type[Message], Frame] = {}

    def skip_unsubscribed(self, message_types: Collection[type[Message]]) -> None:
        """Nobody on this bus reads these messages: those of them that these nodes send are not made
        where `unread` is asked before."""
        for sender in self._senders.values():
            if sender.codec.message_type in message_types:
                empty = bytes(sender.codec.spec.length)
                frame = Frame(sender.can_id, empty, sender.is_fd, is_extended=True)
                self._unread[sender.codec.message_type] = frame

    def unread(self, *message_types: type[Message]) -> list[Frame] | None:
        """Empty frames in place of these messages, that take as long on the bus; None where anybody
        reads one of them."""
        frames = [self._unread[each] for each in message_types if each in self._unread]
        return frames if len(frames) == len(message_types) else None

    def restart(self, node: Node) -> None:
        """This node has started anew: its counters do as well."""
        for sender in self._senders.values():
            if sender.codec.spec.sender == node:
                sender.counter = COUNTER_MODULUS - 1

    def encode(self, message: Message) -> Frame:
        """The frame of a message, protected where the DBC says so.

        Values are rounded to the nearest step of the wire. `EncodeError`, the counter unchanged,
        for a message these nodes do not send, and for a value out of range, not finite or of a
        wrong kind.
        """
        sender = self._senders.get(type(message))
        if sender is None:
            raise EncodeError(f"{', '.join(self._nodes)}: does not send {type(message).__name__}")
        buffer, data_id = sender.buffer, sender.data_id
        try:
            sender.encode(buffer, sender.counter, message)
        except REFUSALS as error:
            codec = sender.codec
            raise EncodeError(f"{codec.spec.name}.{why_refused(codec.fields, message)}") from error
        if data_id is not None:
            write_crc(buffer, data_id)  # counts on by one, then protects
            sender.counter = buffer[2]
        return _new(Frame, (sender.can_id, bytes(buffer), sender.is_fd, True))

    def instead(self, message: Message) -> Frame:
        """The frame of a message in place of the last one of its type, which is not sent: a counter
        that skipped it would tell of a lost frame."""
        sender = self._senders[type(message)]
        sender.counter = (sender.counter - 1) % COUNTER_MODULUS
        return self.encode(message)


class _Channel:
    """One message this node receives, with what is remembered of its frames."""

    __slots__ = (
        "codec",
        "data_id",
        "decode",
        "is_fd",
        "length",
        "machine",
        "max_delta",
        "next_counter",
        "silence",
    )

    def __init__(self, codec: Codec, limits: E2ELimits) -> None:
        spec = codec.spec
        self.codec = codec
        self.length = spec.length
        self.is_fd = spec.is_fd
        self.data_id = spec.data_id
        self.decode = codec.decode
        self.next_counter: int | None = None
        # Events come when they come: only a repeated counter is wrong, no gap is.
        self.max_delta = limits.max_delta_counter if spec.is_cyclic else COUNTER_MODULUS
        self.machine = StateMachine(limits)
        self.silence = Silence(spec.cycle_time_us, limits)


def _is_event_of(channel: _Channel, sender: Node) -> bool:
    spec = channel.codec.spec
    return spec.sender is sender and spec.is_protected and not spec.is_cyclic


class Receiver:
    """Decodes what the DBC lists these nodes as receivers of, and nothing else.

    Feed every frame of the bus to `receive`, and call `tick` once a step. A frame that is OK
    carries a message whatever its channel's state; whether a cyclic message may be relied on,
    `valid` says.
    """

    def __init__(self, node: Node, *more: Node, limits: E2ELimits = DEFAULT_LIMITS) -> None:
        nodes = {node, *more}
        specs = [codec for codec in CODECS.values() if nodes & codec.spec.receivers]
        self._channels = {codec.spec.can_id: _Channel(codec, limits) for codec in specs}
        self._cyclic = {
            channel.codec.message_type: channel
            for _, channel in sorted(self._channels.items())
            if channel.codec.spec.is_cyclic
        }
        self._events_of = {
            sender: [c for c in self._channels.values() if _is_event_of(c, sender)]
            for sender in {channel.codec.spec.sender for channel in self._cyclic.values()}
        }
        self._ticked_us: int | None = None
        self.e2e_errors = 0
        """Frames with a wrong CRC or counter."""
        self.format_errors = 0
        """Frames of the DBC with a wrong length, frame format or value."""
        self.foreign_frames = 0
        """Frames that are not of the DBC."""

    def receive(self, frame: Frame) -> Received:
        """Judge and decode one frame; never raises."""
        can_id, data, is_fd, is_extended = frame
        channel = self._channels.get(can_id)
        if channel is None or not is_extended:
            if is_extended and can_id in _KNOWN_IDS:
                return _NOT_FOR_US
            self.foreign_frames += 1
            return _FOREIGN
        if len(data) != channel.length or is_fd != channel.is_fd:
            return self._refuse_format(channel)
        data_id = channel.data_id
        if data_id is not None:
            if not check_crc(data, data_id):
                return self._refuse_protection(channel, Status.ERROR)
            counter = data[2]
            if counter != channel.next_counter:
                status = self._check_counter(channel, counter)
                if status is not Status.OK:
                    return self._refuse_protection(channel, status)
            channel.next_counter = (counter + 1) % COUNTER_MODULUS
        message = channel.decode(data)
        if message is None:
            return self._refuse_format(channel)
        machine = channel.machine
        if machine.is_steady:
            machine.status = Status.OK
        else:
            machine.update(Status.OK)
        channel.silence.is_heard = True
        return _new(Received, (_OK, message))

    def _check_counter(self, channel: _Channel, counter: int) -> Status:
        """Judges a counter that is not the next one."""
        expected = channel.next_counter
        previous = None if expected is None else (expected - 1) % COUNTER_MODULUS
        channel.next_counter = (counter + 1) % COUNTER_MODULUS
        return check_counter(previous, counter, channel.max_delta)

    def _refuse_protection(self, channel: _Channel, status: Status) -> Received:
        self.e2e_errors += 1
        channel.machine.update(status)
        return _OF_STATUS[status]

    def _refuse_format(self, channel: _Channel) -> Received:
        self.format_errors += 1
        channel.machine.update(Status.ERROR)
        return _FORMAT

    def tick(self, now_us: int) -> None:
        """Once a step: cyclic channels without a good frame for 5 cycle times are not valid."""
        previous_us = now_us if self._ticked_us is None else self._ticked_us
        self._ticked_us = now_us
        silent = [
            channel
            for channel in self._cyclic.values()
            if channel.silence.tick(now_us, previous_us)
        ]
        for channel in silent:
            channel.machine.update(Status.NO_NEW_DATA)
        for sender in {channel.codec.spec.sender for channel in silent}:
            if self._is_silent(sender, silent):
                self._forget_event_counters(sender)

    def _is_silent(self, sender: Node, silent: list[_Channel]) -> bool:
        """Whether every cyclic message ever heard of a sender is silent now."""
        return all(
            channel in silent
            for channel in self._cyclic.values()
            if channel.silence.was_heard and channel.codec.spec.sender is sender
        )

    def _forget_event_counters(self, sender: Node) -> None:
        """A sender of which nothing cyclic is heard may have restarted: its counters begin anew.

        Its cyclic channels get over a counter that repeats by chance with the next frame; an event
        may be the only one for a long time."""
        for channel in self._events_of[sender]:
            channel.next_counter = None

    def valid(self, message_type: type[Message]) -> bool:
        """Whether this cyclic message may be relied on: its channel is VALID.

        `KeyError` for a message that is not cyclic or not received here: a mistake of the caller.
        """
        return self._cyclic[message_type].machine.state is ChannelState.VALID

    def all_valid(self, message_types: Iterable[type[Message]]) -> bool:
        """Whether all of these may be relied on; `KeyError` as for `valid`."""
        cyclic = self._cyclic
        for message_type in message_types:
            if cyclic[message_type].machine.state is not ChannelState.VALID:
                return False
        return True

    def state(self, message_type: type[Message]) -> ChannelState:
        """The state of a cyclic message's channel; `KeyError` as for `valid`."""
        return self._cyclic[message_type].machine.state

    @property
    def invalid_channels(self) -> int:
        """One bit a received cyclic message, in order of identifier: its channel is not VALID."""
        return sum(
            [
                1 << bit
                for bit, channel in enumerate(self._cyclic.values())
                if channel.machine.state is not ChannelState.VALID
            ]
        )
