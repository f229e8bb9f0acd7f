"""A sleeve in flight that is stopped short of the teeth: its valve off and the opposite one on in
one instant, that one off again after some 10 ms."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from meshpoint.controller.sleeve.answers import Halt
from meshpoint.controller.sleeve.cylinder import TO_REST, TO_TURN
from meshpoint.controller.sleeve.driven import DrivenSleeve, valve_towards
from meshpoint.controller.sleeve.motion import Switch
from meshpoint.controller.sleeve.stroke import to_contact
from meshpoint.kernels.records import Vector

STOPS_US: Final = 40_000
"""A sleeve that is stopped in flight stands within this time, or is not stopped."""
RESTS_US: Final = 400_000
LEAST_MARGIN_M: Final = 2e-4
SURE: Final = 2.5
"""A sleeve that is stopped stays short of the teeth with law and switches this many standard
deviations off to the bad side."""
LONGEST_PULSE_US: Final = 14_000
SHORTEST_PULSE_US: Final = 9_000
"""The step that aborts sends the pulse's beginning, the next one its end."""
PULSE_STEP_US: Final = 500
ALONE_SHARE: Final = 0.4
"""A sleeve that stops by itself within this share of its way to the teeth is not braked."""
NEARLY_M: Final = 1e-4
ABORT_STEP_US: Final = 250


def aborted(switches: list[Switch], direction: int, at_us: int, pulse_us: int) -> list[Switch]:
    """The switches of a sleeve on its way there that is stopped so."""
    kept = [one for one in switches if one.time_us < at_us]
    valve = valve_towards(direction)
    off = Switch(at_us, valve, False)
    if pulse_us == 0:
        return [*kept, off]
    pulse = Switch(at_us, 1 - valve, True), Switch(at_us + pulse_us, 1 - valve, False)
    return [*kept, off, *pulse]


def latest_abort_us(
    sleeve: DrivenSleeve, direction: int, fired: list[Switch], earliest_us: int, contact_us: int
) -> int | None:
    """The latest abort, no sooner than `earliest_us`, after which the sleeve stops short; by
    bisection: the later the abort, the further it gets."""
    if not stops(sleeve, direction, fired, earliest_us):
        return None
    early, late = earliest_us, max(contact_us, earliest_us + 1)
    while late - early > ABORT_STEP_US:
        middle = (early + late) // 2
        in_time = stops(sleeve, direction, fired, middle)
        early, late = (middle, late) if in_time else (early, middle)
    return early


def latest_from_neutral_us(sleeve: DrivenSleeve, direction: int) -> int | None:
    """The same of a sleeve that rests in neutral and is fired at 0."""
    fired = [Switch(0, valve_towards(direction), True)]
    contact_us = to_contact(sleeve, direction, fired).crossed_us or 0.0
    return latest_abort_us(sleeve, direction, fired, 0, int(contact_us))


def halted(sleeve: DrivenSleeve, direction: int, at_us: int) -> Halt:
    """How a sleeve on its way there is stopped from then on, and where it will stand."""
    fired = [one for one in sleeve.switches if one.time_us < at_us]
    alone_m = _expected_m(sleeve, direction, aborted(fired, direction, at_us, 0))
    is_near = alone_m < ALONE_SHARE * sleeve.law.face_m
    stops_by_itself = is_near and stops(sleeve, direction, fired, at_us, 0)
    pulse_us = 0 if stops_by_itself else SHORTEST_PULSE_US
    longest = aborted(fired, direction, at_us, LONGEST_PULSE_US)
    short_m = _expected_m(sleeve, direction, longest) + NEARLY_M
    while 0 < pulse_us < LONGEST_PULSE_US:
        if _expected_m(sleeve, direction, aborted(fired, direction, at_us, pulse_us)) <= short_m:
            break
        pulse_us += PULSE_STEP_US
    switches = aborted(fired, direction, at_us, pulse_us)
    way = sleeve.ahead(ending=TO_REST, until_us=at_us + RESTS_US, switches=switches)
    gets_m = partial(_gets_m, sleeve, direction, switches)
    sd_m = sleeve.sd(gets_m, switches, _expected_m(sleeve, direction, switches))
    return Halt(at_us, at_us + pulse_us, way.m, sd_m)


def stops(
    sleeve: DrivenSleeve,
    direction: int,
    fired: list[Switch],
    at_us: int,
    pulse_us: int = LONGEST_PULSE_US,
) -> bool:
    """Whether a sleeve that is aborted so stops short of the teeth by the margin."""
    switches = aborted(fired, direction, at_us, pulse_us)
    limit_m = sleeve.law.face_m - LEAST_MARGIN_M
    expected_m = _expected_m(sleeve, direction, switches)
    if expected_m > limit_m:
        return False
    gets_m = partial(_gets_m, sleeve, direction, switches)
    bad_side = sleeve.unknowns_at(SURE, gets_m, switches, expected_m)
    # Followed by the law, not extrapolated: once out of its detent a sleeve goes on to the teeth.
    return bool(gets_m(bad_side[np.newaxis])[0] <= limit_m)


def _expected_m(sleeve: DrivenSleeve, direction: int, switches: list[Switch]) -> float:
    """As far as it gets by these switches."""
    return float(_gets_m(sleeve, direction, switches, sleeve.unknowns(switches)[np.newaxis])[0])


def _gets_m(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector
) -> Vector:
    """The same for each row of unknowns."""
    found = sleeve.ways(
        unknowns,
        switches,
        ending=TO_TURN,
        until_us=switches[-1].time_us + STOPS_US,
        level_m=direction * sleeve.law.stroke_m,
        direction=float(direction),
    )
    return direction * found.of("furthest_m")
