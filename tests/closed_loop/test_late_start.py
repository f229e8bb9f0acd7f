"""A controller whose first steps came late, as on a busy machine, and took the sensor clock to be
further behind than it is: it hears that an activation was refused, looks at the clock anew, and
sends the next ones earlier."""

from __future__ import annotations

import pytest
from loop_bench import Loop

from meshpoint.controller.measure.clock import KEPT_US, MOST_TICKS, RefusedLead
from meshpoint.dbc.messages import (
    ControllerState,
    ControllerStatus,
    GearboxSensors,
    ShiftResult,
    ValveStatus,
)
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

REQUEST_US = 60_000
LOST_US = 500_000
"""As if the clock had just been looked at then: a second later it would be again."""


def shifted(measurements_anew: bool) -> Loop:
    """A shift whose controller looks at the clock when the tick comes, and not before."""
    loop = Loop(requests=[(REQUEST_US, 10)], phases_us=(0, 3_000, 5_000))
    core = loop.core
    core._probe.is_armed, core._probe._probed_us = False, LOST_US
    if not measurements_anew:
        core._probe.plan = lambda now_us, switch_us: None  # type: ignore[method-assign]
    assert loop.until(lambda: bool(loop.outcomes), 4_000_000)
    return loop


@pytest.mark.parametrize("measurements_anew", [True, False])
def test_after_one_refusal_the_shift_goes_on(measurements_anew: bool) -> None:
    loop = shifted(measurements_anew)
    (outcome,) = loop.outcomes
    assert outcome.result is ShiftResult.ENGAGED
    assert loop.last(ValveStatus).refused_count == 1
    assert loop.time.now_us < 1_000_000, "each of its activations was refused, one after another"


def test_more_lead_is_kept_for_a_while_and_given_up_again() -> None:
    lead, status = RefusedLead(10_000), ValveStatus()
    assert not lead.take(status, 0)
    assert lead.take(status._replace(refused_count=1), 1)
    assert not lead.take(status._replace(refused_count=1), KEPT_US)
    assert lead.more_us == 10_000
    for count in range(2, 9):
        lead.take(status._replace(refused_count=count), KEPT_US)
    assert lead.more_us == MOST_TICKS * 10_000
    assert not lead.take(None, 2 * KEPT_US + 1)
    assert lead.more_us == 0


def is_closed(loop: Loop) -> bool:
    sensors = loop.last(GearboxSensors)
    return loop.time.now_us > 2_100_000 and sensors.clutch_position_fraction > 0.97


def test_a_clutch_that_may_not_close_on_an_idling_engine_closes_once_it_has_been_raised() -> None:
    """The rig has run alone for two seconds, its clutch open and its engine at idle: closing would
    slip by more than the guard lets it, so the engine is asked for the gear's speed first."""
    loop = Loop(
        sheet=load_sheet("truck12"),
        preset=Preset.TRUCK,
        profile=Profile.TYPICAL,
        phases_us=(2_000_000, 189, 5_513),
    )
    assert loop.until(lambda: is_closed(loop), 5_000_000)
    assert [line for line in loop.events if "guard keeps the clutch open: row 15" in line] == [
        "2000000 controller: guard keeps the clutch open: row 15"
    ]
    assert loop.seen(ControllerStatus, state=ControllerState.IN_GEAR)
    loop.until(lambda: False, loop.time.now_us + 500_000)
    assert loop.core.sequence.engine_rad_s is None, "the engine is the driver's again"
