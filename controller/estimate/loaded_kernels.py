"""Engine and gearbox, shafts, wheels, tyres and vehicle with a gear in mesh: one step of a Kalman
filter.

    G --k, backlash 2 h--> A --tyre in series with its contact--> V

G is what turns with the gear: engine, while the clutch carries, and gearbox. A and V are the driven
wheels and the vehicle. All is felt at the propeller shaft:

    v = theta_G - theta_A       J_G w_G' = u + b - T        T = k s(v + d) + c (w_G - w_A) s'(v + d)
    J_A w_A' = T - T_t          y' = w_A - w_V - r y        T_t = k_t y + d_t y'
    w_V' = T_t / J_V + g        b' = -b / tau + noise

d is how far the gear's tooth lies from where it lay first, and measured; s is the backlash: none
between the flanks. Where the angle is not known well, s and its slope are the means over the
normal law (statistical linearisation: Gelb, Applied Optimal Estimation, 6.3). b is what the
engine's torque is taken for wrongly, g what hills do, r speed over the tyres' relaxation length.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.kernels.jit import compiled, inlined, record_on
from meshpoint.kernels.records import Vector, layout_of
from meshpoint.units import US

GEAR, GEAR_SPEED, TWIST, WHEELS, TYRE, VEHICLE, HILL, WRONG, VEHICLE_INVERSE = range(9)
"""Rows of the state: `theta_G, w_G, v, w_A, y, w_V, g, b, 1 / J_V`."""
LOADED_STATES: Final = 9
LONGEST_S: Final = 1.3e-3
"""A step is no longer: the wheels' mode turns by 0.1 rad in it at 13 Hz."""
MOST_OFF: Final = 4.0
"""A measurement that is further off, in standard deviations, counts as so far off."""
LOST: Final = 25.0
"""Mean square of how far off measurements are, in variances, with which it has lost the
driveline."""
NIS_KEPT: Final = 0.9
"""Weight of the mean normalised innovation squared so far, against a new one."""
LEAST_SD: Final = 1e-5
"""An angle is never known so well that the backlash has corners."""


class LoadedModel:
    """What the kernel takes as known, at the propeller shaft."""

    geared_kgm2: float
    """`J_G`."""
    driving_nm: float
    """`u`: torque of the engine less drag."""
    tooth_rad: float
    """`d`."""
    shaft_nm_rad: float
    shaft_nms: float
    half_lash_rad: float
    wheels_kgm2: float
    tyre_nm_rad: float
    tyre_nms: float
    relaxation_rad: float
    wrong_nm: float
    """Standard deviation of `b`."""
    wrong_s: float
    """`tau`: memory of `b`."""
    gear_rad2_s3: float
    """Density of the noise that accelerates G."""
    wheels_rad2_s3: float
    """Density of the noise that accelerates A."""
    hill_rad2_s5: float
    """Density of the noise that changes `g`."""
    fading_s: float
    """Density of the relative error of `r` (1/Hz)."""


LOADED_MODEL: Final = layout_of(LoadedModel)


@inlined
def beyond_flanks(angle: float, sd: float, half: float) -> tuple[float, float]:
    """Mean of the twist beyond the flanks, and its slope, for an angle of this spread."""
    sd = max(sd, LEAST_SD)
    over, under = (angle - half) / sd, (angle + half) / sd
    above = 0.5 * (1.0 + math.erf(over / math.sqrt(2.0)))
    below = 0.5 * (1.0 + math.erf(-under / math.sqrt(2.0)))
    edges = math.exp(-0.5 * over * over) - math.exp(-0.5 * under * under)
    mean = (angle - half) * above + (angle + half) * below + sd * edges / math.sqrt(2.0 * math.pi)
    return mean, above + below


class Followed:
    """How far the driveline has been followed."""

    time_us: float
    """Of the state."""
    nis: float
    """Mean normalised innovation squared, the newest ones first."""


FOLLOWED: Final = layout_of(Followed)


@compiled
def follow_loaded(
    x: Vector, p: Vector, so_far: Vector, measurements: Vector, own_rad2: float, inverses: Vector,
    flat: Vector,
) -> int:  # fmt: skip
    """State and covariance after measurements (2, n) of the gear: times (us) and angles (rad), of
    which those not after the state's time are left out. Returns the one at which the driveline was
    lost, and none after that was taken; n where it was not.

    so_far: a `Followed`; own_rad2: variance of a measurement; inverses (2,): of the vehicle's
    inertia, least and most; flat: a `LoadedModel`."""
    followed = record_on(so_far, FOLLOWED)
    gain, row = np.empty(LOADED_STATES), np.empty(LOADED_STATES)
    for m in range(measurements.shape[1]):
        time_us = measurements[0, m]
        if not time_us > followed.time_us:
            continue
        loaded_ahead(x, p, (time_us - followed.time_us) * US, flat)
        followed.time_us = time_us
        off, variance = measurements[1, m] - x[GEAR], p[GEAR, GEAR] + own_rad2
        square = off * off / variance
        followed.nis = NIS_KEPT * followed.nis + (1.0 - NIS_KEPT) * square
        if not followed.nis < LOST:  # nor where it is no number
            return int(m)
        scale = variance * max(1.0, square / MOST_OFF**2)
        for i in range(LOADED_STATES):
            gain[i], row[i] = p[i, GEAR] / scale, p[GEAR, i]
        for i in range(LOADED_STATES):
            x[i] += gain[i] * off
            for j in range(LOADED_STATES):
                p[i, j] -= gain[i] * row[j]
        for i in range(LOADED_STATES):
            for j in range(i + 1):
                p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
        x[VEHICLE_INVERSE] = min(max(x[VEHICLE_INVERSE], inverses[0]), inverses[1])
    return int(measurements.shape[1])


