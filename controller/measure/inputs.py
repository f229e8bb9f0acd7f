"""What a step is given: its decoded messages, and what one edge frame says by itself.

Messages are sorted by use. The stamps of an edge frame become numbered times, and teeth over the
time they took are the shaft's speed: without filter, model and tooth numbers, so errors of the
estimators do not affect it. The sequence asks by it whether two shafts turn together, which is what
splitter and range changes wait for: a sleeve's position shows that a step is in mesh, but its
synchroniser may still be slipping. The guard measures speeds by itself (`guard/own_speed`).

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""

from __future__ import annotations

import math
import struct
from typing import Annotated, Any, Final, NamedTuple, Protocol

import numpy as np

from meshpoint.dbc.edges import EDGE_MESSAGES, EDGES
from meshpoint.dbc.messages import (
    EEC1,
    TC1,
    GearboxSensors,
    Message,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)
from meshpoint.dbc.sensor_time import HALF, WRAP
from meshpoint.gearbox import GearboxSheet, Range, Split
from meshpoint.gearbox.gears import DogGear, SplitGear
from meshpoint.gearbox.wheels import SHAFT_OF_WHEEL, SHAFTS
from meshpoint.kernels.jit import bare, compiled, record_on
from meshpoint.kernels.records import WORD_BYTES, Integers, Vector, layout_of

STAMPS: Final = 27
BROKEN: Final = -1
pack_frame: Final = struct.Struct(f"={5 + STAMPS}q").pack_into
"""The fields of a frame into an `EdgeChain`, from its first byte on."""
pack_stamps: Final = struct.Struct(f"={STAMPS}q").pack_into
"""Writes a tuple of stamps into an array's memory, which is faster than element by element."""
FIRST_WRONG: Final = 9
"""Edges after power-up that a Hall sensor may misplace while it finds its thresholds (ATS645)."""
SPAN_US: Final = 15_000
"""A speed is taken over at least this time, as far as the frame holds enough teeth."""
UNEVEN: Final = 1.7
"""Neighbouring intervals that differ by more than this factor hold a tooth too many or too few."""

DEAD_US: Final = 20_000
"""If the newest edge of a frame is older than this, and older than three teeth took before, the
sensor has failed. Read, bus and tick included, this is detected within 50 ms."""
SPEED_STALE_US: Final = 25_000
"""The same limit when no frame arrives, for the newest edge of the last frame: two frames may be
lost without losing the speed."""
TEETH_LATE: Final = 3
SPEED_HELD_US: Final = 45_000
"""While frames hold a tooth too many or too few, the last speed stays valid for this long."""
LOW: Final = 0xFFFF

TOGETHER_SHARE: Final = 0.01
"""Shafts whose speeds differ by less turn together: pitch errors of a wheel are half of it."""


class EdgeFrame(Protocol):
    """What the edge messages of the DBC have in common."""

    @property
    def read_time_us(self) -> int:
        """Sensor clock of the read, 32 bits."""

    @property
    def newest_index(self) -> int:
        """Running number of the newest edge, 16 bits."""

    @property
    def valid_stamps(self) -> int:
        """How many stamps hold an edge."""

    @property
    def long_interval(self) -> bool:
        """An interval in the array is too long to be chained."""

    @property
    def stopped(self) -> bool:
        """The newest edge is too old to be placed."""

    @property
    def sensor_fault(self) -> bool:
        """The sensor's supply or signal is out of range: its edges are none."""

    @property
    def timestamp_low_us(self) -> tuple[int, ...]:
        """Low 16 bits of each edge's time, newest first."""


class StepInputs:
    """The decoded messages of one step."""

    def __init__(self) -> None:
        self.edges: dict[type, list[EdgeFrame]] = {kind: [] for kind in EDGE_MESSAGES}
        self.sleeves_main: list[SleevesMain] = []
        self.sleeves_aux: list[SleevesAux] = []
        self.sensors: list[GearboxSensors] = []
        self.engine: list[EEC1] = []
        self._valve_status: list[ValveStatus] = []
        self._requests: list[TC1] = []
        self._lists: dict[type, list[Any]] = {
            **self.edges,
            SleevesMain: self.sleeves_main,
            SleevesAux: self.sleeves_aux,
            GearboxSensors: self.sensors,
            ValveStatus: self._valve_status,
            EEC1: self.engine,
            TC1: self._requests,
        }

    def take(self, message: Message) -> None:
        """Adds one message."""
        kept = self._lists.get(type(message))
        if kept is not None:
            kept.append(message)

    @property
    def valve_status(self) -> ValveStatus | None:
        """The newest of this step."""
        return self._valve_status[-1] if self._valve_status else None

    @property
    def requested_gear(self) -> int | None:
        """The gear asked for last; None where none was, or the field was not available."""
        return self._requests[-1].requested_gear if self._requests else None


