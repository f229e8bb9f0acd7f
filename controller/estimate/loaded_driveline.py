"""The driveline with a gear in mesh: what the shafts carry, and how fast the vehicle is.

A Kalman filter over the layshaft's angles in gear, with the torque that the engine says it gives
(`loaded_kernels`). When the gear comes out, it says where the driveline begins its way through the
backlash: the shafts' twist, the wheels, the tyres and the vehicle, which no sensor sees.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.loaded_kernels import (
    FOLLOWED,
    GEAR,
    GEAR_SPEED,
    HILL,
    LOADED_MODEL,
    LOADED_STATES,
    TWIST,
    TYRE,
    VEHICLE,
    VEHICLE_INVERSE,
    WHEELS,
    WRONG,
    follow_loaded,
    loaded_ahead,
)
from meshpoint.controller.models.twist import STATES, Twist, TwistFigures
from meshpoint.gearbox import DriveGear, GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.kernels.records import RecordMemory, Vector, filled
from meshpoint.units import US

MEASUREMENT_US: Final = 4000.0
"""Edges within this are taken together, as in the cloud of particles."""
FIRST_MEASUREMENTS: Final = 8
"""A line through this many gives angle and speed at the start."""
LEAST_S: Final = 0.3
"""The estimate says nothing before it has followed a gear for so long."""
LATE_S: Final = 0.1
"""Nor so long after its newest measurement."""
LEAST_EDGES: Final = 4
"""Fewer of a shaft in a step say nothing of its speed."""
MEASUREMENT_RAD: Final = math.radians(0.1)
"""Standard deviation of a measurement at the gear, at the main shaft: it lies anywhere in the
backlash of its mesh."""
START_NM: Final = 1000.0
"""What the shafts may carry beyond what the engine says, before anything was seen."""
START_RAD: Final = 0.02
"""Standard deviation of the first angle (rad)."""
START_RAD_S: Final = 0.4
"""Standard deviation of the first speeds of gear, wheels and vehicle, which are taken to be alike
(rad/s)."""
OPEN_NM: Final = 2.0
"""Drag of the clutch's open plates, at the crankshaft."""
WRONG_S: Final = 0.2
"""What its torque is taken for wrongly lasts for so long: a fifth of a second is a swing."""
SHAFT_NMS: Final = 10.0
"""Damping of the shafts (Nm s/rad): 3 % of critical and more are published (docs/gearbox.md)."""
HILL_S: Final = 40.0
"""A slope lasts for so long: some hundred metres of road."""
FADING_SHARE: Final = 0.4
"""How far tyres' relaxation lengths differ: slip stiffness over longitudinal stiffness is 0.43 to
0.82 m from a light to a heavy load (docs/gearbox.md)."""
FADING_MEMORY_S: Final = 1.0
"""Error of that changes with load and slip within a ramp."""
INFLATION: Final = 1.5
"""Variances count as this many times as large: stiffness and tyres differ from those of the
sheet."""
DRIVING, TOOTH = map((LOADED_MODEL.names or ()).index, ("driving_nm", "tooth_rad"))
BEHIND: Final = (TWIST, WHEELS, TYRE, VEHICLE, HILL)


def grouped_counts(edges: Vector, within_us: float) -> tuple[Vector, Vector, Vector]:
    """Mean times and mean angles of edges (2, n), in order of time, that lie within so long of one
    another, and of how many edges each is; n is at least 1."""
    group = np.floor((edges[0] - edges[0, 0]) / within_us)
    # Where a group begins: numpy's `unique` sorts what is sorted, for four times as long.
    begins = np.flatnonzero(group[1:] != group[:-1])
    first = np.zeros(begins.size + 2, dtype=np.intp)
    first[1:-1], first[-1] = begins + 1, group.size
    count = (first[1:] - first[:-1]).astype(np.float64)
    times, angles = np.add.reduceat(edges, first[:-1], axis=1) / count
    return times, angles, count


class Load(NamedTuple):
    """What loads the gear, as known in one step."""

    torque_nm: float
    """Of the engine, at the crankshaft."""
    carries: bool
    """Whether the clutch's plates carry it."""
    drag_nm: float
    """Of the free gearbox, at the layshaft."""
    has_input: bool = True
    """Whether the input shaft turns with the layshaft: not while a splitter is between steps."""


class Shafts(NamedTuple):
    """What is known of the shafts behind, at the propeller shaft."""

    stiffness_nm_rad: float
    half_lash_rad: float


