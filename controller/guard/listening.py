"""The guard's own ear: which frames it believes, and what they say, from their raw bytes.

It shares nothing with the codec and the receiver of the controller but the CRC's library. A channel
is one message with AUTOSAR E2E profile 5; EEC1 and TC1 are J1939 and carry no protection. Offsets
and steps are written down a second time on purpose; a test holds them against the DBC.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from typing import Final, NamedTuple

from e2e.p05 import e2e_p05_check

from meshpoint.controller.guard.own_clock import signed_us
from meshpoint.dbc.frame import Frame

INPUT_EDGES, LAYSHAFT_EDGES, MAIN_EDGES, PROPELLER_EDGES = (
    0x18FF1080,
    0x18FF1280,
    0x18FF1480,
    0x18FF1680,
)
EDGES: Final = (INPUT_EDGES, LAYSHAFT_EDGES, MAIN_EDGES, PROPELLER_EDGES)
"""The rising edges of input shaft, layshaft, main shaft and propeller shaft."""
SENSORS, SLEEVES_MAIN, SLEEVES_AUX, VALVE_STATUS = 0x18FF2080, 0x18FF2180, 0x18FF2280, 0x18FF2380
NEEDED: Final = (SENSORS, SLEEVES_MAIN, SLEEVES_AUX, VALVE_STATUS)
"""Without one of these no valve may be driven."""
ENGINE_SPEED, GEAR_REQUEST = 0x0CF00400, 0x0C0103F9
PROTECTED: Final = {
    INPUT_EDGES: (64, 19728),
    LAYSHAFT_EDGES: (64, 19730),
    MAIN_EDGES: (64, 19732),
    PROPELLER_EDGES: (64, 19734),
    SENSORS: (16, 19744),
    SLEEVES_MAIN: (48, 19745),
    SLEEVES_AUX: (48, 19746),
    VALVE_STATUS: (16, 19747),
}
"""Identifier: length in bytes and E2E data identifier."""
J1939_LENGTH: Final = 8
COUNTER_BYTE: Final = 2
LARGEST_STEP: Final = 2
"""One frame may be lost between two that are believed."""
WINDOW_MASK: Final = (1 << 10) - 1
MOST_BAD: Final = 2
"""Of the last ten frames this many may have a wrong CRC, counter or value."""
GOOD_TO_BEGIN: Final = 3
"""This many good ones in a row make a channel valid."""
SILENT_US: Final = 40_000
"""A channel not heard for four cycles is lost. With the tick that notices it, within 50 ms."""

_stamp: Final = struct.Struct("<I").unpack_from
_sensors: Final = struct.Struct("<HHHH").unpack_from
_sleeves: Final = struct.Struct("<Bh4xh10xhh4xh10xh").unpack_from
"""Fault bits; of each sleeve the newest sample, the one `OVER_SAMPLES` before it and the oldest."""
_edges: Final = struct.Struct("<HB27H").unpack_from
_word: Final = struct.Struct("<H").unpack_from
STAMP_AT: Final = 3
CONTENT_AT: Final = 7
PRESSURE_STEP_PA: Final = 20.0
CLUTCH_STEPS: Final = 10_000
POSITION_STEP_M: Final = 1e-6
POSITION_STEPS: Final = 20_000
OVER_SAMPLES: Final = 3
SAMPLE_S: Final = 1e-3
OVER_SPAN_S: Final = OVER_SAMPLES * SAMPLE_S
"""A sleeve's speed is taken over this many samples of 1 ms."""
FRAME_SPAN_S: Final = 9 * SAMPLE_S
"""From a frame's oldest sample to its newest."""
ENGINE_AT, ENGINE_STEP_RAD_S = 3, 0.125 * math.pi / 30.0
TORQUE_AT, TORQUE_OFFSET, TORQUE_STEPS = 2, 125, 0xFA
ENGINE_STEPS: Final = 0xFAFF
"""Above this a J1939 word says that there is no value."""
GEAR_AT, GEAR_OFFSET, GEAR_STEPS = 2, 125, 0xFA
STAMPS_MASK: Final = 0x1F
STAMPS: Final = 27


