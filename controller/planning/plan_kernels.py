"""The course of phase and slip to come, and what meeting the gear at each of its moments would cost.

At a contact at time t the phase is spread about its prediction phi with variance v(t) + (slip
sigma_delay)^2. The tooth goes through the overlap without meeting a flank where it starts within
[-b/2, b/2 - slip t_overlap] (slip > 0; mirrored below zero), so with probability P of the normal
law over that interval. The cost, in seconds:

    (t - now) + (1 - P) (miss + block min(1, s_block / |slip|)) + energy slip^2 + aim ((phi - phi*) / (b/2))^2

phi* is the target angle less half of what the slip moves the tooth through the overlap. Compiled by
numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""  # noqa: E501

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.jit import compiled, inlined
from meshpoint.controller.motion.kernels import OMEGA, THETA, US, Vector, travel

RATIO: Final = 0
OFFSET: Final = 1
MAIN_TIME: Final = 2
MAIN_THETA: Final = 3
MAIN_OMEGA: Final = 4
MAIN_ACCELERATION: Final = 5
"""Indices into the mesh vector: i_gear, phase reference (rad), the main shaft's time (us), angle,
speed and acceleration then."""

PITCH: Final = 0
HALF_GAP: Final = 1
TARGET: Final = 2
OVERLAP: Final = 3
DELAY_SD: Final = 4
MISS: Final = 5
BLOCK: Final = 6
BLOCK_SLIP: Final = 7
ENERGY: Final = 8
AIM: Final = 9
SLIP_LOW: Final = 10
SLIP_HIGH: Final = 11
TERMS: Final = 12
"""Indices into the terms of a contact: pitch, b/2 and target (rad); time through the overlap and
standard deviation of the delay (s); s a miss, s more where it may block and the slip (rad/s) below
which it does; s for (rad/s)^2 of slip, s for being b/2 off the target; allowed slips (rad/s)."""

LEAST_VARIANCE: Final = 1e-10
OUTSIDE: Final = 10.0
"""Cost of a contact outside the allowed slips, s a rad/s and more: chosen only where there is no
other."""
NODE: Final = 1.7320508075688772
"""Three-point Gauss-Hermite: nodes 0 and +-sqrt(3), weights 2/3 and 1/6."""


@compiled
def course(
    x: Vector, t_us: float, first_us: float, step_us: float, switch_us: Vector, switch_u: Vector,
    motion: Vector, law: Vector, mesh: Vector, phase: Vector, slip: Vector,
) -> None:  # fmt: skip
    """Phase (unwrapped) and slip at first_us, first_us + step_us, ...; written to the arrays."""
    state, at_us = x.copy(), t_us
    for k in range(phase.shape[0]):
        time_us = first_us + k * step_us
        travel(state, at_us, time_us, switch_us, switch_u, motion, law)
        at_us = time_us
        span = (time_us - mesh[MAIN_TIME]) * US
        gained = span * mesh[MAIN_ACCELERATION]
        main = mesh[MAIN_THETA] + span * (mesh[MAIN_OMEGA] + 0.5 * gained)
        phase[k] = mesh[RATIO] * state[THETA] - main - mesh[OFFSET]
        slip[k] = mesh[RATIO] * state[OMEGA] - mesh[MAIN_OMEGA] - gained


@inlined
def contact_cost(wait_s: float, phase: float, slip: float, variance: float, terms: Vector) -> float:
    """The cost in seconds; phase unwrapped (rad), slip (rad/s), variance of the phase without what
    the delay adds (rad2)."""
    half, pitch = terms[HALF_GAP], terms[PITCH]
    moved = slip * terms[OVERLAP]
    centre = terms[TARGET] - 0.5 * moved
    off = phase - centre
    off -= pitch * math.floor(off / pitch + 0.5)
    at = centre + off
    low, high = -half - min(moved, 0.0), half - max(moved, 0.0)
    delay = slip * terms[DELAY_SD]
    root = math.sqrt(2.0 * (variance + delay * delay + LEAST_VARIANCE))
    hit = 0.0
    if high > low:
        hit = 0.5 * (math.erf((high - at) / root) - math.erf((low - at) / root))
    size = abs(slip)
    miss = terms[MISS] + terms[BLOCK] * min(1.0, terms[BLOCK_SLIP] / max(size, 1e-6))
    cost = wait_s + (1.0 - hit) * miss + terms[ENERGY] * slip * slip
    cost += terms[AIM] * (off / half) ** 2
    if slip > terms[SLIP_HIGH]:
        cost += OUTSIDE * (1.0 + slip - terms[SLIP_HIGH])
    elif slip < terms[SLIP_LOW]:
        cost += OUTSIDE * (1.0 + terms[SLIP_LOW] - slip)
    return float(cost)


@compiled
def cheapest(
    wait_s: float, step_s: float, phase: Vector, slip: Vector, shift: float, variance: float,
    growth: float, terms: Vector,
) -> tuple[int, float]:  # fmt: skip
    """Index and cost of the cheapest contact of a course; the first is `wait_s` from now.

    shift is added to the phase; its variance (rad2) grows by `growth` a second. Contacts below the
    allowed slips are looked at only where there is none before."""
    best, least = 0, math.inf
    for k in range(phase.shape[0]):
        later = k * step_s
        cost = contact_cost(
            wait_s + later, phase[k] + shift, slip[k], variance + growth * later, terms
        )
        if cost < least:
            best, least = k, cost
        if slip[k] < terms[SLIP_LOW]:
            break
    return best, least


@compiled
def expected_least(
    wait_s: float, step_s: float, phase: Vector, slip: Vector, spread: float, variance: float,
    growth: float, terms: Vector,
) -> tuple[int, float]:  # fmt: skip
    """Expected cost of a course whose contact is chosen later, when a part of today's doubt
    (`spread`, rad) will be gone; and the index that would be chosen today."""
    best, least = cheapest(wait_s, step_s, phase, slip, 0.0, variance, growth, terms)
    total = least * 2.0 / 3.0
    for sign in (-1.0, 1.0):
        _, cost = cheapest(
            wait_s, step_s, phase, slip, sign * NODE * spread, variance, growth, terms
        )
        total += cost / 6.0
    return best, total


def warm_up() -> None:
    """Compiles all, or loads what was compiled before."""
    one, mesh, terms = np.ones(1), np.ones(6), np.ones(TERMS)
    law = np.full((2, 6, 3), np.inf)
    law[:, :, 1:] = 1.0
    law[:, 0, 0] = -np.inf
    none = np.empty(0)
    course(np.ones(6), 0.0, 1.0, 1.0, none, none, np.ones(3), law, mesh, one.copy(), one.copy())
    expected_least(0.0, 1.0, one, one, 0.1, 0.1, 0.1, terms)
