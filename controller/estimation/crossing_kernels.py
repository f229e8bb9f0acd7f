"""The crossing-time Kalman filter, and the least squares by which it learns its wheel's teeth.

An edge's angle is exact and its time is noisy, so at the edge's stamp the shaft stands at y =
theta_k + delta_k with variance (omega sigma_t)^2 + sigma_delta^2: theta_k the nominal angle,
delta_k the tooth's own error where it is known, sigma_delta what is left of it. Measured brake
pressure is taken in between, in order of time.

Teeth: over nominal angles the filter's innovations would be white but for the tooth errors e, and
how each innovation depends on them the filter itself gives: with S the derivatives of the state by
the errors and m = e_tooth - S[theta], innovation + m e is white. Summed over a window, that is the
batch least squares for the teeth, in any motion that the filter's model follows, braking included.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.estimation.crossing_layout import (
    AGREEMENT,
    DONE,
    FURTHER,
    GATE,
    GATED,
    HELD,
    HISTORY,
    IN_A_ROW,
    KALMAN,
    KEPT,
    LATE,
    LAW,
    MESH,
    MOMENT,
    MOTION,
    NEXT,
    NOISE,
    NORMAL,
    OFFSET_VAR,
    RIGHT,
    ROW,
    SCALE,
    SENSOR,
    SIGMA_ANGLE,
    SIGMA_PRESSURE,
    SIGMA_TIME,
    STEP,
    TAKEN,
    TIME,
    Integers,
    P,
    X,
)
from meshpoint.controller.estimation.fusion_kernels import (
    MOST_IN_A_ROW,
    carry_offset,
    follow_offset,
    take_further,
)
from meshpoint.controller.jit import bare, compiled, inlined
from meshpoint.controller.motion.kernels import (
    DRAG,
    GAIN,
    LONGEST_S,
    OMEGA,
    PRESSURE,
    SEGMENTS,
    STATES,
    THETA,
    US,
    Vector,
    input_at,
    longest_in_segment,
    measure,
    mirror,
    spread_over,
    transition,
)

LEAST_GAIN: Final = 0.2
SHORT_S: Final = 2e-3
"""In a step this short the pressure law's change of segment matters less than its fit."""
LED_SHARE: Final = 0.2
LED_RAD_S2: Final = 100.0
"""By this share the speed is doubted when the filter was wrong, and by so much its steady change.
"""


@bare
def crossing_filter(
    floats: Vector, integers: Integers, edge_us: Vector, edge_rad: Vector,
    pressure_us: Vector, pressure_pa: Vector, switch_us: Vector, switch_u: Vector,
    teeth: Vector, place: Integers,
) -> int:  # fmt: skip
    """The filter over a batch of edges and pressure samples, both rising in time, in place.

    floats and integers as `crossing_layout` has them; edge_rad the angle each edge stands for, the
    last integers[FURTHER] of them those of a further wheel (`fusion_kernels`), rising by
    themselves; brake switches as in `travel`. To learn teeth: teeth as `TeethArrays` has it, place
    (n,) which of the wheel's N edges each edge is; N = 0 otherwise. Says LATE and takes
    nothing where the batch begins before the state and a moment is held; what is not later than
    the state is skipped where none is. Else keeps the moment before the batch."""
    count, n, m = edge_us.shape[0], edge_us.shape[0] - integers[FURTHER], pressure_us.shape[0]
    if integers[HELD] > 0 and begins_before(floats[TIME], edge_us, n):
        return LATE
    keep(floats, integers)
    x, p = floats[X : X + STATES], floats[P : P + STATES * STATES].reshape(STATES, STATES)
    gain, size, t_us = floats[KALMAN : KALMAN + STATES], teeth.shape[1], floats[TIME]
    by_tooth, right, row, normal = teeth[:RIGHT], teeth[RIGHT], teeth[ROW], teeth[NORMAL:]
    f, motion = floats[STEP:KALMAN].reshape(3, STATES), floats[MOTION:NOISE]
    noise, law = floats[NOISE:LAW], floats[LAW:MESH].reshape(2, SEGMENTS, 3)
    i, j, k, further = input_at(t_us, switch_us), 0, 0, n
    while k < n or further < count or j < m:
        own = k < n and not (further < count and edge_us[further] < edge_us[k])
        edge = k if own else further
        pressure_is_next = j < m and (edge == count or pressure_us[j] < edge_us[edge])
        when_us = pressure_us[j] if pressure_is_next else edge_us[edge]
        late = when_us <= t_us
        if not late:
            i = move(
                floats, x, p, t_us, when_us, i, switch_us, switch_u, motion, law, noise, f, by_tooth
            )
            t_us = when_us
        if pressure_is_next:
            if not late:
                take_pressure(floats, x, p, pressure_pa[j], gain, by_tooth, row)
            j += 1
        elif own:
            if not late:
                innovation = edge_rad[k] - x[THETA]
                s = take_edge(floats, integers, x, p, innovation, gain)
                if size > 0 and s > 0.0:
                    learn(by_tooth, place[k], floats[SCALE], innovation, s, normal, right, row)
                    follow(by_tooth, gain, row)
            k += 1
        else:
            if not late:
                take_further(floats, integers, x, p, edge_rad[further], gain)
            further += 1
        x[GAIN] = max(x[GAIN], LEAST_GAIN)
    mirror(p)
    floats[TIME] = t_us
    return DONE


