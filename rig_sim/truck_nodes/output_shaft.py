"""The impulses of the gearbox's output shaft, and who reads them: tachograph and engine.

Both know how far the vehicle goes with an impulse, each to within its calibration.
"""

from __future__ import annotations

from math import radians, tau
from typing import Final

import numpy as np

from meshpoint.rig_sim.shared.world import Vehicle
from meshpoint.rig_sim.truck_nodes.brakes import Values
from meshpoint.rig_sim.truck_nodes.tone_ring import drawn_ring
from meshpoint.units import US

IMPULSES: Final = 8
"""A turn: some 6,600 a kilometre, of the 4,000 to 25,000 that (EU) 2016/799 has."""
TOOTH_RAD: Final = radians(0.5)
RUNOUT_RAD: Final = 0.1 / 20.0
LEAST_HZ: Final = 1.0
MOTION_US: Final = 5_000_000
"""The vehicle moves where there has been more than an impulse a second for this time
((EU) 2016/799)."""
TACHOGRAPH_US: Final = 50_000
ENGINE_US: Final = 100_000
"""Measuring windows."""
CALIBRATION_SHARE: Final = 0.01


class OutputShaft:
    """The shaft's sensor with both nodes behind it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._ring = drawn_ring(rng, IMPULSES, TOOTH_RAD, RUNOUT_RAD, LEAST_HZ)
        shares = 1.0 + CALIBRATION_SHARE * rng.uniform(-1.0, 1.0, 2)
        self._tachograph_share, self._engine_share = shares.tolist()
        self._vehicle: Vehicle | None = None
        self._stood_us = -MOTION_US

    def turn(self, time_us: int, shaft_rad_s: float, vehicle: Vehicle | None) -> None:
        """The shaft has turned on until now."""
        self._vehicle = vehicle
        self._ring.turn(time_us, shaft_rad_s / tau)

    def tco1(self, at_us: int) -> Values:
        """The tachograph's shaft speed, vehicle speed, and whether it moves."""
        turns_s = self._ring.turns_s(at_us, TACHOGRAPH_US)
        if turns_s == 0.0 or (turns_s is None and at_us * US >= 1.0 / LEAST_HZ):
            self._stood_us = at_us
        if turns_s is None:
            return {}
        return {
            "vehicle_motion": int(at_us - self._stood_us >= MOTION_US),
            "output_shaft_speed_rad_s": tau * turns_s,
            "vehicle_speed_m_s": self._vehicle_m_s(turns_s, self._tachograph_share),
        }

    def ccvs1(self, at_us: int) -> Values:
        """The vehicle's speed as the engine has it; nobody brakes."""
        if self._vehicle is None:
            return {}
        turns_s = self._ring.turns_s(at_us, ENGINE_US)
        speed_m_s = None if turns_s is None else self._vehicle_m_s(turns_s, self._engine_share)
        return {"wheel_based_speed_m_s": speed_m_s, "brake_switch": 0}

    def _vehicle_m_s(self, turns_s: float, share: float) -> float | None:
        vehicle = self._vehicle
        return None if vehicle is None else tau * turns_s * vehicle.wheel_m * share
