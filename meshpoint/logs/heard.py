"""Every message of the DBC as it was last heard: its values, its age, its end-to-end state."""

from __future__ import annotations

from collections import deque
from typing import Final, TypeVar

from meshpoint.dbc.e2e import ChannelState
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import canonical
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict, Receiver
from meshpoint.dbc.messages import (
    ControllerStatus,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferencePhase,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.results.road_speed import span_us

M = TypeVar("M", bound=tuple[object, ...])
LONGEST_STEP_US: Final = 10_000_000
"""A clock that moves by more from one frame to the next has been set, and has not run on."""
LEAST_DELAY_FRAMES: Final = 100
"""Stamped frames, of some 25 reads, of which one at least has come without waiting."""
RATE_FRAMES: Final = 20
"""A message's rate is that of its last this many frames."""
STAMPED: Final = (
    GearboxSensors, SleevesMain, SleevesAux, ValveStatus, ReferenceEncoder, ReferencePhase,
)  # fmt: skip
"""Messages of the sensor side that say when, by the sensor clock, they were made."""


class HeardMessage:
    """One identifier of the DBC: how often it came, when last, and what was wrong with it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.newest: Message | None = None
        """The last one that passed every check."""
        self.frames = 0
        self.refused: dict[FrameVerdict, int] = {}
        """Frames that did not pass, by what was wrong."""
        self._times_s: deque[float] = deque(maxlen=RATE_FRAMES)

    def take(self, time_s: float, verdict: FrameVerdict, message: Message | None) -> None:
        """One more frame of this identifier."""
        self.frames += 1
        if message is None:
            self.refused[verdict] = self.refused.get(verdict, 0) + 1
            return
        self.newest = message
        self._times_s.append(time_s)

    @property
    def newest_s(self) -> float | None:
        """When the newest good one came."""
        return self._times_s[-1] if self._times_s else None

    @property
    def rate_hz(self) -> float | None:
        """Good frames a second; None before the second one."""
        if len(self._times_s) < 2 or self._times_s[-1] <= self._times_s[0]:
            return None
        return (len(self._times_s) - 1) / (self._times_s[-1] - self._times_s[0])


class _RunOn:
    """How far a clock of 32 bits, or more, has run on, without its restarts and steps."""

    def __init__(self) -> None:
        self.total_us = 0
        self._newest_us: int | None = None

    def take(self, stamp_us: int) -> bool:
        """One reading; whether the clock has been set since the one before."""
        ahead_us = 0 if self._newest_us is None else span_us(stamp_us, self._newest_us)
        self._newest_us = stamp_us
        self.total_us += ahead_us if 0 < ahead_us <= LONGEST_STEP_US else 0
        return abs(ahead_us) > LONGEST_STEP_US


class Heard:
    """A listener to the whole bus. Times are seconds of the log, or of the clock that hears."""

    def __init__(self) -> None:
        self._receiver = Receiver(*Node)
        self.messages = {
            codec.spec.can_id: HeardMessage(codec.spec.name) for codec in CODECS.values()
        }
        self._by_type: dict[type[object], HeardMessage] = {
            codec.message_type: self.messages[codec.spec.can_id] for codec in CODECS.values()
        }
        self.now_s = 0.0
        self.frames = 0
        self._clocks = (_RunOn(), _RunOn())
        """Of the sensor side and of the controller, as their frames tell them."""
        self._begin_s: float | None = None
        self._clock_s: float | None = None
        """When the newest frame came that carries a clock."""
        self._idle_us = 0
        """Bus time without any frame, since the last one."""
        self._stamp_us: int | None = None
        """The newest sensor time heard, 32 bits."""
        self._behind_us: deque[int] = deque(maxlen=LEAST_DELAY_FRAMES)
        """By how much the log is ahead of the sensor side's clock: stamped frames of late."""

    @property
    def foreign(self) -> int:
        """Frames that are not of the DBC."""
        return self._receiver.foreign_frames

    def receive(self, time_s: float, frame: Frame) -> Message | None:
        """One frame; its message where it passed every check. Never raises on a bad one."""
        self._begin_s = time_s if self._begin_s is None else self._begin_s
        self.now_s = max(self.now_s, time_s)
        self._idle_us = 0  # a clock of the bus that went on meanwhile says so itself
        self.frames += 1
        frame = canonical(frame)
        verdict, message = self._receiver.receive(frame)
        heard = self.messages.get(frame.can_id) if frame.is_extended else None
        if heard is not None:
            heard.take(time_s, verdict, message)
        sensor_side, controller = self._clocks
        if isinstance(message, STAMPED):
            if sensor_side.take(message.sample_time_us):
                self._behind_us.clear()
            self._stamp_us = message.sample_time_us
            self._behind_us.append(round(self.now_s * 1e6) - sensor_side.total_us)
            self._clock_s = self.now_s
        elif isinstance(message, ControllerStatus):
            controller.take(message.step_time_us)
            self._clock_s = self.now_s
        self._receiver.tick(self.bus_us)
        return message

    @property
    def sensor_us(self) -> int | None:
        """The sensors' time now, 32 bits: that of the newest stamp, and how much later than the
        frame that waited least of late this one is; None before the first."""
        if self._stamp_us is None:
            return None
        behind_us = round(self.now_s * 1e6) - self._clocks[0].total_us
        return (self._stamp_us + behind_us - min(self._behind_us)) & 0xFFFF_FFFF

    @property
    def bus_us(self) -> int:
        """Time by the frames themselves: of sensor side and controller, the one that has gone on
        further. A bus time that waits for a busy machine is not mistaken for silence. Where
        neither speaks it is the time of the log."""
        reported_us = max(clock.total_us for clock in self._clocks)
        if not reported_us:
            return round((self.now_s - (self._begin_s or self.now_s)) * 1e6)
        return reported_us + self._idle_us

    @property
    def pace(self) -> float:
        """Seconds of bus time in one of the clock that hears, at most 1: less where bus time waits
        for a busy machine."""
        heard_s = (self._clock_s or 0.0) - (self._begin_s or 0.0)
        reported_s = max(clock.total_us for clock in self._clocks) * 1e-6
        return min(1.0, reported_s / heard_s) if reported_s and heard_s > 0.0 else 1.0

    def idle(self, now_s: float) -> None:
        """Nothing has come up to now: ages grow, and what stays away is no longer valid."""
        if self._begin_s is not None and now_s > self.now_s:
            self._idle_us += round((now_s - self.now_s) * self.pace * 1e6)
            self._receiver.tick(self.bus_us)
        self.now_s = max(self.now_s, now_s)

    def last(self, kind: type[M]) -> M | None:
        """The newest message of a kind; None where there was none."""
        newest: object = self._by_type[kind].newest
        return newest if isinstance(newest, kind) else None

    def valid(self, kind: type[Message]) -> bool:
        """Whether a cyclic message may be relied on: heard in time, counters and CRC in order."""
        return self._receiver.valid(kind)

    def state(self, kind: type[Message]) -> ChannelState:
        """What the end-to-end protection thinks of a cyclic message's channel."""
        return self._receiver.state(kind)

    def age_s(self, kind: type[object]) -> float | None:
        """How long ago the newest good message of a kind came."""
        newest_s = self._by_type[kind].newest_s
        return None if newest_s is None else self.now_s - newest_s
