"""The pulse of one valve that leaves a sleeve at rest in neutral."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from meshpoint.controller.sleeve.cylinder import TO_REST
from meshpoint.controller.sleeve.driven import DrivenSleeve, valve_towards
from meshpoint.controller.sleeve.motion import Switch
from meshpoint.controller.sleeve.stopping import RESTS_US, SURE
from meshpoint.kernels.records import Vector

LONGEST_PULL_US: Final = 60_000
PULL_STEP_US: Final = 100
NEAR_NEUTRAL_M: Final = 1e-3
BAD_AT: Final = (0.6, 0.8, 1.0)
"""Shares of a pulse's length at which the bad side is looked for: where its detent holds a sleeve,
or friction does not let it go yet, nothing changes how far it gets."""


def rests_at_m(sleeve: DrivenSleeve, at_us: int, pulse: tuple[Switch, ...] = ()) -> float:
    """Where it comes to rest by its switches until then and by this pulse."""
    switches = [one for one in sleeve.switches if one.time_us <= at_us]
    return sleeve.ahead(ending=TO_REST, until_us=at_us + RESTS_US, switches=[*switches, *pulse]).m


def pulse_of(direction: int, on_us: int, length_us: int) -> tuple[Switch, Switch]:
    """The valve that pushes there on, and off again."""
    valve = valve_towards(direction)
    return Switch(on_us, valve, True), Switch(on_us + length_us, valve, False)


def pulse_to_neutral_us(sleeve: DrivenSleeve, direction: int, on_us: int) -> int:
    """How long the valve that pushes there has to be on, as expected: in the middle between the
    shortest pulse that gets there and the longest that does not go beyond. The detent makes good
    for what the law does not know."""
    ends_us = []
    for level_m in (-NEAR_NEUTRAL_M, NEAR_NEUTRAL_M):

        def is_short(long_us: int, level_m: float = level_m) -> bool:
            pulse = pulse_of(direction, on_us, long_us)
            return direction * rests_at_m(sleeve, on_us, pulse) <= level_m

        ends_us.append(_longest_us(is_short, LONGEST_PULL_US))
    return (ends_us[0] + ends_us[1]) // 2


def sure_pulse_us(sleeve: DrivenSleeve, direction: int, on_us: int, most_us: int) -> int:
    """The longest pulse, up to `most_us`, that leaves a sleeve short of the teeth beyond neutral
    with law and switches SURE standard deviations off to the bad side: one that falls short costs
    another push, one thrown through meets a gear that may turn at any speed."""
    before = [one for one in sleeve.switches if one.time_us <= on_us]

    def gets_m(unknowns: Vector, long_us: int) -> Vector:
        return _gets_m(sleeve, direction, [*before, *pulse_of(direction, on_us, long_us)], unknowns)

    bad_sides = []
    for share in BAD_AT:
        long_us = int(share * most_us)
        figure, switches = (
            partial(gets_m, long_us=long_us),
            [*before, *pulse_of(direction, on_us, long_us)],
        )
        expected_m = float(figure(sleeve.unknowns(switches)[np.newaxis])[0])
        bad_sides.append(sleeve.unknowns_at(SURE, figure, switches, expected_m))
    unknowns = np.array(bad_sides)

    def is_short(long_us: int) -> bool:
        return bool(np.max(gets_m(unknowns, long_us)) < sleeve.law.face_m)

    return most_us if is_short(most_us) else _longest_us(is_short, most_us)


def _longest_us(is_short: Callable[[int], bool], most_us: int) -> int:
    """The longest pulse for which this still holds, by bisection."""
    short_us, long_us = 0, most_us
    while long_us - short_us > PULL_STEP_US:
        middle_us = (short_us + long_us) // 2
        short_us, long_us = (middle_us, long_us) if is_short(middle_us) else (short_us, middle_us)
    return short_us


def _gets_m(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector
) -> Vector:
    """How far it gets that way until it rests, for each row of unknowns."""
    found = sleeve.ways(
        unknowns,
        switches,
        ending=TO_REST,
        until_us=switches[-1].time_us + RESTS_US,
        level_m=direction * sleeve.law.stroke_m,
        direction=float(direction),
    )
    return direction * found.of("furthest_m")
