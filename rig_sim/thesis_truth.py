"""What the preset `thesis` knows of itself, for tests in the same process. Plain reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from gearbox.gears import MainGear, Sleeve
from rig_sim.bench_script import ScriptPhase
from rig_sim.engagement import Violation
from rig_sim.plant import Drive
from rig_sim.shafts import Angle
from rig_sim.sleeves import SleeveState

if TYPE_CHECKING:
    from rig_sim.world import World


class ThesisTruth:
    """The state at `time_us`, the newest event up to the last step. Angles are whole turns and a
    rest in rad; speeds rad/s; phases rad; pressure Pa."""

    def __init__(self, world: World) -> None:
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
        shafts = self._world.shafts
        return (shafts.input, shafts.layshaft, shafts.main, shafts.propeller)

    @property
    def speeds_rad_s(self) -> tuple[float, float, float, float]:
        """Speeds of input, layshaft, main and propeller shaft."""
        shafts, plant = self._world.shafts, self._world.plant
        return (
            plant.layshaft_rad_s * shafts.input_mesh.ratio,
            plant.layshaft_rad_s,
            plant.main_rad_s,
            plant.main_rad_s * shafts.propeller_mesh.ratio,
        )

    @property
    def road_speed_m_s(self) -> float:
        """The thesis has no vehicle: its main shaft keeps its speed (4.16)."""
        return 0.0

    def phase_rad(self, gear: MainGear) -> float:
        """Phase of a gear against its sleeve."""
        return self._world.shafts.phase_rad(gear)

    def slip_rad_s(self, gear: MainGear) -> float:
        """Speed of a gear less that of its sleeve."""
        return self._world.plant.slip_rad_s(gear)

    @property
    def locked_gear(self) -> MainGear:
        """The main-box gear that drives the layshaft, or neutral."""
        lock = self._world.shafts.lock
        return MainGear.NEUTRAL if lock is None else lock.gear

    @property
    def drive(self) -> Drive:
        """What moves the layshaft."""
        return self._world.plant.drive

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure at the brake."""
        return self._world.plant.brake_gauge_pa

    def delay_s(self, gear: MainGear) -> tuple[float, float]:  # noqa: ARG002
        """From a sleeve valve's activation now to contact: mean and standard deviation."""
        sleeve = self._world.sheet.sleeve
        return sleeve.delay_s, sleeve.delay_sd_s

    @property
    def brake_valve_delay_s(self) -> float:
        """From the brake valve's activation to the first change of pressure."""
        return self._world.sheet.brake.valve_delay_s

    @property
    def plant(self) -> None:
        """The controller's own model is this gearbox's: there is nothing to run ahead."""
        return None

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
