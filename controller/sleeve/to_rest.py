"""The pulse of one valve that leaves a sleeve at rest in neutral."""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.sleeve.cylinder import PARAMETERS, TO_REST
from meshpoint.controller.sleeve.driven import DrivenSleeve, valve_towards
from meshpoint.controller.sleeve.motion import Switch
from meshpoint.controller.sleeve.stopping import RESTS_US
from meshpoint.units import SECOND_US

LONGEST_PULL_US: Final = 60_000
PULL_STEP_US: Final = 100
NEAR_NEUTRAL_M: Final = 1e-3
NEAR_TEETH_M: Final = 1e-3
LATE_SDS: Final = 4.2
"""A valve shuts by no more of its standard deviations later than expected."""


def rests_at_m(sleeve: DrivenSleeve, at_us: int, pulse: tuple[Switch, ...] = ()) -> float:
    """Where it comes to rest by its switches until then and by this pulse."""
    switches = [one for one in sleeve.switches if one.time_us <= at_us]
    return sleeve.ahead(ending=TO_REST, until_us=at_us + RESTS_US, switches=[*switches, *pulse]).m


def may_be_thrown(sleeve: DrivenSleeve, direction: int) -> bool:
    """Whether a sleeve on its way out of a gear's teeth may come near the opposite ones, where the
    valve that pulled it shuts as late as it may by what is seen."""
    valve = valve_towards(direction)
    off = [one for one in sleeve.switches if one.valve == valve and not one.on]
    is_pulled = abs(sleeve.start.state[0]) > sleeve.law.face_m
    if not off or not is_pulled:
        return False
    unknowns = sleeve.unknowns(sleeve.switches)
    unknowns[PARAMETERS + sleeve.switches.index(off[-1])] += LATE_SDS * sleeve.sd_of(off[-1])
    level_m = direction * (sleeve.law.face_m - NEAR_TEETH_M)
    way = sleeve.to_level(direction, level_m, off[-1].time_us + RESTS_US, unknowns)
    return way.crossed_us is not None


def pulse_of(direction: int, on_us: int, length_us: int) -> tuple[Switch, Switch]:
    """The valve that pushes there on, and off again."""
    valve = valve_towards(direction)
    return Switch(on_us, valve, True), Switch(on_us + length_us, valve, False)


def pulse_to_neutral_us(sleeve: DrivenSleeve, direction: int, on_us: int, sure_sds: float) -> int:
    """How long the valve that pushes there has to be on.

    Between the shortest pulse that gets there and the longest that does not go beyond, in the
    middle: the detent makes good for what the law does not know. The longest is not passed either
    where the valve makes the pulse this many standard deviations longer: one that falls short costs
    another push, one that throws the sleeve through may send it against turning teeth."""
    ends_us = []
    for level_m in (-NEAR_NEUTRAL_M, NEAR_NEUTRAL_M):
        short_us, long_us = 0, LONGEST_PULL_US
        while long_us - short_us > PULL_STEP_US:
            middle_us = (short_us + long_us) // 2
            m = rests_at_m(sleeve, on_us, pulse_of(direction, on_us, middle_us))
            is_beyond = direction * m > level_m
            short_us, long_us = (short_us, middle_us) if is_beyond else (middle_us, long_us)
        ends_us.append(short_us)
    shortest_us, longest_us = ends_us
    longer_s = math.hypot(*map(sleeve.sd_of, pulse_of(direction, on_us, longest_us)))
    sure_us = longest_us - int(sure_sds * longer_s * SECOND_US)
    return max(shortest_us, min((shortest_us + longest_us) // 2, sure_us))
