"""Where a driveline lies in its backlash: a cloud of drivelines, weighed by the edges.

When a gear has come out it is not known where between its flanks the driveline lies, how wide the
backlash is, nor how fast the vehicle is within some tenths. Each driveline of the cloud holds
another answer to all of it; all move on (`motion/lash_motion`), and each edge weighs them by how
well they foretold it. When few weigh most, the cloud is drawn anew around those (particle filter:
Gordon, Salmond and Smith 1993; with a kernel for what does not move: Liu and West 2001). The
shaft's own angle, speed and drag differ from those foretold by torques of chance: these three are
estimated in each driveline by a Kalman filter, whose gain is the same for all (Rao and Blackwell;
Doucet et al. 2000).

There is no randomness in it: the first cloud is a low-discrepancy sequence (Halton 1960), and what
is added to a cloud drawn anew are numbers that only look drawn (`halton.scattered_twice`).
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimation.cloud_redraw import SHARES, SPREAD, drawn, drawn_anew
from meshpoint.controller.estimation.edge_looks import grouped_counts
from meshpoint.controller.estimation.halton import PRIMES, even, normal, scattered_twice
from meshpoint.controller.estimation.loaded_driveline import BehindState, Shafts
from meshpoint.controller.jit import bare
from meshpoint.controller.motion.lash_course import Chance, LashCourse
from meshpoint.controller.motion.lash_motion import (
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
    LashModel,
    each,
    move,
)
from meshpoint.controller.records import Vector
from meshpoint.gearbox.driveline import Axle
from meshpoint.units import US

DRIVELINES: Final = 2500
FOLLOWED: Final = 240
"""So many of them, by their weights, are followed ahead."""
LOOK_US: Final = 4000.0
"""Edges within this are taken together: one by itself tells little, and a shaft swings slowly."""
LEAST_SHARE: Final = 0.25
"""The cloud is drawn anew when fewer than this share of it carries the weight."""
MOST_OFF: Final = 4.0
"""An angle that is further off, in standard deviations, counts as so far off."""
PRESSED: Final = 0.6
"""Share of the first cloud that is still pressed to the flank that the shafts' torque held;"""
AROUND: Final = 1.15
"""the rest lies within the backlash and this much of its half beyond: flanks give way."""
TOLD_SDS: Final = 2.0
"""In gear a flank was pressed on, where the twist was beyond it by so many standard deviations;"""
PRESSED_TOLD: Final = 0.9
PRESSED_UNTOLD: Final = 0.5
"""so much of the first cloud lies where it was found in gear, with a flank pressed on, and else."""
GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)
DOUBT_KEPT: Final = 0.9
"""Weight of what was doubted before against a new look."""
LOST: Final = 9.0
"""A cloud that is so much doubted has lost the driveline: it begins anew"""
RECENT: Final = 4
"""from a line through so many looks."""
FIRST_OMEGA: Final = 2.0
"""Standard deviation (rad/s) of the speed when a gear comes out;"""
FIRST_DRAG: Final = 0.5
"""of the drag's acceleration (rad/s2) in one driveline,"""
DRAG_CHANGE: Final = 4.0
"""and density of its change (rad2/s5)."""
LEAST_DRAG: Final = 0.5
"""Drag is never less (rad/s2): it always slows a shaft down."""
SEEN_SDS: Final = (0.2, 0.5, 0.25, 0.5)
"""What one window tells of stiffness, loss, backlash and drag counts as no surer than this, in
their logarithms: a shaft that met no flank tells little, and its cloud does not know how little."""
LEAST_SHARE_SD: Final = 0.5
"""They are never known better than by this share of what the sheet leaves open."""


class LashStart(NamedTuple):
    """What is known when a gear has come out."""

    time_us: float
    angle_rad: float
    speed_rad_s: float
    vehicle_rad_s: float
    """The vehicle's speed at the main shaft, and its acceleration,"""
    hill_rad_s2: float = 0.0
    vehicle_root: Vector | None = None
    """with a root of their covariance, (2, 2); None: as the sheet says."""
    pressed_nm: float = 0.0
    """About what was left in the shafts, at the propeller shaft: above 0 at the flank of drive,
    below at that of coast, 0 unknown."""
    behind: BehindState | None = None
    """What the driveline was found to be while the gear was in mesh; None: it was not followed."""


class VehicleCourse(NamedTuple):
    """What was known of the vehicle at a time, at the main shaft."""

    time_us: float
    speed_rad_s: float
    hill_rad_s2: float
    covariance: Vector
    """(2, 2)."""

    def at(self, time_us: float) -> VehicleCourse:
        """The same at a later time."""
        wait_s = (time_us - self.time_us) * US
        moves = np.array(((1.0, wait_s), (0.0, 1.0)))
        speed, hill = self.speed_rad_s + wait_s * self.hill_rad_s2, self.hill_rad_s2
        return VehicleCourse(time_us, speed, hill, moves @ self.covariance @ moves.T)


