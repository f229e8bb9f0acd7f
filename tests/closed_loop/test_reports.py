"""What every step says on the bus of gears, slip and phase, of itself and of the step before."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from loop_bench import SHEET, Loop

from meshpoint.controller.core.reporter import ETC2_CYCLE_US
from meshpoint.controller.settings.settings import ControllerSettings, Timing
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    ETC1,
    ETC2,
    ControllerEstimates,
    ControllerState,
    ControllerStatus,
    J1939Measured,
    ShiftOutcome,
    ShiftPrediction,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox.gears import DRIVE_GEARS

AT_REST = (ControllerState.STARTING, ControllerState.IN_GEAR, ControllerState.NEUTRAL)
REPORTS = (ETC1, ETC2, ControllerEstimates, ShiftPrediction, ShiftOutcome)


def steps_of(loop: Loop) -> list[dict[type, Any]]:
    """What was said in each step, by kind; its status closes a step."""
    steps: list[dict[type, Any]] = [{}]
    for _, message in loop.messages:
        if type(message) in REPORTS:
            steps[-1][type(message)] = message
        elif type(message) is ControllerStatus:
            steps[-1][ControllerStatus] = message
            steps.append({})
    return steps[:-1]


def test_before_any_edge_has_come_neither_shaft_slip_nor_phase_is_reported(
    one_shift: Loop,
) -> None:
    first = steps_of(one_shift)[0]
    etc1, estimates = first[ETC1], first[ControllerEstimates]
    assert (etc1.output_shaft_speed_rad_s, etc1.input_shaft_speed_rad_s) == (None, None)
    assert (estimates.slip_rad_s, estimates.phase_known) == (0.0, False)
    assert first[ETC2].current_gear is None


def test_the_truck_reads_the_gear_that_is_in_and_the_one_asked_for(one_shift: Loop) -> None:
    """Between two gears none is in."""
    seen, shifting = set(), 0
    for step in steps_of(one_shift):
        status, etc1 = step[ControllerStatus], step[ETC1]
        under_way = status.state not in AT_REST
        assert (etc1.shift_in_process is J1939Measured.YES) is under_way
        in_gear = status.state is ControllerState.IN_GEAR
        assert (etc1.driveline_engaged is J1939Measured.YES) is in_gear
        if under_way and ShiftOutcome not in step:
            shifting += 1
            assert status.target_gear == 10
        if status.current_gear <= 0:
            assert etc1.output_shaft_speed_rad_s is None
        if (etc2 := step.get(ETC2)) is not None:
            gear = status.current_gear
            assert etc2.selected_gear == status.target_gear
            assert etc2.current_gear == (gear if gear >= 0 else None)
            if gear > 0:
                ratio = SHEET.overall_ratio(DRIVE_GEARS[gear])
                assert etc2.actual_ratio == pytest.approx(ratio, abs=1e-3)
            else:
                assert etc2.actual_ratio is None
            seen.add((etc2.selected_gear, etc2.current_gear))
    assert shifting > 20
    assert {(8, 8), (10, 8), (10, 0), (10, 10)} <= seen


@pytest.mark.parametrize("gear", [3, 8])
def test_in_gear_both_ends_of_the_gearbox_turn_as_the_gear_has_it(gear: int) -> None:
    """In either range and either splitter step."""
    etc1 = Loop(start_gear=gear).run(1_000_000).last(ETC1)
    turned = SHEET.overall_ratio(DRIVE_GEARS[gear]) * etc1.output_shaft_speed_rad_s
    assert etc1.input_shaft_speed_rad_s == pytest.approx(turned, rel=0.01)


def test_a_step_tells_its_own_number_and_the_time_and_count_of_the_one_before(
    one_shift: Loop,
) -> None:
    steps = steps_of(one_shift)
    assert [step[ControllerStatus].step_number for step in steps] == list(range(len(steps)))
    for before, after in pairwise(step[ControllerStatus] for step in steps):
        assert after.previous_step_time_us == before.step_time_us
        assert after.previous_consumed_count == before.consumed_count
        assert after.previous_consumed_crc == before.consumed_crc
    assert sum(ShiftPrediction in step for step in steps) > 10


@pytest.mark.parametrize(("tick_ms", "every"), [(5, 20), (10, 10), (20, 5)])
def test_the_truck_is_told_the_gear_each_tenth_of_a_second(tick_ms: int, every: int) -> None:
    """Red before at 5 ms, where it was told twice as often, and at 20."""
    steps = steps_of(Loop(settings=ControllerSettings(timing=Timing(tick_ms=tick_ms))).run(600_000))
    assert every * tick_ms * 1_000 == ETC2_CYCLE_US
    assert [ETC2 in step for step in steps] == [k % every == 0 for k in range(len(steps))]


def test_a_step_is_as_late_as_can_be_said() -> None:
    loop = Loop().run(50_000)
    late, receiver = loop.core.step(loop.core.next_step_us + 90_000), Receiver(*Node)
    status = [receiver.receive(frame).message for frame in late.frames][-1]
    assert status.step_lateness_us == 65_535


def test_the_next_step_after_a_change_of_settings_has_their_run_hash() -> None:
    loop = Loop().run(50_000)
    before = loop.header.run_hash
    loop.core.change_settings(ControllerSettings(strategy_name="speed_window"))
    loop.run(80_000)
    reported = loop.status.run_hash_high << 32 | loop.status.run_hash_low
    assert reported == loop.core.header.run_hash != before
