"""What the truck knows of itself, for tests in the same process. Plain reads, no side effects."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig_sim import truck_layout as at
from rig_sim.common_truth import CommonTruth
from rig_sim.shafts import Angle
from rig_sim.truck_plant import Energy

if TYPE_CHECKING:
    from rig_sim.truck_world import TruckWorld


class TruckTruth(CommonTruth):
    """The state at `time_us`, the last grid point or event up to the last step."""

    def __init__(self, world: TruckWorld) -> None:
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
        y = self._world.plant.y
        return (
            float(y[at.SPEED + at.INPUT]),
            float(y[at.SPEED + at.LAYSHAFT]),
            float(y[at.SPEED + at.MAIN]),
            float(y[at.SPEED + at.PROPELLER]),
        )

    @property
    def energy(self) -> Energy:
        """The balance since power-up."""
        return self._world.plant.energy