class LashFigures(NamedTuple):
    """What is known of a driveline in one step of the range, at the main shaft: logarithms with
    their standard deviations."""

    stiff_log: float
    stiff_sd: float
    """Of the shafts' stiffness over the main shaft's inertia (1/s2),"""
    loss_log: float
    loss_sd: float
    """of the loss at a flank (s/rad),"""
    half_log: float
    half_sd: float
    """of half of the backlash (rad),"""
    drag_log: float
    drag_sd: float
    """and of the drag's acceleration (rad/s2)."""


class Lash:
    """The figures of a driveline in one step of the range, from the data sheet, and as learned."""

    def __init__(self, axle: Axle, backlash_rad: float, factor: float, ratio: float) -> None:
        """ratio: the range's, i_range; factor: most backlash over the sheet's."""
        self.axle, self.ratio = axle, ratio
        turned = axle.main_kgm2 + axle.propeller_kgm2 * ratio * ratio
        self._turned_kgm2 = turned
        drag = (axle.pinion_nm * ratio + axle.loose_nm) / turned
        self.prior = LashFigures(
            math.log(axle.shaft_nm_rad * ratio * ratio / turned),
            axle.shaft_tolerance,
            math.log(axle.flank_loss_s_rad * ratio),
            math.log(axle.flank_loss_factor),
            math.log(0.5 * backlash_rad / ratio),
            math.log(factor) / math.sqrt(3.0),
            math.log(drag),
            axle.pinion_tolerance / math.sqrt(3.0),
        )
        self.known = self.prior

    def restore(self, half_rad: float, half_sd: float) -> None:
        """Starts from the half backlash that an earlier run learned."""
        sd = min(self.prior.half_sd, max(LEAST_SHARE_SD * self.prior.half_sd, half_sd))
        self.known = self.known._replace(half_log=math.log(half_rad), half_sd=sd)

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
        stiff = math.exp(self.known.stiff_log) * self._turned_kgm2 / (self.ratio * self.ratio)
        return Shafts(stiff, math.exp(self.known.half_log) * self.ratio)

    @property
    def chance(self) -> Chance:
        """How torques of chance accelerate the shaft."""
        axle = self.axle
        nm = math.hypot(axle.main_chance_nm, self.ratio * axle.propeller_chance_nm)
        return Chance(2.0 * (nm / self._turned_kgm2) ** 2 * axle.chance_s, axle.chance_s)

    def cloud(self, start: LashStart) -> Vector:
        """The first cloud, (ROWS, DRIVELINES)."""
        known, axle, sure = self.known, self.axle, normal(DRIVELINES)
        x = np.empty((ROWS, DRIVELINES))
        x[ANGLE], x[SPEED] = start.angle_rad, start.speed_rad_s
        x[HALF] = np.exp(known.half_log + known.half_sd * sure[0])
        root = np.diag(self.vehicle_sds) if start.vehicle_root is None else start.vehicle_root
        off_speed, off_hill = root @ sure[2:4]
        x[VEHICLE], x[HILL] = start.vehicle_rad_s + off_speed, start.hill_rad_s2 + off_hill
        x[WHEELS] = x[VEHICLE] + axle.wheels_start_rad_s * sure[4]
        x[TYRE] = axle.wheels_start_rad_s / math.sqrt(self._tyre_per_s2) * sure[5]
        x[STIFF] = np.exp(known.stiff_log + known.stiff_sd * sure[6])
        x[LOSS] = np.exp(known.loss_log + known.loss_sd * sure[7])
        x[DRAG] = np.maximum(np.exp(known.drag_log + known.drag_sd * sure[8]), LEAST_DRAG)
        x[TYRE_STIFF] = self._tyre_per_s2 * np.exp(axle.tyre_tolerance * sure[9])
        self._press(x, start.pressed_nm)
        if start.behind is not None:
            self._follow_on(x, start.behind)
        return x

    def _follow_on(self, x: Vector, behind: BehindState) -> None:
        """Starts from what the driveline was found to be in gear. Where it lies in its backlash is
        not believed of all: half of them lie as the ramp says where no flank is pressed on."""
        mean, root, half = behind
        found = mean[:, np.newaxis] + root @ normal(DRIVELINES)[1:6]
        twist, ratio = found[0], self.ratio
        beyond = twist - np.clip(twist, -half, half)
        way = x[HALF] * (1.0 + (twist - beyond) / half) + beyond / ratio
        told = abs(mean[0]) - half > TOLD_SDS * math.sqrt(float(root[0] @ root[0]))
        share = PRESSED_TOLD if told else PRESSED_UNTOLD
        x[WAY] = np.where(GOLDEN * np.arange(DRIVELINES) % 1.0 < share, way, x[WAY])
        x[WHEELS], x[TYRE], x[VEHICLE], x[HILL] = found[1:] / ratio

    def _press(self, x: Vector, pressed_nm: float) -> None:
        """Places the drivelines between their flanks, and at the one that was pressed on."""
        pressed = float(np.sign(pressed_nm))
        places, share = even(DRIVELINES)[1], PRESSED * abs(pressed)
        on, rest = places < share, (places - share) / (1.0 - share)
        # The law of what a ramp leaves has a mean and is no less than none: exponential.
        left_nm = -abs(pressed_nm) * np.log1p(-np.where(on, places / PRESSED, 0.0))
        twist = left_nm * self.ratio / (self._turned_kgm2 * x[STIFF])
        flank = (1 + pressed) * x[HALF] + pressed * twist
        x[WAY] = np.where(on, flank, (1.0 - AROUND + 2.0 * AROUND * rest) * x[HALF])
        x[TYRE] += pressed * left_nm * self.ratio / self._turned_kgm2 * self._share / x[TYRE_STIFF]

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

    def learn(self, cloud: LashCloud) -> None:
        """Takes over what a window has shown."""
        learned: list[float] = []
        for k, row in enumerate((STIFF, LOSS, HALF, DRAG)):
            log, sd = cloud.log_figure(row)
            if not (math.isfinite(log) and math.isfinite(sd)):
                return
            middle, most = self.prior[2 * k : 2 * k + 2]
            before, before_sd = self.known[2 * k : 2 * k + 2]
            gain = before_sd**2 / (before_sd**2 + max(sd, SEEN_SDS[k]) ** 2)
            after = before + gain * (log - before)
            after_sd = max(before_sd * math.sqrt(1.0 - gain), LEAST_SHARE_SD * most)
            learned += [min(max(after, middle - 2.0 * most), middle + 2.0 * most), after_sd]
        self.known = LashFigures(*learned)


