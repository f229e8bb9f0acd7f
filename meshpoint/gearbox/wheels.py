"""The wheels of a gearbox as drawn: pairs in mesh, dog teeth, sensor wheels.

Ratios are never written down: they are quotients of tooth counts, kept exact, so that phases do not
drift over hours. One definition throughout (docs/decisions/0003):

    i_split = omega_layshaft / omega_input     = teeth_input / teeth_layshaft
    i_gear  = omega_gear / omega_layshaft      = teeth_layshaft / teeth_gear
    i_range = omega_propeller / omega_main     = teeth_main / teeth_propeller

The angle from dog tooth to dog tooth is the pitch; a gear tooth stands in a gap of the sleeve where
|phase| < backlash / 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from fractions import Fraction
from typing import Final

from meshpoint.gearbox.tables import TableError, count, counts, group, key_of, quantity, text
from meshpoint.units import MM

LEAST_RUN: Final = 6
"""Teeth in a row that a sensor wheel needs somewhere, to see its speed."""


@dataclass(frozen=True)
class Mesh:
    """A pair of wheels in constant mesh; the driven wheel's speed is ratio x the driving one's."""

    driving: int = count("teeth_driving", 8, 200)
    """Teeth of the wheel nearer to the engine."""
    driven: int = count("teeth_driven", 8, 200)
    """Teeth of the other wheel."""

    @property
    def exact(self) -> Fraction:
        """Driven speed over driving speed."""
        return Fraction(self.driving, self.driven)

    @property
    def ratio(self) -> float:
        """The same as the nearest float."""
        return self.driving / self.driven


@dataclass(frozen=True)
class MainBox:
    """Layshaft (driving) to the four loose gears on the main shaft (driven)."""

    crawl: Mesh = group(Mesh)
    first: Mesh = group(Mesh)
    second: Mesh = group(Mesh)
    third: Mesh = group(Mesh)


@dataclass(frozen=True)
class RangeBox:
    """Main shaft (driving) to propeller shaft (driven)."""

    low: Mesh = group(Mesh)
    high: Mesh = group(Mesh)


@dataclass(frozen=True)
class DogTeeth:
    """The toothed sides of gears and sleeves of the main box (thesis 2.2)."""

    teeth: int = count("teeth", 8, 96)
    """Dog teeth around a gear, and gaps around its sleeve."""
    backlash_share: float = quantity("backlash_percent_of_pitch", 2.0, 50.0, 0.01)
    """Width of a gap beyond the tooth that goes into it."""
    radius_m: float = quantity("radius_mm", 30.0, 150.0, MM)
    """Middle radius of the dog teeth."""
    overlap_m: float = quantity("overlap_mm", 0.0, 10.0, MM, default=1.0 * MM)
    """How far a sleeve must go past the teeth's faces to be held."""
    overlap_tolerance_m: float = quantity("overlap_tolerance_mm", 0.0, 5.0, MM, default=0.2 * MM)
    """By how much that may differ, from gear to gear and with wear."""

    @property
    def most_overlap_m(self) -> float:
        """An overlap that holds in any gearbox of the tolerance."""
        return self.overlap_m + self.overlap_tolerance_m

    @property
    def pitch_rad(self) -> float:
        """Angle from dog tooth to dog tooth."""
        return 2.0 * math.pi / self.teeth

    @property
    def backlash_rad(self) -> float:
        """Width of the gap: a gear tooth is in it where |phase| < backlash / 2."""
        return self.backlash_share * self.pitch_rad

    @property
    def free_rad(self) -> float:
        """A gear that has turned against its sleeve by more than this has no tooth in a gap: by
        half a tooth's width more than all backlash, which is for what the angle may be wrong by."""
        return 0.5 * (self.pitch_rad + self.backlash_rad)


@dataclass(frozen=True)
class Wheel:
    """A sensor wheel and its Hall sensor (thesis 2.5, 4.5)."""

    teeth: int = count("teeth", 8, 120)
    """Teeth of the sensor wheel, those that are left out included."""
    duty_share: float = quantity("duty_percent", 20.0, 80.0, 0.01)
    """Share of a tooth in its pitch, from rising to falling edge."""
    missing: tuple[int, ...] = counts("missing", 0, 119, default=())
    """Teeth that were left out (58 and 59 of a 60-2 wheel): they tell which tooth is which."""

    def __post_init__(self) -> None:
        if not self.missing:
            return
        if self.missing[-1] >= self.teeth:
            raise TableError(f"missing = {list(self.missing)}, allowed are 0 to {self.teeth - 1}")
        left = "".join("-" if k in self.missing else "#" for k in range(self.teeth))
        if "#" * LEAST_RUN not in left + left:
            raise TableError(
                f"missing = {list(self.missing)} of {self.teeth}, allowed is what leaves "
                f"{LEAST_RUN} teeth in a row"
            )
        if left in (left + left)[1:-1]:
            raise TableError("missing must tell each tooth from all others, its pattern repeats")

    @property
    def pitch_rad(self) -> float:
        """Angle from rising edge to rising edge, where no tooth is missing."""
        return 2.0 * math.pi / self.teeth


@dataclass(frozen=True)
class Wheels:
    """The sensor wheels: one row each, in the order of their messages (`meshpoint.dbc.edges`). The
    first four are one of each shaft; the name of any other begins with its shaft's."""

    input_: Wheel = group(Wheel)
    layshaft: Wheel = group(Wheel)
    main: Wheel = group(Wheel)
    propeller: Wheel = group(Wheel)

    @property
    def rows(self) -> dict[str, Wheel]:
        """By the name in the file."""
        return {key_of(field): getattr(self, field.name) for field in fields(self)}


WHEEL_NAMES: Final = tuple(key_of(field) for field in fields(Wheels))
SHAFTS: Final = WHEEL_NAMES[:4]
"""From the engine to the road."""
SHAFT_OF_WHEEL: Final = tuple(SHAFTS.index(name.split("_")[0]) for name in WHEEL_NAMES)
"""Which of `SHAFTS` each wheel turns with."""


@dataclass(frozen=True)
class Splitter:
    """Input shaft (driving) to layshaft (driven)."""

    low: Mesh = group(Mesh)
    high: Mesh = group(Mesh)
    engagement: str = text("engagement", "cones", "dog", default="cones")
    """What engages a step: friction cones, which bring the shafts together, or dog teeth alone, as
    in the main box (thesis 2.1)."""
    dog: DogTeeth | None = group(DogTeeth, default=None)
    """Its dog teeth; left out, they are as those of the main box."""

    def __post_init__(self) -> None:
        if self.dog is not None and self.engagement == "cones":
            raise TableError('engagement = "cones" with a table dog, allowed is "dog"')
