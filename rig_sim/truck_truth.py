"""What the truck knows of itself, for tests in the same process. Plain reads, no side effects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from gearbox.gears import MainGear, Sleeve
from rig_sim import truck_layout as at
from rig_sim.bench_script import ScriptPhase
from rig_sim.engagement import Violation
from rig_sim.plant import Drive
from rig_sim.shafts import Angle
from rig_sim.sleeves import SleeveState
from rig_sim.truck_plant import Energy, TruckPlant

if TYPE_CHECKING:
    from rig_sim.truck_world import TruckWorld


class TruckTruth:
    """The state at `time_us`, the last grid point or event up to the last step."""

    def __init__(self, world: TruckWorld) -> None:
        self._world = world

    @property
    def time_us(self) -> float:
        """Time since power-up of everything else here."""
        return self._world.plant.time_us

    @property
    def clock_start_us(self) -> int:
        """Sensor clock at power-up."""
        return self._world.clock_start_us

    @property
    def angles(self) -> tuple[Angle, Angle, Angle, Angle]:
        """Sensor wheels of input, layshaft, main and propeller shaft."""
        angle = self._world.plant.angle
        return (angle(at.INPUT), angle(at.LAYSHAFT), angle(at.MAIN), angle(at.PROPELLER))

    @property
    def speeds_rad_s(self) -> tuple[float, float, float, float]:
        """Speeds of input, layshaft, main and propeller shaft."""
        y = self._world.plant.y
        return (
            float(y[at.SPEED + at.INPUT]),
            float(y[at.SPEED + at.LAYSHAFT]),
            float(y[at.SPEED + at.MAIN]),
            float(y[at.SPEED + at.PROPELLER]),
        )

    @property
    def road_speed_m_s(self) -> float:
        """Speed of the vehicle: propeller shaft, axle and wheel (`vehicle.py`)."""
        plant = self._world.plant
        return float(plant.y[at.SPEED + at.PROPELLER] * plant.p[at.WHEEL_M])

    def phase_rad(self, gear: MainGear) -> float:
        """Phase of a gear against its sleeve."""
        return self._world.plant.shafts.phase_rad(gear)

    def slip_rad_s(self, gear: MainGear) -> float:
        """Speed of a gear less that of its sleeve."""
        return self._world.plant.slip_rad_s(gear)

    @property
    def locked_gear(self) -> MainGear:
        """The main-box gear in mesh, at a flank or between them; or neutral."""
        lock = self._world.plant.shafts.lock
        return MainGear.NEUTRAL if lock is None else lock.gear

    @property
    def drive(self) -> Drive:
        """What moves the layshaft."""
        return self._world.plant.drive

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure at the brake."""
        return self._world.plant.brake_gauge_pa

    @property
    def energy(self) -> Energy:
        """The balance since power-up."""
        return self._world.plant.energy

    def delay_s(self, gear: MainGear) -> tuple[float, float]:
        """From a sleeve valve's activation now to contact: mean and standard deviation."""
        world = self._world
        mean_s = world.delays.mean_gear_s(gear, world.plant.supply_gauge_pa)
        return mean_s, world.delays.sd_s

    @property
    def brake_valve_delay_s(self) -> float:
        """From the brake valve's activation to the first change of pressure."""
        return self._world.sheet.brake.valve_delay_s

    @property
    def plant(self) -> TruckPlant:
        """What turns and carries air; not to be touched, but to be copied."""
        return self._world.plant

    def sleeve_state(self, sleeve: Sleeve) -> SleeveState:
        """State of one of the two main sleeves. KeyError for splitter and range."""
        return self._world.engagement.sleeves[sleeve].state

    @property
    def script(self) -> ScriptPhase:
        """Where the bench script stands."""
        return self._world.script.phase

    @property
    def violations(self) -> Mapping[Violation, int]:
        """How often each of the forbidden things has happened."""
        return dict(self._world.engagement.violations)
