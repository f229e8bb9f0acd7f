"""A brake whose valve sticks while it is on: no gear is engaged against it."""

from __future__ import annotations

import pytest
from loop_bench import Loop

from meshpoint.dbc.messages import ControllerState, RigFault, ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset

TRUCK12 = load_sheet("truck12")
BRAKE = 0


@pytest.mark.parametrize(("after_ms", "seed"), [(0, 3), (30, 4), (60, 5)])
def test_a_brake_that_does_not_let_go_ends_the_shift_in_neutral(after_ms: int, seed: int) -> None:
    """By when it was to be rid of its pressure a sleeve that would be fired is not, and one that
    has not moved yet is recalled: it would lock two shafts with the brake on."""
    loop = Loop(requests=[(1_000_000, 10)], sheet=TRUCK12, preset=Preset.TRUCK, seed=seed)
    loop.run_to_state(ControllerState.SYNCHRONISING, 3_000_000)
    loop.run(loop.time.now_us + 1_000 * after_ms)
    loop.fault(RigFault.VALVE_STUCK, BRAKE)
    assert loop.until(lambda: bool(loop.outcomes), 12_000_000)
    (outcome,) = loop.outcomes
    assert outcome.result is ShiftResult.ENDED_IN_NEUTRAL
    assert loop.violations == 0
