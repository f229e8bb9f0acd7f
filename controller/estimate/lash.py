"""A driveline behind the gearbox: its figures by data sheet and as learned, and how it begins.

What the data sheet leaves open of a driveline is learned from window to window in neutral: each
begins where and as fast as main shaft and vehicle are when a gear has come out, with a cloud of
particles (`lash_cloud`) that are spread as far as that is not known yet.

They are spread by numbers that fill a space evenly without any randomness: Halton's sequences
(1960). `scipy.stats.qmc.Halton` gives the same bits; to load it would cost a node 0.8 s and 68 MB.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.figures import Figure
from meshpoint.controller.estimate.loaded_driveline import DrivelineMotion, Shafts
from meshpoint.controller.estimate.wheel_tracker import STRUCK_RAD_S
from meshpoint.controller.models.backlash import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LOSS,
    ROWS,
    SPEED,
    STIFF,
    TYRE,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
    Chance,
    LashModel,
)
from meshpoint.gearbox.driveline import Axle
from meshpoint.kernels.records import Vector
from meshpoint.units import US

PRIMES: Final = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)
"""A sequence each."""

PARTICLES: Final = 2500
"""Number of drivelines in a cloud."""
AROUND: Final = 1.15
"""The first cloud lies within the backlash and this much of its half beyond, and as far as its
swing goes: flanks give way."""
PRESSED_SDS: Final = 2.0
"""In gear, a flank was pressed on where the twist was beyond it by this many standard
deviations."""
PRESSED_IN_GEAR: Final = 0.9
"""Share of the first cloud that lies where the driveline was found in gear, if a flank was pressed
on."""
FREE_IN_GEAR: Final = 0.5
"""Share of the first cloud that lies where the driveline was found in gear, if no flank was pressed
on."""
GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)
LEAST_DRAG: Final = 0.5
"""Drag is never less (rad/s2): it always slows a shaft down."""
SEEN_SDS: Final = (0.2, 0.5, 0.25, 0.5)
"""What one window says of stiffness, loss, backlash and drag counts as no surer than this, in
their logarithms: a shaft that met no flank shows little, and its cloud does not know how
little."""
WITHIN: Final = 2.0
"""They stay within this many standard deviations of the sheet's values."""
LEAST_SHARE_SD: Final = 0.5
"""They are never known better than by this share of what the sheet leaves open."""

KEPT_US: Final = 400_000.0
"""What a window in neutral has shown of the vehicle holds so long."""
HILL_SHARE: Final = 0.1
"""Standard deviation of the vehicle's acceleration so kept is at least this share of what hills may
make of it."""
FIRST_EDGES: Final = 12
"""A line through this many edges in neutral gives angle and speed at its start."""


@cache
def even(count: int) -> Vector:
    """Numbers that fill 0 to 1 evenly, (len(PRIMES), count)."""
    found = np.zeros((len(PRIMES), count))
    for row, base in zip(found, PRIMES, strict=True):
        rest, share = np.arange(1, count + 1), 1.0
        while rest.any():
            share /= base
            row += share * (rest % base)
            rest //= base
    return found


@cache
def normal(count: int) -> Vector:
    """The same as numbers of the normal law."""
    law = NormalDist()
    return np.array([[law.inv_cdf(value) for value in row] for row in even(count).tolist()])


@cache
def scattered_twice(count: int) -> Vector:
    """Numbers of the normal law that go with no others, neither those above nor those of another
    row nor their own from another place on; each row twice over, (len(PRIMES), 2 count).

    Fractions of i^2 times the root of a prime are spread evenly, and so are their differences
    between any two rows and any two places (Weyl 1916)."""
    law, squares = NormalDist(), np.arange(1.0, count + 1.0) ** 2
    rows = [(squares * math.sqrt(base) % 1.0).tolist() for base in PRIMES]
    found = np.array([[law.inv_cdf(value) for value in row] for row in rows])
    return np.concatenate((found, found), axis=1)


class LashStart(NamedTuple):
    """What is known when a gear has come out."""

    time_us: float
    angle_rad: float
    speed_rad_s: float
    vehicle_rad_s: float
    """The vehicle's speed, at the main shaft."""
    hill_rad_s2: float = 0.0
    """The vehicle's acceleration, at the main shaft."""
    vehicle_root: Vector | None = None
    """A root of the covariance of the vehicle's speed and acceleration, (2, 2), as known from
    before; None: as the sheet says."""
    behind: DrivelineMotion | None = None
    """What the driveline was found to be while the gear was in mesh; None: it was not followed."""

    @property
    def swing_rad_s(self) -> float:
        """How fast the shaft swings against the vehicle, wherever in its swing it is now: since the
        vehicle became known a synchroniser or a tooth has struck it. Out of a gear it hardly does.
        """
        if self.vehicle_root is None:
            return 0.0
        return math.hypot(self.speed_rad_s - self.vehicle_rad_s, STRUCK_RAD_S)


