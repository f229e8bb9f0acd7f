"""How engine and vehicle swing on the shafts between them, from the engine's speed and torque.

With a gear in mesh, for a torque u of the engine beyond what it was, all at the propeller shaft:

    w_1 = c + a t + A cos wt + B sin wt + int u(s) (y + (1/J_1 - y) cos w(t - s)) ds
    y = 1 / (J_1 + J_2)        w^2 = k (1/J_1 + 1/J_2)

J_1 (engine and gearbox) is the sheet's. For each frequency w of a row about what is known of it the
rest is found by linear least squares, with what is known of the vehicle as one more equation; the
frequencies are then weighed by how well they explain the speeds.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

FREQUENCIES: Final = 25
REACH_SD: Final = 2.0
"""The row of frequencies reaches this many standard deviations to either side."""
LEAST_SPEED_SD: Final = 0.1
"""Least error of the engine's speed against this model (rad/s): ripple and torque of chance."""
LEAST_SHARE: Final = 1e-12
"""Keeps the equations solvable where two columns cannot be distinguished."""
CORRELATED: Final = 4.0
"""An error lasts for this many measurements: 40 ms."""


class Known(NamedTuple):
    """What is known of shafts and vehicle."""

    stiffness_nm_rad: float
    stiffness_sd: float
    """As a share."""
    vehicle_inverse: float
    """1 / J_2."""
    vehicle_sd: float


class SwingFit(NamedTuple):
    """What came out."""

    known: Known
    acceleration_rad_s2: float
    """Of engine and vehicle together, at the propeller shaft, had the torque stayed as at first."""


class EngineTrajectory(NamedTuple):
    """Times (s), engine speeds and engine torques, both at the propeller shaft."""

    time_s: Vector
    omega_rad_s: Vector
    torque_nm: Vector


class _Scan(NamedTuple):
    """The best fits for a row of frequencies."""

    deviances: Vector
    """Sums of squares over variances, without those of what was known."""
    found: Vector
    """Acceleration, y and its standard deviation, a row each."""


def fit_swing(
    trajectory: EngineTrajectory, ratio: float, engine_kgm2: float, known: Known
) -> SwingFit:
    """What is known after these speeds. ratio: of the engine's speed to the propeller shaft's."""
    before = 1.0 / engine_kgm2 + known.vehicle_inverse
    square, reach = known.stiffness_nm_rad * before, known.vehicle_sd / before
    logs = np.linspace(-REACH_SD, REACH_SD, FREQUENCIES) * math.hypot(known.stiffness_sd, reach)
    omegas = np.sqrt(square * np.exp(logs))
    sd = LEAST_SPEED_SD / ratio
    first = _scan(trajectory, engine_kgm2, known, omegas, sd)
    # What the model leaves out lasts longer than from one measurement to the next: errors are
    # larger, and fewer.
    sd *= math.sqrt(CORRELATED * max(1.0, float(first.deviances.min()) / len(trajectory.time_s)))
    deviances, found = _scan(trajectory, engine_kgm2, known, omegas, sd)
    weights = np.exp(-0.5 * (deviances - deviances.min()))
    weights /= weights.sum()
    log = float(weights @ logs)
    log_sd = math.sqrt(float(weights @ (logs - log) ** 2) + (logs[1] - logs[0]) ** 2 / 12.0)
    acceleration, y, y_sd = (float(one) for one in weights @ found)
    y = min(max(y, 0.01 / engine_kgm2), 0.99 / engine_kgm2)
    along = 1.0 - engine_kgm2 * y
    vehicle, vehicle_sd = y / along, min(y_sd / along**2, known.vehicle_sd)
    after = 1.0 / engine_kgm2 + vehicle
    seen = math.log(square / known.stiffness_nm_rad / after) + log
    seen_sd = math.hypot(log_sd, vehicle_sd / after)
    gain = known.stiffness_sd**2 / (known.stiffness_sd**2 + seen_sd**2)
    stiffness = known.stiffness_nm_rad * math.exp(gain * seen)
    left_sd = known.stiffness_sd * math.sqrt(1.0 - gain)
    return SwingFit(Known(stiffness, left_sd, vehicle, vehicle_sd), acceleration)


def _scan(
    trajectory: EngineTrajectory, engine_kgm2: float, known: Known, omegas: Vector, sd: float
) -> _Scan:
    """The best fit for each frequency, all at once by their normal equations; sd: of a speed at the
    propeller shaft."""
    at_s = trajectory.time_s - trajectory.time_s[0]
    pull_nm = trajectory.torque_nm - trajectory.torque_nm[0]
    turned = omegas[:, None] * at_s
    cosine, sine = np.cos(turned), np.sin(turned)
    whole, swung = _answers(at_s, pull_nm, omegas, cosine, sine)
    even = np.broadcast_to(np.ones_like(at_s), cosine.shape)
    columns = np.stack((even, np.broadcast_to(at_s, cosine.shape), cosine, sine, whole - swung), 1)
    wanted = trajectory.omega_rad_s - trajectory.omega_rad_s[0] - swung / engine_kgm2
    share = 1.0 + engine_kgm2 * known.vehicle_inverse
    together, weight = known.vehicle_inverse / share, (sd * share**2 / known.vehicle_sd) ** 2
    normal = columns @ columns.transpose(0, 2, 1)
    right = (columns @ wanted[:, :, None])[:, :, 0]
    normal[:, 4, 4] += weight
    right[:, 4] += weight * together
    scale = np.sqrt(normal[:, range(5), range(5)])
    inverse = np.linalg.inv(
        normal / scale[:, :, None] / scale[:, None, :] + LEAST_SHARE * np.eye(5)
    )
    inverse = inverse / scale[:, :, None] / scale[:, None, :]
    solution = (inverse @ right[:, :, None])[:, :, 0]
    missed = (solution[:, None, :] @ columns)[:, 0] - wanted
    squares = (missed**2).sum(axis=1) + weight * (solution[:, 4] - together) ** 2
    found = np.stack((solution[:, 1], solution[:, 4], sd * np.sqrt(inverse[:, 4, 4])), axis=1)
    return _Scan(squares / sd**2, found)


def _answers(
    at_s: Vector, pull_nm: Vector, omegas: Vector, cosine: Vector, sine: Vector
) -> tuple[Vector, Vector]:
    """Integrals of the torque, and of it times cos w(t - s), at each time for each frequency; the
    torque is taken to be even between two measurements."""
    middle_s, step = 0.5 * (at_s[1:] + at_s[:-1]), np.diff(at_s)
    impulse = 0.5 * (pull_nm[1:] + pull_nm[:-1]) * step
    turned = omegas[:, None] * middle_s
    zero = np.zeros((len(omegas), 1))
    by_cosine = np.hstack((zero, np.cumsum(impulse * np.cos(turned), axis=1)))
    by_sine = np.hstack((zero, np.cumsum(impulse * np.sin(turned), axis=1)))
    whole = np.concatenate(([0.0], np.cumsum(impulse)))
    return whole, cosine * by_cosine + sine * by_sine
