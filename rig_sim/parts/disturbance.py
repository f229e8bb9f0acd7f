"""Torques that nothing in the equations explains: chance, engine orders, brake judder.

Chance is an Ornstein-Uhlenbeck torque a body, sampled every 2 ms and linear in between:

    x' = -x / tau + sqrt(2 / tau) sd xi
    x_n+1 = a x_n + sd sqrt(1 - a^2) z          a = exp(-dt / tau)

Below 5 rad/s the body's torque fades with its speed, so that a shaft at rest stays at rest. z is
normal, (A[i] + B[j]) / sqrt(2) from two drawn tables of 4,096 numbers; i and j are bits of a Lehmer
sequence s = 48271 s mod (2^31 - 1) of each body's own, which comes round after 50 days.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

from meshpoint.kernels.jit import inlined
from meshpoint.kernels.structures import Record, Row

SOURCES: Final = 6
"""Five bodies (`layout`) and the driven wheels, which the road shakes."""
WHEELS_SOURCE: Final = 5
NUMBERS: Final = 4096
LEHMER: Final = 48271
MERSENNE: Final = (1 << 31) - 1
SAMPLE_US: Final = 2000
SAMPLE_S: Final = SAMPLE_US * 1e-6
TURNING_RAD_S: Final = 5.0
"""Below this speed chance fades with the speed: a shaft at rest stays at rest."""
LOAD_LAG: Final = 0.05
"""Share of a change of load that eccentricity follows in 2 ms: 40 ms."""
LOAD_NM: Final = 1000.0


class Disturbance(Record):
    """As built. Shares are amplitudes over the mean torque."""

    is_on: int
    keep: Annotated[Row[float], SOURCES]  # a
    spread_nm: Annotated[Row[float], SOURCES]  # sd sqrt(1 - a^2)
    first_order: float  # of the engine: once a turn of the crankshaft, the second half-order
    main_order: float  # three times a turn: six cylinders
    clutch_drag_nm: float  # of the open plates
    judder_once: float  # of the brake: once a turn
    judder_twice: float
    once_rad: float  # where on the disc
    twice_rad: float


class ChanceNumbers(Record):
    """The drawn tables."""

    first: Annotated[Row[float], NUMBERS]
    second: Annotated[Row[float], NUMBERS]


class Shaking(Record):
    """What moves: the torques at the last sample and their slopes up to the next."""

    count: int  # number of that sample, -1: none yet
    since_s: float  # from it to the beginning of the step
    at_s: float  # from it to the instant of the present rates
    seeds: Annotated[Row[int], SOURCES]  # s
    chance_nm: Annotated[Row[float], SOURCES]  # x at the next sample
    now_nm: Annotated[Row[float], SOURCES]
    slope_nm_s: Annotated[Row[float], SOURCES]
    load: float  # share of LOAD_NM that the main box carries, lagged


@inlined
def renew(shaking: Shaking, count: int, built: Disturbance, numbers: ChanceNumbers) -> None:
    """Takes sample `count` as reached and draws the next. Once a sample, in order."""
    for k in range(SOURCES):
        product = LEHMER * shaking.seeds[k]
        seed = (product & MERSENNE) + (product >> 31)
        if seed >= MERSENNE:
            seed -= MERSENNE
        shaking.seeds[k] = seed
        z = numbers.first[seed & (NUMBERS - 1)] + numbers.second[(seed >> 12) & (NUMBERS - 1)]
        shaking.chance_nm[k] = built.keep[k] * shaking.chance_nm[k] + built.spread_nm[k] * z
    shaking.count = count


@inlined
def chance_nm(shaking: Shaking, source: int) -> float:
    """The torque of chance on a body now."""
    return shaking.now_nm[source] + shaking.slope_nm_s[source] * shaking.at_s


@inlined
def lead_to_next(shaking: Shaking, source: int, speed_rad_s: float) -> None:
    """From this sample on the torque on a body goes to that of the next sample, faded by the
    body's speed."""
    now = chance_nm(shaking, source)
    following = shaking.chance_nm[source] * min(abs(speed_rad_s) / TURNING_RAD_S, 1.0)
    shaking.now_nm[source] = now
    shaking.slope_nm_s[source] = (following - now) / SAMPLE_S


@inlined
def orders(angle_rad: float, built: Disturbance) -> float:
    """Engine orders at a crank angle, as a share of the mean torque."""
    once = wave(angle_rad)
    return built.first_order * once + built.main_order * once * (3.0 - 4.0 * once * once)


@inlined
def wave(angle_rad: float) -> float:
    """The sine of an angle in 0..2 pi within 0.0011 and continuous in its slope, at less cost."""
    x = 1.0 - angle_rad / math.pi
    y = 4.0 * x * (1.0 - abs(x))
    return y * (0.775 + 0.225 * abs(y))


@inlined
def judder(angle_rad: float, built: Disturbance) -> float:
    """Brake torque over that of an even disc."""
    once = built.judder_once * math.sin(angle_rad + built.once_rad)
    return 1.0 + once + built.judder_twice * math.sin(2.0 * angle_rad + built.twice_rad)
