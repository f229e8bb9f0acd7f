"""From edge frames to teeth: unwrapped times and running tooth numbers of one wheel.

An edge frame is the thesis's figure 2.2: the last 27 timestamps of one polarity as their low 16
bits, newest first, with the running number of the newest. So a lost frame loses no edge as long as
fewer than 27 came since, and the tooth number is never lost.

Where it is lost all the same, the running number bounds by how many teeth the wheel was renumbered.
The sensor goes on counting edges while the gate (`gate_kernels`) is not sure of tooth numbers:
while frames are lost, and while a wheel stops and starts again. It cannot count backwards, so each
of E edges may have been a tooth passing in reverse. The tooth that now has number t had number
t + k before, with k between a - 2 E and a, where a is the count if all edges went forward; some
teeth are added at both ends for edges that a sensor misses. Where there was no time to stop and
start again, no edge went backwards and k = a. With k modulo the wheel's teeth known from its tooth
pattern (`estimate/teeth`), the number of whole turns follows, or only a few are possible.

No bound is given after a loss at speed while all frames arrived (the sensor was blind and has not
counted), nor for a wheel with missing teeth, whose edges are not its teeth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.gate import (
    ALONE,
    COUNTING,
    GAPS_TO_TURN,
    SEEKING,
    new_gate,
    teeth_of,
)
from meshpoint.controller.measure.gate_kernels import gate_edges, stand, turn
from meshpoint.controller.measure.inputs import (
    BROKEN,
    CHAIN,
    STAMPS,
    EdgeFrame,
    chain_edges,
    pack_frame,
)
from meshpoint.gearbox.wheels import Wheel
from meshpoint.kernels.records import Integers, RecordMemory, Vector

LONGEST_GAP_US: Final = 5_000_000
"""Without a frame for longer, the 16 bits may have gone round: 120 teeth at 6,000 rpm: 5.4 s."""
LOST_FRAMES_US: Final = 50_000
SLACK: Final = 3
"""Teeth: edges that wait for their verdict, were left out, or were missed beside a stop."""
STOPPING: Final = 1.5
"""Up to this many times the least speed of a count a wheel may have come to a stop."""

LONG_AGO_US: Final = -(1 << 62)
LONGEST_US: Final = 65_535
"""Without an edge for longer than a 16-bit stamp covers, the wheel counts as standing still."""
MOST_RAD_S2: Final = 300.0
"""Largest acceleration of a shaft: a layshaft of 0.33 kg m2 braked with 100 Nm."""
BRAKED_RAD_S2: Final = 170.0
"""Largest deceleration to standstill of a shaft that drives the wheels: 8 m/s2, tyre 0.5 m, axle
ratio 2.85, range ratio 3.75."""
_ROOM: Final = 4 * STAMPS
_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling


class Renumbered(NamedTuple):
    """Old tooth number less new one, summed over all losses: the least and the most it can be."""

    least: int = 0
    most: int = 0
    uncounted: int = 0
    """Number of losses without a bound: two values are comparable only if this is equal."""


class _Count(NamedTuple):
    ahead: int
    """Tooth number less the sensor's running number."""
    rises: int
    falls: int
    time_us: int
    rate: float
    """Pitches a microsecond."""


class SensorCount:
    """The running numbers of both polarities of a wheel, unwrapped, beside its tooth numbers."""

    def __init__(self, most_bend: float, least_rate: float, whole: bool) -> None:
        """Half the largest acceleration, pitches/us2; the least speed of a count, pitches/us;
        whether the wheel has all its teeth."""
        self._most_bend, self._least_rate, self._whole = most_bend, least_rate, whole
        self._numbers = [0, 0]
        self._indices: list[int | None] = [None, None]
        self._read_us, self._stamps = [0, 0], [0, 0]
        self._last: _Count | None = None
        self._before: _Count | None = None
        """As it was when teeth were lost that are not numbered again yet."""
        self._gap_us = 0
        self._dragged = False
        self.anew = False
        """Whether the sensor has restarted its count after a loss of power; then call `restart`."""
        self.renumbered = Renumbered()

    def dragged(self) -> None:
        """A synchroniser may change the speed at once."""
        self._dragged = True

    def frame(self, falling: bool, index: int, stamps: int, read_us: int) -> None:
        """A frame: the running number of its newest edge, and how many stamps it holds."""
        before = self._indices[falling]
        if before is not None:
            gap_us = read_us - self._read_us[falling]
            self._gap_us = max(self._gap_us, gap_us)
            self._numbers[falling] += (index - before) & 0xFFFF
            if gap_us > LONGEST_GAP_US:
                self._doubt()
        if stamps < self._stamps[falling]:
            self.anew = True  # an array gets emptier in no other way
        self._indices[falling], self._read_us[falling] = index, read_us
        self._stamps[falling] = stamps

    def lost(self) -> None:
        """Teeth are not numbered any more."""
        before = self._before = self._before or self._last
        slow = before is not None and before.rate < STOPPING * self._least_rate
        if not self._whole or not (slow or self._gap_us > LOST_FRAMES_US):
            self._doubt()

    def counting(
        self, tooth: int, waiting: int, time_us: int, rate: float, turned: bool = False
    ) -> None:
        """Tooth of the last rising edge that has one (falling, where teeth begin with those:
        `turned`); how many newer edges wait for theirs; when the last tooth came, and the speed,
        pitches/us."""
        rises, falls = self._numbers[::-1] if turned else self._numbers
        now = _Count(tooth - (rises - waiting), rises, falls, time_us, rate)
        if self._before is not None:
            self._join(self._before, now)
        self._last, self._before = now, None
        self._gap_us, self._dragged = 0, False

    def restart(self) -> None:
        """Takes the sensor's restarted count."""
        self._indices, self._last, self._before = [None, None], None, None
        self.anew = False
        self._doubt()

    def _join(self, before: _Count, now: _Count) -> None:
        edges, falls = now.rises - before.rises, now.falls - before.falls
        if abs(edges - falls) > SLACK:
            self._doubt()
        stop_us = (before.rate + now.rate) / (2.0 * self._most_bend)
        if now.time_us - before.time_us < stop_us and not self._dragged:
            edges = 0
        forward, total = before.ahead - now.ahead, self.renumbered
        least = total.least + forward - 2 * edges - SLACK
        self.renumbered = Renumbered(least, total.most + forward + SLACK, total.uncounted)

    def _doubt(self) -> None:
        self.renumbered = self.renumbered._replace(uncounted=self.renumbered.uncounted + 1)


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
