"""The numeric inner loops: closed-form motion, its inverse, exact gearing, edge times.

Compiled by numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python. Everything works on
scalars or in place on arrays, so nothing is allocated while the rig runs.

An *angle* is whole turns (integer) and a rest in [0, 2 pi): gearing by tooth counts is then exact
in the whole turns, and phases do not drift over hours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final

from meshpoint.gearbox.wheels import SHAFT_OF_WHEEL
from meshpoint.kernels.jit import bare
from meshpoint.kernels.structures import Record, RecordArray, Row
from meshpoint.rig_sim.shared.angle_kernels import TAU
from meshpoint.rig_sim.shared.capture_records import CHANNELS, RING, WHEELS, Captured

ACCELERATED, FREE = range(2)

SERIES_BELOW: Final = 0.02
SETTLED_S: Final = 1e-9
BISECTED_S: Final = 1e-14
ROOT_ITERATIONS: Final = 80


class Motion(Record):
    """How one shaft turns from a start instant on."""

    kind: int  # ACCELERATED: constant acceleration; FREE: thesis 4.13 with 4.1
    speed_rad_s: float  # at the start
    accel_rad_s2: float  # if ACCELERATED
    drag: float  # a = c_tot / J, 1/s
    valve_rate: float  # b = 1 / tau_valve, 1/s
    gain: float  # k = C_db / J, rad/s^2 per Pa
    end_pa: float  # gauge pressure the brake tends to, K_valve u
    diff_pa: float  # gauge pressure at the start less end_pa


class WheelTurn(Record):
    """What a sensor wheel does in a piece of motion."""

    share: float  # wheel angle over that of the shaft that drives it
    turns: int  # angle at the start: whole turns and rest
    rest_rad: float
    end_turns: int  # and at the end
    end_rest_rad: float


class Piece(Record):
    """A piece of motion: both motions, and the wheels. The layshaft drives the input shaft's, the
    main shaft the propeller shaft's."""

    start_us: float
    duration_s: float
    layshaft: Motion
    main: Motion
    wheels: Annotated[Row[WheelTurn], WHEELS]


class SensorWheels(Record):
    """The sensor wheels and their edges; preset thesis."""

    teeth: Annotated[Row[int], WHEELS]
    offsets: Annotated[Row[float], CHANNELS]  # where in the pitch: 0 rising, the duty for falling
    captured: Captured


@bare
def free_motion(motion: Motion, s: float) -> tuple[float, float]:
    """Angle turned through (rad) and speed (rad/s) a time s after the start.

    Solves w' = -a w - k p, p = p_end + p_diff exp(-b s) (thesis 4.13, 4.1) with

        F = int exp(-a r),  G = int F,  E = exp(-a .) * exp(-b .) (convolved),  H = int E

    each over 0..s. F and E have no cancellation for any a, b >= 0; G gets a series for small a s;
    H = (F - E) / b is safe because b, the rate of a real valve, is never small.
    """
    a, b, k = motion.drag, motion.valve_rate, motion.gain
    omega, p_end, p_diff = motion.speed_rad_s, motion.end_pa, motion.diff_pa
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


@bare
def motion_at(motion: Motion, s: float) -> tuple[float, float]:
    """Angle turned through (rad) and speed (rad/s) a time s after the motion's start."""
    if motion.kind == FREE:
        return free_motion(motion, s)
    omega, accel = motion.speed_rad_s, motion.accel_rad_s2
    return (omega + 0.5 * accel * s) * s, omega + accel * s


@bare
def time_to_turn(motion: Motion, angle: float, low: float, high: float, guess: float) -> float:
    """When the shaft has turned through an angle (rad): s in [low, high], where it turns forward.

    Closed form for constant acceleration, else Newton's method kept inside a shrinking bracket.
    """
    if motion.kind == ACCELERATED:
        omega = motion.speed_rad_s
        root = math.sqrt(max(omega * omega + 2.0 * motion.accel_rad_s2 * angle, 0.0))
        return min(max(2.0 * angle / (omega + root), low), high) if omega + root > 0.0 else high
    s = min(max(guess, low), high)
    for _ in range(ROOT_ITERATIONS):
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


