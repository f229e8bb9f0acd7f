"""The numeric inner loops: closed-form motion, its inverse, exact gearing, edge times.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python. Everything works on
scalars or in place on arrays, so nothing is allocated while the rig runs.

A *motion* is how one shaft turns from a start instant on, as a float64 vector:

    KIND      ACCELERATED: constant acceleration; FREE: thesis 4.13 with 4.1
    OMEGA     speed at the start, rad/s
    ACCEL     acceleration, rad/s^2 (ACCELERATED)
    DRAG      a = c_tot / J, 1/s
    RATE      b = 1 / tau_valve, 1/s
    GAIN      k = C_db / J, rad/s^2 per Pa
    P_END     gauge pressure the brake tends to, K_valve u, Pa
    P_DIFF    gauge pressure at the start less P_END, Pa

An *angle* is whole turns (integer) and a rest in [0, 2 pi): gearing by tooth counts is then exact
in the whole turns, and phases do not drift over hours.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.rig_sim.shared.angle_kernels import (
    TAU,
    Floats,
    Integers,
    Turned,
    compiled,
    geared,
    read_ring,
    settled,
    wrapped,
)

KIND: Final = 0
OMEGA: Final = 1
ACCEL: Final = 2
DRAG: Final = 3
RATE: Final = 4
GAIN: Final = 5
P_END: Final = 6
P_DIFF: Final = 7
MOTION_SIZE: Final = 8

ACCELERATED: Final = 0.0
FREE: Final = 1.0

SERIES_BELOW: Final = 0.02
SETTLED_S: Final = 1e-9
BISECTED_S: Final = 1e-14
MAX_ITERATIONS: Final = 80


@compiled
def free_motion(
    s: float, omega: float, a: float, b: float, k: float, p_end: float, p_diff: float
) -> tuple[float, float]:
    """Angle turned through (rad) and speed (rad/s) a time s after the start.

    Solves w' = -a w - k p, p = p_end + p_diff exp(-b s) (thesis 4.13, 4.1) with

        F = int exp(-a r),  G = int F,  E = exp(-a .) * exp(-b .) (convolved),  H = int E

    each over 0..s. F and E have no cancellation for any a, b >= 0; G gets a series for small a s;
    H = (F - E) / b is safe because b, the rate of a real valve, is never small.
    """
    x = a * s
    f = -math.expm1(-x) / a if a > 0.0 else s
    if x < SERIES_BELOW:
        terms = 1.0 / 120.0 - x * (1.0 / 720.0 - x / 5040.0)
        g = s * s * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * terms)))
    else:
        g = (s - f) / a
    apart = abs(a - b)
    spread = -math.expm1(-apart * s) / apart if apart > 0.0 else s
    e = math.exp(-min(a, b) * s) * spread
    h = (f - e) / b
    turned = omega * f - k * (p_end * g + p_diff * h)
    return turned, omega * (1.0 - a * f) - k * (p_end * f + p_diff * e)


@compiled
def motion_at(motion: Floats, s: float) -> tuple[float, float]:
    """Angle turned through (rad) and speed (rad/s) a time s after the motion's start."""
    if motion[KIND] == FREE:
        return free_motion(
            s,
            motion[OMEGA],
            motion[DRAG],
            motion[RATE],
            motion[GAIN],
            motion[P_END],
            motion[P_DIFF],
        )
    accel = motion[ACCEL]
    return (motion[OMEGA] + 0.5 * accel * s) * s, motion[OMEGA] + accel * s


@compiled
def time_to_turn(motion: Floats, angle: float, low: float, high: float, guess: float) -> float:
    """When the shaft has turned through an angle (rad): s in [low, high], where it turns forward.

    Closed form for constant acceleration, else Newton's method kept inside a shrinking bracket.
    """
    if motion[KIND] == ACCELERATED:
        omega = motion[OMEGA]
        root = math.sqrt(max(omega * omega + 2.0 * motion[ACCEL] * angle, 0.0))
        return min(max(2.0 * angle / (omega + root), low), high) if omega + root > 0.0 else high
    s = min(max(guess, low), high)
    for _ in range(MAX_ITERATIONS):
        turned, omega = motion_at(motion, s)
        error = turned - angle
        if error > 0.0:
            high = s
        else:
            low = s
        step = error / omega if omega > 0.0 else math.inf
        if abs(step) < SETTLED_S:
            return s - step
        s -= step
        if not low < s < high:
            s = 0.5 * (low + high)
        if high - low < BISECTED_S:
            return s
    return s


@compiled
def time_of_stop(motion: Floats, horizon: float) -> float:
    """When a braked shaft comes to rest, s in [0, horizon], or -1: speed falls monotonically."""
    if motion[KIND] != FREE or motion_at(motion, horizon)[1] > 0.0:
        return -1.0
    low, high = 0.0, horizon
    for _ in range(MAX_ITERATIONS):
        middle = 0.5 * (low + high)
        if motion_at(motion, middle)[1] > 0.0:
            low = middle
        else:
            high = middle
        if high - low < BISECTED_S:
            break
    return high


@compiled
def slip_at(driving: Floats, sleeve: Floats, ratio: float, s: float) -> float:
    """Gear speed less sleeve speed (rad/s)."""
    return ratio * motion_at(driving, s)[1] - motion_at(sleeve, s)[1]


@compiled
def phase_at(driving: Floats, sleeve: Floats, ratio: float, phase: float, s: float) -> float:
    """Phase (rad, not wrapped) a time s after it was `phase`."""
    return phase + ratio * motion_at(driving, s)[0] - motion_at(sleeve, s)[0]


