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

Many such drivelines move at once: a row for each quantity, a column for each driveline. This is
plain NumPy: a step costs about a microsecond for each hundred drivelines.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.records import Vector

ANGLE, SPEED, DRAG, WAY, WHEELS, TYRE, VEHICLE, HILL, STIFF, LOSS, HALF, TYRE_STIFF = range(12)
"""theta, w, a, z, w_A, y, w_V, g, k, c, h, c_t."""
ROWS: Final = 12
LONGEST_S: Final = 1.3e-3
"""A step is no longer: the shafts' mode turns by 0.37 rad in it at 45 Hz."""


class LashModel(NamedTuple):
    """What of the driveline is taken as known, the same for all."""

    wheels_share: float
    """m."""
    tyre_per_s: float
    """d_t: damping of the tyres' carcass over the inertia of A."""
    fading_per_s: float
    """r."""


def push(x: Vector, way: Vector, slip: Vector) -> Vector:
    """Torque of the flanks on A, over the inertia of P: at these ways and rates of them."""
    half = x[HALF]
    twist = way - half
    beyond = twist - np.minimum(np.maximum(twist, -half), half)
    loss = 1.0 + np.copysign(x[LOSS], beyond) * slip
    found: Vector = x[STIFF] * beyond * np.maximum(loss, 0.0)
    return found


def move(x: Vector, seconds: float, model: LashModel) -> None:
    """Drivelines (ROWS, n) after some time, in place; by the midpoint rule."""
    parts = max(1, math.ceil(seconds / LONGEST_S))
    follows = 1.0 / (1.0 + model.fading_per_s * model.tyre_per_s / x[TYRE_STIFF])
    for _ in range(parts):
        _step(x, seconds / parts, model, follows)


def _step(x: Vector, dt: float, model: LashModel, follows: Vector) -> None:
    """follows: how much of the wheels' slip the tyre's carcass takes up."""
    _, speed, drag, way, wheels, tyre, vehicle, hill = x[: HILL + 1]
    fading, carcass, half, stiff = model.fading_per_s, model.tyre_per_s, 0.5 * dt, x[TYRE_STIFF]
    slip = speed - wheels
    torque = push(x, way, slip)
    rate = (wheels - vehicle - fading * tyre) * follows
    mid_speed = speed - half * (drag + torque)
    traction = stiff * tyre + carcass * rate
    mid_wheels = wheels + half * (model.wheels_share * torque - traction)
    mid_tyre = tyre + half * rate
    mid_slip = mid_speed - mid_wheels
    torque = push(x, way + half * slip, mid_slip)
    rate = (mid_wheels - vehicle - half * hill - fading * mid_tyre) * follows
    traction = stiff * mid_tyre + carcass * rate
    x[ANGLE] += dt * mid_speed
    x[WAY] += dt * mid_slip
    x[SPEED] -= dt * (drag + torque)
    x[WHEELS] += dt * (model.wheels_share * torque - traction)
    x[TYRE] += dt * rate
    x[VEHICLE] += dt * hill