class LashCloud:
    """The drivelines of one interval in neutral."""

    def __init__(self, lash: Lash, start: LashStart, edge_time_s: float) -> None:
        self._lash, self._start = lash, start
        self._begin(start)
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)
        """Times (us) and angles of the newest looks."""
        self._model = lash.model(start.speed_rad_s)
        self._chance = lash.chance
        self._edge_time_s = edge_time_s
        self._drawn = 0
        self.time_us = start.time_us
        """Up to here edges have been taken."""

    def _begin(self, start: LashStart) -> None:
        self._x = self._lash.cloud(start)
        self._logs = np.zeros(DRIVELINES)
        self._weights: Vector | None = None
        """Those of the present logarithms, once they were asked for."""
        self._p = np.diag((0.05**2, FIRST_OMEGA**2, FIRST_DRAG**2))
        """Covariance of angle, speed and drag in each driveline."""
        self._doubt = 1.0
        """Mean square of how far off the angles were, over how far the cloud let expect."""

    def _begin_anew(self) -> None:
        """From the newest looks, wherever in the backlash: what was known of it has proved wrong
        (sensor resetting, Lenser and Veloso 2000)."""
        looks, start = np.array(self._recent), self._start
        waits_s = (looks[:, 0] - self.time_us) * US
        speed, angle = np.polyfit(waits_s, looks[:, 1], 1).tolist()
        since_s = (self.time_us - start.time_us) * US
        vehicle = start.vehicle_rad_s + start.hill_rad_s2 * since_s
        # Either the shaft swings so fast, or the vehicle's speed was wrong.
        speed_sd, hill_sd = self._lash.vehicle_sds
        self._begin(
            start._replace(
                time_us=self.time_us,
                angle_rad=angle,
                speed_rad_s=speed,
                vehicle_rad_s=vehicle,
                vehicle_root=np.diag((math.hypot(speed_sd, speed - vehicle), hill_sd)),
                pressed_nm=0.0,
                behind=None,
            )
        )

    @property
    def is_alive(self) -> bool:
        """Whether all of it are numbers."""
        return bool(np.isfinite(self._x).all() and np.isfinite(self._logs).all())

    @property
    def weights(self) -> Vector:
        """Probabilities of the drivelines."""
        if self._weights is None:
            found = np.exp(self._logs - self._logs.max())
            self._weights = np.asarray(found / found.sum())
        return self._weights

    def mean(self, row: int) -> float:
        """Mean of a quantity."""
        return float(self.weights @ self._x[row])

    @property
    def vehicle(self) -> VehicleCourse:
        """The vehicle as far as it is known, as unsure as the cloud is doubted."""
        rows = self._x[[VEHICLE, HILL]]
        speed, hill = (rows @ self.weights).tolist()
        spread = np.cov(rows, aweights=self.weights, ddof=0)
        return VehicleCourse(self.time_us, speed, hill, max(1.0, self._doubt) * spread)

    def log_figure(self, row: int) -> tuple[float, float]:
        """Mean and standard deviation of a quantity's logarithm; not numbers where it has none."""
        if not self.is_alive:
            return math.nan, math.nan
        weights, logs = self.weights, np.log(self._x[row])
        mean = weights @ logs
        return float(mean), math.sqrt(float(weights @ (logs - mean) ** 2))

    def take(self, edges: Vector, tooth_rad: float) -> None:
        """Takes edges: times (us) and angles (rad), (2, n), in order of time; late ones are left
        out. tooth_rad: standard deviation of an edge's angle."""
        edges = edges[:, edges[0] > self.time_us]
        if not edges.size:
            return
        times, angles, count = grouped_counts(edges, LOOK_US)
        jitter_rad = float(self._x[SPEED, 0]) * self._edge_time_s
        variances = (tooth_rad**2 + jitter_rad**2) / count
        for time_us, angle_rad, variance in zip(times, angles, variances, strict=True):
            self._look((float(time_us) - self.time_us) * US, float(angle_rad), float(variance))
            self.time_us = float(time_us)
            self._recent.append((self.time_us, float(angle_rad)))
            if self._doubt > LOST and len(self._recent) == RECENT:
                self._begin_anew()

    def _look(self, seconds: float, angle_rad: float, variance: float) -> None:
        x = self._x
        move(x, seconds, self._model)
        p = spread(self._p, seconds, self._chance.rad2_s3)
        whole = float(p[0, 0]) + variance
        gain = p[:, 0] / whole
        off = angle_rad - x[ANGLE]
        self._look_back(off, whole)
        correct(x, self._logs, off, gain, whole)
        self._weights = None
        self._p = p - np.outer(gain, p[0])
        weights = self.weights
        if 1.0 / float(weights @ weights) < LEAST_SHARE * DRIVELINES and self.is_alive:
            self._draw(weights)

    def _look_back(self, off: Vector, variance: float) -> None:
        """Takes how far off the cloud was: one that has lost the driveline does not know it by
        itself, because what is drawn anew is as narrow as the little that was left."""
        weights = self.weights
        mean = float(weights @ off)
        expected = float(weights @ (off - mean) ** 2) + variance
        self._doubt = DOUBT_KEPT * self._doubt + (1.0 - DOUBT_KEPT) * mean**2 / expected

    def _draw(self, weights: Vector) -> None:
        """Draws the cloud anew, each driveline as often as its weight says."""
        self._drawn += 1
        begin = -self._drawn * PRIMES[-1] ** 2 % DRIVELINES
        numbers = scattered_twice(DRIVELINES)[: len(SPREAD) + len(SHARES)]
        self._x = drawn_anew(self._x, weights, numbers[:, begin : begin + DRIVELINES])
        self._logs[:], self._weights = 0.0, None

    def course(self, half_gap_rad: float) -> LashCourse | None:
        """The course from the newest edges on, told to half a gap; None where it is lost."""
        if not self.is_alive:
            return None
        followed = np.take(self._x, drawn(self.weights, FOLLOWED), axis=1)
        doubt = math.sqrt(max(1.0, self._doubt))
        own = (self._p, self._chance)
        return LashCourse(followed, self._model, own, half_gap_rad, doubt)


