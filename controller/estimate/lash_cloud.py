"""Where a driveline lies in its backlash: a cloud of particles, weighed by the edges.

When a gear has come out it is not known where between its flanks the driveline lies, how wide the
backlash is, nor how fast the vehicle is within some tenths. Each driveline of the cloud holds
another answer to all of it; all move on (`models/backlash`), and each edge weighs them by how well
they predicted it. When few weigh most, the cloud is resampled around those (particle filter:
Gordon, Salmond and Smith 1993; with a kernel for what does not move: Liu and West 2001). The
shaft's own angle, speed and drag differ from those predicted by torques of chance: these three are
estimated in each driveline by a Kalman filter, whose gain is the same for all (Rao and Blackwell;
Doucet et al. 2000).

Resampled, each is drawn as often as its weight says, and what does not move by itself is spread a
little, so that copies of one driveline part. The spread is Liu and West's: shrunk towards the mean,
it leaves mean and covariance as they were, and what was found of two quantities together - a wide
backlash with a late flank, a fast vehicle with fast wheels - stays together. Mean and covariance
are those of the drivelines at the same flank or between them: over all of these at once they would
be of drivelines that move by different laws.

There is no randomness in it: the first cloud is a low-discrepancy sequence (Halton 1960), and what
is added to a cloud resampled are numbers that only look drawn (`lash.scattered_twice`).
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from meshpoint.controller.estimate.lash import (
    LEAST_DRAG,
    PARTICLES,
    PRIMES,
    Lash,
    LashStart,
    VehicleTrajectory,
    scattered_twice,
)
from meshpoint.controller.estimate.loaded_driveline import grouped_counts
from meshpoint.controller.models.backlash import (
    ANGLE,
    DRAG,
    HALF,
    HILL,
    LOSS,
    SPEED,
    STIFF,
    TYRE,
    TYRE_STIFF,
    VEHICLE,
    WAY,
    WHEELS,
    LashTrajectory,
    each,
    move,
)
from meshpoint.kernels.jit import bare
from meshpoint.kernels.records import Integers, Vector
from meshpoint.units import US

KERNEL: Final = 0.4
"""Spread of each driveline, in standard deviations of those in the same contact; Liu and West's h.
Theirs is 0.1 to 0.3, for one draw in a step of data; here more, as the road shakes the wheels."""
SHRUNK: Final = math.sqrt(1.0 - KERNEL**2)
SPREAD: Final = (WAY, WHEELS, TYRE, VEHICLE, HILL)
"""What is spread; of what follows the logarithms."""
SHARES: Final = (STIFF, LOSS, HALF, TYRE_STIFF)
LEAST_APART: Final = 1e-6
"""Added to a correlation of 1 in square: so few drivelines may stand for a contact that some of
their quantities depend on the others."""
LEAST_SD: Final = 1e-140
"""Of a smaller one the square has too few digits for a correlation."""
FLANKS: Final = 3
"""Contacts: at the flank of coast, between, at the flank of drive."""

FOLLOWED: Final = 240
"""This many of them, by their weights, are followed ahead."""
MEASUREMENT_US: Final = 4000.0
"""Edges within this are taken together: one by itself says little, and a shaft swings slowly."""
LEAST_SHARE: Final = 0.25
"""The cloud is resampled when fewer than this share of it carries the weight."""
MOST_OFF: Final = 4.0
"""An angle that is further off, in standard deviations, counts as so far off."""
NIS_KEPT: Final = 0.9
"""Weight of the mean normalised innovation squared so far, against a new one."""
LOST: Final = 9.0
"""A cloud whose mean normalised innovation squared is above this has lost the driveline, and begins
anew."""
RECENT: Final = 4
"""A cloud that begins anew takes angle and speed from a line through this many measurements."""
FIRST_OMEGA: Final = 2.0
"""Standard deviation of the shaft's speed when a gear comes out (rad/s)."""
FIRST_DRAG: Final = 0.5
"""Standard deviation of the drag's acceleration in one driveline, at the start (rad/s2)."""
DRAG_CHANGE: Final = 4.0
"""Density of the change of the drag's acceleration in one driveline (rad2/s5)."""


