"""A gear that was seen to turn with its sleeve is taken to be in mesh until it has turned free; and
one that is measured in is not, once it has turned free after a pull.

In mesh a gear crosses the backlash of its teeth whenever the torque turns round, and for as long
does not turn exactly with its sleeve. Against it by more than that it cannot turn.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from meshpoint.controller.guard.limits import MainValve
from meshpoint.controller.guard.own_speed import ShaftSpeed, TeethCounted
from meshpoint.units import TURN

FREE_PITCHES: Final = 2.0
"""Turned by this many pitches of the dog teeth, a gear is free of its sleeve: a pitch is more than
all backlash in between, another one more than the angle may be wrong by."""
BELIEVED_US: Final = 1_000_000
"""A gear that has turned with its sleeve for so long is in mesh."""


class Shaft(NamedTuple):
    """One shaft's teeth and speed as the guard counts them; None where it does not know."""

    counted: TeethCounted | None
    speed: ShaftSpeed | None
    teeth: int
    """Of its wheel."""

    def angle_rad(self, at_us: int) -> float | None:
        """How far it has turned by a time near its newest edge."""
        if self.counted is None or self.speed is None:
            return None
        since_s = (at_us - self.counted.time_us) * 1e-6
        return self.counted.teeth * TURN / self.teeth + self.speed.omega_rad_s * since_s


def gear_angle_rad(ratio: float, layshaft: Shaft, main: Shaft) -> float | None:
    """The angle of a gear against its sleeve, as of the newest edge of both shafts."""
    if layshaft.counted is None or main.counted is None:
        return None
    at_us = max(layshaft.counted.time_us, main.counted.time_us)
    turned, sleeve = layshaft.angle_rad(at_us), main.angle_rad(at_us)
    return None if turned is None or sleeve is None else ratio * turned - sleeve


class PulledGear:
    """Whether the gear of one main sleeve, pulled and still measured in, turns against it."""

    def __init__(self) -> None:
        self._since: tuple[int, float] | None = None
        """When the gear was last seen to have turned on, or pulled; and how it stood then."""
        self.is_denied = False

    @staticmethod
    def two() -> tuple[PulledGear, PulledGear]:
        """One for each main sleeve."""
        return PulledGear(), PulledGear()

    def pull(self, now_us: int, angle_rad: float | None) -> None:
        """It is pulled out now."""
        if self._since is None and angle_rad is not None:
            self._since = (now_us, angle_rad)

    def forget(self) -> None:
        """Its sleeve is measured elsewhere."""
        self._since, self.is_denied = None, False

    def restart(self) -> None:
        """The sensors' clock is another: teeth are counted anew."""
        self._since = None

    def stands(self, now_us: int, angle_rad: float | None, free_rad: float) -> None:
        """It is measured in its gear, and no valve drives it. One that turns with its sleeve for a
        while is in mesh, whatever was seen of it before."""
        if angle_rad is None:
            return
        if self._since is None:
            self._since = (now_us, angle_rad) if self.is_denied else None
            return
        since_us, stood_rad = self._since
        if abs(angle_rad - stood_rad) > free_rad:
            self._since, self.is_denied = (now_us, angle_rad), True
        elif now_us - since_us > BELIEVED_US:
            self.forget()


class HeldGear:
    """Which main valve's gear is held, and where it stood against its sleeve."""

    def __init__(self, main: dict[int, MainValve], pitch_rad: float, apart_m: float) -> None:
        self._main, self._free_rad = main, FREE_PITCHES * pitch_rad
        self._apart_m = apart_m
        self._held: tuple[int, float] | None = None

    def forget(self) -> None:
        """The sensors' clock is another: teeth are counted anew."""
        self._held = None

    def take(
        self, agreeing: int, positions_m: tuple[float, ...], layshaft: Shaft, main: Shaft
    ) -> int:
        """The main valve of the gear that is taken to be in mesh although both sleeves are measured
        apart from all teeth, 0 if there is none. agreeing: the one whose gear turns with its sleeve
        now."""
        if max(abs(positions_m[0]), abs(positions_m[1])) > self._apart_m:
            self._held = None
            return 0
        if agreeing:
            angle = self._angle_rad(agreeing, layshaft, main)
            self._held = None if angle is None else (agreeing, angle)
            return agreeing
        if self._held is None:
            return 0
        valve, stood_rad = self._held
        angle = self._angle_rad(valve, layshaft, main)
        if angle is not None and abs(angle - stood_rad) > self._free_rad:
            self._held = None
            return 0
        return valve

    def _angle_rad(self, valve: int, layshaft: Shaft, main: Shaft) -> float | None:
        return gear_angle_rad(self._main[valve].ratio, layshaft, main)
