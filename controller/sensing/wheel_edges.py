"""From edge frames to teeth: unwrapped times and running tooth numbers of one wheel.

An edge frame is the thesis's figure 2.2: the last 27 timestamps of one polarity as their low 16
bits, newest first, with the running number of the newest. So a lost frame loses no edge as long as
fewer than 27 came since, and the tooth number is never lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np

from meshpoint.controller.motion.linear_kernels import Vector
from meshpoint.controller.sensing import gate_kernels as edge_gate
from meshpoint.controller.sensing import gate_layout as edge_layout
from meshpoint.controller.sensing.chain_kernels import (
    BROKEN,
    CHAIN,
    STAMPS,
    Integers,
    chain_edges,
    pack_stamps,
)
from meshpoint.controller.sensing.sensor_clock import SensorClockEstimate
from meshpoint.controller.sensing.sensor_count import SensorCount
from meshpoint.gearbox.sheet import Wheel

LONG_AGO_US: Final = -(1 << 62)
LONGEST_US: Final = 65_535
"""Without an edge for longer than a stamp can say, a wheel stands."""
MOST_RAD_S2: Final = 300.0
"""What a shaft's speed may change by: a layshaft of 0.33 kg m2 braked with 100 Nm."""

BRAKED_RAD_S2: Final = 170.0
"""What a shaft that drives the wheels stops by: 8 m/s2, tyre 0.5 m, axle 2.85, range 3.75."""


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


class EdgeHealth(NamedTuple):
    """Edges left out as extra, edges that were missing, how often a tooth was in doubt, how often
    of the losses the wheel was slow or stood, and whether teeth are numbered now."""

    extra: int
    missed: int
    doubts: int
    stops: int
    counting: bool


NO_EDGES: Final = EdgeBatch(np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64))
_ROOM: Final = 4 * STAMPS
_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling


class Polarity:
    """One polarity of a wheel: the chain of its frames, and the edges of this step."""

    def __init__(self) -> None:
        self._chain: Integers = np.zeros(CHAIN, np.int64)
        self._low: Integers = np.zeros(STAMPS, np.int64)
        self.numbers: Integers = np.empty(_ROOM, np.int64)
        self.times_us: Integers = np.empty(_ROOM, np.int64)
        self.count = 0
        """How many of `numbers` and `times_us` are edges not used yet, oldest first."""

    def use(self, used: int) -> None:
        """The first `used` edges are done with; the others stay for the next step."""
        left = self.count - used
        if left and used:
            self.numbers[:left] = self.numbers[used : self.count].copy()
            self.times_us[:left] = self.times_us[used : self.count].copy()
        self.count = left

    def take(self, frame: EdgeFrame, read_us: int) -> bool:
        """Appends the edges since the last frame.

        False when the chain is broken: the wheel stood still or more edges came than one frame
        holds. The other polarity may still know the wheel's tooth numbers."""
        if self.count + STAMPS > self.numbers.size:
            self.numbers = np.resize(self.numbers, 2 * self.numbers.size)
            self.times_us = np.resize(self.times_us, 2 * self.times_us.size)
        pack_stamps(self._low.data, 0, *frame.timestamp_low_us)
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
        if count == BROKEN:
            return False
        self.count = count
        return True

    def edges(self) -> list[tuple[int, int]]:
        """The edges not used yet as (number, time)."""
        n = self.count
        return list(zip(self.numbers[:n].tolist(), self.times_us[:n].tolist(), strict=True))