@inlined
def begins_before(t_us: float, edge_us: Vector, n: int) -> bool:
    """Whether edges, n of one wheel and the rest of another, begin before a time."""
    own_does = n > 0 and edge_us[0] < t_us
    further_does = edge_us.shape[0] > n and edge_us[n] < t_us
    return bool(own_does or further_does)


@inlined
def keep(floats: Vector, integers: Integers) -> None:
    """The present moment into the ring."""
    at = HISTORY + integers[NEXT] * MOMENT
    for k in range(MOMENT):
        floats[at + k] = floats[k]
    integers[NEXT] = (integers[NEXT] + 1) % KEPT
    integers[HELD] = min(integers[HELD] + 1, KEPT)


@inlined
def move(
    floats: Vector, x: Vector, p: Vector, t_us: float, to_us: float, i: int, switch_us: Vector,
    switch_u: Vector, motion: Vector, law: Vector, noise: Vector, f: Vector, by_tooth: Vector,
) -> int:  # fmt: skip
    """State, covariance and tooth derivatives to a time; returns the number of switches passed.

    Views of two dimensions are handed down: to make one anew for every edge costs a quarter."""
    while t_us < to_us:
        u = int(switch_u[i - 1]) if i > 0 else 0
        until_us = to_us
        if i < switch_us.shape[0] and switch_us[i] < to_us:
            until_us = switch_us[i]
        dt = (until_us - t_us) * US
        part = dt
        if dt > SHORT_S:
            part = min(longest_in_segment(law, u, x[PRESSURE], dt), LONGEST_S)
        transition(x, part, u, motion, law, f)
        spread_over(p, part, f, motion, noise, x)
        if by_tooth.shape[1] > 0:
            carry(by_tooth, f)
        if floats[OFFSET_VAR] > 0.0:
            carry_offset(floats, f, part, i > 0 and t_us - switch_us[i - 1] < floats[MESH + 2])
        if part < dt:
            t_us += part / US
        else:
            t_us = until_us
            if i < switch_us.shape[0] and switch_us[i] <= until_us:
                i += 1
    return i


@inlined
def take_pressure(
    floats: Vector, x: Vector, p: Vector, pressure_pa: float, gain: Vector, by_tooth: Vector,
    row: Vector,
) -> None:  # fmt: skip
    """One sample of the measured pressure into the filter."""
    r = floats[SENSOR + SIGMA_PRESSURE] * floats[SENSOR + SIGMA_PRESSURE]
    innovation = pressure_pa - x[PRESSURE]
    s = measure(x, p, PRESSURE, innovation, r, gain)
    for c in range(row.shape[0]):
        row[c] = -by_tooth[PRESSURE, c]
    follow(by_tooth, gain, row)
    if floats[OFFSET_VAR] > 0.0:
        follow_offset(floats, PRESSURE, innovation, s, gain)


