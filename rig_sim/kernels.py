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
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt

from rig_sim.jit import DISABLED

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Stamps = npt.NDArray[np.uint16]
Turned = tuple[int, float]
Kernel = TypeVar("Kernel", bound=Callable[..., Any])

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

TAU: Final = 2.0 * math.pi
SERIES_BELOW: Final = 0.02
SETTLED_S: Final = 1e-9
BISECTED_S: Final = 1e-14
MAX_ITERATIONS: Final = 80


WITHOUT_RUNTIME: Final[dict[str, Any]] = {"_nrt": False}


def compiled(function: Kernel) -> Kernel:
    """numba's njit with its file cache, without its runtime (`jit.OPTIONS`), keeping the function's
    type for the type checker."""
    if DISABLED:
        return function
    import numba

    try:
        return cast(Kernel, numba.njit(cache=True, **WITHOUT_RUNTIME)(function))
    except RuntimeError:  # as in `rig_sim.jit.entry`
        return cast(Kernel, numba.njit(**WITHOUT_RUNTIME)(function))


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
def settled(turns: int, rest: float) -> tuple[int, float]:
    """The same angle with its rest brought into [0, 2 pi)."""
    extra = math.floor(rest / TAU)
    rest -= extra * TAU
    if rest < 0.0:
        rest += TAU
        # A rest of next to nothing below zero rounds up to a whole turn.
        return (turns + extra - 1, rest) if rest < TAU else (turns + extra, 0.0)
    if rest >= TAU:
        return turns + extra + 1, rest - TAU
    return turns + extra, rest


@compiled
def geared(angle: Turned, teeth: int, other: int, offset: Turned) -> Turned:
    """An angle times teeth / other, and an offset: exact in the whole turns, however many."""
    whole = angle[0] * teeth
    quotient = whole // other
    remainder = whole - quotient * other
    rest = (remainder * TAU + angle[1] * teeth) / other
    return settled(quotient + offset[0], rest + offset[1])


@compiled
def wrapped(angle: float, pitch: float) -> float:
    """An angle brought into [-pitch/2, pitch/2)."""
    rest = angle - pitch * math.floor(angle / pitch + 0.5)
    return rest if rest < 0.5 * pitch else rest - pitch


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


@compiled
def _clock_before(clock: Floats, time_us: float) -> int:
    piece = clock.shape[0] - 1
    while piece > 0 and time_us < clock[piece, 0]:
        piece -= 1
    since, base, rate = clock[piece, 0], int(clock[piece, 1]), clock[piece, 2]
    shown: int = base + math.floor((time_us - since) * rate)
    return shown


@compiled
def read_ring(
    now_us: float,
    on_us: float,
    clock: Floats,
    counts: Integers,
    ring: Floats,
    stamps: Stamps,
    heads: Integers,
) -> None:
    """What the edge frames of one read hold, all channels at once.

    now_us  when it is read, and since when the sensor is on (on_us), us since power-up
    clock   (pieces, 3) the sensor clock, as `sensor_clock.SensorClock.pieces`
    counts  (channels,) edges captured so far; those still to come at now_us are left out
    ring    (channels, size) when they were captured, us since power-up
    stamps  (channels, 27) low 16 bits of the sensor clock, newest first, zero where there is none
    heads   (channels, 4) newest index, valid stamps, long interval, stopped
    """
    size = ring.shape[1]
    length = stamps.shape[1]
    newest = clock.shape[0] - 1
    since, base, rate = clock[newest, 0], int(clock[newest, 1]), clock[newest, 2]
    now = base + math.floor((now_us - since) * rate)
    for channel in range(ring.shape[0]):
        count = counts[channel]
        slot = count % size
        while count > 0 and ring[channel, (slot if slot > 0 else size) - 1] > now_us:
            count -= 1
            slot = (slot if slot > 0 else size) - 1
        valid = min(count, length)
        newer = now
        heads[channel, 2] = 0
        heads[channel, 3] = 1 if count == 0 and now_us - on_us > 0xFFFF else 0
        for entry in range(valid):
            slot = (slot if slot > 0 else size) - 1
            time_us = ring[channel, slot]
            stamp = base + math.floor((time_us - since) * rate)
            if time_us < since:
                stamp = _clock_before(clock, time_us)
            stamps[channel, entry] = stamp & 0xFFFF
            if newer - stamp > 0xFFFF:
                heads[channel, 3 if entry == 0 else 2] = 1
            newer = stamp
        for entry in range(valid, length):
            stamps[channel, entry] = 0
        heads[channel, 0] = count & 0xFFFF
        heads[channel, 1] = valid


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