@compiled
def loaded_ahead(x: Vector, p: Vector, seconds: float, flat: Vector) -> None:
    """State (LOADED_STATES,) and covariance after some time, in place; flat: a `LoadedModel`."""
    model = record_on(flat, LOADED_MODEL)
    parts = max(1, math.ceil(seconds / LONGEST_S))
    dt = seconds / parts
    rate, by = np.zeros(LOADED_STATES), np.zeros((LOADED_STATES, LOADED_STATES))
    square, step = np.zeros_like(by), np.zeros_like(by)
    moved, bent = np.zeros(LOADED_STATES), np.zeros(LOADED_STATES)
    for _ in range(parts):
        _rates(x, math.sqrt(max(p[TWIST, TWIST], 0.0)), model, rate, by)
        _product(by, by, square)
        _product(by, square, step)
        for i in range(LOADED_STATES):
            moved[i] = bent[i] = 0.0
            for j in range(LOADED_STATES):
                moved[i] += by[i, j] * rate[j]
                bent[i] += square[i, j] * rate[j]
        for i in range(LOADED_STATES):
            x[i] += dt * (rate[i] + 0.5 * dt * (moved[i] + dt / 3.0 * bent[i]))
            for j in range(LOADED_STATES):
                curved = 0.5 * square[i, j] + dt / 6.0 * step[i, j]
                step[i, j] = (1.0 if i == j else 0.0) + dt * (by[i, j] + dt * curved)
        _product(step, p, square)
        for i in range(LOADED_STATES):
            for j in range(LOADED_STATES):
                p[i, j] = 0.0
                for k in range(LOADED_STATES):
                    p[i, j] += square[i, k] * step[j, k]
        faded = abs(x[VEHICLE]) / model.relaxation_rad * x[TYRE]
        p[GEAR_SPEED, GEAR_SPEED] += dt * model.gear_rad2_s3
        p[WHEELS, WHEELS] += dt * model.wheels_rad2_s3
        p[TYRE, TYRE] += dt * model.fading_s * faded * faded
        p[HILL, HILL] += dt * model.hill_rad2_s5
        p[WRONG, WRONG] += dt * 2.0 * model.wrong_nm * model.wrong_nm / model.wrong_s


@inlined
def _product(a: Vector, b: Vector, found: Vector) -> None:
    for i in range(LOADED_STATES):
        for j in range(LOADED_STATES):
            total = 0.0
            for k in range(LOADED_STATES):
                total += a[i, k] * b[k, j]
            found[i, j] = total


@inlined
def _rates(x: Vector, sd: float, model: LoadedModel, rate: Vector, by: Vector) -> None:
    """The state's rate of change, and its derivatives; `by` is zero where nothing is written."""
    twist, slope = beyond_flanks(x[TWIST] + model.tooth_rad, sd, model.half_lash_rad)
    spring, loss = model.shaft_nm_rad, model.shaft_nms * slope
    shafts = spring * twist + loss * (x[GEAR_SPEED] - x[WHEELS])
    fading = abs(x[VEHICLE]) / model.relaxation_rad
    follows = 1.0 / (1.0 + fading * model.tyre_nms / model.tyre_nm_rad)
    carcass = model.tyre_nms * follows
    rate[TYRE] = follows * (x[WHEELS] - x[VEHICLE] - fading * x[TYRE])
    tyre = model.tyre_nm_rad * x[TYRE] + model.tyre_nms * rate[TYRE]
    hold = model.tyre_nm_rad - carcass * fading

    rate[GEAR], by[GEAR, GEAR_SPEED] = x[GEAR_SPEED], 1.0
    inverse = 1.0 / model.geared_kgm2
    rate[GEAR_SPEED] = inverse * (model.driving_nm + x[WRONG] - shafts)
    by[GEAR_SPEED, WRONG], by[GEAR_SPEED, TWIST] = inverse, -inverse * spring * slope
    by[GEAR_SPEED, GEAR_SPEED], by[GEAR_SPEED, WHEELS] = -inverse * loss, inverse * loss
    rate[TWIST] = x[GEAR_SPEED] - x[WHEELS]
    by[TWIST, GEAR_SPEED], by[TWIST, WHEELS] = 1.0, -1.0
    inverse = 1.0 / model.wheels_kgm2
    rate[WHEELS] = inverse * (shafts - tyre)
    by[WHEELS, TWIST], by[WHEELS, GEAR_SPEED] = inverse * spring * slope, inverse * loss
    by[WHEELS, WHEELS] = -inverse * (loss + carcass)
    by[WHEELS, TYRE], by[WHEELS, VEHICLE] = -inverse * hold, inverse * carcass
    by[TYRE, WHEELS], by[TYRE, VEHICLE], by[TYRE, TYRE] = follows, -follows, -follows * fading
    inverse = x[VEHICLE_INVERSE]
    rate[VEHICLE] = inverse * tyre + x[HILL]
    by[VEHICLE, TYRE], by[VEHICLE, WHEELS] = inverse * hold, inverse * carcass
    by[VEHICLE, VEHICLE], by[VEHICLE, HILL] = -inverse * carcass, 1.0
    by[VEHICLE, VEHICLE_INVERSE] = tyre
    rate[WRONG], by[WRONG, WRONG] = -x[WRONG] / model.wrong_s, -1.0 / model.wrong_s
