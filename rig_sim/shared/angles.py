"""Angles of shafts, gears and sleeves, held together by exact tooth counts.

Two angles are integrated, layshaft and main shaft; all others follow from them. The input shaft is
the layshaft over the splitter, the propeller shaft the main shaft over the range, and a gear of the
main box the layshaft over its mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from meshpoint.gearbox.gears import MAIN_GEARS, DogGear, MainGear, Range, Split
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.gearbox.wheels import Mesh
from meshpoint.rig_sim.shared.angle_kernels import geared, settled, wrapped

Angle = tuple[int, float]
ZERO: Final[Angle] = (0, 0.0)


class StartAngles(NamedTuple):
    """Where the wheels stand at power-up, rad: sensor wheels in 0..2 pi, gear phases in a pitch."""

    input_rad: float
    layshaft_rad: float
    main_rad: float
    propeller_rad: float
    phase_rad: dict[MainGear, float]


@dataclass(frozen=True)
class Lock:
    """A gear held by its sleeve at a flank: gear angle = main angle + pitches x pitch + phase."""

    gear: MainGear
    phase_rad: float
    pitches: int


def over(angle: Angle, mesh: Mesh, offset: Angle) -> Angle:
    """The angle of the driven wheel of a mesh."""
    return geared(angle, mesh.driving, mesh.driven, offset)


def less(a: Angle, b: Angle) -> Angle:
    """The difference of two angles."""
    return settled(a[0] - b[0], a[1] - b[1])


class Shafts:
    """The gear train as angles. The plant moves `layshaft` and `main`, `follow` does the rest."""

    def __init__(
        self, sheet: GearboxSheet, start: StartAngles, split: Split, range_: Range
    ) -> None:
        self._sheet = sheet
        self._pitch_rad = sheet.dog.pitch_rad
        self._teeth = sheet.dog.teeth
        self._meshes: dict[DogGear, Mesh] = {gear: sheet.main_mesh(gear) for gear in MAIN_GEARS}
        self._load_meshes(split, range_)
        self.layshaft: Angle = (0, start.layshaft_rad)
        self.main: Angle = (0, start.main_rad)
        self.input: Angle = (0, start.input_rad)
        self.propeller: Angle = (0, start.propeller_rad)
        self._input_offset = ZERO
        self._propeller_offset = ZERO
        self._gear_offset_rad: dict[DogGear, float] = {
            gear: wrapped(
                start.phase_rad[gear] + self.main[1] - self._gear_angle(gear)[1], self._pitch_rad
            )
            for gear in MAIN_GEARS
        }
        self.lock: Lock | None = None
        self._rebase_offsets()

    def follow(self) -> None:
        """Bring all angles in line with the main shaft and, with no gear locked, the layshaft."""
        if self.lock is not None:
            self.layshaft = self._locked_layshaft(self.lock)
        self.input = over(self.layshaft, self.input_mesh, self._input_offset)
        self.propeller = over(self.main, self.propeller_mesh, self._propeller_offset)

    def phase_rad(self, gear: DogGear) -> float:
        """Angle of a gear tooth from the middle of the sleeve's gap, half a pitch either way."""
        if self.lock is not None and self.lock.gear is gear:
            return self.lock.phase_rad
        angle = self._gear_angle(gear)[1] + self._gear_offset_rad[gear] - self.main[1]
        return wrapped(angle, self._pitch_rad)

    def lock_gear(self, gear: MainGear, phase_rad: float) -> None:
        """Hold the gear at this phase from now on: the layshaft angle follows the main shaft."""
        turns, rest = self._gear_angle(gear)
        rest += self._gear_offset_rad[gear] - self.main[1] - phase_rad
        pitches = (turns - self.main[0]) * self._teeth + round(rest / self._pitch_rad)
        self.lock = Lock(gear, phase_rad, pitches)

    def set_steps(self, split: Split, range_: Range) -> None:
        """Change splitter and range steps; no angle changes by it."""
        self._load_meshes(split, range_)
        self._rebase_offsets()

    def _load_meshes(self, split: Split, range_: Range) -> None:
        self.split = split
        self.range_ = range_
        mesh = self._sheet.split_mesh(split)
        self.input_mesh = Mesh(mesh.driven, mesh.driving)
        self.propeller_mesh = self._sheet.range_mesh(range_)

    def _rebase_offsets(self) -> None:
        base = over(self.layshaft, self.input_mesh, ZERO)
        self._input_offset = less(self.input, base)
        base = over(self.main, self.propeller_mesh, ZERO)
        self._propeller_offset = less(self.propeller, base)

    def _gear_angle(self, gear: DogGear) -> Angle:
        return over(self.layshaft, self._meshes[gear], ZERO)

    def _locked_layshaft(self, lock: Lock) -> Angle:
        turns, teeth = divmod(lock.pitches, self._teeth)
        rest = teeth * self._pitch_rad + lock.phase_rad - self._gear_offset_rad[lock.gear]
        gear = settled(self.main[0] + turns, self.main[1] + rest)
        mesh = self._meshes[lock.gear]
        return geared(gear, mesh.driven, mesh.driving, ZERO)