class EdgeChain:
    """The edges of one polarity over all frames: fields of the newest frame, then those kept from
    the frames before."""

    newest_index: int
    """Running number of the frame's newest edge, 16 bits."""
    valid: int
    """How many of its times are those of edges."""
    long_interval: int
    """1: an interval is too long to be chained."""
    stopped: int
    """1: the newest edge is too old to be placed."""
    read_us: int
    """When the frame was read, unwrapped."""
    low_us: Annotated[Integers, STAMPS]
    """Low 16 bits of the edges' times, newest first."""
    index: int
    """Running number of the newest edge, unwrapped."""
    time_us: int
    """Its sensor time; without a meaning before the chain has started."""
    started: int
    wrong_until: int
    """The last of the edges after power-up that may lie wrong."""


CHAIN: Final = layout_of(EdgeChain)
CHAIN_WORDS: Final = CHAIN.itemsize // WORD_BYTES


@bare
def newest_teeth(low: Integers, valid: int) -> tuple[int, int]:
    """How long the newest teeth of one frame took, us, and how many they are.

    low: low 16 bits of the newest `valid` edge times, newest first. Returns no teeth with fewer
    than two edges, or if neighbouring intervals are uneven, the one before the last taken among
    them: a sensor that was silent for longer than the span looks like one slow tooth."""
    span_us = teeth = last_us = 0
    for k in range(1, valid):
        interval_us = (low[k - 1] - low[k]) & 0xFFFF
        if teeth > 0 and not last_us < UNEVEN * interval_us < UNEVEN * UNEVEN * last_us:
            return 0, 0
        if span_us >= SPAN_US:
            break
        last_us = interval_us
        span_us += interval_us
        teeth += 1
    return (span_us, teeth) if span_us > 0 else (0, 0)


@compiled
def chain_edges(memory: Vector, edges: Integers, count: int) -> int:
    """Appends the edges since the last frame, oldest first, behind the first `count`.

    memory: an `EdgeChain` with the new frame, moved on; edges (2, n): running numbers and
    times (us). The first edges after power-up are left out: a frame that is not full shows that
    the sensor has just begun to count. Returns the new count, or BROKEN when the numbers before
    and after cannot be joined: the wheel stood still, or more edges came than a frame holds.
    """
    chain = record_on(memory, CHAIN)
    low, valid, newest_index, read_us = chain.low_us, chain.valid, chain.newest_index, chain.read_us
    if valid == 0:
        return count
    fresh = (newest_index - chain.index) & 0xFFFF
    if chain.started == 0:
        # With a long interval in the array only the newest edge can be placed.
        fresh = 1 if chain.long_interval == 1 else valid
        chain.index = newest_index - fresh
        chain.wrong_until = newest_index - valid + (FIRST_WRONG if valid < STAMPS else 0)
    if fresh == 0:
        return count
    tied = chain.stopped == 0 and fresh <= valid
    if tied:
        time_us = read_us - ((read_us - low[0]) & 0xFFFF)
        number = chain.index + fresh
        newest_us = time_us
        kept = min(fresh, max(number - chain.wrong_until, 0))
        for k in range(fresh):
            if k > 0:
                time_us -= (low[k - 1] - low[k]) & 0xFFFF
            if k < kept:
                edges[0, count + kept - 1 - k] = number - k
                edges[1, count + kept - 1 - k] = time_us
        if chain.started == 1:
            # The edge before the oldest new one is known already: the chain must lead to it.
            if fresh < valid:
                tied = time_us - ((low[fresh - 1] - low[fresh]) & 0xFFFF) == chain.time_us
            else:
                tied = chain.long_interval == 0
    if not tied:
        had_begun = chain.started == 1
        chain.index, chain.time_us, chain.started = 0, read_us, 0
        # Before the chain has started there are no tooth numbers to lose.
        return BROKEN if had_begun else count
    chain.index, chain.time_us, chain.started = number, newest_us, 1
    return int(count + kept)


