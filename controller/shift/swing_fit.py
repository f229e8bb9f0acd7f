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

from meshpoint.controller.records import Vector

FREQUENCIES: Final = 25
REACH_SD: Final = 2.0
"""The row of frequencies reaches so many standard deviations to either side."""
LEAST_SPEED_SD: Final = 0.1
"""Least error of the engine's speed against this model (rad/s): ripple and torque of chance."""
CORRELATED: Final = 4.0
"""An error lasts for so many looks: 40 ms."""


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


class EngineCourse(NamedTuple):
    """Times (s), engine speeds and engine torques, both at the propeller shaft."""

    time_s: Vector
    omega_rad_s: Vector
    torque_nm: Vector


class _Scan(NamedTuple):
    """The best fits for a row of frequencies."""

    misfits: Vector
    """Sums of squares over variances, without those of what was known."""
    found: Vector
    """Acceleration, y and its standard deviation, a row each."""


def fit_swing(course: EngineCourse, ratio: float, engine_kgm2: float, known: Known) -> SwingFit:
    """What is known after these speeds. ratio: of the engine's speed to the propeller shaft's."""
    before = 1.0 / engine_kgm2 + known.vehicle_inverse
    square, reach = known.stiffness_nm_rad * before, known.vehicle_sd / before
    logs = np.linspace(-REACH_SD, REACH_SD, FREQUENCIES) * math.hypot(known.stiffness_sd, reach)
    omegas = np.sqrt(square * np.exp(logs))
    sd = LEAST_SPEED_SD / ratio
    first = _scan(course, engine_kgm2, known, omegas, sd)
    # What the model leaves out lasts longer than from look to look: errors are larger, and fewer.
    sd *= math.sqrt(CORRELATED * max(1.0, float(first.misfits.min()) / len(course.time_s)))
    misfits, found = _scan(course, engine_kgm2, known, omegas, sd)
    weights = np.exp(-0.5 * (misfits - misfits.min()))
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
    course: EngineCourse, engine_kgm2: float, known: Known, omegas: Vector, sd: float
) -> _Scan:
    """The best fit for each frequency; sd: of a speed at the propeller shaft."""
    at_s = course.time_s - course.time_s[0]
    pull_nm = course.torque_nm - course.torque_nm[0]
    share = 1.0 + engine_kgm2 * known.vehicle_inverse
    together, together_sd = known.vehicle_inverse / share, known.vehicle_sd / share**2
    misfits, found = np.empty(len(omegas)), np.empty((len(omegas), 3))
    for n, omega in enumerate(omegas):
        whole, swung = _answers(at_s, pull_nm, omega)
        columns = np.column_stack(
            (np.ones_like(at_s), at_s, np.cos(omega * at_s), np.sin(omega * at_s), whole - swung)
        )
        wanted = course.omega_rad_s - swung / engine_kgm2
        rows = np.vstack((columns / sd, [0.0, 0.0, 0.0, 0.0, 1.0 / together_sd]))
        right = np.append(wanted / sd, together / together_sd)
        solution, *_ = np.linalg.lstsq(rows, right, rcond=None)
        misfits[n] = ((rows @ solution - right) ** 2).sum()
        spread = np.linalg.pinv(rows.T @ rows)
        found[n] = solution[1], solution[4], math.sqrt(spread[4, 4])
    return _Scan(misfits, found)


def _answers(at_s: Vector, pull_nm: Vector, omega: float) -> tuple[Vector, Vector]:
    """Integrals of the torque, and of it times cos w(t - s), at each time; linear between."""
    step = np.diff(at_s)
    middle_s, mean = 0.5 * (at_s[1:] + at_s[:-1]), 0.5 * (pull_nm[1:] + pull_nm[:-1])
    whole = np.concatenate(([0.0], np.cumsum(mean * step)))
    cosine = np.concatenate(([0.0], np.cumsum(mean * step * np.cos(omega * middle_s))))
    sine = np.concatenate(([0.0], np.cumsum(mean * step * np.sin(omega * middle_s))))
    swung = np.cos(omega * at_s) * cosine + np.sin(omega * at_s) * sine
    return whole, swung
