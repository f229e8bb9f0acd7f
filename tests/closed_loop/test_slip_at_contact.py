"""A sleeve that is thrown through neutral onto the opposite gear: rig, shift and row say so."""

from __future__ import annotations

import pytest
from drawn_shift import judged_shift
from loop_bench import Loop

from meshpoint.dbc.messages import FaultCode, RigFault, ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.results.rows import RowCollector, ShiftRow
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.rig_sim.shared.engagement import Violation
from meshpoint.rig_sim.shared.valve_drivers import Valve

TRUCK12 = load_sheet("truck12")
REQUEST_US = 300_000
PATIENCE_US = 6_000_000


def shifted(late_ms: float) -> Loop:
    """6 to 8, the valve that pulls third out slow to shut."""
    loop = Loop(
        [(REQUEST_US, 8)], sheet=TRUCK12, preset=Preset.TRUCK, start_gear=6, toward=8, seed=3
    )
    loop.run(REQUEST_US)
    if late_ms:
        loop.fault(RigFault.VALVE_SLOW_OFF, Valve.MAIN_CRAWL, late_ms, 800_000)
    assert loop.until(lambda: bool(loop.outcomes), PATIENCE_US)
    return loop


def row_of(loop: Loop) -> ShiftRow:
    """What a table has of the only shift."""
    rows = RowCollector(TRUCK12)
    for _, message in loop.messages:
        rows.take(message)
    (row,) = rows.rows
    return row


def test_a_sleeve_thrown_onto_the_opposite_gear_is_said_by_rig_shift_and_row() -> None:
    loop = shifted(30.0)
    outcome, row = loop.outcomes[0], row_of(loop)
    assert loop.rig_core.truth.violations == {Violation.SLIP_AT_CONTACT: 1}
    assert (outcome.result, outcome.fault) == (ShiftResult.ENGAGED, FaultCode.SLIP_AT_CONTACT)
    assert (row.fault, row.outside_window) == ("slip_at_contact", 1)


def test_a_shift_without_a_fault_meets_no_gear_outside_the_window() -> None:
    loop = shifted(0.0)
    assert loop.violations == 0
    assert loop.outcomes[0].fault is FaultCode.NONE
    assert row_of(loop).outside_window == 0


@pytest.mark.long
@pytest.mark.parametrize(("gearbox", "judged"), [(917_000_028, 13), (917_000_095, 1)])
def test_a_pull_whose_valve_comes_early_and_shuts_late_meets_no_other_gear(
    gearbox: int, judged: int
) -> None:
    """By 6 and 8 ms together. Red before: 9 to 11, first gear met at -289 and -286 rpm."""
    row = judged_shift(gearbox, Profile.HARSH, judged, 16)
    assert (row.from_, row.to) == (9, 11)
    assert (row.result, row.fault, row.outside_window) == ("engaged", "none", 0)