class VehicleTrajectory(NamedTuple):
    """What was known of the vehicle at a time, at the main shaft or the propeller shaft."""

    time_us: float
    speed_rad_s: float
    hill_rad_s2: float
    covariance: Vector
    """(2, 2)."""

    def at(self, time_us: float) -> VehicleTrajectory:
        """The same at a later time."""
        wait_s = (time_us - self.time_us) * US
        moves = np.array(((1.0, wait_s), (0.0, 1.0)))
        speed, hill = self.speed_rad_s + wait_s * self.hill_rad_s2, self.hill_rad_s2
        return VehicleTrajectory(time_us, speed, hill, moves @ self.covariance @ moves.T)

    def through(self, ratio: float) -> VehicleTrajectory:
        """The same at a shaft that turns `ratio` times as fast."""
        speed, hill = ratio * self.speed_rad_s, ratio * self.hill_rad_s2
        return VehicleTrajectory(self.time_us, speed, hill, ratio * ratio * self.covariance)


class LashFigures(NamedTuple):
    """What is known of a driveline in one step of the range, at the main shaft."""

    stiff: Figure
    """The shafts' stiffness over the main shaft's inertia (1/s2)."""
    loss: Figure
    """The loss at a flank (s/rad)."""
    half: Figure
    """Half of the backlash (rad)."""
    drag: Figure
    """The drag's acceleration (rad/s2)."""


def _figure(value: float, sd: float) -> Figure:
    """By the data sheet, with the deviation of its logarithm."""
    log = math.log(value)
    return Figure(log, sd, log - WITHIN * sd, log + WITHIN * sd, sd, LEAST_SHARE_SD * sd)


class Lash:
    """The figures of a driveline in one step of the range, from the data sheet, and as learned."""

    def __init__(self, axle: Axle, backlash_rad: float, factor: float, ratio: float) -> None:
        """ratio: the range's, i_range; factor: most backlash over the sheet's."""
        self.axle, self.ratio = axle, ratio
        turned = axle.main_kgm2 + axle.propeller_kgm2 * ratio * ratio
        self._turned_kgm2 = turned
        drag = (axle.pinion_nm * ratio + axle.loose_nm) / turned
        self.known = LashFigures(
            _figure(axle.shaft_nm_rad * ratio * ratio / turned, axle.shaft_tolerance),
            _figure(axle.flank_loss_s_rad * ratio, math.log(axle.flank_loss_factor)),
            _figure(0.5 * backlash_rad / ratio, math.log(factor) / math.sqrt(3.0)),
            _figure(drag, axle.pinion_tolerance / math.sqrt(3.0)),
        )

    def restore(self, half_rad: float, half_sd: float) -> None:
        """Starts from the half backlash that an earlier run learned."""
        self.known = self.known._replace(half=self.known.half.restored(half_rad, half_sd))

    def model(self, speed_rad_s: float) -> LashModel:
        """What is taken as known, at a speed of the main shaft."""
        axle, ratio = self.axle, self.ratio
        return LashModel(
            self._share,
            axle.tyre_nms / axle.wheels_kgm2,
            abs(speed_rad_s) * ratio / axle.relaxation_rad,
        )

    @property
    def shafts(self) -> Shafts:
        """Stiffness and backlash as known, at the propeller shaft."""
        stiff = self.known.stiff.value * self._turned_kgm2 / (self.ratio * self.ratio)
        return Shafts(stiff, self.known.half.value * self.ratio)

    @property
    def chance(self) -> Chance:
        """How torques of chance accelerate the shaft."""
        axle = self.axle
        nm = math.hypot(axle.main_chance_nm, self.ratio * axle.propeller_chance_nm)
        return Chance(2.0 * (nm / self._turned_kgm2) ** 2 * axle.chance_s, axle.chance_s)

    def cloud(self, start: LashStart) -> Vector:
        """The first cloud, (ROWS, PARTICLES)."""
        known, axle, sure = self.known, self.axle, normal(PARTICLES)
        x = np.empty((ROWS, PARTICLES))
        x[ANGLE], x[SPEED] = start.angle_rad, start.speed_rad_s
        x[HALF] = np.exp(known.half.log + known.half.sd * sure[0])
        root = np.diag(self.vehicle_sds) if start.vehicle_root is None else start.vehicle_root
        off_speed, off_hill = root @ sure[2:4]
        x[VEHICLE], x[HILL] = start.vehicle_rad_s + off_speed, start.hill_rad_s2 + off_hill
        swing_rad_s = start.swing_rad_s
        wheels_sd = math.hypot(axle.wheels_start_rad_s, self._share * swing_rad_s)
        x[WHEELS] = x[VEHICLE] + wheels_sd * sure[4]
        x[TYRE] = wheels_sd / math.sqrt(self._tyre_per_s2) * sure[5]
        x[STIFF] = np.exp(known.stiff.log + known.stiff.sd * sure[6])
        x[LOSS] = np.exp(known.loss.log + known.loss.sd * sure[7])
        x[DRAG] = np.maximum(np.exp(known.drag.log + known.drag.sd * sure[8]), LEAST_DRAG)
        x[TYRE_STIFF] = self._tyre_per_s2 * np.exp(axle.tyre_tolerance * sure[9])
        around = AROUND * x[HALF] + swing_rad_s / np.sqrt(x[STIFF])
        x[WAY] = x[HALF] + (2.0 * even(PARTICLES)[1] - 1.0) * around
        if start.behind is not None:
            self._follow_on(x, start.behind)
        return x

    def _follow_on(self, x: Vector, behind: DrivelineMotion) -> None:
        """Starts from what the driveline was found to be in gear. Where it lies in its backlash is
        not believed of all: half of them lie anywhere where no flank was pressed on."""
        mean, root, half = behind
        found = mean[:, np.newaxis] + root @ normal(PARTICLES)[1:6]
        twist, ratio = found[0], self.ratio
        beyond = twist - np.clip(twist, -half, half)
        way = x[HALF] * (1.0 + (twist - beyond) / half) + beyond / ratio
        is_pressed = abs(mean[0]) - half > PRESSED_SDS * math.sqrt(float(root[0] @ root[0]))
        share = PRESSED_IN_GEAR if is_pressed else FREE_IN_GEAR
        x[WAY] = np.where(GOLDEN * np.arange(PARTICLES) % 1.0 < share, way, x[WAY])
        x[WHEELS], x[TYRE], x[VEHICLE], x[HILL] = found[1:] / ratio

    @property
    def vehicle_sds(self) -> tuple[float, float]:
        """What is not known of the vehicle's speed and acceleration, at the main shaft."""
        return self.axle.vehicle_start_rad_s, self.axle.vehicle_rad_s2 / self.ratio

    @property
    def _share(self) -> float:
        """The inertia of what turns with the main shaft over that of the wheels."""
        return self._turned_kgm2 / (self.axle.wheels_kgm2 * self.ratio * self.ratio)

    @property
    def _tyre_per_s2(self) -> float:
        return self.axle.tyre_nm_rad / self.axle.wheels_kgm2

    def learn(self, shown: Callable[[int], tuple[float, float]]) -> None:
        """Takes over what a window has shown: mean and standard deviation of the logarithm of a row
        of its cloud."""
        learned = []
        for figure, row, least_sd in zip(
            self.known, (STIFF, LOSS, HALF, DRAG), SEEN_SDS, strict=True
        ):
            log, sd = shown(row)
            if not (math.isfinite(log) and math.isfinite(sd)):
                return
            learned.append(figure.after(log, max(sd, least_sd)))
        self.known = LashFigures(*learned)


