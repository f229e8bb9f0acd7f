"""Predicting edges by the pattern that comes back every cycle: teeth out of place, and the speed's
own swing with compression and combustion, which on a four-stroke engine takes two turns.

With p_k the learned share of a cycle that has passed at edge k, the time of an edge is t = a + b p:
a Kalman filter of time and cycle duration [t, b] over the pattern instead of over time, its
measurement noise learned from its innovations. The pattern is the mean of past cycles, each freed
of the change of speed from the cycle before.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from meshpoint.kernels.records import Vector

CYCLE_DRIFT_SHARE: Final = 0.03
"""Random walk of the cycle's duration, as a share of it, over a cycle."""
NEWEST_SHARE: Final = 0.2
"""What a cycle counts for in the pattern once some are known."""
NOISE_SHARE, START_NOISE_US, LEAST_NOISE_US = 0.02, 20.0, 2.0
START_SPREAD: Final = 0.05


class CyclePattern:
    """A filter of one wheel's edges; edges come one by one and none may be left out.

    places (m,): where in a cycle the edges of the drawing lie, shares rising from 0."""

    def __init__(self, places: Vector) -> None:
        self.shares = places.copy()
        self.cycles = 0
        """Cycles the pattern was learned from."""
        self._times: list[float] = []
        self._slots: list[int] = []
        self._x, self._p = np.zeros(2), np.zeros((2, 2))
        self._noise = START_NOISE_US**2

    def restart(self) -> None:
        """Edges were lost: the pattern stays, speed and time start anew."""
        self._times, self._slots = [], []

    def between(self, slot: int, ahead: int) -> float:
        """Share of a cycle from an edge to one some edges later."""
        whole, to = divmod(slot + ahead, self.shares.size)
        return float(self.shares[to] - self.shares[slot] + whole)

    def edge(self, slot: int, time_us: float) -> None:
        """The next edge, the slot-th of its cycle."""
        if len(self._times) == 1:
            cycle_us = (time_us - self._times[0]) / self.between(self._slots[0], 1)
            self._x[:] = time_us, cycle_us
            self._p[:] = np.diag([self._noise, (START_SPREAD * cycle_us) ** 2])
        elif self._times:
            self._update(self.between(self._slots[-1], 1), time_us)
        self._times.append(time_us)
        self._slots.append(slot)
        if slot == 0 and len(self._times) > self.shares.size:
            self._learn()

    def ahead_us(self, edges: int) -> float:
        """When the edge after this many will come; there must have been two."""
        return float(self._x[0] + self._x[1] * self.between(self._slots[-1], edges))

    def _update(self, share: float, time_us: float) -> None:
        x, p = self._x, self._p
        move = np.array([[1.0, share], [0.0, 1.0]])
        x[:] = move @ x
        walk = (CYCLE_DRIFT_SHARE * x[1]) ** 2
        shape = np.array([[share**3 / 3.0, share**2 / 2.0], [share**2 / 2.0, share]])
        p[:] = move @ p @ move.T + walk * shape
        innovation = time_us - x[0]
        seen = max(innovation**2 - p[0, 0], LEAST_NOISE_US**2)
        self._noise += NOISE_SHARE * (seen - self._noise)
        gain = p[:, 0] / (p[0, 0] + self._noise)
        x += gain * innovation
        p -= np.outer(gain, p[0])

    def _learn(self) -> None:
        """A cycle is complete: into the mean."""
        m = self.shares.size
        cycle = np.array(self._times[-m - 1 :])
        duration = cycle[-1] - cycle[0]
        shares = (cycle - cycle[0]) / duration
        if len(self._times) > 2 * m:
            before = cycle[0] - self._times[-2 * m - 1]
            bend = (duration - before) / duration
            even = np.append(self.shares, 1.0)
            shares -= 0.5 * bend * (even * even - even)
        self.cycles += 1
        weight = max(NEWEST_SHARE, 1.0 / self.cycles)
        self.shares += weight * (shares[:-1] - self.shares)
        del self._times[: -2 * m - 1], self._slots[: -2 * m - 1]
