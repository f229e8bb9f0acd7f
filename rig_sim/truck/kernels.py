"""The truck plant's inner loop: fixed steps cut at events, and the edges found in each step.

Steps go from one grid point to the next. A step is cut only at scheduled times and at events found
in it, never at the time up to which the caller wants to go: so the result does not depend on how
often the rig is stepped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from meshpoint.kernels.jit import bare, inlined
from meshpoint.kernels.structures import Floats
from meshpoint.rig_sim.parts.disturbance import (
    LOAD_LAG,
    LOAD_NM,
    SAMPLE_US,
    WHEELS_SOURCE,
    lead_to_next,
    renew,
)
from meshpoint.rig_sim.shared.angle_kernels import TAU, wrapped
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.capture import capture
from meshpoint.rig_sim.truck.events import TORQUE_S, first_event, torques_turn
from meshpoint.rig_sim.truck.layout import Rig
from meshpoint.rig_sim.truck.motion import rates
from meshpoint.rig_sim.truck.step import step
from meshpoint.units import SECOND_US

FINE_GRID_US: Final = 250.0
QUIET_PA_S: Final = 1e4


@inlined
def _settle(rig: Rig) -> bool:
    """Wraps angles into one turn and phases into one pitch; watched phases are left unwrapped.
    Whether an angle was wrapped."""
    y = rig.y
    wraps = False
    for k in range(at.BODIES):
        if y.angle_rad[k] >= TAU:
            y.angle_rad[k] -= TAU
            rig.laps[k] += 1
            wraps = True
        elif y.angle_rad[k] < 0.0:
            y.angle_rad[k] += TAU
            rig.laps[k] -= 1
            wraps = True
    for gear in range(rig.p.dogs):
        before, pitch = y.phase_rad[gear], rig.p.pitch_rad[gear]
        if before >= 0.5 * pitch or before < -0.5 * pitch:
            y.phase_rad[gear] = wrapped(before, pitch)
            for i in range(at.WATCHES):
                watch = rig.watches[i]
                if watch.gear == gear:
                    watch.offset_rad += before - y.phase_rad[gear]
    return wraps


@inlined
def _next_grid_us(t_us: float, rig: Rig) -> float:
    """The next grid point (us). The grid is finer while air moves, because the pressure's rate has
    kinks, and for shafts that swing fast."""
    grid_us = rig.g.swing_us
    if abs(rig.stages[0].brake_pa) > QUIET_PA_S:
        grid_us = min(grid_us, FINE_GRID_US)
    return (math.floor(t_us / grid_us) + 1.0) * grid_us


@inlined
def _shake(t_us: float, rig: Rig) -> None:
    """At a sample of chance that has been reached: draws the next."""
    shaking, count = rig.shaking, math.floor(t_us / SAMPLE_US)
    if rig.p.disturbance.is_on != 0 and count > shaking.count:
        renew(shaking, int(count), rig.p.disturbance, rig.chance)
        for k in range(at.BODIES):
            lead_to_next(shaking, k, rig.y.speed_rad_s[k])
        lead_to_next(shaking, WHEELS_SOURCE, rig.y.wheels_rad_s)
        load = min(abs(rig.torques.link_nm[at.MAIN_BOX]) / LOAD_NM, 1.0)
        shaking.load += LOAD_LAG * (load - shaking.load)


@inlined
def _copy(source: Floats, target: Floats) -> None:
    for i in range(len(source)):
        target[i] = source[i]


@inlined
def _remember(t_us: float, rig: Rig) -> None:
    """Stores the layshaft's angle and speed every 2 ms for the reference encoder."""
    count = math.floor(t_us / at.HISTORY_STEP_US)
    if count * at.HISTORY_STEP_US == t_us:
        past = rig.history[int(count) % at.HISTORY]
        past.turns = rig.laps[at.LAYSHAFT]
        past.rest_rad = rig.y.angle_rad[at.LAYSHAFT]
        past.speed_rad_s = rig.y.speed_rad_s[at.LAYSHAFT]


