"""Torques that nothing in the equations explains: chance, engine orders, brake judder.

Chance is an Ornstein-Uhlenbeck torque a body, sampled every 2 ms and linear in between:

    x' = -x / tau + sqrt(2 / tau) sd xi
    x_n+1 = a x_n + sd sqrt(1 - a^2) z          a = exp(-dt / tau)

z is normal, (A[n + a_k] + B[n + b_k]) / sqrt(2) from two drawn tables of 4096 and 4093 numbers, a
place of its own in each for each body: the same instant has the same chance however the rig got
there, and repeats after nine hours.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

from meshpoint.rig_sim.jit import inlined
from meshpoint.rig_sim.records import Record, Row

SOURCES: Final = 6
"""Five bodies (`layout`) and the driven wheels, which the road shakes."""
WHEELS_SOURCE: Final = 5
FIRST_NUMBERS: Final = 4096
SECOND_NUMBERS: Final = 4093
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

    first: Annotated[Row[float], FIRST_NUMBERS]
    second: Annotated[Row[float], SECOND_NUMBERS]


class Shaking(Record):
    """What moves: the torques at the last sample and their slopes up to the next."""

    count: int  # number of that sample, -1: none yet
    since_s: float  # from it to the beginning of the step
    at_s: float  # from it to the instant of the present rates
    now_nm: Annotated[Row[float], SOURCES]
    slope_nm_s: Annotated[Row[float], SOURCES]
    load: float  # share of LOAD_NM that the main box carries, lagged


@inlined
def renew(shaking: Shaking, count: int, built: Disturbance, numbers: ChanceNumbers) -> None:
    """Takes sample `count` as reached and draws the next. Once a sample, in order."""
    for k in range(SOURCES):
        now = shaking.now_nm[k] + shaking.slope_nm_s[k] * SAMPLE_S
        z = numbers.first[(count + 683 * k) % FIRST_NUMBERS]
        z += numbers.second[(count + 1021 * k) % SECOND_NUMBERS]
        following = built.keep[k] * now + built.spread_nm[k] * z * math.sqrt(0.5)
        shaking.now_nm[k] = now
        shaking.slope_nm_s[k] = (following - now) / SAMPLE_S
    shaking.count = count


@inlined
def chance_nm(shaking: Shaking, source: int, speed_rad_s: float) -> float:
    """The torque of chance now on a body that turns at this speed."""
    torque = shaking.now_nm[source] + shaking.slope_nm_s[source] * shaking.at_s
    return torque * min(abs(speed_rad_s) / TURNING_RAD_S, 1.0)


@inlined
def orders(angle_rad: float, built: Disturbance) -> float:
    """Engine orders at a crank angle, as a share of the mean torque."""
    once = math.sin(angle_rad)
    return built.first_order * once + built.main_order * once * (3.0 - 4.0 * once * once)


@inlined
def judder(angle_rad: float, built: Disturbance) -> float:
    """Brake torque over that of an even disc."""
    once = built.judder_once * math.sin(angle_rad + built.once_rad)
    return 1.0 + once + built.judder_twice * math.sin(2.0 * angle_rad + built.twice_rad)
