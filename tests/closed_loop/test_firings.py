"""How often and how far ahead a sleeve is fired, as the bus and the valves' coils show it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest
from loop_bench import Loop
from test_refused_firing import HeldUp

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import (
    FaultCode,
    RigFault,
    ShiftOutcome,
    ShiftResult,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.core import RigCore
from meshpoint.rig_sim.settings import Preset

CRAWL_AND_THIRD = 1
"""The sleeve that has to engage from gear 8 to 12, and has nothing to pull out."""
LONG_US = 8_000_000
WRAP = 1 << 32
FRAMES_US = 2_000
"""The frames of a read and of the command that it leads to are through in so long, together."""


def limited(**limits: int) -> ControllerSettings:
    settings = ControllerSettings()
    return replace(settings, limits=replace(settings.limits, **limits))


@pytest.mark.parametrize("attempts", [1, 2])
def test_a_sleeve_that_never_engages_is_fired_as_often_as_its_attempts_and_no_more(
    attempts: int,
) -> None:
    """Counted at the valve's coil, and reported in the outcome. All valves are off then."""
    loop = Loop(
        [(300_000, 12)],
        settings=limited(attempts=attempts),
        sheet=load_sheet("truck12"),
        preset=Preset.TRUCK,
        toward=12,
    )
    loop.run(50_000)
    loop.fault(RigFault.SLEEVE_JAMMED, CRAWL_AND_THIRD)
    assert loop.until(lambda: loop.last(ShiftOutcome) is not None, LONG_US), "\n".join(loop.events)
    loop.run(loop.time.now_us + 100_000)
    driven = [bool(status.main_third_energised) for status in loop.of(ValveStatus)]
    assert sum(after and not before for before, after in pairwise(driven)) == attempts
    (outcome,) = loop.outcomes
    assert outcome.attempts == attempts
    assert (outcome.result, outcome.fault) == (
        ShiftResult.ENDED_IN_NEUTRAL,
        FaultCode.ENGAGE_FAILED,
    )
    assert loop.valves_driven == ()


def leads_us(loop: Loop) -> Iterator[int]:
    """How far ahead each activation of the sleeve into gear 10 was when the bus first had it."""
    core = loop.rig.core
    assert isinstance(core, RigCore)
    start_us, reported = core.truth.clock_start_us - loop.phases_us[1], set[int]()
    for time_us, message in loop.messages:
        if type(message) is ValveCommand and message.main_second_action is ValveAction.ON_AT:
            at_us = message.main_second_time_us
            if at_us not in reported:
                reported.add(at_us)
                yield (at_us - start_us - time_us + WRAP // 2) % WRAP - WRAP // 2


@pytest.mark.parametrize("lead_ms", [4, 7])
def test_after_a_refusal_activations_are_sent_a_tick_earlier(lead_ms: int) -> None:
    """A sleeve whose gear's phase is not known is fired as soon as may be: `timing.lead_ms` ahead;
    10 ms more once the valve side has refused one that came too late."""
    settings = ControllerSettings()
    settings = replace(settings, timing=replace(settings.timing, lead_ms=lead_ms))
    loop = Loop([(300_000, 10)], settings=settings)
    loop.rig.receiving = HeldUp(loop)
    loop.until(lambda: loop.last(ShiftOutcome) is not None, LONG_US)
    assert loop.last(ShiftOutcome).result is ShiftResult.ENGAGED, "\n".join(loop.events)
    *_, first_us, second_us = leads_us(loop)  # those before pull the old gear out
    assert 0 <= 1_000 * lead_ms - first_us < FRAMES_US
    assert 0 <= 1_000 * lead_ms + 10_000 - second_us < FRAMES_US
