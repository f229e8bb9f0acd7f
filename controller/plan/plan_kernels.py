"""Phase and slip at times to come, and the expected cost of a contact at each of them.

At a contact at time t the phase is spread about its prediction phi with variance v(t) + (slip
sigma_delay)^2. The tooth passes the overlap without meeting a flank if its phase at contact lies in
[-b/2, b/2 - slip t_overlap] (slip > 0; mirrored for slip < 0): P is the probability of that interval
under the normal law. The cost, in seconds:

    (t - now) + (1 - P) (miss + block min(1, s_block / |slip|)) + energy slip^2 + aim ((phi - phi*) / (b/2))^2

phi* is the target angle less half of what the slip moves the tooth through the overlap. Compiled by
numba; with NUMBA_DISABLE_JIT=1 the same code runs as plain Python.
"""  # noqa: E501

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.controller.models.layshaft_kernels import MODEL, STATE, STATES, copy_on, travel
from meshpoint.kernels.jit import compiled, inlined, record_on
from meshpoint.kernels.records import WORD_BYTES, Vector, filled, layout_of


class Meeting:
    """The gear's two shafts, and the times at which their trajectory is asked for."""

    layshaft_us: float
    """Time of the layshaft's state."""
    first_us: float
    step_us: float
    i_gear: float
    reference_rad: float
    """Phase reference."""


class ContactSeries:
    """Contacts at equal steps of time."""

    wait_s: float
    """From now to the first."""
    step_s: float


class Terms:
    """The parameters of the cost (docs/strategy.md)."""

    pitch_rad: float
    half_gap_rad: float
    target_rad: float
    overlap_s: float
    """Time through the overlap."""
    delay_sd_s: float
    miss_s: float
    block_s: float
    """Price of a miss, and what may be added to it where the tooth may block."""
    block_slip_rad_s: float
    """Below this slip the tooth may block."""
    energy_s3_rad2: float
    """Price of (rad/s)^2 of slip, in seconds."""
    aim_s: float
    """Price of being half a gap off the target."""
    slip_low_rad_s: float
    slip_high_rad_s: float
    """Allowed slips."""


MEETING: Final = layout_of(Meeting)
CONTACT_SERIES: Final = layout_of(ContactSeries)
TERMS: Final = layout_of(Terms)

LEAST_VARIANCE: Final = 1e-10
OUTSIDE_S: Final = 0.05
OUTSIDE: Final = 0.1
"""Added cost of a contact outside the allowed slips, in s, and in s for each rad/s: it is chosen
only if the gaps within reach are all outside, and then the nearest."""


@compiled
def trajectory(x: Vector, switches: Vector, model: Vector, meeting: Vector, found: Vector) -> None:
    """Phase (unwrapped) and slip at equal steps of time; written to the rows of found (2, n), in
    which the main shaft's angle and speed at these times are given.

    x: the layshaft's `State`; switches and model as for `travel`; meeting: a `Meeting`."""
    mesh = record_on(meeting, MEETING)
    meet(x.copy(), switches, model, mesh, mesh.first_us, found)


@compiled
def trajectories(
    x: Vector, commands: Vector, model: Vector, meeting: Vector, releases: Vector, found: Vector
) -> None:
    """As `trajectory`, after each of m releases of the brake, instead of the switches: found (m, 2,
    n).

    commands (3, k): times of the brake valve's switches, its states from then on, and when pressure
    begins to react; releases (3, m): times of the releases, when pressure begins to react to them,
    and the first time that is asked for after each."""
    mesh, ahead = record_on(meeting, MEETING), np.empty(STATES)
    switches = np.empty((2, commands.shape[1] + 1))
    for r in range(releases.shape[1]):
        release(commands, releases[0, r], releases[1, r], switches)
        copy_on(x, ahead)
        meet(ahead, switches, model, mesh, releases[2, r], found[r])


@inlined
def release(commands: Vector, release_us: float, reacts_us: float, switches: Vector) -> None:
    """The switches of `BrakeInput.with_release`; room that is left is filled with switches that
    never come."""
    kept = commands.shape[1]
    while kept > 0 and (commands[1, kept - 1] == 0.0 or commands[0, kept - 1] >= release_us):
        kept -= 1
    for k in range(switches.shape[1]):
        switches[0, k], switches[1, k] = math.inf, 0.0
        if k < kept:
            switches[0, k], switches[1, k] = commands[2, k], commands[1, k]
    switches[0, kept] = reacts_us


