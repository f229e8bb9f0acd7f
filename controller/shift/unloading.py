"""How the engine's torque is taken away so that nothing swings when the clutch opens.

With a gear in mesh engine and gearbox (J_1) and the vehicle (J_2) swing against each other on the
shafts and tyres between them, w^2 = k (1 / J_1 + 1 / J_2). A torque that is taken away at once
leaves the engine but not the twisted shafts: they swing about their new rest, with all the torque
that was in them. Taken away in two halves, half a period apart, the second swing cancels the first
(zero vibration, Singer and Seering 1990); in a quarter, a half and a quarter it does so even if the
period is not quite known. A frequency that is off by a share d leaves sin(d pi / 2) of the swing,
and that squared.

The torque to end at is not none. Once the shafts carry nothing the vehicle coasts, and an engine
that gives no torque would be turned by them: so it is asked for what makes engine and gearbox slow
down, or speed up, with the vehicle, and for the gearbox's drag. The clutch then carries as little
as that, and may open; the shafts take it over, and it has hardly begun to twist them when the gear
is out.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from meshpoint.controller.shift.swing_fit import Known
from meshpoint.gearbox import DriveGear, GearboxSheet
from meshpoint.units import SECOND_US

SHAPES: Final = ((1.0,), (0.5, 0.5), (0.25, 0.5, 0.25))
"""Shares of the torque taken away at each half period, the shortest first."""
THROWN_SHARE: Final = 1.0 / 3.0
"""What is left may throw the main shaft off its flank so fast that it turns by this share of the
dog teeth's backlash while a sleeve is on its way."""
DISTINCT_SDS: Final = 2.0
"""A torque of the shafts is distinguished from none where it is this many times as large as its
error."""


class GearedBodies(NamedTuple):
    """Engine with gearbox, and vehicle, with a gear in mesh; at the propeller shaft."""

    ratio: float
    """Engine speed over the propeller shaft's."""
    engine_kgm2: float
    known: Known
    harmless_nm: float
    """What may swing in the shafts."""
    drag_nm: float = 0.0
    """The gearbox's own drag."""

    @property
    def _inverse(self) -> float:
        return 1.0 / self.engine_kgm2 + self.known.vehicle_inverse

    @property
    def half_period_us(self) -> float:
        """Of engine against vehicle."""
        return SECOND_US * math.pi / math.sqrt(self.known.stiffness_nm_rad * self._inverse)

    @property
    def tolerance(self) -> float:
        """Of the frequency, as a share."""
        vehicle = self.known.vehicle_sd / self._inverse
        return 0.5 * math.sqrt(3.0) * math.hypot(self.known.stiffness_sd, vehicle)

    def shafts_nm(self, torque_nm: float, acceleration_rad_s2: float) -> float:
        """What the shafts carry: torque of the engine (Nm at the crankshaft), acceleration of the
        propeller shaft."""
        return self.ratio * torque_nm - self.engine_kgm2 * acceleration_rad_s2 - self.drag_nm

    def coasting_rad_s2(self, torque_nm: float, acceleration_rad_s2: float) -> float:
        """The acceleration of the propeller shaft once the shafts carry nothing, where it is so
        much with this torque of the engine."""
        pulled = self.shafts_nm(torque_nm, acceleration_rad_s2)
        return acceleration_rad_s2 - self.known.vehicle_inverse * pulled

    def coasting_nm(self, coasting_rad_s2: float) -> float:
        """The torque with which engine and gearbox coast along with the vehicle (Nm at the
        crankshaft)."""
        return (self.engine_kgm2 * coasting_rad_s2 + self.drag_nm) / self.ratio


