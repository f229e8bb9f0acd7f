"""The main shaft in neutral, behind it propeller shaft, backlash, driven wheels, tyres and vehicle.

    P --k, backlash 2 h--> A --tyre in series with its contact--> V

P is what turns with the main shaft, A the driven wheels, V the vehicle. All angles are the main
shaft's. P pushes A by a flank, with the law of Hunt and Crossley (1975) for its loss, and not at
all between the flanks (Lagerberg and Egardt 2007):

    theta' = w      z' = w - w_A      w' = -a - T        T = k b (1 + c b')   b beyond a flank
    w_A' = m T - c_t y - d_t y'       w_V' = g           y' = w_A - w_V - r y

z is the way from the flank to which drag takes the shaft; the other flank is at 2 h. a is the drag
of P and g what hills do to the vehicle, both steady; r is speed over the relaxation length of the
tyres (Pacejka, Tire and Vehicle Dynamics, 7.2). T and k are over the inertia of P, and m is the
inertia of P over that of A.

Many such drivelines move at once: a row for each quantity, a column for each driveline. One after
the other where numba compiles it, which takes a fifth of NumPy's time; all as one row of NumPy's
where compiling is switched off. Both come to the same bits.

A cloud of such drivelines moves ahead as one trajectory of the main shaft.
"""

from __future__ import annotations

import copy
import math
from bisect import bisect_right
from statistics import NormalDist
from typing import Any, Final, NamedTuple

import numpy as np

from meshpoint.kernels.jit import DISABLED, bare, compiled, inlined
from meshpoint.kernels.records import Integers, Vector

ANGLE, SPEED, DRAG, WAY, WHEELS, TYRE, VEHICLE, HILL, STIFF, LOSS, HALF, TYRE_STIFF = range(12)
"""Rows of a cloud: `theta, w, a, z, w_A, y, w_V, g, k, c, h, c_t`."""
ROWS: Final = 12
LONGEST_S: Final = 1.3e-3
"""A step is no longer: the shafts' mode turns by 0.37 rad in it at 45 Hz."""
MOST_LOSS: Final = 10.0
"""A flank pushes no harder than this many times its spring. From 1 + c b' = 2.5 on, the law gives
nothing back of an impact (restitution 1 - 2 c b' / 3), and means no more; with this limit a step
stays stable however hard a driveline falls onto a flank."""

STEP_S: Final = 2.5e-3
STEPS: Final = 49
"""The trajectory is worked out at this many steps of this. Beyond the last the speed is held."""
TIMES: Final[Vector] = STEP_S * np.arange(float(STEPS))
PLACES: Final[Vector] = np.arange(float(STEPS))
_TIMES: Final[list[float]] = TIMES.tolist()
MOST_TICKS: Final = 8
"""What will be known is worked out for at most this number of ticks."""
COMPARED: Final = 60
"""Number of drivelines by which it is worked out."""
LEAST_SD_RAD: Final = math.radians(0.1)
"""An angle ahead is never known better: teeth and bearings."""
MOST_SURE: Final = 0.9999
_TABLE: Final = np.linspace(0.0, MOST_SURE, 400)
_WIDTHS: Final = np.array([NormalDist().inv_cdf(0.5 + 0.5 * share) for share in _TABLE.tolist()])
LEAST_WIDTH: Final = 1e-2


class LashModel(NamedTuple):
    """What of the driveline is taken as known, the same for all."""

    wheels_share: float
    """`m`: inertia of P over that of A."""
    tyre_per_s: float
    """`d_t`: damping of the tyres' carcass over the inertia of A."""
    fading_per_s: float
    """`r`: speed over the relaxation length of the tyres."""


def move(x: Vector, seconds: float, model: LashModel) -> None:
    """Drivelines (ROWS, n) after some time, in place; by the midpoint rule."""
    move_often(x, seconds, model, np.empty((2, 1, x.shape[1])))


def move_often(x: Vector, seconds: float, model: LashModel, found: Vector) -> None:
    """The same m times over; angles and speeds before each time are noted in found (2, m, n)."""
    parts = max(1, math.ceil(seconds / LONGEST_S))
    follows = 1.0 / (1.0 + model.fading_per_s * model.tyre_per_s / x[TYRE_STIFF])
    _move(x, seconds / parts, parts, model, follows, found)


