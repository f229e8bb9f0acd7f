"""The interface of the rotating parts for sleeves, bench script and truth, in both presets."""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

from meshpoint.gearbox.gears import DogGear, MainGear, Range, Sleeve, Split


class Drive(IntEnum):
    """What moves the layshaft."""

    COASTING = 0  # friction and brake, thesis 4.13
    STOPPED = 1  # braked to rest; stays until a gear or the bench turns it
    LOCKED = 2  # follows the main shaft through an engaged gear
    SCRIPTED = 3  # the bench drives it


class Angles(Protocol):
    """What sleeves and bench script ask of the gear train."""

    split: Split
    range_: Range

    @property
    def lock(self) -> Held | None:
        """The main-box gear that drives the layshaft."""

    def phase_rad(self, gear: DogGear) -> float:
        """Angle of a gear tooth from the middle of the sleeve's gap, half a pitch either way."""


class Held(Protocol):
    """A gear in mesh."""

    @property
    def gear(self) -> MainGear:
        """Which."""


class Rotation(Protocol):
    """What the sleeves and the bench script ask of the rotating parts; the same in all presets."""

    @property
    def shafts(self) -> Angles:
        """The gear train."""

    @property
    def time_us(self) -> float:
        """Time of the state."""

    @property
    def layshaft_rad_s(self) -> float:
        """Layshaft speed."""

    @property
    def main_rad_s(self) -> float:
        """Main shaft speed."""

    @property
    def brake_gauge_pa(self) -> float:
        """Gauge pressure between valve and brake."""

    def slip_rad_s(self, gear: DogGear) -> float:
        """Speed of the gear less that of its sleeve."""

    def coast(self) -> None:
        """No gear and no bench holds the layshaft."""

    def script_layshaft(self, accel_rad_s2: float) -> None:
        """The bench drives the layshaft at constant acceleration."""

    @property
    def input_rad_s(self) -> float:
        """Input shaft speed."""

    def script_input(self, accel_rad_s2: float) -> None:
        """The bench drives an input shaft that is in no step, at constant acceleration."""

    def script_main(self, accel_rad_s2: float) -> None:
        """The bench drives the main shaft at constant acceleration."""

    def set_steps(self, split: Split, range_: Range, moving: frozenset[Sleeve]) -> None:
        """Splitter and range steps; angles are continuous. `moving` are still on their way."""