@compiled
def _time_of_no_slip(driving: Floats, sleeve: Floats, ratio: float, horizon: float) -> float:
    rising = slip_at(driving, sleeve, ratio, horizon) > 0.0
    low, high = 0.0, horizon
    for _ in range(MAX_ITERATIONS):
        middle = 0.5 * (low + high)
        if (slip_at(driving, sleeve, ratio, middle) > 0.0) == rising:
            high = middle
        else:
            low = middle
        if high - low < BISECTED_S:
            break
    return 0.5 * (low + high)


@compiled
def _time_of_phase(
    driving: Floats,
    sleeve: Floats,
    ratio: float,
    phase: float,
    level: float,
    low: float,
    high: float,
) -> float:
    rising = phase_at(driving, sleeve, ratio, phase, high) >= level
    s = 0.5 * (low + high)
    for _ in range(MAX_ITERATIONS):
        error = phase_at(driving, sleeve, ratio, phase, s) - level
        if (error >= 0.0) == rising:
            high = s
        else:
            low = s
        slip = slip_at(driving, sleeve, ratio, s)
        step = error / slip if slip != 0.0 else math.inf
        if abs(step) < SETTLED_S:
            return min(max(s - step, low), high)
        s -= step
        if not low < s < high:
            s = 0.5 * (low + high)
        if high - low < BISECTED_S:
            return s
    return s


@compiled
def time_of_exit(
    driving: Floats,
    sleeve: Floats,
    ratio: float,
    phase: float,
    bottom: float,
    top: float,
    horizon: float,
) -> tuple[float, int]:
    """When the phase, now between bottom and top, first leaves: (s, +1 top / -1 bottom / 0 never).

    The slip may change its sign once within the horizon: the two pieces are searched in turn. A
    phase that rounding has put a hair outside leaves only if the slip carries it outwards.
    """
    start = slip_at(driving, sleeve, ratio, 0.0)
    end = slip_at(driving, sleeve, ratio, horizon)
    turn = horizon
    if start * end < 0.0:
        turn = _time_of_no_slip(driving, sleeve, ratio, horizon)
    low = 0.0
    for piece in range(2):
        high = turn if piece == 0 else horizon
        slip = end if piece == 1 or start == 0.0 else start
        reached = phase_at(driving, sleeve, ratio, phase, high)
        level = top if slip > 0.0 else bottom
        if slip != 0.0 and (reached - level) * slip >= 0.0:
            if (phase_at(driving, sleeve, ratio, phase, low) - level) * slip >= 0.0:
                return low, 1 if slip > 0.0 else -1
            s = _time_of_phase(driving, sleeve, ratio, phase, level, low, high)
            return s, 1 if slip > 0.0 else -1
        low = high
    return -1.0, 0


@compiled
def capture_edges(
    motions: tuple[Floats, Floats, Floats, Floats],
    start_us: float,
    duration_s: float,
    shares: tuple[float, float, float, float],
    before: tuple[Turned, Turned, Turned, Turned],
    after: tuple[Turned, Turned, Turned, Turned],
    teeth: Integers,
    offsets: Floats,
    seen: Integers,
    ring: Floats,
) -> None:
    """Put all edges of a piece of motion into the capture rings; two channels a wheel.

    motions     of the shaft that drives each wheel; the wheel turns `shares` of its angle
    before      wheel angles at the start (turns, rest); after: at the end, duration_s later
    teeth       (wheels,) of each wheel
    offsets     (channels,) where in the pitch the edge lies: 0 rising, the duty for falling
    seen        (channels, 2): tooth number of the newest edge, edges since power-up
    ring        (channels, size) capture times, us since power-up, rounded down (1 us timer)
    """
    size = ring.shape[1]
    for channel in range(ring.shape[0]):
        wheel = channel // 2
        motion = motions[wheel]
        offset = offsets[channel]
        pitch = TAU / teeth[wheel]
        newest = after[wheel][0] * teeth[wheel] + math.floor(after[wheel][1] / pitch - offset)
        low = 0.0
        reached = 0.0
        speed = motion[OMEGA]
        while seen[channel, 0] < newest:
            seen[channel, 0] += 1
            tooth = seen[channel, 0] - before[wheel][0] * teeth[wheel]
            angle = ((tooth + offset) * pitch - before[wheel][1]) / shares[wheel]
            guess = low + (angle - reached) / speed if speed > 0.0 else duration_s
            low = time_to_turn(motion, angle, low, duration_s, guess)
            reached, speed = motion_at(motion, low)
            ring[channel, seen[channel, 1] % size] = math.floor(start_us + low * 1e6)
            seen[channel, 1] += 1


def warm_up() -> None:
    """Compile everything now, so that no live run stalls at its first shift."""
    motion = np.zeros(MOTION_SIZE)
    motion[OMEGA] = motion[RATE] = 1.0
    angle = settled(0, 0.5)
    angles = (angle, geared(angle, 2, 3, angle), angle, angle)
    wrapped(0.5, 1.0)
    time_of_stop(motion, 0.01)
    time_of_exit(motion, motion, 1.0, 0.0, -1.0, 1.0, 0.01)
    motion_at(motion, 0.01)
    integers = np.zeros((8, 4), dtype=np.int64)
    shares = (1.0, 1.0, 1.0, 1.0)
    motions = (motion, motion, motion, motion)
    teeth, offsets = np.ones(4, dtype=np.int64), np.zeros(8)
    ring, clock = np.zeros((8, 4)), np.zeros((1, 3))
    capture_edges(motions, 0.0, 0.0, shares, angles, angles, teeth, offsets, integers, ring)
    stamps = np.zeros((8, 4), dtype=np.uint16)
    read_ring(0.0, 0.0, clock, integers[:, 0], ring, stamps, integers)