class Slow(NamedTuple):
    """What a frame of positions or pressures says, SI, and when it was sampled (sensor clock)."""

    time_us: int
    values: tuple[float, ...]
    """Brake and supply pressure (Pa, absolute) and clutch (1: closed); or two sleeves' newest
    positions (m)."""
    is_faulty: bool = False
    """A sensor says that it is out of range."""
    speeds_m_s: tuple[float, float] = (0.0, 0.0)
    """Of two sleeves, over their newest samples."""
    means_m_s: tuple[float, float] = (0.0, 0.0)
    """Of two sleeves, over all samples of the frame."""


class Engine(NamedTuple):
    """What EEC1 says; None: it says that there is no value."""

    speed_rad_s: float | None
    torque_share: float | None
    """Of the engine's reference torque."""


class Edges(NamedTuple):
    """The newest edges of a wheel."""

    time_us: int
    """When the sensor was read (sensor clock)."""
    newest_index: int
    """Running number of the newest edge, 16 bits."""
    lows_us: tuple[int, ...]
    """Low 16 bits of the edges' times, newest first; empty where they cannot be placed."""


class Channel:
    """One protected message: whether its frames may be believed."""

    def __init__(self, length: int, data_id: int) -> None:
        self._length, self._data_id = length, data_id
        self._counter: int | None = None
        self._bad = 0
        self._good_in_a_row = 0
        self._heard_us = 0
        self.is_valid = False

    def passes(self, frame: Frame, now_us: int) -> bool:
        """Whether this frame is good; `now_us` is the controller's clock."""
        data = frame.data
        good = len(data) == self._length and frame.is_fd and e2e_p05_check(data, self._data_id)
        if good:
            counter, before = data[COUNTER_BYTE], self._counter
            self._counter = counter
            good = before is None or 1 <= (counter - before) % 256 <= LARGEST_STEP
        if good:
            self._heard_us = now_us
        return good

    def note(self, good: bool) -> None:
        """What a frame came to, its values included. A lost channel is believed again only when the
        bad frames that came since have left the window."""
        self._bad = (self._bad << 1 | (not good)) & WINDOW_MASK
        self._good_in_a_row = self._good_in_a_row + 1 if good else 0
        if self._bad.bit_count() > MOST_BAD:
            if self.is_valid:
                self._forget()
        elif self._good_in_a_row >= GOOD_TO_BEGIN:
            self.is_valid = True

    def tick(self, now_us: int) -> None:
        """Once a step, after its frames: a silent channel is lost."""
        if now_us - self._heard_us >= SILENT_US:
            self._forget()

    def _forget(self) -> None:
        self.is_valid, self._bad, self._good_in_a_row = False, 0, 0


