"""What the preset `thesis` knows of itself, for tests in the same process. Plain reads."""

from __future__ import annotations

from typing import Any, Protocol

from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.shared.angles import Angle, Shafts
from meshpoint.rig_sim.shared.engagement import Engagement
from meshpoint.rig_sim.shared.script import BenchScript
from meshpoint.rig_sim.shared.truth import CommonTruth
from meshpoint.rig_sim.thesis.plant import ThesisPlant


class ThesisParts(Protocol):
    """What is read here of the thesis's world."""

    sheet: GearboxSheet
    clock_start_us: int
    script: BenchScript
    shafts: Shafts
    plant: ThesisPlant

    @property
    def engagement(self) -> Engagement[Any]:
        """The main sleeves."""


class ThesisTruth(CommonTruth):
    """The state at `time_us`, the newest event up to the last step. Angles are whole turns and a
    rest in rad; speeds rad/s; phases rad; pressure Pa."""

    def __init__(self, world: ThesisParts) -> None:
        super().__init__(world)
        self._world = world

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

    @property
    def vehicle(self) -> None:
        """There is none."""

    def delay_s(self, gear: MainGear) -> tuple[float, float]:  # noqa: ARG002
        """From a sleeve valve's activation now to contact: mean and standard deviation."""
        sleeve = self._world.sheet.sleeve
        return sleeve.delay_s, sleeve.delay_sd_s

    @property
    def brake_valve_delay_s(self) -> float:
        """From the brake valve's activation to the first change of pressure."""
        return self._world.sheet.brake.valve_delay_s