@inlined
def meet(
    ahead: Vector, switches: Vector, model: Vector, mesh: Meeting, first_us: float, found: Vector
) -> None:
    """The trajectory of a `Meeting` from a time on; the layshaft's state is moved."""
    state, at_us = record_on(ahead, STATE), mesh.layshaft_us
    phase, slip = found[0], found[1]
    for k in range(phase.shape[0]):
        time_us = first_us + k * mesh.step_us
        travel(ahead, at_us, time_us, switches, model)
        at_us = time_us
        phase[k] = mesh.i_gear * state.theta_rad - phase[k] - mesh.reference_rad
        slip[k] = mesh.i_gear * state.omega_rad_s - slip[k]


@inlined
def contact_cost(
    wait_s: float, phase: float, slip: float, variance: float, terms: Terms, enough: float
) -> float:
    """The cost in seconds; phase unwrapped (rad), slip (rad/s), variance of the phase without what
    the delay adds (rad2). Where even a sure hit would cost `enough` or more, the cost of that: the
    probability of a hit is most of the work, and does not matter then."""
    half, pitch = terms.half_gap_rad, terms.pitch_rad
    moved = slip * terms.overlap_s
    centre = terms.target_rad - 0.5 * moved
    off = phase - centre
    off -= pitch * math.floor(off / pitch + 0.5)
    energy, aim, outside = terms.energy_s3_rad2 * slip * slip, terms.aim_s * (off / half) ** 2, 0.0
    if slip > terms.slip_high_rad_s:
        outside = OUTSIDE_S + OUTSIDE * (slip - terms.slip_high_rad_s)
    elif slip < terms.slip_low_rad_s:
        outside = OUTSIDE_S + OUTSIDE * (terms.slip_low_rad_s - slip)
    # In the order of the sum below: rounding, too, keeps it the lower one.
    least = wait_s + energy + aim + outside
    if least >= enough:
        return float(least)
    at = centre + off
    low, high = -half - min(moved, 0.0), half - max(moved, 0.0)
    delay = slip * terms.delay_sd_s
    root = math.sqrt(2.0 * (variance + delay * delay + LEAST_VARIANCE))
    hit = 0.0
    if high > low:
        hit = 0.5 * (math.erf((high - at) / root) - math.erf((low - at) / root))
    size = abs(slip)
    miss = terms.miss_s + terms.block_s * min(1.0, terms.block_slip_rad_s / max(size, 1e-6))
    return float(wait_s + (1.0 - hit) * miss + energy + aim + outside)


@compiled
def cheapest(
    phase: Vector, slip: Vector, variance: Vector, contacts: Vector, terms: Vector
) -> tuple[int, float]:
    """Index and cost of the cheapest contact of a trajectory: phase and slip at each contact, and
    the phase's variance without what the delay adds.

    contacts: a `ContactSeries`; terms: `Terms`."""
    series, price = record_on(contacts, CONTACT_SERIES), record_on(terms, TERMS)
    best, least = 0, math.inf
    for k in range(phase.shape[0]):
        later = k * series.step_s
        cost = contact_cost(series.wait_s + later, phase[k], slip[k], variance[k], price, least)
        if cost < least:
            best, least = k, cost
    return best, least


@compiled
def best_trajectory(
    found: Vector, variance: Vector, waits_s: Vector, contacts: Vector, terms: Vector
) -> tuple[int, int]:
    """Of several trajectories, found (m, 2, n), the one with the cheapest contact, and the index of
    that contact.

    waits_s (m,): from now to the first contact of each, `ContactSeries.wait_s`, which is set."""
    series = record_on(contacts, CONTACT_SERIES)
    chosen, best, least = 0, 0, math.inf
    for r in range(found.shape[0]):
        series.wait_s = waits_s[r]
        index, cost = cheapest(found[r, 0], found[r, 1], variance, contacts, terms)
        if cost < least:
            chosen, best, least = r, index, cost
    return chosen, best


def warm_up() -> None:
    """Compiles all, or loads what was compiled before."""
    model = np.ones(MODEL.itemsize // WORD_BYTES)
    law = model.view(MODEL)["segments"]
    law[..., 0], law[0, :, 0, 0] = np.inf, -np.inf
    meeting = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    trajectory(np.ones(STATES), np.empty((2, 0)), model, meeting, np.ones((2, 1)))
    found = np.ones((1, 2, 1))
    trajectories(np.ones(STATES), np.empty((3, 0)), model, meeting, np.ones((3, 1)), found)
    contacts = filled(CONTACT_SERIES, wait_s=0.0, step_s=1.0)
    one, terms = np.ones(1), np.ones(TERMS.itemsize // WORD_BYTES)
    cheapest(one, one, one, contacts, terms)
    best_trajectory(found, one, one, contacts, terms)