class GuardReceiver:
    """Takes the frames of each step."""

    def __init__(self) -> None:
        self.channels = {can_id: Channel(*kind) for can_id, kind in PROTECTED.items()}
        self.slow: dict[int, Slow] = {}
        """The newest of each."""
        self.edges: dict[int, list[Edges]] = {}
        """Those of this step."""
        self.engine: list[Engine] = []
        """Those of this step."""
        self.clutch: list[tuple[int, float]] = []
        """Of this step: times, and how far the clutch was closed."""
        self.requested_gear: int | None = None
        """The gear asked for in this step; None where none was."""
        self.has_restarted = False
        """Whether the sensors' clock is another since this step: an array of edges has got emptier,
        or a message's time has gone back while its counter went on."""
        self._held = dict.fromkeys(EDGES, 0)
        self.newest_us: dict[int, int] = {}
        """The newest time of each message."""
        self._heard_us: int | None = None
        """The time heard last: the next one's 32 bits go on from there."""

    def take(self, frames: Iterable[Frame], now_us: int) -> list[int]:
        """One step's frames at `now_us` of the controller's clock. Returns the times (us) of the
        sensor clock that they carry, as they came."""
        self.edges = {can_id: [] for can_id in EDGES}
        self.engine, self.clutch, self.requested_gear = [], [], None
        self.has_restarted = False
        times_us: list[int] = []
        for frame in frames:
            if not frame.is_extended:
                continue
            can_id = frame.can_id
            channel = self.channels.get(can_id)
            if channel is None:
                if can_id in (ENGINE_SPEED, GEAR_REQUEST):
                    self._hear_j1939(frame)
                continue
            time_us = self._time_us(frame.data) if channel.passes(frame, now_us) else None
            good = time_us is not None and self._read(can_id, time_us, frame.data)
            channel.note(good)
            if time_us is not None and good:
                if time_us < self.newest_us.get(can_id, time_us):
                    self.has_restarted = True
                    times_us.clear()  # those of this step from before it
                    if can_id in self.edges:
                        del self.edges[can_id][:-1]
                self.newest_us[can_id] = time_us
                times_us.append(time_us)
        for channel in self.channels.values():
            channel.tick(now_us)
        return times_us

    @property
    def hears_all(self) -> bool:
        """Whether no needed channel is lost, and no sensor of theirs says that it is out of
        range."""
        lost = [can_id for can_id in NEEDED if not self.channels[can_id].is_valid]
        faulty = [slow for slow in self.slow.values() if slow.is_faulty]
        return not (lost or faulty)

    def _hear_j1939(self, frame: Frame) -> None:
        """The engine's speed, or a request for a gear."""
        data = frame.data
        if frame.is_fd or len(data) != J1939_LENGTH:
            return
        if frame.can_id == ENGINE_SPEED:
            (raw,) = _word(data, ENGINE_AT)
            torque = data[TORQUE_AT]
            self.engine.append(
                Engine(
                    raw * ENGINE_STEP_RAD_S if raw <= ENGINE_STEPS else None,
                    (torque - TORQUE_OFFSET) / 100 if torque <= TORQUE_STEPS else None,
                )
            )
        else:
            raw = data[GEAR_AT]
            self.requested_gear = raw - GEAR_OFFSET if raw <= GEAR_STEPS else None

    def _time_us(self, data: bytes) -> int:
        """When a frame's content was sampled, beyond the 32 bits that it has room for."""
        (stamp,) = _stamp(data, STAMP_AT)
        heard_us = stamp if self._heard_us is None else self._heard_us
        self._heard_us = heard_us + signed_us(stamp - heard_us)
        return self._heard_us

    def _read(self, can_id: int, time_us: int, data: bytes) -> bool:
        """Keeps what a frame says; False where a value is none."""
        if can_id in self.edges:
            said = _edges(data, CONTENT_AT)
            index, shape = said[0], said[1]
            held = shape & STAMPS_MASK
            if held > STAMPS:
                return False
            if held < self._held[can_id]:
                self.has_restarted = True
                self.edges[can_id].clear()
            self._held[can_id] = held
            usable = shape == held  # neither stopped, nor an interval too long, nor a faulty sensor
            self.edges[can_id].append(Edges(time_us, index, said[2 : 2 + held] if usable else ()))
            return True
        if can_id == SENSORS:
            brake, supply, _, clutch = _sensors(data, CONTENT_AT)
            pressures = (brake * PRESSURE_STEP_PA, supply * PRESSURE_STEP_PA)
            self.slow[can_id] = Slow(time_us, (*pressures, clutch / CLUTCH_STEPS))
            self.clutch.append((time_us, clutch / CLUTCH_STEPS))
            return bool(clutch <= CLUTCH_STEPS)
        if can_id == VALVE_STATUS:
            self.slow[can_id] = Slow(time_us, ())
            return True
        fault, *samples = _sleeves(data, CONTENT_AT)
        if max(map(abs, samples)) > POSITION_STEPS:
            return False
        a, a_before, a_oldest, b, b_before, b_oldest = [each * POSITION_STEP_M for each in samples]
        speeds = ((a - a_before) / OVER_SPAN_S, (b - b_before) / OVER_SPAN_S)
        means = ((a - a_oldest) / FRAME_SPAN_S, (b - b_oldest) / FRAME_SPAN_S)
        self.slow[can_id] = Slow(time_us, (a, b), bool(fault), speeds, means)
        return True
