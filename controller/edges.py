"""From edge frames to teeth: unwrapped times and running tooth numbers of one wheel.

An edge frame is the thesis's figure 2.2: the last 27 timestamps of one polarity as their low 16
bits, newest first, with the running number of the newest. So a lost frame loses no edge as long as
fewer than 27 came since, and the tooth number is never lost.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from controller.clock import SensorClock
from controller.kernels import Vector


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
    """New edges of one wheel, both polarities, rising in time."""

    time_us: Vector
    theta_rad: Vector


NO_EDGES = EdgeBatch(np.empty(0), np.empty(0))


@dataclass
class Polarity:
    """One polarity of a wheel: the chain of its frames."""

    index: int = 0
    """Running number of the newest edge, unwrapped."""
    time_us: int = 0
    """Its sensor time; meaningless while `index` is 0."""
    started: bool = False

    def read(self, frame: EdgeFrame, read_us: int) -> list[tuple[int, int]] | None:
        """The edges since the last frame as (number, time), oldest first.

        None when the chain is broken: the wheel stood still or more edges came than one frame
        holds, so tooth numbers before and after cannot be tied together."""
        if frame.valid_stamps == 0:
            return []
        fresh = (frame.newest_index - self.index) & 0xFFFF
        if not self.started:
            # With a long interval in the array only the newest edge can be placed.
            fresh = 1 if frame.long_interval else frame.valid_stamps
            self.index = frame.newest_index - fresh
        if fresh == 0:
            return []
        lost = frame.stopped or fresh > frame.valid_stamps
        edges = None if lost else self._chain(frame, read_us, fresh)
        if edges is None:
            # A wheel that has not begun to count has nothing to lose.
            had_begun = self.started
            self._restart(read_us)
            return None if had_begun else []
        self.started = True
        self.index, self.time_us = edges[-1]
        return edges

    def _chain(self, frame: EdgeFrame, read_us: int, fresh: int) -> list[tuple[int, int]] | None:
        low = frame.timestamp_low_us
        time_us = read_us - ((read_us - low[0]) & 0xFFFF)
        number = self.index + fresh
        edges = [(number, time_us)]
        for k in range(1, fresh):
            time_us -= (low[k - 1] - low[k]) & 0xFFFF
            edges.append((number - k, time_us))
        if self.started and fresh < frame.valid_stamps:
            # The edge before the oldest new one is known already: the chain must lead to it.
            if time_us - ((low[fresh - 1] - low[fresh]) & 0xFFFF) != self.time_us:
                return None
        elif self.started and frame.long_interval:
            return None
        edges.reverse()
        return edges

    def _restart(self, read_us: int) -> None:
        self.started = False
        self.index = 0
        self.time_us = read_us


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
        self._last_us = -(1 << 62)
        self.broken = 0
        """How often tooth numbers were lost: every phase reference of this wheel with them."""
        self.newest: Edge | None = None

    def restart(self) -> None:
        """Forgets all numbers: the sensor side has restarted."""
        self._rise, self._fall = Polarity(), Polarity()
        self._fall_shift = None
        self._last_us = -(1 << 62)
        self.newest = None
        self.broken += 1

    def read(
        self, rise: list[EdgeFrame], fall: list[EdgeFrame], clock: SensorClock, now_us: int
    ) -> EdgeBatch:
        """Takes this step's frames of both polarities; returns the new edges in order of time."""
        risen = self._read(self._rise, rise, clock, now_us)
        fallen = self._read(self._fall, fall, clock, now_us)
        pitch = self.pitch_rad
        edges = [(t, k * pitch) for k, t in risen]
        if self._fall_shift is None:
            self._pair(risen, fallen)
        if self._fall_shift is not None:
            shift = self._fall_shift + self._duty_share
            edges += [(t, (k + shift) * pitch) for k, t in fallen]
        edges.sort()
        if edges and edges[0][0] <= self._last_us:
            # A polarity that was late must not turn time back in the filters.
            edges = [edge for edge in edges if edge[0] > self._last_us]
        if not edges:
            return NO_EDGES
        self.newest = Edge(*edges[-1])
        self._last_us = edges[-1][0]
        table = np.array(edges, dtype=np.float64)
        return EdgeBatch(table[:, 0].copy(), table[:, 1].copy())

    def _read(
        self, polarity: Polarity, frames: list[EdgeFrame], clock: SensorClock, now_us: int
    ) -> list[tuple[int, int]]:
        edges: list[tuple[int, int]] = []
        for frame in frames:
            fresh = polarity.read(frame, clock.stamp(frame.read_time_us, now_us))
            if fresh is None:
                edges.clear()
                self._fall_shift = None
                self.newest = None
                self.broken += 1
            else:
                edges += fresh
        return edges

    def _pair(self, risen: list[tuple[int, int]], fallen: list[tuple[int, int]]) -> None:
        for (number, before), (_, after) in itertools.pairwise(risen):
            for fall_number, time_us in fallen:
                if before < time_us < after:
                    self._fall_shift = number - fall_number
                    return
