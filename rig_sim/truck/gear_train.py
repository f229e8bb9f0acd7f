"""The gear train as the sleeves and the bench script see it."""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.gearbox.gears import (
    MAIN_GEARS,
    SPLIT_GEARS,
    DogGear,
    MainGear,
    Range,
    Split,
    SplitGear,
)
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.shared.angle_kernels import wrapped
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.layout import Rig

INDEX: Final[dict[DogGear, int]] = {
    **{gear: index for index, gear in enumerate(MAIN_GEARS)},
    **{gear: at.GEARS + index for index, gear in enumerate(SPLIT_GEARS)},
}


class Joint(NamedTuple):
    """How a gear, its sleeve in its teeth, links two bodies. In the main box the link's torque is
    the teeth's, on the sleeve's shaft. The splitter's gears and sleeve are before its link: there
    the layshaft is behind."""

    link: int
    ratio: float
    """Speed behind the link over that before it."""
    turn: int
    """+1, or -1 where the gear pushing its sleeve forward is a negative torque of the link."""
    arm: float
    """Torque of the link over that of the teeth."""


class InMesh(NamedTuple):
    """The gear whose teeth carry the torque, and at which flank: +1, -1, or 0 in between."""

    gear: MainGear
    flank: int


class StepInMesh(NamedTuple):
    """The same of a splitter with dog teeth."""

    gear: SplitGear
    flank: int


class TruckShafts:
    """The gear train as the sleeves and the bench script see it."""

    def __init__(self, sheet: GearboxSheet, rig: Rig, split: Split, range_: Range) -> None:
        self._rig = rig
        self._sheet = sheet
        self._pitch_rad = sheet.dog.pitch_rad
        self._joints = {gear: _joint(gear, sheet.dog_mesh(gear).ratio) for gear in sheet.dog_gears}
        self.split = split
        self.range_ = range_
        self.lock: InMesh | None = None
        """Of the main box."""
        self.split_lock: StepInMesh | None = None
        """Of a splitter with dog teeth."""

    @property
    def split_ratio(self) -> float:
        """Layshaft speed over input speed."""
        return self._sheet.split_mesh(self.split).ratio

    @property
    def range_ratio(self) -> float:
        """Propeller speed over main shaft speed."""
        return self._sheet.range_mesh(self.range_).ratio

    def phases_rad(self) -> tuple[float, ...]:
        """`phase_rad` of all gears, in the order of `MAIN_GEARS`."""
        y, pitch_rad = self._rig.y, self._pitch_rad
        phase, lash = y.phase_rad, y.lash_rad
        return tuple([wrapped(phase[i] + lash[i], pitch_rad) for i in range(at.GEARS)])

    def phase_rad(self, gear: DogGear) -> float:
        """Angle of a gear tooth from the middle of the sleeve's gap, half a pitch either way."""
        y, index = self._rig.y, INDEX[gear]
        return wrapped(y.phase_rad[index] + y.lash_rad[index], self._rig.p.pitch_rad[index])

    def joint(self, gear: DogGear) -> Joint:
        """What a gear links when its sleeve is in its teeth."""
        return self._joints[gear]

    def locked_at(self, link: int) -> InMesh | StepInMesh | None:
        """The gear in mesh there."""
        return self.lock if link == at.MAIN_BOX else self.split_lock


def _joint(gear: DogGear, ratio: float) -> Joint:
    if isinstance(gear, SplitGear):
        return Joint(at.SPLITTER, 1.0 / ratio, -1, ratio)
    return Joint(at.MAIN_BOX, ratio, 1, 1.0)
