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
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from meshpoint.kernels.jit import DISABLED, bare, inlined
from meshpoint.kernels.records import Vector

ANGLE, SPEED, DRAG, WAY, WHEELS, TYRE, VEHICLE, HILL, STIFF, LOSS, HALF, TYRE_STIFF = range(12)
"""Rows of a cloud: `theta, w, a, z, w_A, y, w_V, g, k, c, h, c_t`."""
ROWS: Final = 12
LONGEST_S: Final = 1.3e-3
"""A step is no longer: the shafts' mode turns by 0.37 rad in it at 45 Hz."""
MOST_LOSS: Final = 10.0
"""A flank pushes no harder than this many times its spring. From 1 + c b' = 2.5 on, the law gives
nothing back of an impact (restitution 1 - 2 c b' / 3), and means no more; with this limit a step
stays stable however hard a driveline falls onto a flank."""


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