class WheelEdges:
    """One sensor wheel with both polarities.

    Rising edge k stands for the angle k pitch, a falling edge for a duty share of a pitch more than
    the rising edge before it. What is extra or missing the gate finds (`edge_gate`). Teeth are
    numbered from any one on; on a wheel with `missing` teeth, numbers from 0, modulo `teeth` they
    are those of the drawing: tooth 0 where the list of missing ones counts from."""

    def __init__(
        self,
        teeth: int,
        duty_share: float,
        missing: tuple[int, ...] = (),
        stopping_rad_s2: float = MOST_RAD_S2,
    ) -> None:
        self.pitch_rad = 2.0 * np.pi / teeth
        self._duty_share = duty_share
        self._advance = edge_gate.advances(teeth, missing)
        self._candidates = np.zeros_like(self._advance)
        self._rise, self._fall = Polarity(), Polarity()
        self._counts, self._floats = edge_gate.new_state(
            self.pitch_rad, MOST_RAD_S2, stopping_rad_s2, self._advance
        )
        self.sensor = SensorCount(
            float(self._floats[edge_layout.BEND]),
            float(self._floats[edge_layout.LEAST_RATE]),
            not missing,
        )
        self.broken = 0
        """How often tooth numbers were lost: every phase reference of this wheel with them."""
        self.newest: Edge | None = None
        self.extra_us: Integers = np.empty(0, np.int64)
        """Times of the edges that were left out as extra at the last read."""

    @classmethod
    def of(cls, wheel: Wheel, stopping_rad_s2: float = MOST_RAD_S2) -> WheelEdges:
        """The edges of a wheel of the data sheet, and what its shaft may come to a stop by."""
        return cls(wheel.teeth, wheel.duty_share, wheel.missing, stopping_rad_s2)

    @property
    def health(self) -> EdgeHealth:
        """What was wrong with this wheel's edges since power-up."""
        c = self._counts
        return EdgeHealth(
            int(c[edge_layout.EXTRA]),
            int(c[edge_layout.MISSED]),
            int(c[edge_layout.DOUBTS]),
            int(c[edge_layout.STOPS]),
            bool(c[edge_layout.MODE] == edge_layout.COUNTING),
        )

    def set_dragged(self, dragged: bool) -> None:
        """Whether a synchroniser may be dragging the shaft to another speed."""
        self._counts[edge_layout.DRAGGED] = int(dragged)
        if dragged:
            self.sensor.dragged()

    def restart(self) -> None:
        """Forgets all numbers: the sensor side has restarted."""
        self._rise, self._fall = Polarity(), Polarity()
        edge_gate.forget(self._counts)
        self.sensor.restart()
        self.newest = None
        self.broken += 1

    def read(
        self,
        rise: Sequence[EdgeFrame],
        fall: Sequence[EdgeFrame],
        clock: SensorClockEstimate,
        now_us: int,
    ) -> EdgeBatch:
        """Takes this step's frames of both polarities; returns the new edges in order of time."""
        risen, fallen = self._rise, self._fall
        read_us = max(
            self._take(risen, rise, clock, now_us, False),
            self._take(fallen, fall, clock, now_us, True),
        )
        if self.sensor.anew:
            # However well its edges go on from the last ones, their wheel is at another angle.
            self.restart()
            clock.restart()
            self.extra_us = NO_EDGES.tooth
            return NO_EDGES
        counts = self._counts
        lost = int(counts[edge_layout.LOST])
        batch = self._gate(risen, fallen)
        if read_us - counts[edge_layout.TIME] > LONGEST_US:
            counts[edge_layout.STOPS] += edge_gate.lose(counts)
        if counts[edge_layout.LOST] > lost:
            self.broken += int(counts[edge_layout.LOST]) - lost
            self.newest = None
            self.sensor.lost()
        if batch.time_us.size and counts[edge_layout.MODE] == edge_layout.COUNTING:
            self.sensor.counting(
                int(counts[edge_layout.LAST]),
                risen.count,
                int(counts[edge_layout.TIME]),
                float(self._floats[edge_layout.RATE]),
            )
            self.newest = Edge(int(batch.time_us[-1]), float(batch.theta_rad[-1]))
        return batch

    def _gate(self, risen: Polarity, fallen: Polarity) -> EdgeBatch:
        room = risen.count + fallen.count
        if room == 0:
            self.extra_us = NO_EDGES.tooth
            return NO_EDGES
        edge_us, edge_rad = np.empty(room), np.empty(room)
        tooth, falling = np.empty(room, np.int64), np.empty(room, np.int64)
        extra_us = np.empty(room, np.int64)
        counts = self._counts
        extra = int(counts[edge_layout.EXTRA])
        n = edge_gate.gate_edges(
            counts,
            self._floats,
            self._advance,
            self._candidates,
            risen.numbers,
            risen.times_us,
            risen.count,
            fallen.times_us,
            fallen.count,
            self._duty_share,
            self.pitch_rad,
            edge_us,
            edge_rad,
            tooth,
            falling,
            extra_us,
        )
        risen.use(int(counts[edge_layout.NEXT]))
        fallen.use(int(counts[edge_layout.NEXT + 1]))
        self.extra_us = extra_us[: counts[edge_layout.EXTRA] - extra]
        return _new(EdgeBatch, (edge_us[:n], edge_rad[:n], tooth[:n], falling[:n]))

    def _take(
        self,
        polarity: Polarity,
        frames: Sequence[EdgeFrame],
        clock: SensorClockEstimate,
        now_us: int,
        falling: bool,
    ) -> int:
        """The time of the last frame; long ago where there is none."""
        read_us = LONG_AGO_US
        for frame in frames:
            read_us = clock.stamp(frame.read_time_us, now_us)
            polarity.take(frame, read_us)
            self.sensor.frame(falling, frame.newest_index, frame.valid_stamps, read_us)
        return read_us
