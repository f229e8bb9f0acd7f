"""The truck plant's inner loop: fixed steps cut at events, and the edges found in each step.

Steps go from fixed instant to fixed instant. A step is cut only at scheduled instants and at events
found in it, never by how far the caller wants to go: so what happens does not depend on how often
anybody asks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from meshpoint.rig_sim.jit import SOURCES, entry, inlined
from meshpoint.rig_sim.shared.angle_kernels import TAU, Floats, Integers, wrapped
from meshpoint.rig_sim.truck.capture import capture
from meshpoint.rig_sim.truck.events import TORQUE_S, WATCHES, first_event, torques_turn
from meshpoint.rig_sim.truck.layout import (
    ANGLE,
    BODIES,
    BRAKE_PA,
    DUE,
    GEAR,
    HISTORY,
    HISTORY_US,
    LASH,
    LAYSHAFT,
    MAIN,
    OFFSET,
    PHASE,
    REACHED,
    SPEED,
    STATES,
    STEP_US,
    STIFF_NM_RAD,
    STOPPED,
)
from meshpoint.rig_sim.truck.step import step

SECOND_US: Final = 1e6
FINE_US: Final = 250.0
QUIET_PA_S: Final = 1e4


@inlined
def _settle(y: Floats, laps: Integers, pitch: float, watches: Floats) -> None:
    """Angles back into a turn and free phases into a pitch; a watched phase keeps its branch."""
    for k in range(BODIES):
        if y[ANGLE + k] >= TAU:
            y[ANGLE + k] -= TAU
            laps[k] += 1
        elif y[ANGLE + k] < 0.0:
            y[ANGLE + k] += TAU
            laps[k] -= 1
    for gear in range(4):
        before = y[PHASE + gear]
        if before >= 0.5 * pitch or before < -0.5 * pitch:
            y[PHASE + gear] = wrapped(before, pitch)
            for watch in range(WATCHES):
                if int(watches[watch, GEAR]) == gear:
                    watches[watch, OFFSET] += before - y[PHASE + gear]


@inlined
def _next_grid_us(t_us: float, p: Floats, rate: Floats) -> float:
    """The next grid point; a finer grid while air moves, as filling and exhausting have kinks, and
    for shafts that twist, which swing fast."""
    grid_us: float = p[STEP_US]
    if abs(rate[BRAKE_PA]) > QUIET_PA_S or p[STIFF_NM_RAD] > 0.0:
        grid_us = min(grid_us, FINE_US)
    return (math.floor(t_us / grid_us) + 1.0) * grid_us


@inlined
def _copy(source: Floats, target: Floats) -> None:
    for i in range(STATES):
        target[i] = source[i]


@inlined
def _remember(t_us: float, y: Floats, laps: Integers, history: Floats) -> None:
    """The layshaft's angle and speed, every 2 ms, for the reference encoder."""
    count = math.floor(t_us / HISTORY_US)
    if count * HISTORY_US == t_us:
        row = int(count) % HISTORY
        history[row, 0] = laps[LAYSHAFT]
        history[row, 1] = y[ANGLE + LAYSHAFT]
        history[row, 2] = y[SPEED + LAYSHAFT]


def _make_advance(sources: int) -> Callable[..., tuple[float, int]]:
    def advance(
        t_us: float,
        until_us: float,
        stop_us: float,
        pitch: float,
        y: Floats,
        laps: Integers,
        p: Floats,
        g: Floats,
        slots: Floats,
        watches: Floats,
        scratch: Floats,
        history: Floats,
        teeth: Integers,
        table: Floats,
        first: Floats,
        jitter_s: Floats,
        pointers: Integers,
        faults: Integers,
        ring: Floats,
    ) -> tuple[float, int]:
        """Go on to the next event, to `stop_us`, or to the last grid point up to `until_us`.

        Everything is updated in place; returns the time reached and why it ended there. scratch is
        (7, STATES): rates, three stages, the state after the step, torques, the rates there.
        """
        _ = sources
        k, after, aux, ahead = scratch[:4], scratch[4], scratch[5], scratch[6]
        end_us, is_first = t_us, True
        while True:
            if not is_first:
                end_us = min(_next_grid_us(t_us, p, k[0]), stop_us)
                if end_us > until_us:
                    return t_us, REACHED
            h = (end_us - t_us) / SECOND_US
            event = REACHED
            _copy(y, after)
            if h > 0.0:
                step(y, after, h, p, g, slots, k, aux)
                event, s = first_event(y, after, h, p, g, slots, watches, k, aux)
                if event != REACHED:
                    h = s
                    end_us = t_us + s * SECOND_US
            turned, s = torques_turn(y, after, h, p, g, slots, k, ahead, aux)
            if turned != REACHED and (event == REACHED or s < h - 2.0 * TORQUE_S):
                event, h = turned, s
                end_us = t_us + s * SECOND_US
            if h > 0.0:
                capture(
                    y, after, laps, t_us, h, teeth, table, first, jitter_s, pointers, faults, ring
                )
                _copy(after, y)
                _settle(y, laps, pitch, watches)
            _copy(ahead, k[0])
            t_us = end_us
            _remember(t_us, y, laps, history)
            if event != REACHED:
                return t_us, event
            if t_us == stop_us:
                return t_us, DUE
            is_first = False

    return entry(advance)


advance = _make_advance(SOURCES)


def _make_sample(sources: int) -> Callable[..., tuple[float, bool]]:
    def sample(
        t_us: float,
        every_us: float,
        start_us: float,
        number: int,
        gear: int,
        found: Floats,
        pitch: float,
        y: Floats,
        laps: Integers,
        p: Floats,
        g: Floats,
        slots: Floats,
        watches: Floats,
        scratch: Floats,
        history: Floats,
        teeth: Integers,
        table: Floats,
        first: Floats,
        jitter_s: Floats,
        pointers: Integers,
        faults: Integers,
        ring: Floats,
    ) -> tuple[float, bool]:
        """Goes on alone for as many samples as `found` (n, 3) has rows, each `every_us` since
        `start_us`, from this number on: layshaft speed, main shaft speed, and phase of the gear of
        this index, within half a pitch.

        As `advance`, again and again, where nothing is done at events. Returns the time reached and
        whether the shafts have come to rest; the rows from there on stay as they were."""
        _ = sources
        for row in range(found.shape[0]):
            stop_us = start_us + every_us * (number + row)
            while t_us < stop_us:
                t_us, event = advance(
                    t_us, math.inf, stop_us, pitch, y, laps, p, g, slots, watches, scratch,
                    history, teeth, table, first, jitter_s, pointers, faults, ring,
                )  # fmt: skip
                if event == STOPPED:
                    return t_us, True
            found[row, 0], found[row, 1] = y[SPEED + LAYSHAFT], y[SPEED + MAIN]
            found[row, 2] = wrapped(y[PHASE + gear] + y[LASH + 1 + gear], pitch)
        return t_us, False

    return entry(sample)


sample = _make_sample(SOURCES)
