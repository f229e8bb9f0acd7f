"""From edge frames to teeth: unwrapped times and running tooth numbers of one wheel.

An edge frame is the thesis's figure 2.2: the last 27 timestamps of one polarity as their low 16
bits, newest first, with the running number of the newest. So a lost frame loses no edge as long as
fewer than 27 came since, and the tooth number is never lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np

from meshpoint.controller.measure.chain_kernels import (
    BROKEN,
    CHAIN,
    STAMPS,
    chain_edges,
    pack_frame,
)
from meshpoint.controller.measure.gate_kernels import gate_edges, stand, turn
from meshpoint.controller.measure.gate_layout import (
    ALONE,
    COUNTING,
    GAPS_TO_TURN,
    SEEKING,
    new_gate,
    teeth_of,
)
from meshpoint.controller.measure.sensor_clock import SensorClockEstimate
from meshpoint.controller.measure.sensor_count import SensorCount
from meshpoint.gearbox.sheet import Wheel
from meshpoint.kernels.records import Integers, RecordMemory, Vector

LONG_AGO_US: Final = -(1 << 62)
LONGEST_US: Final = 65_535
"""Without an edge for longer than a 16-bit stamp covers, the wheel counts as standing still."""
MOST_RAD_S2: Final = 300.0
"""Largest acceleration of a shaft: a layshaft of 0.33 kg m2 braked with 100 Nm."""

BRAKED_RAD_S2: Final = 170.0
"""Largest deceleration to standstill of a shaft that drives the wheels: 8 m/s2, tyre 0.5 m, axle
ratio 2.85, range ratio 3.75."""


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
    def sensor_fault(self) -> bool:
        """The sensor's supply or signal is out of range: its edges are none."""

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

    def split(self, time_us: float) -> tuple[EdgeBatch, EdgeBatch]:
        """The edges up to a time, and those after it."""
        k = int(np.searchsorted(self.time_us, time_us, side="right"))
        times, angles, teeth, falling = self
        return (
            EdgeBatch(times[:k], angles[:k], teeth[:k], falling[:k]),
            EdgeBatch(times[k:], angles[k:], teeth[k:], falling[k:]),
        )


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
        self._chain = RecordMemory(CHAIN)
        self.rows: Integers = np.empty((2, _ROOM), np.int64)
        """Running numbers and times (us) of edges."""
        self.count = 0
        """Number of edges not used yet; these come first, oldest first."""

    def use(self, used: int) -> None:
        """Drops the first `used` edges; the others are kept for the next step."""
        left = self.count - used
        if left and used:
            self.rows[:, :left] = self.rows[:, used : self.count].copy()
        self.count = left

    def take(self, frame: EdgeFrame, read_us: int) -> bool:
        """Appends the edges since the last frame.

        False when the chain is broken: the wheel stood still or more edges came than one frame
        holds. The other polarity may still know the wheel's tooth numbers."""
        if self.count + STAMPS > self.rows.shape[1]:
            self.rows = np.concatenate((self.rows, np.empty_like(self.rows)), axis=1)
        chain = self._chain.flat
        pack_frame(
            chain.data,
            0,
            frame.newest_index,
            frame.valid_stamps,
            frame.long_interval,
            frame.stopped,
            read_us,
            *frame.timestamp_low_us,
        )
        count = chain_edges(chain, self.rows, self.count)
        if count == BROKEN:
            return False
        self.count = count
        return True

    def edges(self) -> list[tuple[int, int]]:
        """The edges not used yet as (number, time)."""
        numbers, times_us = self.rows[:, : self.count].tolist()
        return list(zip(numbers, times_us, strict=True))


class WheelEdges:
    """One sensor wheel with both polarities.

    Rising edge k stands for the angle k pitch, a falling edge for a duty share of a pitch more than
    the rising edge before it. What is extra or missing the gate finds (`gate_kernels`). Teeth are
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
        self._teeth = teeth_of(teeth, missing)
        self._rise, self._fall = Polarity(), Polarity()
        widest = int(self._teeth[0].max())
        self._gate = new_gate(self.pitch_rad, duty_share, MOST_RAD_S2, stopping_rad_s2, widest)
        self.sensor = SensorCount(
            self._gate.part("bend_per_us2").item(),
            self._gate.part("least_rate_per_us").item(),
            not missing,
        )
        self._lead, self._other = self._rise, self._fall
        self._alone = 0
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
        """Counts of defects of this wheel's edges since power-up."""
        gate = self._gate
        return EdgeHealth(
            gate.extra.item(),
            gate.part("missed").item(),
            gate.part("doubts").item(),
            gate.part("stops").item(),
            gate.mode.item() == COUNTING,
        )

    @property
    def begins_falling(self) -> bool:
        """Whether teeth begin with their falling edge: the wheel's gaps end with one, or no other
        edge comes."""
        return self._lead is self._fall

    def set_dragged(self, dragged: bool) -> None:
        """Whether a synchroniser may be dragging the shaft to another speed."""
        self._gate.dragged[0] = dragged
        if dragged:
            self.sensor.dragged()

    def restart(self) -> None:
        """Forgets all numbers: the sensor side has restarted."""
        turned = self._lead is self._fall
        self._rise, self._fall = Polarity(), Polarity()
        self._lead, self._other = self._rise, self._fall
        if turned:
            self._lead, self._other = self._fall, self._rise
        self._gate.forget()
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
        gate = self._gate
        lost = gate.lost.item()
        batch = self._judge()
        if read_us - gate.time_us.item() > LONGEST_US:
            stand(gate.flat)
        lost_now = gate.lost.item() - lost
        if lost_now > 0:
            self.broken += lost_now
            self.newest = None
            self.sensor.lost()
        if batch.time_us.size and gate.mode.item() == COUNTING:
            self.sensor.counting(
                gate.last.item(0),
                self._lead.count,
                gate.time_us.item(),
                gate.rate_per_us.item(),
                self._lead is fallen,
            )
            self.newest = Edge(int(batch.time_us[-1]), float(batch.theta_rad[-1]))
        return batch

    def _judge(self) -> EdgeBatch:
        lead, other, gate = self._lead, self._other, self._gate
        room = lead.count + other.count
        if room == 0:
            self.extra_us = NO_EDGES.tooth
            return NO_EDGES
        if lead.count == 0 and gate.mode.item() == SEEKING:
            self._alone += other.count
        else:
            self._alone = 0
        gate.given[0], gate.given[1] = lead.count, other.count
        edges, numbers = np.empty((2, room)), np.empty((3, room), np.int64)
        extra = gate.extra.item()
        n = gate_edges(gate.flat, self._teeth, lead.rows, other.rows, edges, numbers)
        lead.use(gate.used.item(0))
        other.use(gate.used.item(1))
        self.extra_us = numbers[2, : gate.extra.item() - extra]
        alone = self._alone >= ALONE
        if (alone or gate.other_gaps.item() >= GAPS_TO_TURN) and turn(gate.flat, int(alone)):
            self._lead, self._other, self._alone = other, lead, 0
        return _new(EdgeBatch, (edges[0, :n], edges[1, :n], numbers[0, :n], numbers[1, :n]))

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
            if frame.sensor_fault:
                continue
            polarity.take(frame, read_us)
            self.sensor.frame(falling, frame.newest_index, frame.valid_stamps, read_us)
        return read_us
