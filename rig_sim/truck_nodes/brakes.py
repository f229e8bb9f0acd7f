"""The brake controller of the truck: four wheels by their tone rings, and what it says of them.

The front wheels roll with the vehicle, the driven ones as the driveline turns them. A differential
is not modelled, so left and right differ by their tyres and rings alone. Nor are wheel brakes:
nobody brakes.
"""

from __future__ import annotations

from math import radians
from typing import Final

import numpy as np

from meshpoint.rig_sim.shared.world import Vehicle
from meshpoint.rig_sim.truck_nodes.tone_ring import drawn_ring
from meshpoint.units import SECOND_US

TEETH: Final = 100
TOOTH_RAD: Final = radians(0.05)
RUNOUT_RAD: Final = 0.1 / 80.0
"""Eccentricity over radius of the ring, mm."""
CIRCUMFERENCE_M: Final = 1609.344 / 510.0
"""Of the tyre that the controller is set to, 510 turns a mile."""
TYRE_SHARE: Final = 0.01
"""By how much a tyre's circumference may be another."""
LEAST_M_S: Final = 0.5
WINDOW_US: Final = 20_000
ACCELERATION_US: Final = 200_000
"""The acceleration is the change of the front axle's speed over this time."""

Values = dict[str, float | int | None]
"""What a message says, by field; what is left out or None is 'not available'."""


class BrakeController:
    """Wheels front left, front right, rear left, rear right."""

    def __init__(self, rng: np.random.Generator) -> None:
        least_hz = TEETH * LEAST_M_S / CIRCUMFERENCE_M
        self._rings = [drawn_ring(rng, TEETH, TOOTH_RAD, RUNOUT_RAD, least_hz) for _ in range(4)]
        self._tyres = (1.0 + TYRE_SHARE * rng.uniform(-1.0, 1.0, 4)).tolist()
        self._has_vehicle = False

    def turn(self, time_us: int, vehicle: Vehicle | None) -> None:
        """The wheels have turned on until now."""
        self._has_vehicle = vehicle is not None
        if vehicle is not None:
            treads_m_s = (vehicle.road_m_s,) * 2 + (vehicle.driven_m_s,) * 2
            for ring, tyre, tread_m_s in zip(self._rings, self._tyres, treads_m_s, strict=True):
                ring.turn(time_us, tread_m_s / (CIRCUMFERENCE_M * tyre))

    def _speeds_m_s(self, at_us: int) -> list[float | None]:
        turns_s = [ring.turns_s(at_us, WINDOW_US) for ring in self._rings]
        return [None if each is None else each * CIRCUMFERENCE_M for each in turns_s]

    def _front_axle_m_s(self, at_us: int) -> float | None:
        left, right = self._speeds_m_s(at_us)[:2]
        return None if left is None or right is None else 0.5 * (left + right)

    def hrw(self, at_us: int) -> Values:
        """Each wheel's speed."""
        left, right, rear_left, rear_right = self._speeds_m_s(at_us)
        return {
            "front_left_speed_m_s": left,
            "front_right_speed_m_s": right,
            "rear_left_speed_m_s": rear_left,
            "rear_right_speed_m_s": rear_right,
        }

    def ebc2(self, at_us: int) -> Values:
        """The front axle's speed, and each wheel's less that. There is one rear axle."""
        axle_m_s = self._front_axle_m_s(at_us)
        if axle_m_s is None:
            return {}
        left, right, rear_left, rear_right = [
            None if each is None else each - axle_m_s for each in self._speeds_m_s(at_us)
        ]
        return {
            "front_axle_speed_m_s": axle_m_s,
            "front_left_relative_m_s": left,
            "front_right_relative_m_s": right,
            "rear_left_relative_m_s": rear_left,
            "rear_right_relative_m_s": rear_right,
        }

    def vdc2(self, at_us: int) -> Values:
        """The acceleration by the front axle's speed."""
        now_m_s = self._front_axle_m_s(at_us)
        before_m_s = self._front_axle_m_s(at_us - ACCELERATION_US)
        if now_m_s is None or before_m_s is None:
            return {}
        change_m_s = now_m_s - before_m_s
        return {"longitudinal_acceleration_m_s2": change_m_s * SECOND_US / ACCELERATION_US}

    def ebc1(self, _at_us: int) -> Values:
        """Nobody brakes, in a truck with brakes."""
        if not self._has_vehicle:
            return {}
        return {"abs_active": 0, "ebs_brake_switch": 0, "brake_pedal_position_fraction": 0.0}