@bare
def correct(x: Vector, logs: Vector, off: Vector, gain: Vector, variance: float) -> None:
    """Corrects each driveline by how far off it was (n,), and weighs it by that, in place."""
    most = MOST_OFF * math.sqrt(variance)
    for i in each(x.shape[1]):
        near = np.minimum(np.maximum(off[i], -most), most)
        # Beyond `most` the logarithm falls in a line: Huber's law (1964).
        logs[i] -= 0.5 * (2.0 * np.abs(off[i]) - np.abs(near)) * np.abs(near) / variance
        x[ANGLE, i] += gain[0] * near
        x[WAY, i] += gain[0] * near
        x[SPEED, i] += gain[1] * near
        x[DRAG, i] = np.maximum(x[DRAG, i] - gain[2] * near, LEAST_DRAG)


def spread(p: Vector, seconds: float, chance_rad2_s3: float) -> Vector:
    """Covariance of angle, speed and drag after some time; drag slows down."""
    f = np.array(((1.0, seconds, -0.5 * seconds**2), (0.0, 1.0, -seconds), (0.0, 0.0, 1.0)))
    found = f @ p @ f.T
    found[0, 0] += chance_rad2_s3 * seconds**3 / 3.0
    found[0, 1] += chance_rad2_s3 * seconds**2 / 2.0
    found[1, 0] += chance_rad2_s3 * seconds**2 / 2.0
    found[1, 1] += chance_rad2_s3 * seconds
    found[2, 2] += DRAG_CHANGE * seconds
    return np.asarray(found)