def drawn(weights: Vector, count: int) -> Integers:
    """This many indices, each as often as its weight says, by one row of even steps."""
    places = (np.arange(count) + 0.5) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), weights.size - 1)


def resampled(x: Vector, weights: Vector, numbers: Vector) -> Vector:
    """Drivelines (ROWS, n) resampled by their weights (n,) and spread by independent numbers of a
    standard normal law (9, n)."""
    chosen = drawn(weights, x.shape[1])
    # By rows in memory as before: of columns numba would make every kernel once more.
    found = np.take(x, chosen, axis=1)
    before, contact = _quantities(x), _contacts(x)
    after = np.take(before, chosen, axis=1)
    for flank in range(FLANKS):
        there, taken = contact == flank, contact[chosen] == flank
        if taken.any():
            mean, root = _mean_and_root(before[:, there], weights[there])
            off = after[:, taken] - mean
            after[:, taken] = mean + SHRUNK * off + KERNEL * (root @ numbers[:, taken])
    found[SPREAD, :] = after[: len(SPREAD)]
    found[SHARES, :] = np.exp(after[len(SPREAD) :])
    return found


def _quantities(x: Vector) -> Vector:
    """What is spread, (9, n)."""
    return np.concatenate((x[SPREAD, :], np.log(x[SHARES, :])))


def _contacts(x: Vector) -> Integers:
    """Where each driveline lies in its backlash, 0 to 2 (n,)."""
    contacts: Integers = (x[WAY] >= 0.0).astype(np.int64)
    contacts += x[WAY] > 2.0 * x[HALF]
    return contacts


def _mean_and_root(quantities: Vector, weights: Vector) -> tuple[Vector, Vector]:
    """Mean (9, 1) and a root of the covariance (9, 9)."""
    total = float(weights.sum())
    # Rounding may draw the last driveline though it weighs nothing.
    shares = weights / total if total > 0.0 else np.full(weights.size, 1.0 / weights.size)
    mean = (quantities @ shares)[:, np.newaxis]
    off = quantities - mean
    covariance = (off * shares) @ off.T
    sd = np.sqrt(np.diag(covariance))
    apart = np.where(sd > LEAST_SD, sd, 1.0)
    related = covariance / np.outer(apart, apart)
    if not np.isfinite(related).all():
        return mean, np.zeros_like(related)  # squares of numbers beyond all sense
    np.fill_diagonal(related, 1.0 + LEAST_APART)
    return mean, sd[:, np.newaxis] * np.linalg.cholesky(related)


