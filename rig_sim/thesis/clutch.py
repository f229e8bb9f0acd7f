"""Clutch and engine, as far as this preset needs them: a delay each way, and a speed for EEC1.

The clutch position moves linearly, over the sheet's whole delay from one end to the other. Without
a valid command for 100 ms it opens. The engine turns with the input shaft while the clutch is
closed, judged at the 10 ms reads, and otherwise falls or rises to idle with a first-order lag.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.gearbox.sheet import Clutch
from meshpoint.rig_sim.shared.valve_drivers import EXPIRY_US
from meshpoint.units import RPM, US

IDLE_RAD_S: Final = 600.0 * RPM
LAG_S: Final = 0.5


class ClutchActuator:
    """Position 0 (open) to 1 (closed)."""

    def __init__(self, clutch: Clutch) -> None:
        self._clutch = clutch
        self._since_us = 0
        self._from = 1.0
        self._closing = True
        self._expiry_us = EXPIRY_US

    def command(self, close: bool, now_us: int) -> None:
        """A valid command, consumed now."""
        self._expire(now_us)
        self._go(close, now_us)
        self._expiry_us = now_us + EXPIRY_US

    def position(self, now_us: int) -> float:
        """Position now; calls come in the order of time."""
        self._expire(now_us)
        return self._position(now_us)

    def _expire(self, now_us: int) -> None:
        if now_us >= self._expiry_us:
            self._go(False, self._expiry_us)

    def _go(self, close: bool, now_us: int) -> None:
        if close is not self._closing:
            self._from = self._position(now_us)
            self._since_us, self._closing = now_us, close

    def _position(self, now_us: int) -> float:
        delay_s = self._clutch.close_delay_s if self._closing else self._clutch.open_delay_s
        if delay_s == 0.0:
            return float(self._closing)
        way = (now_us - self._since_us) * US / delay_s
        return min(self._from + way, 1.0) if self._closing else max(self._from - way, 0.0)


class Engine:
    """Engine speed at the reads."""

    def __init__(self, speed_rad_s: float) -> None:
        self._speed_rad_s = speed_rad_s
        self._since_us = 0

    def speed_rad_s(self, now_us: int, clutch_position: float, input_rad_s: float) -> float:
        """Speed at this read, from that of the read before."""
        share = math.exp(-(now_us - self._since_us) * US / LAG_S)
        self._since_us = now_us
        if clutch_position >= 1.0:
            self._speed_rad_s = input_rad_s
        else:
            self._speed_rad_s = IDLE_RAD_S + (self._speed_rad_s - IDLE_RAD_S) * share
        return self._speed_rad_s