class StartWatch:
    """Waits for the first edges after a gear's coming out."""

    def __init__(self) -> None:
        self._since_us = 0.0
        self._behind: DrivelineMotion | None = None
        self._vehicle: VehicleTrajectory | None = None
        """At the propeller shaft."""
        self.waiting: Vector = np.empty((2, 0))
        """Edges since the gear came out, until they were enough."""

    def lose(self) -> None:
        """Edges were lost: nothing from before holds."""
        self._vehicle = None

    def take_vehicle(self, vehicle: VehicleTrajectory) -> None:
        """A window in neutral has shown how the vehicle goes."""
        self._vehicle = vehicle

    def released(self, since_us: float, behind: DrivelineMotion | None = None) -> None:
        """A gear came out no later than this; behind: as in `LashStart`."""
        self._since_us, self._behind = since_us, behind
        self.waiting = np.empty((2, 0))

    def take_out(self, edges: Vector, lash: Lash) -> LashStart | None:
        """New edges since then; the start once they are enough. lash: the driveline in the range
        that is in."""
        after = edges[:, edges[0] > self._since_us]
        self.waiting = np.concatenate((self.waiting, after), axis=1)
        if self.waiting.shape[1] < FIRST_EDGES:
            return None
        waits = (self.waiting[0] - self._since_us) * US
        speed, angle = np.polyfit(waits, self.waiting[1], 1).tolist()
        kept, self._vehicle = self._vehicle, None
        start = LashStart(self._since_us, angle, speed, speed, behind=self._behind)
        if kept is not None and 0.0 <= self._since_us - kept.time_us < KEPT_US:
            return _kept(start, kept.through(1.0 / lash.ratio), lash.vehicle_sds)
        return start


def _kept(start: LashStart, vehicle: VehicleTrajectory, sds: tuple[float, float]) -> LashStart:
    """The start with the vehicle as a window in neutral has shown it."""
    if not (np.isfinite(vehicle[1:3]).all() and np.isfinite(vehicle.covariance).all()):
        return start
    vehicle = vehicle.at(start.time_us)
    covariance = vehicle.covariance + np.diag((sds[0], HILL_SHARE * sds[1])) ** 2
    root = np.asarray(np.linalg.cholesky(covariance), np.float64)
    return start._replace(
        vehicle_rad_s=vehicle.speed_rad_s, hill_rad_s2=vehicle.hill_rad_s2, vehicle_root=root
    )