@bare
def _move(
    x: Vector, dt: float, parts: int, model: LashModel, follows: Vector, found: Vector
) -> None:
    """`parts` steps after each note; follows: how much of the wheels' slip the tyre's carcass takes
    up."""
    for k in range(found.shape[1]):
        for i in each(x.shape[1]):
            found[0, k, i], found[1, k, i] = x[ANGLE, i], x[SPEED, i]
        for _ in range(parts):
            for i in each(x.shape[1]):
                _step(x, i, dt, model, follows[i])


def _at_once(_count: int) -> tuple[slice]:
    """All drivelines as one, for NumPy."""
    return (slice(None),)


each: Any = _at_once if DISABLED else range
"""What a kernel's loop over drivelines runs through, by their number."""


@inlined
def _step(x: Vector, i: int, dt: float, model: LashModel, follows: float) -> None:
    """One step of a driveline, in place."""
    share, carcass, fading = model
    speed, drag, way, wheels = x[SPEED, i], x[DRAG, i], x[WAY, i], x[WHEELS, i]
    tyre, vehicle, hill, stiff = x[TYRE, i], x[VEHICLE, i], x[HILL, i], x[TYRE_STIFF, i]
    half = 0.5 * dt
    slip = speed - wheels
    torque = _push(x, i, way, slip)
    rate = (wheels - vehicle - fading * tyre) * follows
    mid_speed = speed - half * (drag + torque)
    traction = stiff * tyre + carcass * rate
    mid_wheels = wheels + half * (share * torque - traction)
    mid_tyre = tyre + half * rate
    mid_slip = mid_speed - mid_wheels
    torque = _push(x, i, way + half * slip, mid_slip)
    rate = (mid_wheels - vehicle - half * hill - fading * mid_tyre) * follows
    traction = stiff * mid_tyre + carcass * rate
    x[ANGLE, i] += dt * mid_speed
    x[WAY, i] += dt * mid_slip
    x[SPEED, i] -= dt * (drag + torque)
    x[WHEELS, i] += dt * (share * torque - traction)
    x[TYRE, i] += dt * rate
    x[VEHICLE, i] += dt * hill


@inlined
def _push(x: Vector, i: int, way: float, slip: float) -> float:
    """Torque of the flanks on A, over the inertia of P: at this way and its rate."""
    half = x[HALF, i]
    twist = way - half
    beyond = twist - np.minimum(np.maximum(twist, -half), half)
    loss = 1.0 + np.copysign(x[LOSS, i], beyond) * slip
    found: float = x[STIFF, i] * beyond * np.minimum(np.maximum(loss, 0.0), MOST_LOSS)
    return found


class Chance(NamedTuple):
    """Accelerations of chance that last for a while (Ornstein-Uhlenbeck)."""

    rad2_s3: float
    """Their density at low frequencies, 2 sigma^2 tau."""
    memory_s: float
    """Their memory tau."""

    def theta_rad2(self, wait_s: Vector) -> Vector:
        """Variance of an angle after some time:

        int int (t - u)(t - v) sigma^2 exp(-|u - v| / tau) du dv over 0..t"""
        shares = wait_s / self.memory_s
        grown = 2.0 / 3.0 * shares**3 - shares**2 + 2.0 - 2.0 * (1.0 + shares) * np.exp(-shares)
        return np.asarray(0.5 * self.rad2_s3 * self.memory_s**3 * np.maximum(grown, 0.0))


