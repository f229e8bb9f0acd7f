"""The gear train as the sleeves and the bench script see it."""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.gearbox.gears import MAIN_GEARS, MainGear, Range, Split
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.shared.angle_kernels import wrapped
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.layout import Rig

INDEX: Final = {gear: index for index, gear in enumerate(MAIN_GEARS)}


class InMesh(NamedTuple):
    """The gear whose teeth carry the torque, and at which flank: +1, -1, or 0 in between."""

    gear: MainGear
    flank: int


class TruckShafts:
    """The gear train as the sleeves and the bench script see it."""

    def __init__(self, sheet: GearboxSheet, rig: Rig, split: Split, range_: Range) -> None:
        self._rig = rig
        self._sheet = sheet
        self._pitch_rad = sheet.dog.pitch_rad
        self.split = split
        self.range_ = range_
        self.lock: InMesh | None = None

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

    def phase_rad(self, gear: MainGear) -> float:
        """Angle of a gear tooth from the middle of the sleeve's gap, half a pitch either way."""
        y, index = self._rig.y, INDEX[gear]
        return wrapped(y.phase_rad[index] + y.lash_rad[index], self._pitch_rad)