class DrivelineMotion(NamedTuple):
    """The driveline behind a gearbox at a time, at the propeller shaft: the shafts' twist from the
    middle of their backlash (rad), the wheels' speed (rad/s), the tyres' twist (rad), the vehicle's
    speed (rad/s) and what hills do to it (rad/s2)."""

    mean: Vector
    """The five figures above, (5,)."""
    root: Vector
    """A root of their covariance, (5, 5)."""
    half_lash_rad: float
    """Half of the backlash by which it was found."""


class HeldLayshaft(NamedTuple):
    """A layshaft that a gear in mesh holds, rad/s."""

    omega_rad_s: float
    steady_rad_s: float
    """Its speed if the driveline did not swing: the vehicle's."""


class InGear(NamedTuple):
    """What a gear makes of the shafts: ratios, and what turns and drags at the propeller shaft."""

    overall: float
    """Crankshaft over propeller shaft."""
    layshaft: float
    """Layshaft over propeller shaft."""
    main: float
    """Turns of the main shaft for one of the layshaft."""
    range_: float
    """Turns of the propeller shaft for one of the main shaft."""
    turned_kgm2: float
    """The clutch open."""
    loose_nm: float
    """Drag behind the gearbox."""
    input_kgm2: float
    """Of what turns, the input shaft's part."""


def in_gear(sheet: GearboxSheet, gear: DriveGear) -> InGear:
    """Of a gear of this sheet."""
    axle, overall = sheet.axle, sheet.overall_ratio(gear)
    behind = sheet.range_mesh(gear.range_).ratio
    turned = axle.propeller_kgm2 + axle.main_kgm2 / behind**2
    turned += sheet.geared_kgm2(gear)
    return InGear(
        overall,
        overall * sheet.split_mesh(gear.split).ratio,
        sheet.main_mesh(gear.main).ratio,
        behind,
        turned,
        axle.loose_nm / behind,
        sheet.shafts.input_inertia_kgm2 * overall**2,
    )