@inlined
def take_edge(
    floats: Vector, integers: Integers, x: Vector, p: Vector, innovation: float, gain: Vector
) -> float:
    """One edge into the filter; returns the innovation's variance, 0 where the gate refused it."""
    sigma = x[OMEGA] * floats[SENSOR + SIGMA_TIME]
    r = sigma * sigma + floats[SENSOR + SIGMA_ANGLE] * floats[SENSOR + SIGMA_ANGLE]
    square = innovation * innovation / (p[THETA, THETA] + r)
    if square > floats[SENSOR + GATE] * floats[SENSOR + GATE]:
        integers[GATED] += 1
        integers[IN_A_ROW] += 1
        if integers[IN_A_ROW] < MOST_IN_A_ROW:
            return 0.0
        # Eight in a row: what the filter believes is wrong; let it be led.
        p[THETA, THETA] += innovation * innovation
        p[OMEGA, OMEGA] += (LED_SHARE * x[OMEGA]) ** 2
        p[DRAG, DRAG] += LED_RAD_S2 * LED_RAD_S2
    else:
        floats[AGREEMENT] += square
        floats[AGREEMENT + 1] += 1.0
    integers[IN_A_ROW] = 0
    integers[TAKEN] += 1
    s = measure(x, p, THETA, innovation, r, gain)
    if floats[OFFSET_VAR] > 0.0:
        follow_offset(floats, THETA, innovation, s, gain)
    return s


@inlined
def learn(
    by_tooth: Vector, place: int, scale: float, innovation: float, s: float, normal: Vector,
    right: Vector, row: Vector,
) -> None:  # fmt: skip
    """Adds one innovation to the teeth's normal equations; row (N,) becomes its m."""
    size = row.shape[0]
    for c in range(size):
        row[c] = -by_tooth[THETA, c]
    row[place] += scale
    for c in range(size):
        weighted = row[c] / s
        right[c] -= weighted * innovation
        for d in range(c, size):
            normal[c, d] += weighted * row[d]


@inlined
def follow(by_tooth: Vector, gain: Vector, row: Vector) -> None:
    """The derivatives by the tooth errors after an update."""
    for state in range(STATES):
        for c in range(row.shape[0]):
            by_tooth[state, c] += gain[state] * row[c]


@inlined
def carry(by_tooth: Vector, f: Vector) -> None:
    """The derivatives by the tooth errors after a step."""
    for c in range(by_tooth.shape[1]):
        theta, omega = by_tooth[0, c], 0.0
        for k in range(1, STATES):
            theta += f[0, k] * by_tooth[k, c]
            omega += f[1, k] * by_tooth[k, c]
        by_tooth[0, c], by_tooth[1, c] = theta, omega
        by_tooth[2, c] *= f[2, 2]
        by_tooth[3, c] *= f[2, 3]


@compiled
def inverse_of_positive(matrix: Vector) -> Vector:
    """The inverse of a symmetric positive definite matrix (n, n) by Cholesky's factors; NaN where
    it is not one. A wheel's equations are small: threads of a linear algebra library would cost
    more than the sum, and need not add up in the same order twice."""
    n = matrix.shape[0]
    lower = np.zeros((n, n))
    for j in range(n):
        rest = matrix[j, j]
        for k in range(j):
            rest -= lower[j, k] * lower[j, k]
        if not rest > 0.0:
            return np.full((n, n), np.nan)
        lower[j, j] = math.sqrt(rest)
        for i in range(j + 1, n):
            s = matrix[i, j]
            for k in range(j):
                s -= lower[i, k] * lower[j, k]
            lower[i, j] = s / lower[j, j]
    half = np.zeros((n, n))
    for c in range(n):
        half[c, c] = 1.0 / lower[c, c]
        for i in range(c + 1, n):
            s = 0.0
            for k in range(c, i):
                s -= lower[i, k] * half[c, k]
            half[c, i] = s / lower[i, i]
    inverse = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(i, n):
                s += half[i, k] * half[j, k]
            inverse[i, j] = inverse[j, i] = s
    return inverse