def geared_bodies(
    sheet: GearboxSheet, gear: DriveGear, known: Known, drag_nm: float = 0.0
) -> GearedBodies:
    """The bodies of a drive gear, with what is known of shafts and vehicle; drag_nm: of the free
    gearbox, at the layshaft."""
    ratio = sheet.overall_ratio(gear)
    layshaft = ratio * sheet.split_mesh(gear.split).ratio
    engine = sheet.engine.inertia_kgm2 * ratio**2 + sheet.geared_kgm2(gear)
    return GearedBodies(ratio, engine, known, _harmless_nm(sheet, gear), layshaft * drag_nm)


def _harmless_nm(sheet: GearboxSheet, gear: DriveGear) -> float:
    """The torque of the shafts that throws the main shaft off no faster than it may be: a mass
    that a spring releases leaves it with T / sqrt(k J)."""
    axle, main = sheet.axle, sheet.range_mesh(gear.range_).ratio
    thrown_rad_s = main * THROWN_SHARE * sheet.dog.backlash_rad / sheet.sleeve.delay_s
    turned_kgm2 = axle.propeller_kgm2 + axle.main_kgm2 / main**2
    return thrown_rad_s * math.sqrt(sheet.driveline.stiffness_nm_rad * turned_kgm2)


class Loaded(NamedTuple):
    """How engine, shafts and vehicle stand as a ramp begins, without what swings."""

    own_nm: float
    """The engine's torque at the crankshaft."""
    pulled_nm: float
    """What the shafts carry, at the propeller shaft."""
    coasting_rad_s2: float
    """The acceleration of the propeller shaft once they carry nothing."""
    doubt_nm: float
    """Error of `own_nm`: of what is read, and of what the engine needs for its own speed."""


class Unloading(NamedTuple):
    """A ramp under way; torques at the crankshaft."""

    bodies: GearedBodies
    own_nm: float
    """The engine's torque when it began, without what swings."""
    left_nm: float
    """The torque with which engine and gearbox coast along with the vehicle."""
    shares: tuple[float, ...]
    settle_us: float
    """From the last step until the engine has followed."""
    taken: int
    """Steps taken."""
    began_us: int
    step_us: float
    """When the last step was taken."""

    @property
    def torque_nm(self) -> float:
        """What is asked for."""
        return self.own_nm + sum(self.shares[: self.taken]) * (self.left_nm - self.own_nm)

    @property
    def next_us(self) -> float:
        """When the next step is due; infinite after the last one."""
        if self.taken == len(self.shares):
            return math.inf
        return self.step_us + self.bodies.half_period_us

    @property
    def over_us(self) -> float:
        """The plates may part from then on, as far as it is known now."""
        to_come = len(self.shares) - self.taken
        return self.step_us + to_come * self.bodies.half_period_us + self.settle_us


def unloading(
    sheet: GearboxSheet, bodies: GearedBodies, loaded: Loaded, now_us: int
) -> list[Unloading]:
    """Ramps with their first step at `now_us`, the shortest first; the last is the shortest that
    leaves a harmless swing."""
    engine = sheet.engine
    own_nm, pulled_nm, coasting_rad_s2, own_sd_nm = loaded
    left_nm = bodies.coasting_nm(coasting_rad_s2)
    doubt_nm = bodies.ratio * own_sd_nm
    away_nm = abs(pulled_nm) + doubt_nm
    if abs(pulled_nm) < max(DISTINCT_SDS * doubt_nm, bodies.harmless_nm):
        # Nothing that could be distinguished from none: the shafts are as much at rest as they can
        # be.
        return [Unloading(bodies, own_nm, own_nm, SHAPES[0], 0.0, 1, now_us, now_us)]
    swings = math.sin(0.5 * math.pi * min(bodies.tolerance, 1.0))
    found = []
    for shares in SHAPES:
        last_nm = max(shares[-1] * away_nm, bodies.harmless_nm)
        settle_us = engine.lag_s * math.log(last_nm / bodies.harmless_nm) * SECOND_US
        found.append(Unloading(bodies, own_nm, left_nm, shares, settle_us, 1, now_us, now_us))
        if away_nm * swings ** (len(shares) - 1) <= bodies.harmless_nm:
            break
    return found
