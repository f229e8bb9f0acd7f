"""Rising and falling edges of the four wheels over a time, with no data sheet: times and numbers.

A frame's stamps are chained back from its newest edge. What is asked afterwards: how many edges of
each wheel, and when, while something was in mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from meshpoint.commission.shafts import EDGES, INDEX_MODULUS, Shaft
from meshpoint.dbc.messages import EEC1, Message
from meshpoint.dbc.sensor_time import chained_us
from meshpoint.gearbox.gears import MainGear, Range, Split
from meshpoint.kernels.records import Vector
from meshpoint.results.road_speed import span_us


class State(NamedTuple):
    """What is in mesh, as the sleeves' positions say."""

    split: Split
    gear: MainGear
    range_: Range


@dataclass
class Window:
    """A time of steady turning. Sensor clock, us."""

    state: State
    start_us: int
    end_us: int
    engine_rad_s: list[float]
    """Samples of the engine's speed."""

    @property
    def turns(self) -> float:
        """Of the engine."""
        mean = float(np.mean(self.engine_rad_s)) if self.engine_rad_s else 0.0
        return mean * (self.end_us - self.start_us) * 1e-6 / (2.0 * np.pi)


class Track:
    """The edges of one polarity of one wheel."""

    def __init__(self) -> None:
        self.times: list[int] = []
        self.numbers: list[int] = []
        self._index: int | None = None

    def take(self, frame: Any, read_us: int) -> None:
        """One edge frame; read_us: its read time on the clock of all."""
        valid, before, index = frame.valid_stamps, self._index, frame.newest_index
        self._index = index
        if before is None or valid == 0 or frame.stopped:
            return
        fresh = (index - before) % INDEX_MODULUS
        if fresh == 0 or fresh >= INDEX_MODULUS // 2:
            return
        number = (self.numbers[-1] if self.numbers else 0) + fresh
        # What came in before a standstill cannot be chained over it.
        known = min(fresh, 1 if frame.long_interval else valid)
        times = chained_us(read_us, frame.timestamp_low_us[:known])
        self.times.extend(reversed(times))
        self.numbers.extend(range(number - known + 1, number + 1))


class EdgeLog:
    """All wheels, the engine's speed, and the windows in which something was in mesh."""

    def __init__(self) -> None:
        self.tracks = {(shaft, falling): Track() for shaft in Shaft for falling in (0, 1)}
        self.windows: list[Window] = []
        self.engine_rad_s: float | None = None
        self.now_us = 0
        self._open: Window | None = None

    def take(self, message: Message) -> None:
        """Any message of sensor side and engine."""
        place = EDGES.get(type(message))
        if place is not None:
            frame: Any = message
            self.now_us += span_us(frame.read_time_us, self.now_us & 0xFFFF_FFFF)
            self.tracks[place].take(frame, self.now_us)
        elif isinstance(message, EEC1) and message.engine_speed_rad_s is not None:
            self.engine_rad_s = message.engine_speed_rad_s
            if self._open is not None:
                self._open.engine_rad_s.append(message.engine_speed_rad_s)

    def begin(self, state: State) -> None:
        """From here on the shafts turn steadily in this state."""
        self._open = Window(state, self.now_us, self.now_us, [])

    def end(self) -> None:
        """Up to here."""
        if self._open is not None:
            self._open.end_us = self.now_us
            self.windows.append(self._open)
            self._open = None

    def edges(self, shaft: Shaft, window: Window, falling: int = 0) -> tuple[Vector, Vector]:
        """Times (us, from the window's start) and running numbers of a wheel's edges in it."""
        track = self.tracks[shaft, falling]
        times = np.array(track.times, dtype=np.float64)
        numbers = np.array(track.numbers, dtype=np.float64)
        inside = (times >= window.start_us) & (times <= window.end_us)
        return times[inside] - window.start_us, numbers[inside]