@bare
def advance(rigs: Sequence[Rig], t_us: float, until_us: float, stop_us: float) -> tuple[float, int]:
    """Go on to the next event, to `stop_us`, or to the last grid point up to `until_us`.

    Everything is updated in place; returns the time reached and why it ended there.
    """
    rig = rigs[0]
    end_us, is_first = t_us, True
    while True:
        if not is_first:
            end_us = min(_next_grid_us(t_us, rig), stop_us)
            if end_us > until_us:
                return t_us, at.REACHED
        h = (end_us - t_us) / SECOND_US
        rig.shaking.since_s = (t_us - rig.shaking.count * SAMPLE_US) / SECOND_US
        rig.shaking.at_s = rig.shaking.since_s
        event = at.REACHED
        _copy(rig.y.vector, rig.after.vector)
        if h > 0.0:
            step(rig, h)
            event, s = first_event(h, rig)
            if event != at.REACHED:
                h = s
                end_us = t_us + s * SECOND_US
        rig.shaking.at_s = (end_us - rig.shaking.count * SAMPLE_US) / SECOND_US
        turned, s = torques_turn(h, rig)
        if turned != at.REACHED and (event == at.REACHED or s < h - 2.0 * TORQUE_S):
            event, h = turned, s
            end_us = t_us + s * SECOND_US
        if h > 0.0:
            capture(t_us, h, rig)
            _copy(rig.after.vector, rig.y.vector)
            if _settle(rig) and rig.p.disturbance.is_on != 0:
                # to the last bit what the next call would begin with: orders go by the angle
                rates(rig.y, rig.ahead, rig)
        _copy(rig.ahead.vector, rig.stages[0].vector)
        t_us = end_us
        _remember(t_us, rig)
        _shake(t_us, rig)
        if event != at.REACHED and event < at.MEETS_FLANK:
            return t_us, event
        if t_us == stop_us:
            return t_us, at.DUE
        is_first = False


@inlined
def _ignore(event: int, rig: Rig) -> None:
    """Where nobody acts on an event it would happen again at once: what rubs rubs no more, and a
    phase that has left its span is not watched."""
    if event >= at.NO_SLIP and event < at.NO_SLIP + at.CONTACTS:
        rig.contacts[event - at.NO_SLIP].sign = 0.0
    elif event >= at.LEFT_BOTTOM and event < at.LEFT_BOTTOM + at.WATCHES:
        rig.watches[event - at.LEFT_BOTTOM].gear = -1
    elif event >= at.LEFT_TOP and event < at.LEFT_TOP + at.WATCHES:
        rig.watches[event - at.LEFT_TOP].gear = -1


@bare
def advance_alone(rigs: Sequence[Rig], t_us: float, stop_us: float) -> tuple[float, bool]:
    """Goes on to `stop_us` with no action at events. The time reached (us): earlier where the
    layshaft has come to rest, and whether it has."""
    while t_us < stop_us:
        t_us, event = advance(rigs, t_us, math.inf, stop_us)
        if event == at.STOPPED:
            return t_us, True
        _ignore(event, rigs[0])
    return t_us, False


@bare
def sample(
    rigs: Sequence[Rig], t_us: float, gear: int, stops_us: Floats, found: Floats
) -> tuple[float, bool]:
    """Goes on alone through these instants. `found` (n, 3) gets layshaft speed, main shaft
    speed, and phase of the gear of this index, within half a pitch.

    Like repeated calls of `advance_alone`. Returns the time reached (us) and
    whether the layshaft has come to rest; the rows from there on are not written."""
    rig = rigs[0]
    y = rig.y
    for row in range(stops_us.shape[0]):
        t_us, rests = advance_alone(rigs, t_us, stops_us[row])
        if rests:
            return t_us, True
        found[row, 0], found[row, 1] = y.speed_rad_s[at.LAYSHAFT], y.speed_rad_s[at.MAIN]
        phase = y.phase_rad[gear] + y.lash_rad[gear]
        found[row, 2] = wrapped(phase, rig.p.pitch_rad[gear])
    return t_us, False
