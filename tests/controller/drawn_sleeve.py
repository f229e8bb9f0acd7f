"""A main sleeve for tests: a mass between two chambers, integrated in its own way in 20 us steps,
with valves, friction, chambers and position sensor of its own. Made by the five ways in which such
a cylinder can have the data sheet's delay."""

from __future__ import annotations

import bisect
import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

STEP_US: Final = 20
AIR_PA: Final = 1.013e5


class Cylinder(NamedTuple):
    """The mechanics."""

    feed: float = 4.2e-9
    vent: float = 4.2e-9
    dead_m3: float = 15e-6
    friction_n: float = 120.0
    damping_nsm: float = 1200.0
    detent_n: float = 0.0
    in_gear_n: float = 300.0
    static: float = 1.25
    supply_pa: float = 8.5e5 + AIR_PA


NARROW = Cylinder()
LONG_PIPE = Cylinder(feed=2e-8, vent=2e-8, dead_m3=179e-6)
BETWEEN = Cylinder(feed=1e-8, vent=1e-8, dead_m3=75e-6)
DETENT = Cylinder(feed=6.2e-9, vent=6.2e-9, detent_n=400.0)
QUICK_VENT = Cylinder(vent=6.3e-9)
CYLINDERS: Final = {
    "narrow valve": NARROW,
    "long pipe": LONG_PIPE,
    "between": BETWEEN,
    "detent": DETENT,
    "quick vent": QUICK_VENT,
}
AREA, MASS, STROKE, FACE, DETENT_M = 18e-4, 3.0, 12e-3, 5e-3, 2e-3


@njit(cache=True)
def _flow(conductance: float, from_pa: float, to_pa: float) -> float:
    if to_pa > from_pa:
        return -conductance * to_pa * _choked(from_pa / to_pa)
    return conductance * from_pa * _choked(to_pa / from_pa)


@njit(cache=True)
def _choked(ratio: float) -> float:
    return 1.0 if ratio <= 0.3 else math.sqrt(max(0.0, 1.0 - ((ratio - 0.3) / 0.7) ** 2))


@njit(cache=True)
def _move(
    c: Cylinder,
    state: tuple[float, float, float, float],
    on: tuple[bool, bool],
    limit: float,
    steps: int,
    watched: np.ndarray,
    reached: np.ndarray,
) -> tuple[float, float, float, float]:
    """Way, speed and pressures so many steps later; `reached`: in which step each place watched was
    first passed. Compiled: a stroke has 15,000 steps."""
    x, v, p0, p1 = state
    h, rt = 1e-6 * STEP_US, 1.2 * 287.05 * 293.15 * 1.185
    for step in range(1, steps + 1):
        if not on[0] and not on[1] and v == 0.0 and max(p0, p1) < AIR_PA + 50.0:
            break
        flow0 = _flow(c.feed, c.supply_pa, p0) if on[0] else _flow(c.vent, AIR_PA, p0)
        flow1 = _flow(c.feed, c.supply_pa, p1) if on[1] else _flow(c.vent, AIR_PA, p1)
        p0 += h * (rt * flow0 - 1.2 * p0 * AREA * v) / (c.dead_m3 + AREA * (STROKE + x))
        p1 += h * (rt * flow1 + 1.2 * p1 * AREA * v) / (c.dead_m3 + AREA * (STROKE - x))
        push = (p0 - p1) * AREA
        if abs(x) < DETENT_M:
            push -= c.detent_n * math.sin(math.pi * x / DETENT_M)
        left = STROKE - abs(x)
        if left < DETENT_M:
            push += math.copysign(c.in_gear_n, x) * math.sin(math.pi * left / DETENT_M)
        if v == 0.0 and abs(push) <= c.static * c.friction_n:
            continue
        side = math.copysign(1.0, v if v != 0.0 else push)
        new = v + h * (push - side * c.friction_n - c.damping_nsm * v) / MASS
        v = 0.0 if new * v < 0.0 else new
        before, x = x, x + h * v
        if abs(x) >= limit > abs(before) or abs(x) >= STROKE:
            x, v = math.copysign(limit, x), 0.0
        for k, place in enumerate(watched):
            if not reached[k] and abs(before) < abs(place) <= abs(x) + 1e-9 and place * x > 0.0:
                reached[k] = step
    return x, v, p0, p1


class DrawnSleeve:
    """One sleeve of one gearbox, with what differs from stroke to stroke."""

    def __init__(self, cylinder: Cylinder, seed: int, scatter_s: float = 3e-4) -> None:
        self.rng = np.random.default_rng(seed)
        draw = self.rng.uniform
        self.cylinder = cylinder._replace(
            friction_n=cylinder.friction_n * draw(0.8, 1.2),
            damping_nsm=cylinder.damping_nsm * draw(0.8, 1.2),
            in_gear_n=cylinder.in_gear_n * draw(0.5, 1.5),
        )
        self.on_s = [12e-3 + draw(-2e-3, 2e-3) for _ in range(2)]
        self.off_s = [12e-3 + draw(-2e-3, 2e-3) for _ in range(2)]
        self.offset_m, self.gain = draw(-3e-4, 3e-4), 1.0 + draw(-0.015, 0.015)
        self.scatter_s = scatter_s
        self.noise_m = 4e-5
        self.teeth_at: float | None = None
        """A tooth stops it there; None: it meets a gap."""
        self.now_us = 0
        self.x = self.v = 0.0
        self.p = [AIR_PA, AIR_PA]
        self.on = [False, False]
        self._spools: list[tuple[float, int, bool]] = []
        self.reached_us: dict[float, float] = {}
        """When it first passed a place, by place."""
        self.watched: tuple[float, ...] = (FACE, -FACE)

    def copy(self) -> DrawnSleeve:
        """The same sleeve in the same state; its chance goes on from the same point."""
        other = object.__new__(DrawnSleeve)
        other.__dict__ = {**self.__dict__}
        other.p, other.on, other._spools = [*self.p], [*self.on], [*self._spools]
        other.reached_us = {**self.reached_us}
        other.rng = np.random.default_rng()
        other.rng.bit_generator.state = self.rng.bit_generator.state
        return other

    def command(self, valve: int, on: bool, time_us: int) -> None:
        """The coil switches then; its spool after its delay and chance."""
        late_s = (self.on_s if on else self.off_s)[valve]
        late_s += float(np.clip(self.rng.normal(0.0, self.scatter_s), -3e-3, 3e-3))
        bisect.insort(self._spools, (time_us + 1e6 * late_s, valve, on))

    def advance(self, until_us: int) -> None:
        """On to this time (us)."""
        limit = STROKE if self.teeth_at is None else self.teeth_at
        while self.now_us < until_us:
            while self._spools and self._spools[0][0] <= self.now_us:
                _, valve, on = self._spools.pop(0)
                self.on[valve] = on
            next_us = min([until_us, *(each[0] for each in self._spools[:1])])
            steps = math.ceil((next_us - self.now_us) / STEP_US)
            reached = np.zeros(len(self.watched), np.int64)
            self.x, self.v, *self.p = _move(
                self.cylinder, (self.x, self.v, *self.p), (self.on[0], self.on[1]),
                limit, steps, np.array(self.watched), reached,
            )  # fmt: skip
            for place, step in zip(self.watched, reached.tolist(), strict=True):
                if step:
                    self.reached_us.setdefault(place, self.now_us + step * STEP_US)
            self.now_us += steps * STEP_US

    def reading_m(self) -> float:
        """A sample of the position sensor."""
        noise_m = float(self.rng.normal(0.0, self.noise_m))
        return self.gain * self.x + self.offset_m + noise_m
