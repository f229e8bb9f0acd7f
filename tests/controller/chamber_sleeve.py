"""A main sleeve for tests of the shift sequence: a mass between two chambers, as the data sheet
truck12 describes it, without any scatter. Equations and integration are this file's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Final

STEP_S: Final = 1e-4
AIR_PA: Final = 1.013e5
SUPPLY_PA: Final = 8.5e5 + AIR_PA
AREA_M2, MASS_KG, DEAD_M3 = 18e-4, 3.0, 35e-6
FRICTION_N, STATIC_N, DAMPING_NSM = 120.0, 150.0, 1200.0
DETENT_N, DETENT_M = 600.0, 2e-3
FACE_M, STROKE_M = 5e-3, 12e-3
WAY_OUT: Final = 1.25
"""A valve lets air out by so much better than in."""
TRAVEL_S: Final = 33e-3
"""From the spool to the teeth: 45 ms less the valve's 12 ms."""
POLYTROPIC: Final = 1.2
FILLS: Final = POLYTROPIC * 287.05 * 293.15 * 1.185
"""n R T rho, by which a flow of normal air raises n p V."""
VENTED_PA: Final = 50.0


def nothing_in_the_way(_: int) -> bool:
    """A gap."""
    return False


class ChamberSleeve:
    """Place and speed from neutral; chamber 0 pushes it towards -, chamber 1 towards +."""

    def __init__(self, x_m: float = 0.0, conductance: float | None = None) -> None:
        self.x_m, self.speed_m_s = x_m, 0.0
        self.pressure_pa = [AIR_PA, AIR_PA]
        self._conductance = conductance or _solved_conductance()

    def put(self, x_m: float) -> None:
        """Somebody else has put it there: it stands, without air."""
        self.__init__(x_m, self._conductance)  # type: ignore[misc]

    def advance(
        self,
        on: tuple[bool, bool],
        supply_pa: float = SUPPLY_PA,
        tooth: Callable[[int], bool] = nothing_in_the_way,
        is_stuck: bool = False,
    ) -> None:
        """0.1 ms more. on: whether a chamber's spool lets air in; tooth: whether one stands before
        the sleeve as it comes to the teeth in this direction."""
        if not any(on) and self.speed_m_s == 0.0 and max(self.pressure_pa) < AIR_PA + VENTED_PA:
            return
        for k, sign in ((0, -1.0), (1, 1.0)):
            pa, feeds = self.pressure_pa[k], on[k]
            outer_pa, share = (supply_pa, 1.0) if feeds else (AIR_PA, WAY_OUT)
            flow = share * self._conductance * _through(outer_pa, pa)
            grown = FILLS * flow - POLYTROPIC * pa * AREA_M2 * sign * self.speed_m_s
            volume_m3 = DEAD_M3 + AREA_M2 * (STROKE_M + sign * self.x_m)
            self.pressure_pa[k] += STEP_S * grown / volume_m3
        if not is_stuck:
            self._move(tooth)

    def _move(self, tooth: Callable[[int], bool]) -> None:
        force_n = (self.pressure_pa[1] - self.pressure_pa[0]) * AREA_M2
        if abs(self.x_m) < DETENT_M:
            force_n -= DETENT_N * math.sin(math.pi * self.x_m / DETENT_M)
        if self.speed_m_s == 0.0 and abs(force_n) <= STATIC_N:
            return
        against_n = math.copysign(FRICTION_N, self.speed_m_s or force_n)
        pushed_n = force_n - against_n - DAMPING_NSM * self.speed_m_s
        speed_m_s = self.speed_m_s + STEP_S * pushed_n / MASS_KG
        self.speed_m_s = 0.0 if speed_m_s * self.speed_m_s < 0.0 else speed_m_s
        at_m = self.x_m + STEP_S * self.speed_m_s
        side = 1 if self.speed_m_s > 0.0 else -1
        if self.x_m * side <= FACE_M < at_m * side and tooth(side):
            at_m, self.speed_m_s = FACE_M * side, 0.0
        if abs(at_m) >= STROKE_M:
            at_m, self.speed_m_s = math.copysign(STROKE_M, at_m), 0.0
        self.x_m = at_m


def _through(outer_pa: float, pa: float) -> float:
    """Flow into a chamber, by ISO 6358 with a critical ratio of 0.3, for a conductance of one."""
    high, low, sign = (outer_pa, pa, 1.0) if outer_pa > pa else (pa, outer_pa, -1.0)
    over = max(0.0, (low / high - 0.3) / 0.7)
    return sign * high * math.sqrt(max(0.0, 1.0 - over * over))


@cache
def _solved_conductance() -> float:
    """The one that brings the sleeve from neutral to the teeth in the data sheet's time."""
    low, high = math.log(1e-10), math.log(1e-7)
    for _ in range(25):
        middle = 0.5 * (low + high)
        sleeve, steps = ChamberSleeve(conductance=math.exp(middle)), 0
        while sleeve.x_m < FACE_M and steps * STEP_S < TRAVEL_S:
            sleeve.advance((False, True))
            steps += 1
        low, high = (low, middle) if sleeve.x_m >= FACE_M else (middle, high)
    return math.exp(high)
