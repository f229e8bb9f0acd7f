"""A sleeve's motion along its axis, integrated ahead: from each change to what happens next.

The bodies act on the axis at events alone, and the axis on the bodies through these events and the
force on a face; so the cylinder is integrated from a change (a spool that moves, a tooth that is
met) to its next event, and its way there is kept: for the position sensor, and to be cut at a
change that comes earlier. A cut repeats the step it falls into, so the state there is as exact as
any.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.structures import Floats, RecordArray
from meshpoint.rig_sim.parts.cylinder import (
    COLUMNS,
    HIGH,
    LOW,
    POLYTROPIC,
    RESTS,
    RUNS,
    STOPS,
    AxialState,
    Cylinder,
    run_ahead,
)
from meshpoint.rig_sim.shared.sleeves import NEVER_US
from meshpoint.units import SECOND_US

SAMPLES: Final = 301
"""Of a piece of the way: 30 ms."""
LONGEST_STROKE_US: Final = 6e5
"""What takes longer counts as never."""
KEPT_US: Final = 11_000.0
"""The position sensor looks back by 10 ms."""
SCRIPTED_SAMPLES: Final = 33


class Piece(NamedTuple):
    """A piece of the way: from `since_us` to `end_us`, where `code` happens (`parts.cylinder`)."""

    since_us: float
    end_us: float
    samples: Floats
    code: int
    direction: int
    spools: tuple[bool, bool]
    """Whether those of A and B were on."""

    def position_m(self, time_us: float) -> float:
        """Position, cubic between the samples; constant beyond them."""
        rows, t = self.samples, (time_us - self.since_us) / SECOND_US
        row = bisect_right(rows[:, 0], t) - 1
        if row < 0 or row >= len(rows) - 1:
            return float(rows[max(row, 0), 1])
        h = rows[row + 1, 0] - rows[row, 0]
        s = (t - rows[row, 0]) / h
        here, there = rows[row], rows[row + 1]
        way = (1.0 + 2.0 * s) * (1.0 - s) ** 2 * here[1] + s * s * (3.0 - 2.0 * s) * there[1]
        return float(way + h * s * (1.0 - s) * ((1.0 - s) * here[2] - s * there[2]))


class AxialMotion:
    """The axis of one sleeve. `end_us` is when `code` happens; the cylinder stands there then."""

    def __init__(self, cylinder: Cylinder, position_m: float) -> None:
        self._memory = RecordArray(cylinder)
        self.cylinder = cylinder
        y = cylinder.y
        y.x_m, y.v_m_s, y.a_pa, y.b_pa = position_m, 0.0, *(cylinder.atmosphere_pa,) * 2
        self._scripted: list[Piece] = []
        self._scripted_until_us = 0.0
        self._pieces = [self._still(0.0)]

    @property
    def end_us(self) -> float:
        """When something happens on the axis; never, where it rests."""
        piece = self._pieces[-1]
        return NEVER_US if piece.code == RESTS else piece.end_us

    @property
    def code(self) -> int:
        """What happens then."""
        return self._pieces[-1].code

    def spools(self, time_us: float) -> tuple[bool, bool]:
        """Whether those of A and B were on, at most 10 ms before the newest change."""
        return self._piece_at(time_us).spools

    def push_at_n(self, time_us: float) -> float:
        """What air and detents push with, towards +x."""
        return float(self._row_at(time_us)[5])

    def moves_after(self, time_us: float) -> bool:
        """Whether the position at or after that instant may differ from the present one."""
        piece = self._pieces[-1]
        return bool(piece.since_us > time_us or piece.samples[0, 1] != piece.samples[-1, 1])

    @property
    def stands_at_m(self) -> float:
        """Where it stands; nan, if it moves."""
        return self.cylinder.y.x_m if self.cylinder.direction == 0 else math.nan

    def position_m(self, time_us: float) -> float:
        """Signed distance from neutral, at most 10 ms before the newest change."""
        return self._piece_at(time_us).position_m(time_us)

    def rests(self, time_us: float) -> bool:
        """Whether position and pressures are the same from this instant on."""
        piece = self._pieces[-1]
        return piece.code == RESTS and piece.end_us <= time_us

    def state(self, time_us: float) -> AxialState:
        """Position, speed and pressures at an instant, as exact as at an event."""
        return AxialState(*self._row_at(time_us)[1:5])

    def cut(self, time_us: float) -> None:
        """The cylinder stands at this instant; what was found of the time after it is forgotten."""
        piece = self._pieces[-1]
        if time_us < piece.end_us and time_us >= self._scripted_until_us:
            now = self._row_at(time_us)
            self.cylinder.y.vector[:] = now[1:5]
            self.cylinder.direction = piece.direction
            kept = piece.samples[: max(bisect_right(piece.samples[:, 0], now[0]), 1)]
            kept = np.concatenate((kept, now[None, :]))
            self._pieces[-1] = piece._replace(end_us=time_us, samples=kept, code=RUNS)

    def run(self, time_us: float) -> None:
        """Integrate from this instant, at which the cylinder stands, to what happens next."""
        if time_us < self._scripted_until_us:
            if time_us >= self._pieces[-1].end_us:
                self._keep_scripted()
            return
        direction = self.cylinder.direction
        samples = np.empty((SAMPLES, COLUMNS))
        count, code = run_ahead(self._memory.array, math.inf, samples)
        rows = samples[:count].copy()
        end_us = time_us + float(rows[-1, 0]) * SECOND_US
        self._keep(Piece(time_us, end_us, rows, code, direction, self._spools))

    def stop(self) -> None:
        """Something in its way takes its speed."""
        self.cylinder.y.v_m_s, self.cylinder.direction = 0.0, 0

    def place(self, position_m: float) -> None:
        """It is moved there at once, at rest; the air in its chambers goes with it."""
        c, y = self.cylinder, self.cylinder.y
        by_m = position_m - y.x_m
        a_m3 = c.dead_m3 + c.area_m2 * (c.stroke_m + y.x_m)
        b_m3 = c.dead_m3 + c.area_m2 * (c.stroke_m - y.x_m)
        y.a_pa *= (a_m3 / (a_m3 + c.area_m2 * by_m)) ** POLYTROPIC
        y.b_pa *= (b_m3 / (b_m3 - c.area_m2 * by_m)) ** POLYTROPIC
        y.x_m = position_m
        self.stop()

    def script(self, time_us: float, stops_m: tuple[float, ...], duration_s: float) -> None:
        """The bench moves it, its chambers vented: from here to the last of these places under a
        constant force, which takes this long. Each place on the way is an event (STOPS)."""
        self._scripted_until_us = 0.0
        self.cut(time_us)
        self.stop()
        self._scripted.clear()
        c, from_m = self.cylinder, self.cylinder.y.x_m
        c.a_on = c.b_on = 0
        c.y.a_pa = c.y.b_pa = c.atmosphere_pa
        way_m, begun_s = stops_m[-1] - from_m, 0.0
        for stop_m in stops_m:
            end_s = duration_s * math.sqrt(abs((stop_m - from_m) / way_m)) if way_m else duration_s
            t = np.linspace(begun_s, end_s, SCRIPTED_SAMPLES)
            rows = np.zeros((SCRIPTED_SAMPLES, COLUMNS))
            rows[:, 0] = t - begun_s
            rows[:, 1] = from_m + way_m * (t / duration_s) ** 2
            rows[:, 2] = 2.0 * way_m * t / duration_s**2
            rows[:, 3:5] = c.atmosphere_pa
            rows[-1, 1] = stop_m
            since_us, end_us = (time_us + s * SECOND_US for s in (begun_s, end_s))
            self._scripted.append(Piece(since_us, end_us, rows, STOPS, 0, self._spools))
            begun_s = end_s
        self._scripted_until_us = self._scripted[-1].end_us
        self._keep_scripted()

    @property
    def _spools(self) -> tuple[bool, bool]:
        return self.cylinder.a_on != 0, self.cylinder.b_on != 0

    def _still(self, time_us: float) -> Piece:
        rows = np.array([[0.0, *self.cylinder.y.vector, 0.0]])
        return Piece(time_us, time_us, rows, RESTS, 0, self._spools)

    def _row_at(self, time_us: float) -> Floats:
        """A sample of this instant: the step it falls into is repeated up to there."""
        piece = self._piece_at(time_us)
        t = (time_us - piece.since_us) / SECOND_US
        row = max(bisect_right(piece.samples[:, 0], t) - 1, 0)
        found: Floats = piece.samples[row].copy()
        rest_s = min(t, float(piece.samples[-1, 0])) - float(found[0])
        if rest_s > 0.0:
            probe = self.cylinder.copy()
            probe.y.vector[:] = found[1:5]
            probe.direction = piece.direction
            rows = np.empty((3, COLUMNS))
            count, _ = run_ahead(RecordArray(probe).array, rest_s, rows)
            found = rows[count - 1]
        found[0] = t
        return found

    def _piece_at(self, time_us: float) -> Piece:
        index = len(self._pieces) - 1
        while index > 0 and time_us < self._pieces[index].since_us:
            index -= 1
        return self._pieces[index]

    def _keep_scripted(self) -> None:
        piece = self._scripted.pop(0)
        self.cylinder.y.x_m, self.cylinder.y.v_m_s = float(piece.samples[-1, 1]), 0.0
        self._keep(piece)

    def _keep(self, piece: Piece) -> None:
        oldest_us = piece.since_us - KEPT_US
        while len(self._pieces) > 1 and self._pieces[1].since_us < oldest_us:
            del self._pieces[0]
        self._pieces.append(piece)


def stroke_s(cylinder: Cylinder, to_m: float) -> float:
    """From the moment the spool towards there switches, the sleeve standing in neutral with both
    chambers vented, until it is there; infinite, where it never is."""
    probe = cylinder.copy()
    probe.low_m, probe.high_m, probe.direction = -abs(to_m), abs(to_m), 0
    probe.a_on, probe.b_on = (1, 0) if to_m > 0.0 else (0, 1)
    motion = AxialMotion(probe, 0.0)
    time_us = 0.0
    while time_us < LONGEST_STROKE_US:
        motion.run(time_us)
        time_us = motion.end_us
        if motion.code == (HIGH if to_m > 0.0 else LOW):
            return time_us / SECOND_US
    return math.inf
