"""From edge frames to teeth: unwrapped times and running tooth numbers of one wheel.

An edge frame is the thesis's figure 2.2: the last 27 timestamps of one polarity as their low 16
bits, newest first, with the running number of the newest. So a lost frame loses no edge as long as
fewer than 27 came since, and the tooth number is never lost.
"""

from __future__ import annotations

import itertools
import struct
from typing import Final, NamedTuple, Protocol

import numpy as np

from controller.clock import SensorClock
from controller.edge_kernels import BROKEN, Integers, chain_edges, merge_edges
from controller.kernels import Vector

LONG_AGO_US: Final = -(1 << 62)


class EdgeFrame(Protocol):
    """What the eight edge messages of the DBC have in common."""

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
    def timestamp_low_us(self) -> tuple[int, ...]:
        """Low 16 bits of each edge's time, newest first."""


class Edge(NamedTuple):
    """One edge: sensor time and the wheel angle it stands for."""

    time_us: int
    theta_rad: float


class EdgeBatch(NamedTuple):
    """New edges of one wheel, both polarities, rising in time. Arrays of one length.

    theta_rad is that of a perfect wheel: tooth x pitch, and the duty share of a pitch more for a
    falling edge."""

    time_us: Vector
    theta_rad: Vector
    tooth: Integers
    """Running number of the tooth that the edge belongs to, a falling one to the rising before."""
    falling: Integers
    """1 for a falling edge, 0 for a rising one."""


NO_EDGES: Final = EdgeBatch(np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64))
STAMPS: Final = 27
_PACK_STAMPS: Final = struct.Struct(f"={STAMPS}q").pack_into
_ROOM: Final = 4 * STAMPS


class Polarity:
    """One polarity of a wheel: the chain of its frames, and the edges of this step."""

    def __init__(self) -> None:
        self._chain: Integers = np.zeros(3, np.int64)
        self._low: Integers = np.zeros(STAMPS, np.int64)
        self.numbers: Integers = np.empty(_ROOM, np.int64)
        self.times_us: Integers = np.empty(_ROOM, np.int64)
        self.count = 0
        """How many of `numbers` and `times_us` are edges of this step, oldest first."""

    def begin(self) -> None:
        """A new step: no edges yet."""
        self.count = 0

    def take(self, frame: EdgeFrame, read_us: int) -> bool:
        """Appends the edges since the last frame.

        False when the chain is broken: the wheel stood still or more edges came than one frame
        holds, so tooth numbers before and after cannot be tied together."""
        if self.count + STAMPS > self.numbers.size:
            self.numbers = np.resize(self.numbers, 2 * self.numbers.size)
            self.times_us = np.resize(self.times_us, 2 * self.times_us.size)
        # A tuple gets into an array fastest through the bytes that the array stands on.
        _PACK_STAMPS(self._low.data, 0, *frame.timestamp_low_us)
        count = chain_edges(
            self._low,
            frame.newest_index,
            frame.valid_stamps,
            frame.long_interval,
            frame.stopped,
            read_us,
            self._chain,
            self.numbers,
            self.times_us,
            self.count,
        )
        self.count = max(count, 0)
        return count != BROKEN

    def edges(self) -> list[tuple[int, int]]:
        """This step's edges as (number, time)."""
        n = self.count
        return list(zip(self.numbers[:n].tolist(), self.times_us[:n].tolist(), strict=True))


class WheelEdges:
    """One sensor wheel with both polarities.

    Rising edge k stands for the angle k pitch; a falling edge lies a duty share of a pitch behind
    the rising edge before it. Which falling number belongs to which rising one is seen from their
    order in time, once, and holds as long as neither chain breaks."""

    def __init__(self, teeth: int, duty_share: float) -> None:
        self.pitch_rad = 2.0 * np.pi / teeth
        self._duty_share = duty_share
        self._rise, self._fall = Polarity(), Polarity()
        self._fall_shift: int | None = None
        self._last_us = LONG_AGO_US
        self.broken = 0
        """How often tooth numbers were lost: every phase reference of this wheel with them."""
        self.newest: Edge | None = None

    def restart(self) -> None:
        """Forgets all numbers: the sensor side has restarted."""
        self._rise, self._fall = Polarity(), Polarity()
        self._fall_shift = None
        self._last_us = LONG_AGO_US
        self.newest = None
        self.broken += 1

    def read(
        self, rise: list[EdgeFrame], fall: list[EdgeFrame], clock: SensorClock, now_us: int
    ) -> EdgeBatch:
        """Takes this step's frames of both polarities; returns the new edges in order of time."""
        risen, fallen = self._rise, self._fall
        self._take(risen, rise, clock, now_us)
        self._take(fallen, fall, clock, now_us)
        if self._fall_shift is None:
            self._pair(risen.edges(), fallen.edges())
        # Falling edges that cannot be placed yet are left out.
        falls = 0 if self._fall_shift is None else fallen.count
        if risen.count + falls == 0:
            return NO_EDGES
        room = risen.count + falls
        edge_us, edge_rad = np.empty(room), np.empty(room)
        tooth, falling = np.empty(room, np.int64), np.empty(room, np.int64)
        n = merge_edges(
            risen.numbers,
            risen.times_us,
            risen.count,
            fallen.numbers,
            fallen.times_us,
            falls,
            self._fall_shift or 0,
            self._duty_share,
            self.pitch_rad,
            self._last_us,
            edge_us,
            edge_rad,
            tooth,
            falling,
        )
        if n == 0:
            return NO_EDGES
        self._last_us = int(edge_us[n - 1])
        self.newest = Edge(self._last_us, float(edge_rad[n - 1]))
        return EdgeBatch(edge_us[:n], edge_rad[:n], tooth[:n], falling[:n])

    def _take(
        self, polarity: Polarity, frames: list[EdgeFrame], clock: SensorClock, now_us: int
    ) -> None:
        polarity.begin()
        for frame in frames:
            if not polarity.take(frame, clock.stamp(frame.read_time_us, now_us)):
                self._fall_shift = None
                self.newest = None
                self.broken += 1

    def _pair(self, risen: list[tuple[int, int]], fallen: list[tuple[int, int]]) -> None:
        for (number, before), (_, after) in itertools.pairwise(risen):
            for fall_number, time_us in fallen:
                if before < time_us < after:
                    self._fall_shift = number - fall_number
                    return
