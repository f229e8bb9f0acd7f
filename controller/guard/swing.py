"""How a shaft's speed changes and has changed, from the guard's own speeds.

In neutral the main shaft hangs on the driveline alone and swings with it, to and fro through the
backlash of the final drive: within the time from a firing to its contact by more than the slip
window is wide. What it may do next is bounded by what it has done within one period; where that
was a swing of one frequency, by that swing (`one_swing`).
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

from meshpoint.controller.guard import one_swing
from meshpoint.controller.guard.own_speed import ShaftSpeed

PERIOD_US: Final = 180_000
"""In so long a driveline in neutral has swung to both its ends, and as fast as it does."""
RATE_SPEEDS: Final = 2
"""A rate is taken from a speed and the one this many before it: over 20 ms, since neighbouring ones
are measured over teeth that they share."""
RATE_GAP_US: Final = PERIOD_US // 4
"""Speeds further apart say nothing of a rate: a quarter of a swing lies between. Two ticks of 20 ms
have room in it."""


class Swing(NamedTuple):
    """A shaft's newest speed, the rate at which it changes (rad/s2), and both within a period, the
    newest last."""

    newest: ShaftSpeed
    rate_rad_s2: float
    speeds: tuple[ShaftSpeed, ...]
    rates_rad_s2: tuple[float, ...]

    def between(self, from_us: float, until_us: float) -> tuple[float, float]:
        """Least and greatest speed (rad/s) between two times: as it swings; or else, from now on,
        as fast as it has changed within a period, as far as it has been."""
        swings = one_swing.between(self.speeds, from_us, until_us)
        if swings is not None:
            return swings
        ahead_s = max(0.0, until_us - self.newest.time_us) * 1e-6
        now, omegas = self.newest.omega_rad_s, [each.omega_rad_s for each in self.speeds]
        falls, rises = min(0.0, *self.rates_rad_s2), max(0.0, *self.rates_rad_s2)
        return max(min(omegas), now + falls * ahead_s), min(max(omegas), now + rises * ahead_s)


class SwingMemory:
    """One shaft's speeds of the last period."""

    def __init__(self) -> None:
        self._speeds: deque[ShaftSpeed] = deque()
        self._rates: deque[float] = deque()
        self._rated_us: deque[int] = deque()
        """The time of each one's newer speed."""

    def forget(self) -> None:
        """The sensors' clock is another: nothing of before holds."""
        self._speeds.clear()
        self._rates.clear()
        self._rated_us.clear()

    def take(self, speed: ShaftSpeed | None) -> Swing | None:
        """The newest speed, which may be the one before or none; None while no rate is known."""
        if speed is None:
            return None
        speeds, rates, rated_us = self._speeds, self._rates, self._rated_us
        if not speeds or speed.time_us > speeds[-1].time_us:
            speeds.append(speed)
            self._add_rate()
        since_us = speeds[-1].time_us - PERIOD_US
        while speeds[0].time_us < since_us:
            speeds.popleft()
        while rated_us and rated_us[0] < since_us:
            rated_us.popleft()
            rates.popleft()
        if not rated_us or rated_us[-1] != speeds[-1].time_us:
            return None
        return Swing(speeds[-1], rates[-1], tuple(speeds), tuple(rates))

    def _add_rate(self) -> None:
        if len(self._speeds) <= RATE_SPEEDS:
            return
        newest, before = self._speeds[-1], self._speeds[-1 - RATE_SPEEDS]
        passed_us = newest.time_us - before.time_us
        if passed_us <= RATE_GAP_US:
            self._rates.append((newest.omega_rad_s - before.omega_rad_s) / passed_us * 1e6)
            self._rated_us.append(newest.time_us)
