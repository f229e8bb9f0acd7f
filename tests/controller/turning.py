"""A sensor wheel that turns as its motion says, with faults in what its sensor sees."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from wheel import READ_US, capture

from meshpoint.controller.measure.clock import SensorClockEstimate
from meshpoint.controller.measure.wheel_edges import WheelEdges
from meshpoint.dbc.messages import EdgesMainFall, EdgesMainRise

LEAD_US = 1 << 20
"""Sensor time at the start: frames want a past."""


@dataclass(frozen=True)
class Turning:
    """Angle in pitches: speed and acceleration in pitches and s; what is braked stays standing."""

    teeth: int
    duty: float
    rate: float
    bend: float
    until_s: float
    missing: tuple[int, ...] = ()

    def angle(self, time_s: float) -> float:
        if self.bend < 0.0:
            time_s = min(time_s, -self.rate / self.bend)
        return self.rate * time_s + 0.5 * self.bend * time_s * time_s

    def time_of(self, angle: float) -> float:
        """The instant of an angle; of a wheel that does not get there, infinity."""
        root = self.rate * self.rate + 2.0 * self.bend * angle
        return math.inf if root < 0.0 else 2.0 * angle / (self.rate + math.sqrt(root))

    def edges(self, falling: int) -> dict[int, float]:
        """True times of this polarity's edges by tooth."""
        found: dict[int, float] = {}
        tooth = 1
        while (at := self.time_of(tooth + self.duty * falling)) <= self.until_s:
            if tooth % self.teeth not in self.missing:
                found[tooth] = at
            tooth += 1
        return found


@dataclass
class Seen:
    """What the controller made of a wheel's frames: times, places in pitches, and the losses."""

    time_us: list[int] = field(default_factory=list)
    place: list[float] = field(default_factory=list)
    falling: list[int] = field(default_factory=list)
    part: list[int] = field(default_factory=list)
    """How often the teeth were lost before each edge."""
    edges: WheelEdges | None = None

    def offsets(self, motion: Turning) -> dict[int, list[float]]:
        """Place said less true angle of each edge, for each part between losses."""
        parts: dict[int, list[float]] = {}
        for time_us, place, part in zip(self.time_us, self.place, self.part, strict=True):
            true = motion.angle((time_us - LEAD_US) * 1e-6)
            parts.setdefault(part, []).append(place - true)
        return parts

    def teeth_wrong(self, motion: Turning) -> list[float]:
        """How far, in pitches, edges lie from the tooth they were said to be of."""
        wrong: list[float] = []
        for offsets in self.offsets(motion).values():
            if motion.missing:
                turn = motion.teeth
                wrong += [abs((off + turn / 2) % turn - turn / 2) for off in offsets]
            else:
                wrong += [abs(off - round(offsets[0])) for off in offsets]
        return wrong


def run(
    motion: Turning,
    rise_s: list[float],
    fall_s: list[float],
    most_rad_s2: float,
    just_powered_up: bool = False,
) -> Seen:
    """All reads of 10 ms with these edges in them, each frame received. Frames are full from the
    first on, as a sensor's that has been powered for long, unless it has not."""
    rise = sorted({LEAD_US + round(t * 1e6) for t in rise_s})
    fall = sorted({LEAD_US + round(t * 1e6) for t in fall_s})
    wheel = WheelEdges(motion.teeth, motion.duty, motion.missing, most_rad_s2)
    clock, seen = SensorClockEstimate(), Seen()
    before = [] if just_powered_up else [LEAD_US - 100_000 * k for k in range(27, 0, -1)]
    for read_us in range(LEAD_US, LEAD_US + round(motion.until_s * 1e6) + 1, READ_US):
        risen = EdgesMainRise(**capture(before + rise, 1, read_us))
        fallen = EdgesMainFall(**capture(before + fall, 1, read_us))
        batch = wheel.read([risen], [fallen], clock, read_us)
        seen.time_us += batch.time_us.astype(int).tolist()
        seen.place += (batch.tooth + motion.duty * batch.falling).tolist()
        seen.falling += batch.falling.tolist()
        seen.part += [wheel.broken] * batch.time_us.size
    seen.edges = wheel
    return seen
