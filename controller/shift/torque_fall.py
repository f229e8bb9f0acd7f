"""How far the engine's torque has fallen, by what the engine says (EEC1), what will be left, and
how the engine changes its speed meanwhile."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from meshpoint.units import SECOND_US

MEASUREMENTS: Final = 6
"""The engine's acceleration is that of its last 50 ms."""
LONGEST_GAP_US: Final = 25_000
"""Over a longer pause in what the engine says nobody knows what it did."""


class TorqueFall:
    """The engine's torque as it says it to be, and what will be left of it."""

    def __init__(self) -> None:
        self._newest: tuple[int, float] | None = None
        self._before: tuple[int, float] | None = None
        self.step = 0.01
        """The engine says it in steps of this share of its reference torque."""
        self._speeds: deque[tuple[int, float]] = deque(maxlen=MEASUREMENTS)

    def take(
        self, now_us: int, share: float | None, step: float = 0.01, speed_rad_s: float | None = None
    ) -> None:
        """One step's torque, as a share of the engine's reference torque, None: nothing new; and in
        which steps it is said; and the engine's speed."""
        if speed_rad_s is not None:
            if self._speeds and now_us - self._speeds[-1][0] > LONGEST_GAP_US:
                self._speeds.clear()
            self._speeds.append((now_us, speed_rad_s))
        if share is not None:
            self._before, self._newest, self.step = self._newest, (now_us, share), step

    @property
    def engine_rad_s2(self) -> float:
        """The engine's acceleration; 0 before it was seen for long enough."""
        if len(self._speeds) < MEASUREMENTS:
            return 0.0
        (first_us, first), (last_us, last) = self._speeds[0], self._speeds[-1]
        return (last - first) / max(1, last_us - first_us) * SECOND_US

    @property
    def share(self) -> float | None:
        """The newest torque; None where the engine says none."""
        return None if self._newest is None else self._newest[1]

    def left_in(self, ahead_s: float) -> float | None:
        """The torque after so long, falling toward zero exponentially as it does now; None where
        the engine says none."""
        if self._newest is None:
            return None
        now_us, share = self._newest
        if self._before is None or share == 0.0:
            return share
        before_us, before = self._before
        if now_us <= before_us or share * before <= 0.0 or abs(share) >= abs(before):
            return share
        rate = math.log(share / before) / ((now_us - before_us) / SECOND_US)
        return share * math.exp(rate * ahead_s)