class BacklashParticleFilter:
    """The drivelines of one interval in neutral."""

    def __init__(self, lash: Lash, start: LashStart, edge_time_s: float) -> None:
        self._lash = lash
        self._begin(start)
        self._recent: deque[tuple[float, float]] = deque(maxlen=RECENT)
        """Times (us) and angles of the newest measurements."""
        self._model = lash.model(start.speed_rad_s)
        self._chance = lash.chance
        self._edge_time_s = edge_time_s
        self._drawn = 0
        self.time_us = start.time_us
        """Up to here edges have been taken."""
        self._at_start = self.vehicle

    def _begin(self, start: LashStart) -> None:
        self._x = self._lash.cloud(start)
        self._logs = np.zeros(PARTICLES)
        self._weights: Vector | None = None
        """Those of the present logarithms, once they were asked for."""
        self._p = np.diag((0.05**2, FIRST_OMEGA**2, FIRST_DRAG**2))
        """Covariance of angle, speed and drag in each driveline."""
        self._nis = 1.0
        """Mean square of how far off the angles were, over how far the cloud let expect."""

    def _begin_anew(self) -> None:
        """From the newest measurements, wherever in the backlash: what was known of it has proved
        wrong (sensor resetting, Lenser and Veloso 2000)."""
        measurements, vehicle = np.array(self._recent), self._at_start.at(self.time_us)
        waits_s = (measurements[:, 0] - self.time_us) * US
        speed, angle = np.polyfit(waits_s, measurements[:, 1], 1).tolist()
        # Either the shaft swings so fast, or the vehicle's speed was wrong.
        speed_sd, hill_sd = self._lash.vehicle_sds
        speed_sd = math.hypot(speed_sd, speed - vehicle.speed_rad_s)
        root = np.diag((speed_sd, hill_sd))
        of_vehicle = vehicle.speed_rad_s, vehicle.hill_rad_s2, root
        self._begin(LashStart(self.time_us, angle, speed, *of_vehicle))

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
    def vehicle(self) -> VehicleTrajectory:
        """The vehicle as far as it is known, as unsure as the innovations show."""
        rows = self._x[[VEHICLE, HILL]]
        speed, hill = (rows @ self.weights).tolist()
        spread = np.cov(rows, aweights=self.weights, ddof=0)
        return VehicleTrajectory(self.time_us, speed, hill, max(1.0, self._nis) * spread)

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
        times, angles, count = grouped_counts(edges, MEASUREMENT_US)
        jitter_rad = float(self._x[SPEED, 0]) * self._edge_time_s
        variances = (tooth_rad**2 + jitter_rad**2) / count
        for time_us, angle_rad, variance in zip(times, angles, variances, strict=True):
            self._measure((float(time_us) - self.time_us) * US, float(angle_rad), float(variance))
            self.time_us = float(time_us)
            self._recent.append((self.time_us, float(angle_rad)))
            if self._nis > LOST and len(self._recent) == RECENT:
                self._begin_anew()

    def _measure(self, seconds: float, angle_rad: float, variance: float) -> None:
        x = self._x
        move(x, seconds, self._model)
        p = spread(self._p, seconds, self._chance.rad2_s3)
        whole = float(p[0, 0]) + variance
        gain = p[:, 0] / whole
        off = angle_rad - x[ANGLE]
        self._update_nis(off, whole)
        correct(x, self._logs, off, gain, whole)
        self._weights = None
        self._p = p - np.outer(gain, p[0])
        weights = self.weights
        if 1.0 / float(weights @ weights) < LEAST_SHARE * PARTICLES and self.is_alive:
            self._draw(weights)

    def _update_nis(self, off: Vector, variance: float) -> None:
        """Updates the mean NIS: a collapsed particle set underestimates its spread, so divergence
        is detected from the innovations."""
        weights = self.weights
        mean = float(weights @ off)
        expected = float(weights @ (off - mean) ** 2) + variance
        self._nis = NIS_KEPT * self._nis + (1.0 - NIS_KEPT) * mean**2 / expected

    def _draw(self, weights: Vector) -> None:
        """Draws the cloud anew, each driveline as often as its weight says."""
        self._drawn += 1
        begin = -self._drawn * PRIMES[-1] ** 2 % PARTICLES
        numbers = scattered_twice(PARTICLES)[: len(SPREAD) + len(SHARES)]
        self._x = resampled(self._x, weights, numbers[:, begin : begin + PARTICLES])
        self._logs[:], self._weights = 0.0, None

    def trajectory(self, half_gap_rad: float) -> LashTrajectory | None:
        """The trajectory from the newest edges on, known to half a gap; None where it is lost."""
        if not self.is_alive:
            return None
        followed = np.take(self._x, drawn(self.weights, FOLLOWED), axis=1)
        nis = math.sqrt(max(1.0, self._nis))
        own = (self._p, self._chance)
        return LashTrajectory(followed, self._model, own, half_gap_rad, nis)


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