class LashTrajectory:
    """The trajectory of a main shaft from a time on: what `Swing` is for a linear one.

    At each time it gives the angle that most of the drivelines are within half a gap of, and the
    standard deviation of a normal law that lies within half a gap with the same probability."""

    def __init__(
        self,
        x: Vector,
        model: LashModel,
        spread: tuple[Vector, Chance],
        half_gap_rad: float,
        nis: float = 1.0,
    ) -> None:
        """x: drivelines (ROWS, n), all alike in weight, at the trajectory's time; they are moved.
        spread: covariance of angle, speed and drag in each (3, 3), and the chance by which the
        shaft is accelerated. doubt: how many times as far off as they let expect
        the drivelines have been."""
        self._half_gap_rad = half_gap_rad
        self._p, self._chance = spread
        self.hill_rad_s2 = float(x[HILL].mean())
        """The vehicle's acceleration at the main shaft."""
        self.speed_rad_s = float((x[SPEED] - x[VEHICLE]).mean())
        """The part of the shaft's speed with which it moves against the vehicle."""
        own = float(self._p[1, 1])
        self.speed_sd_rad_s = math.sqrt(float(x[SPEED].var()) + own)
        """Standard deviation of the speed now."""
        found = np.empty((2, STEPS, x.shape[1]))
        move_often(x, STEP_S, model, found)
        self._angle, self._speed = found
        self._nis = nis
        self._own_rad2 = self._own_variance(TIMES)
        self._merged = np.full((3, STEPS), np.nan)
        """Angle, speed and standard deviation at each step where that was asked for."""
        self._is_merged = [False] * STEPS
        """Whether `_merged` holds a step: few, of a trajectory by which no sleeve is fired."""
        self.since_s = 0.0
        """Now, on the trajectory's own time."""
        self._shapes: list[Vector] = []
        """How `outlook` goes on from its first variance, once it was asked for."""

    def _own_variance(self, wait_s: Vector) -> Vector:
        """Variance of the angle ahead in one driveline."""
        p = self._p
        found = p[0, 0] + wait_s * (2.0 * p[0, 1] + wait_s * (p[1, 1] - p[0, 2]))
        found = found + self._chance.theta_rad2(wait_s) - wait_s**3 * p[1, 2]
        found = found + 0.25 * wait_s**4 * p[2, 2] + LEAST_SD_RAD**2
        return np.asarray(np.maximum(found, LEAST_SD_RAD**2))

    def _merge(self, first: int, end: int) -> None:
        """Works out the steps from `first` to before `end`; each comes to the same, whichever are
        worked out together."""
        if all(self._is_merged[first:end]):
            return
        self._is_merged[first:end] = [True] * (end - first)
        order = np.argsort(self._angle[first], kind="stable")
        merge_steps(
            self._angle, self._speed, self._own_rad2, self._half_gap_rad, self._nis, _WIDTHS,
            first, end, order, self._merged,
        )  # fmt: skip

    def after(self, wait_s: float) -> LashTrajectory:
        """The same as seen from a later time."""
        later = copy.copy(self)
        later.since_s += wait_s
        return later

    def ahead(self, wait_s: float) -> tuple[float, float]:
        """Angle and speed after a time."""
        wait_s += self.since_s
        inside = min(max(wait_s, 0.0), _TIMES[-1])
        before = max(0, bisect_right(_TIMES, inside) - 1)
        end = min(before + 2, STEPS)
        self._merge(before, end)
        angle, speed = (
            float(np.interp(inside, TIMES[before:end], self._merged[row, before:end]))
            for row in (0, 1)
        )
        return angle + (wait_s - inside) * speed, speed

    def fastest_ahead(self, wait_s: float, share: float) -> float:
        """The speed after a time that this share of the drivelines exceeds."""
        at = min(max(round((self.since_s + wait_s) / STEP_S), 0), STEPS - 1)
        return float(np.quantile(self._speed[at], 1.0 - share))

    def trajectories(self, waits_s: Vector, step_s: float, found: Vector) -> None:
        """Angle and speed at equal steps of time, the first after each of `waits_s` (m,), to found
        (m, 2, n). Before now and after the last step of the trajectory the speed is held."""
        self._merge(0, STEPS)
        steps = step_s * np.arange(found.shape[2])
        waits = self.since_s + waits_s[:, np.newaxis] + steps
        inside = np.clip(waits, 0.0, STEP_S * (STEPS - 1))
        found[:, 1] = np.interp(inside, TIMES, self._merged[1])
        found[:, 0] = np.interp(inside, TIMES, self._merged[0]) + (waits - inside) * found[:, 1]

    def theta_sd_ahead(self, wait_s: float) -> float:
        """Standard deviation of the angle after a time."""
        at = min(max(self.since_s + wait_s, 0.0) / STEP_S, float(STEPS - 1))
        before = int(max(0.0, at))  # of what is no number, the first
        self._merge(before, min(before + 2, STEPS))
        return float(np.interp(at, PLACES, self._merged[2]))

    def outlook(self, horizon_s: float, tick_s: float, count: int) -> Vector:
        """Variances (rad2) of the angle predicted `horizon_s` ahead: now, and after each further
        tick of edges, which will have distinguished some of the drivelines from others."""
        if not self._shapes:
            self._shapes.append(self._settled(self.since_s + horizon_s, tick_s))
        now, shape = self.theta_sd_ahead(horizon_s) ** 2, self._shapes[0]
        found: Vector = now * shape[np.minimum(np.arange(count), MOST_TICKS - 1)]
        return found

    def _settled(self, horizon_s: float, tick_s: float) -> Vector:
        """Variances of `outlook` over the first one. It is worked out once a trajectory: a sleeve's
        way differs by some milliseconds only.

        Each of the drivelines may be the real one. Those that keep near it until then are still
        possible then; of these the share within half a gap of it will be the probability."""
        angle = self._angle[:, :: max(1, self._angle.shape[1] // COMPARED)]
        known = self._p[0, 0] + LEAST_SD_RAD**2
        then = np.minimum(np.rint(tick_s * np.arange(MOST_TICKS) / STEP_S), STEPS - 1).astype(int)
        later = np.minimum(then + round(horizon_s / STEP_S), STEPS - 1)
        most = np.empty((MOST_TICKS, angle.shape[1], angle.shape[1]))
        widest_apart(np.ascontiguousarray(angle), then, most)
        weights = np.exp(-0.25 * most**2 / known)
        weights /= weights.sum(axis=2, keepdims=True)
        there = angle[later]
        near = np.abs(there[:, :, np.newaxis] - there[:, np.newaxis]) < self._half_gap_rad
        shares = (weights * near).sum(axis=2).mean(axis=1)
        width = math.sqrt(self._own_rad2[min(round(horizon_s / STEP_S), STEPS - 1)])
        shares *= math.erf(self._half_gap_rad / (math.sqrt(2.0) * width))
        variances = _width(shares) ** -2.0
        return np.asarray(np.minimum(variances / variances[0], 1.0))


def _width(share: Vector) -> Vector:
    """Half width of the normal law's span, in its deviations, that holds a share."""
    return np.asarray(np.maximum(np.interp(share, _TABLE, _WIDTHS), LEAST_WIDTH))


@compiled
def widest_apart(angle: Vector, rows: Integers, most: Vector) -> None:
    """How far any two columns of angles (m, n) have been apart in any row up to each of some rows,
    in ascending order: most (k, n, n)."""
    last, noted = rows.shape[0] - 1, 0
    most[last] = 0.0
    for row in range(angle.shape[0]):
        for i in range(angle.shape[1]):
            for j in each(angle.shape[1]):
                apart = np.abs(angle[row, i] - angle[row, j])
                most[last, i, j] = np.maximum(most[last, i, j], apart)
        while rows[noted] == row:
            if noted == last:
                return
            most[noted] = most[last]
            noted += 1


@compiled
def merge_steps(
    angle: Vector, speed: Vector, own_rad2: Vector, half_gap: float, nis: float, widths: Vector,
    first: int, end: int, order: Integers, merged: Vector,
) -> None:  # fmt: skip
    """Of some steps of a trajectory (m, n) the span of a gap's width that holds most drivelines:
    mean angle and mean speed in it, and the deviation of the normal law that lies within half a gap
    with the same probability, to merged (3, m).

    Of spans that hold as many it is the one in the middle: a lone group is met in its middle.
    order (n,): in which the first step's angles ascend; widths: of `_width`'s table."""
    count = angle.shape[1]
    inside = np.empty(count, np.int64)
    for step in range(first, end):
        at = angle[step]
        # A step earlier they came in nearly the same order: little is left to be moved.
        sort_on(at, order)
        last, most, as_many = 0, 0, 0
        for i in range(count):
            while last < count and at[order[last]] <= at[order[i]] + 2.0 * half_gap:
                last += 1
            inside[i] = last - i
            if inside[i] > most:
                most, as_many = inside[i], 0
            as_many += 1 if inside[i] == most else 0
        begin, passed = -1, 0
        while passed <= as_many // 2 and begin + 1 < count:
            begin += 1
            passed += 1 if inside[begin] == most else 0
        held = order[begin : begin + most]
        mean = fast = within = 0.0
        for i in held:
            mean += at[i]
            fast += speed[step, i]
        mean, fast = mean / most, fast / most
        for i in held:
            within += (at[i] - mean) ** 2
        width = math.sqrt(2.0 * (within / most + own_rad2[step]))
        share = most / count * math.erf(half_gap / width)
        place = min(share / MOST_SURE, 1.0) * (widths.size - 1)
        k = min(int(place), widths.size - 2)
        width = max(widths[k] + (place - k) * (widths[k + 1] - widths[k]), LEAST_WIDTH)
        merged[0, step], merged[1, step], merged[2, step] = mean, fast, half_gap / width * nis


@inlined
def sort_on(angle: Vector, order: Integers) -> None:
    """Sorts indices by their angles, in place; of equal angles the lower index comes first."""
    for i in range(1, order.shape[0]):
        index, k = order[i], i
        value = angle[index]
        while k > 0 and (
            angle[order[k - 1]] > value or (angle[order[k - 1]] == value and order[k - 1] > index)
        ):
            order[k] = order[k - 1]
            k -= 1
        order[k] = index