class LoadedDriveline:
    """Follows the driveline while a gear is in mesh."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._gears = {gear: in_gear(sheet, gear) for gear in DRIVE_GEARS.values()}
        self._gear: DriveGear | None = None
        self._carried, self._load_nm, self._drag_nm = False, 0.0, 0.0
        self._model, self._followed = np.zeros(0), RecordMemory(FOLLOWED)
        self._model_of: tuple[InGear, float, Shafts] | None = None
        """What the model was worked out for; torque and teeth are each step's own."""
        self._x, self._p = np.zeros(LOADED_STATES), np.zeros((LOADED_STATES, LOADED_STATES))
        least, most = sheet.driveline.vehicle_kgm2
        self._inverses = np.array((1.0 / most, 1.0 / least))
        self.lose()

    def lose(self) -> None:
        """Teeth or times were lost: begins anew with the next measurements."""
        self._first: list[tuple[float, float]] = []
        self._running, self._apart, self._began_us = False, math.nan, 0.0
        self._followed.part("time_us")[0], self._followed.part("nis")[0] = 0.0, 1.0

    def take(
        self, gear: DriveGear | None, layshaft: Vector, main: Vector, load: Load, shafts: Shafts
    ) -> None:
        """One step's edges of both shafts, times (us) and angles (rad), (2, n), in order of time.
        gear: the one in mesh; None: none is, or it is not known."""
        if gear is None or layshaft.shape[1] < LEAST_EDGES or main.shape[1] < LEAST_EDGES:
            return
        if not self._goes_on(gear):
            self.lose()
        self._gear = gear
        mesh = self._gears[gear]
        edges = np.array((layshaft[0], layshaft[1] * mesh.range_ * mesh.main))
        tooth = _tooth_rad(edges, main[0], mesh.range_ * main[1])
        self._apart = tooth if math.isnan(self._apart) else self._apart
        self._load(mesh, load, shafts, tooth - self._apart)
        measurements = np.array(grouped_counts(edges, MEASUREMENT_US)[:2])
        while measurements.shape[1]:
            if self._running:
                measurements = self._measure(measurements, mesh)
            else:
                time_us, angle = measurements[:, 0].tolist()
                self._begin(time_us, angle, mesh, shafts)
                measurements = measurements[:, 1:]

    def _goes_on(self, gear: DriveGear) -> bool:
        """Whether the layshaft is still in the gear that is followed. A splitter with dog teeth
        changes with the main box in gear."""
        before = self._gear
        if before is None or not self._sheet.has_dog_splitter:
            return gear == before
        return (gear.main, gear.range_) == (before.main, before.range_)

    def _measure(self, measurements: Vector, mesh: InGear) -> Vector:
        """Returns what is left of them where it has lost the driveline."""
        own_rad2 = (MEASUREMENT_RAD * mesh.range_) ** 2
        taken = follow_loaded(
            self._x, self._p, self._followed.flat, np.ascontiguousarray(measurements), own_rad2,
            self._inverses, self._model,
        )  # fmt: skip
        if taken < measurements.shape[1]:
            self.lose()
        return measurements[:, taken + 1 :]

    def _load(self, mesh: InGear, load: Load, shafts: Shafts, tooth_rad: float) -> None:
        """What the kernel takes as known in this step."""
        engine, axle, ratio = self._sheet.engine, self._sheet.axle, mesh.overall
        turned = mesh.turned_kgm2 - (0.0 if load.has_input else mesh.input_kgm2)
        drag_nm = mesh.layshaft * load.drag_nm + axle.pinion_nm + mesh.loose_nm
        driving_nm, wrong_nm = -drag_nm, OPEN_NM
        if load.carries:
            turned += engine.inertia_kgm2 * ratio**2
            driving_nm, wrong_nm = ratio * load.torque_nm - drag_nm, engine.error_nm
        elif self._carried and self._running:
            # The plates have parted: what the engine's torque was taken for wrongly is gone.
            self._x[WRONG], self._p[WRONG, :], self._p[:, WRONG] = 0.0, 0.0, 0.0
            self._p[WRONG, WRONG] = (ratio * OPEN_NM) ** 2
        self._carried, self._load_nm, self._drag_nm = load.carries, load.torque_nm, drag_nm
        if self._model_of == (mesh, turned, shafts):
            self._model[DRIVING], self._model[TOOTH] = driving_nm, tooth_rad
            return
        self._model_of = mesh, turned, shafts
        chance = 2.0 * axle.propeller_chance_nm**2 * axle.chance_s
        road = 2.0 * axle.road_chance_nm**2 * axle.road_chance_s
        self._model = filled(
            LOADED_MODEL,
            geared_kgm2=turned,
            driving_nm=driving_nm,
            tooth_rad=tooth_rad,
            shaft_nm_rad=shafts.stiffness_nm_rad,
            shaft_nms=SHAFT_NMS,
            half_lash_rad=shafts.half_lash_rad,
            wheels_kgm2=axle.wheels_kgm2,
            tyre_nm_rad=axle.tyre_nm_rad,
            tyre_nms=axle.tyre_nms,
            relaxation_rad=axle.relaxation_rad,
            wrong_nm=ratio * wrong_nm,
            wrong_s=WRONG_S,
            gear_rad2_s3=chance / turned**2,
            wheels_rad2_s3=road / axle.wheels_kgm2**2,
            hill_rad2_s5=2.0 * axle.vehicle_rad_s2**2 / HILL_S,
            fading_s=2.0 * FADING_SHARE**2 * FADING_MEMORY_S,
        )

    def _begin(self, time_us: float, angle: float, mesh: InGear, shafts: Shafts) -> None:
        """Collects the first measurements, and starts from a line through them and from the
        engine's torque: shafts and tyres carry it, and a hill takes it, whichever vehicle of the
        sheet that is, or the vehicle speeds up by as much."""
        self._first.append((time_us, angle))
        if len(self._first) < FIRST_MEASUREMENTS:
            return
        measurements, axle = np.array(self._first), self._sheet.axle
        speed, start = np.polyfit(
            (measurements[:, 0] - time_us) * US, measurements[:, 1], 1
        ).tolist()
        x, (least, most), driving_nm = self._x, self._inverses, float(self._model[DRIVING])
        x[:] = 0.0
        x[GEAR], x[[GEAR_SPEED, WHEELS]] = start, speed
        x[TWIST] = math.copysign(shafts.half_lash_rad, driving_nm)
        x[TWIST] += driving_nm / shafts.stiffness_nm_rad
        x[TYRE] = driving_nm / axle.tyre_nm_rad
        x[VEHICLE] = speed - abs(speed) / axle.relaxation_rad * x[TYRE]
        x[VEHICLE_INVERSE] = 0.5 * (least + most)
        x[HILL] = -driving_nm * x[VEHICLE_INVERSE]
        sds = np.empty(LOADED_STATES)
        sds[GEAR], sds[GEAR_SPEED], sds[[WHEELS, VEHICLE]] = START_RAD, START_RAD_S, START_RAD_S
        sds[TWIST] = shafts.half_lash_rad + START_NM / shafts.stiffness_nm_rad
        sds[TYRE], sds[HILL] = START_NM / axle.tyre_nm_rad, axle.vehicle_rad_s2 + abs(x[HILL])
        sds[WRONG] = mesh.overall * self._sheet.engine.error_nm
        sds[VEHICLE_INVERSE] = (most - least) / math.sqrt(12.0)
        root = np.diag(sds)
        root[HILL, VEHICLE_INVERSE] = -driving_nm * sds[VEHICLE_INVERSE]
        self._p = root @ root.T
        self._followed.part("time_us")[0] = self._began_us = time_us
        self._followed.part("nis")[0], self._running = 1.0, True

    def _at(self, time_us: float) -> tuple[Vector, Vector] | None:
        """State and covariance at a time soon after the newest measurement; None where the gear was
        not followed for long enough."""
        ahead_s = (time_us - self._newest_us) * US
        if not self._running or self.is_early or not 0.0 <= ahead_s < LATE_S:
            return None
        x, p = self._x.copy(), self._p.copy()
        loaded_ahead(x, p, ahead_s, self._model)
        return (x, p) if np.isfinite(x).all() and np.isfinite(p).all() else None

    @property
    def is_early(self) -> bool:
        """Whether it follows a gear, and has not for long enough yet to say anything."""
        return self._running and (self._newest_us - self._began_us) * US < LEAST_S

    @property
    def _newest_us(self) -> float:
        """Time of the newest measurement."""
        return float(self._followed.part("time_us")[0])

    def twist(self, time_us: float) -> Twist | None:
        """The driveline on its flank, for a plan of the engine's torque; None where the gear was
        not followed for long enough, or the clutch carries nothing."""
        found = self._at(time_us)
        if found is None or self._gear is None or not self._carried:
            return None
        (x, _), mesh, axle = found, self._gears[self._gear], self._sheet.axle
        model = self._model.view(LOADED_MODEL)[0]
        place, half = x[TWIST] + model["tooth_rad"], model["half_lash_rad"]
        fading = abs(x[VEHICLE]) / axle.relaxation_rad
        state = np.empty(STATES)
        state[:2] = x[GEAR_SPEED] - x[WHEELS], place - min(max(place, -half), half)
        state[2:] = x[WHEELS] - x[VEHICLE], x[TYRE], self._load_nm, 1.0
        figures = TwistFigures(
            ratio=mesh.overall,
            geared_kgm2=float(model["geared_kgm2"]),
            released_kgm2=axle.propeller_kgm2 + axle.main_kgm2 / mesh.range_**2,
            constant_nm=float(x[WRONG]) - self._drag_nm,
            shaft_nm_rad=float(model["shaft_nm_rad"]),
            shaft_nms=SHAFT_NMS,
            wheels_kgm2=axle.wheels_kgm2,
            tyre_nm_rad=axle.tyre_nm_rad,
            tyre_nms=axle.tyre_nms,
            fading=float(fading),
            vehicle_inverse=float(x[VEHICLE_INVERSE]),
            hill_rad_s2=float(x[HILL]),
            lag_s=self._sheet.engine.lag_s,
        )
        return Twist(figures, state)

    def layshaft(self, time_us: float) -> HeldLayshaft | None:
        """The layshaft soon after the newest measurement, as the driveline turns it; None where the
        gear was not followed for long enough."""
        found = self._at(time_us)
        if found is None or self._gear is None:
            return None
        (x, _), mesh = found, self._gears[self._gear]
        turns = mesh.main * mesh.range_
        return HeldLayshaft(float(x[GEAR_SPEED]) / turns, float(x[VEHICLE]) / turns)

    def behind(self, time_us: float) -> DrivelineMotion | None:
        """The driveline behind the gearbox at a time soon after the newest measurement; None where
        the gear was not followed for long enough."""
        found = self._at(time_us)
        if found is None:
            return None
        (x, p), model = found, self._model
        shared = INFLATION * p[np.ix_(BEHIND, BEHIND)]
        mean = x[list(BEHIND)]
        values, vectors = np.linalg.eigh(shared)
        half, tooth = (model.view(LOADED_MODEL)[name][0] for name in ("half_lash_rad", "tooth_rad"))
        mean[0] += tooth
        return DrivelineMotion(mean, vectors * np.sqrt(np.maximum(values, 0.0)), float(half))


def _tooth_rad(edges: Vector, times_us: Vector, angles: Vector) -> float:
    """How far the mean of some angles lies from the line through the edges (2, n)."""
    # Sums over a count: numpy's `mean` takes five times as long for so few.
    middle_us, middle = np.add.reduce(edges, axis=1) / edges.shape[1]
    waits = edges[0] - middle_us
    slope = float(waits @ (edges[1] - middle)) / float(waits @ waits)
    time_us = float(np.add.reduce(times_us)) / times_us.size
    along = float(middle) + slope * (time_us - float(middle_us))
    return float(np.add.reduce(angles)) / angles.size - along
