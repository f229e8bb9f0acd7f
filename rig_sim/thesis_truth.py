"""What the preset `thesis` knows of itself, for tests in the same process. Plain reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig_sim.common_truth import CommonTruth
from rig_sim.shafts import Angle

if TYPE_CHECKING:
    from rig_sim.world import World


class ThesisTruth(CommonTruth):
    """The state at `time_us`, the newest event up to the last step. Angles are whole turns and a
    rest in rad; speeds rad/s; phases rad; pressure Pa."""

    def __init__(self, world: World) -> None:
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