def warm_up() -> None:
    """Compiles it, or loads what was compiled before."""
    chain, room = np.zeros(CHAIN_WORDS), np.zeros((2, STAMPS), np.int64)
    chain_edges(chain, room, 0)
    newest_teeth(np.zeros(STAMPS, np.int64), 1)


class EdgeSpeed:
    """One shaft's wheel by its rising edges."""

    def __init__(self, teeth: int) -> None:
        self._pitch_rad = 2.0 * math.pi / teeth
        self._speed: float | None = None
        self._measured_us = 0
        self._is_dead = False
        self._interval_us = 0
        self._index = 0
        self._low: Integers = np.zeros(STAMPS, np.int64)
        self._newest_us: int | None = None

    def take(self, frame: EdgeFrame, now_us: int) -> None:
        """One frame, read shortly before `now_us` of the sensor clock."""
        if frame.sensor_fault or frame.stopped or frame.long_interval or frame.valid_stamps < 2:
            self._speed = None
            return
        read_us = now_us + ((frame.read_time_us - now_us + HALF) % WRAP) - HALF
        stamps = frame.timestamp_low_us
        newest_us = read_us - ((read_us - stamps[0]) & LOW)
        if frame.newest_index == self._index and self._newest_us is not None:
            newest_us = self._newest_us  # no new edge, however young its 16 bits make it look
        self._index = frame.newest_index
        self._newest_us = newest_us
        self._is_dead = read_us - newest_us > max(DEAD_US, TEETH_LATE * self._interval_us)
        pack_stamps(self._low.data, 0, *stamps)
        span_us, teeth = newest_teeth(self._low, frame.valid_stamps)
        if teeth:
            self._interval_us = span_us // teeth
            self._speed = teeth * self._pitch_rad / (span_us * 1e-6)
            self._measured_us = newest_us

    def at(self, now_us: int) -> float | None:
        """The newest speed (rad/s); None if there is none, or if edges have stopped coming."""
        newest_us = self._newest_us
        if self._speed is None or newest_us is None or self._is_dead:
            return None
        limit_us = max(SPEED_STALE_US, TEETH_LATE * self._interval_us)
        is_turning = now_us - newest_us <= limit_us
        is_measured = now_us - self._measured_us <= max(SPEED_HELD_US, limit_us)
        return self._speed if is_turning and is_measured else None


class ShaftSpeeds(NamedTuple):
    """Speeds of the four shafts (rad/s) as measured at one step; None: stale or invalid."""

    sheet: GearboxSheet
    input_: float | None
    layshaft: float | None
    main: float | None
    propeller: float | None

    def slip_rad_s(self, gear: DogGear) -> float | None:
        """Slip of a gear."""
        if isinstance(gear, SplitGear):
            if self.layshaft is None or self.input_ is None:
                return None
            return self.sheet.dog_mesh(gear).ratio * self.layshaft - self.input_
        if self.layshaft is None or self.main is None:
            return None
        return self.sheet.main_mesh(gear).ratio * self.layshaft - self.main

    def split_turns_together(self, split: Split) -> bool:
        """Whether input shaft and layshaft have the ratio of this step."""
        return _together(self.input_, self.layshaft, self.sheet.split_mesh(split).ratio)

    def range_turns_together(self, range_: Range) -> bool:
        """Whether main and propeller shaft have the ratio of this step."""
        return _together(self.main, self.propeller, self.sheet.range_mesh(range_).ratio)


class ShaftSpeedMeter:
    """Measures the speeds of the four shafts from their newest frames: that of a shaft by the first
    of its wheels that shows one."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._wheels = [
            (EDGES[name].rise, EdgeSpeed(wheel.teeth)) for name, wheel in sheet.wheels.rows.items()
        ]

    def take(self, inputs: StepInputs, now_us: int) -> ShaftSpeeds:
        """One step's frames at a sensor time, and the speeds then."""
        speeds: list[float | None] = [None] * len(SHAFTS)
        for (kind, wheel), shaft in zip(self._wheels, SHAFT_OF_WHEEL, strict=True):
            for frame in inputs.edges[kind]:
                wheel.take(frame, now_us)
            if speeds[shaft] is None:
                speeds[shaft] = wheel.at(now_us)
        return ShaftSpeeds(self._sheet, *speeds)


def _together(driving: float | None, driven: float | None, ratio: float) -> bool:
    if driving is None or driven is None:
        return False
    return abs(driving * ratio - driven) <= TOGETHER_SHARE * driven
