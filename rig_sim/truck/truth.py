"""What the truck knows of itself, for tests in the same process. Plain reads, no side effects."""

from __future__ import annotations

from typing import Any, Protocol

from meshpoint.gearbox.gears import MainGear, Sleeve
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.shared.angles import Angle
from meshpoint.rig_sim.shared.script import BenchScript
from meshpoint.rig_sim.shared.truth import CommonTruth
from meshpoint.rig_sim.shared.world import Vehicle
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.energy import Energy
from meshpoint.rig_sim.truck.engagement import AxisTruth, TruckEngagement
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.units import SECOND_US


class TruckParts(Protocol):
    """What is read here of the truck's world."""

    sheet: GearboxSheet
    clock_start_us: int
    script: BenchScript
    plant: TruckPlant

    @property
    def engagement(self) -> TruckEngagement[Any]:
        """The main sleeves."""


class TruckTruth(CommonTruth):
    """The state at `time_us`, the last grid point or event up to the last step."""

    def __init__(self, world: TruckParts) -> None:
        super().__init__(world)
        self._world = world

    @property
    def angles(self) -> tuple[Angle, Angle, Angle, Angle]:
        """Sensor wheels of input, layshaft, main and propeller shaft."""
        angle = self._world.plant.angle
        return (angle(at.INPUT), angle(at.LAYSHAFT), angle(at.MAIN), angle(at.PROPELLER))

    @property
    def speeds_rad_s(self) -> tuple[float, float, float, float]:
        """Speeds of input, layshaft, main and propeller shaft."""
        speed = self._world.plant.y.speed_rad_s
        return (speed[at.INPUT], speed[at.LAYSHAFT], speed[at.MAIN], speed[at.PROPELLER])

    @property
    def energy(self) -> Energy:
        """The balance since power-up."""
        return self._world.plant.energy

    @property
    def road_speed_m_s(self) -> float:
        """Speed of the vehicle (`vehicle.py`)."""
        return self._world.plant.road_speed_m_s

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle. Driven wheels that are no body of their own turn with the shaft."""
        plant = self._world.plant
        driven_rad_s = plant.y.speed_rad_s[at.PROPELLER]
        if plant.p.twisting.stiff_nm_rad > 0.0:
            driven_rad_s = plant.y.wheels_rad_s
        wheel_m = plant.p.road.wheel_m
        return Vehicle(plant.road_speed_m_s, driven_rad_s * wheel_m, wheel_m)

    def delay_s(self, gear: MainGear) -> tuple[float, float]:
        """From a sleeve valve's activation now to contact: mean and standard deviation."""
        time_us = self.time_us
        mean_us, sd_us = self.expected_contact_us(gear, time_us)
        return (mean_us - time_us) / SECOND_US, sd_us / SECOND_US

    def expected_contact_us(self, gear: MainGear, fire_us: float) -> tuple[float, float]:
        """When a gear's sleeve would meet it, its valve's coil switched on at `fire_us`: from where
        it stands or moves now, its valves as they are. Mean and standard deviation, us."""
        return self._world.engagement.expected_contact_us(gear, fire_us)

    def axis(self, sleeve: Sleeve, time_us: float) -> AxisTruth:
        """One of the two main sleeves at an instant, at most 10 ms before the truth's own. KeyError
        for splitter and range; ValueError where sleeves are a pure delay (`sleeve.model` 0)."""
        return self._world.engagement.axis(sleeve, time_us)

    @property
    def brake_valve_delay_s(self) -> float:
        """From the brake valve's activation to the first change of pressure."""
        return self._world.sheet.brake.valve_delay_s

    @property
    def plant(self) -> TruckPlant:
        """What turns and carries air; not to be touched, but to be copied."""
        return self._world.plant