@bare
def time_of_stop(motion: Motion, horizon: float) -> float:
    """When a braked shaft comes to rest, s in [0, horizon], or -1: speed falls monotonically."""
    if motion.kind != FREE or motion_at(motion, horizon)[1] > 0.0:
        return -1.0
    low, high = 0.0, horizon
    for _ in range(ROOT_ITERATIONS):
        middle = 0.5 * (low + high)
        if motion_at(motion, middle)[1] > 0.0:
            low = middle
        else:
            high = middle
        if high - low < BISECTED_S:
            break
    return high


@bare
def slip_at(driving: Motion, sleeve: Motion, ratio: float, s: float) -> float:
    """Gear speed less sleeve speed (rad/s)."""
    return ratio * motion_at(driving, s)[1] - motion_at(sleeve, s)[1]


@bare
def phase_at(driving: Motion, sleeve: Motion, ratio: float, phase: float, s: float) -> float:
    """Phase (rad, not wrapped) a time s after it was `phase`."""
    return phase + ratio * motion_at(driving, s)[0] - motion_at(sleeve, s)[0]


@bare
def _time_of_no_slip(driving: Motion, sleeve: Motion, ratio: float, horizon: float) -> float:
    rising = slip_at(driving, sleeve, ratio, horizon) > 0.0
    low, high = 0.0, horizon
    for _ in range(ROOT_ITERATIONS):
        middle = 0.5 * (low + high)
        if (slip_at(driving, sleeve, ratio, middle) > 0.0) == rising:
            high = middle
        else:
            low = middle
        if high - low < BISECTED_S:
            break
    return 0.5 * (low + high)


@bare
def _time_of_phase(
    driving: Motion,
    sleeve: Motion,
    ratio: float,
    phase: float,
    level: float,
    bracket: tuple[float, float],
) -> float:
    low, high = bracket
    rising = phase_at(driving, sleeve, ratio, phase, high) >= level
    s = 0.5 * (low + high)
    for _ in range(ROOT_ITERATIONS):
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


@bare
def time_of_exit(
    driving: Motion,
    sleeve: Motion,
    ratio: float,
    phase: float,
    span: tuple[float, float],
    horizon: float,
) -> tuple[float, int]:
    """When the phase first leaves its span, bottom and top: (s, +1 top / -1 bottom / 0 never).

    The slip may change its sign once within the horizon: the two pieces are searched in turn. A
    phase that rounding has put a hair outside leaves only if the slip carries it outwards.
    """
    bottom, top = span
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
            s = _time_of_phase(driving, sleeve, ratio, phase, level, (low, high))
            return s, 1 if slip > 0.0 else -1
        low = high
    return -1.0, 0


@bare
def capture_edges(pieces: Sequence[Piece], sensors: Sequence[SensorWheels]) -> None:
    """Put all edges of a piece of motion into the capture rings; two channels a wheel. Times are
    rounded down, as by a 1 us timer."""
    piece, wheels = pieces[0], sensors[0]
    for edge in range(CHANNELS):
        wheel = edge // 2
        channel, turn = wheels.captured.channels[edge], piece.wheels[wheel]
        motion = piece.layshaft if SHAFT_OF_WHEEL[wheel] < 2 else piece.main
        teeth, offset = wheels.teeth[wheel], wheels.offsets[edge]
        pitch = TAU / teeth
        newest = turn.end_turns * teeth + math.floor(turn.end_rest_rad / pitch - offset)
        low = 0.0
        reached = 0.0
        speed = motion.speed_rad_s
        while channel.tooth < newest:
            channel.tooth += 1
            tooth = channel.tooth - turn.turns * teeth
            angle = ((tooth + offset) * pitch - turn.rest_rad) / turn.share
            guess = low + (angle - reached) / speed if speed > 0.0 else piece.duration_s
            low = time_to_turn(motion, angle, low, piece.duration_s, guess)
            reached, speed = motion_at(motion, low)
            channel.times_us[channel.count % RING] = math.floor(piece.start_us + low * 1e6)
            channel.count += 1


def warm_up() -> None:
    """Compile all of it now, so that no live run stalls at its first shift."""
    motion = RecordArray(Motion(speed_rad_s=1.0, valve_rate=1.0)).array[0]
    time_of_stop(motion, 0.01)
    time_of_exit(motion, motion, 1.0, 0.0, (-1.0, 1.0), 0.01)
    motion_at(motion, 0.01)
    wheels = SensorWheels(teeth=(1,) * WHEELS)
    capture_edges(RecordArray(Piece()).array, RecordArray(wheels).array)
