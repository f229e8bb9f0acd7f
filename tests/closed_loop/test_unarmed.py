"""A controller whose outputs are not armed reads, estimates and logs, and moves nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from loop_bench import Loop

from meshpoint.controller.core.core import UNARMED
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    TSC1,
    ClutchCommand,
    ControllerEstimates,
    ControllerState,
    FaultCode,
    ShiftOutcome,
    ShiftResult,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Verification


@pytest.fixture(scope="module")
def unarmed() -> Loop:
    """Asked for two gears: one it could shift to, one it could not."""
    return Loop([(300_000, 10), (900_000, 15)], armed=False).run(1_500_000)


def drives(command: ValveCommand) -> bool:
    actions = [v for name, v in command._asdict().items() if name.endswith("_action")]
    return any(action is not ValveAction.OFF_NOW for action in actions)


def test_it_drives_no_valve_and_commands_neither_clutch_nor_engine(unarmed: Loop) -> None:
    commands = unarmed.of(ValveCommand)
    assert len(commands) > 100
    assert not any(drives(command) for command in commands)
    assert unarmed.of(ClutchCommand) == []
    assert unarmed.of(TSC1) == []
    energised = [
        name
        for status in unarmed.of(ValveStatus)
        for name, value in status._asdict().items()
        if value and name.endswith(("_energised", "_pending"))
    ]
    assert energised == []


def test_it_estimates_and_reports_as_ever(unarmed: Loop) -> None:
    assert unarmed.status.state is ControllerState.IN_GEAR
    estimates = unarmed.of(ControllerEstimates)[-1]
    assert estimates.layshaft_valid
    assert estimates.layshaft_speed_rad_s > 50.0


def test_it_says_so_once_and_refuses_a_request_with_an_outcome(unarmed: Loop) -> None:
    assert sum(UNARMED in line for line in unarmed.events) == 1
    possible, impossible = unarmed.of(ShiftOutcome)
    assert (possible.from_gear, possible.to_gear) == (8, 10)
    assert possible.result is impossible.result is ShiftResult.REFUSED
    assert possible.fault is FaultCode.GUARD_BLOCKED
    assert impossible.fault is FaultCode.REQUEST_IMPOSSIBLE
    assert any("not armed (--arm)" in line and "gear 10" in line for line in unarmed.events)


def test_an_armed_controller_says_nothing_of_it(one_shift: Loop) -> None:
    assert not any("armed" in line for line in one_shift.events)
    assert any(drives(command) for command in one_shift.of(ValveCommand))


def test_the_guard_alone_holds_a_sequence_that_drives_all_the_same() -> None:
    loop = Loop([(300_000, 10)], armed=False)
    core = loop.controller.core
    core.sequence.armed = True
    loop.run(1_500_000)
    assert loop.status.guard_blocks >= loop.settings.limits.attempts, "each pull"
    assert any("guard blocked a valve command: row 12" in line for line in loop.events)
    assert not any(drives(command) for command in loop.of(ValveCommand))
    assert loop.of(ClutchCommand) == []


def test_its_log_is_verified_like_any_other_by_its_header(unarmed: Loop, tmp_path: Path) -> None:
    frames = [frame for _, frame in unarmed.frames]
    unarmed.header.save(tmp_path)
    (session,) = LogReplay(tmp_path, verify=True).run(frames)
    assert session.verdict is Verification.IDENTICAL, str(session)
    assert session.steps > 100
    assert Loop([], armed=True).header.run_hash != unarmed.header.run_hash


def test_its_last_frame_is_all_valves_off_and_nothing_else(unarmed: Loop) -> None:
    step = unarmed.controller.core.shutdown(2_000_000)
    received = [Receiver(*Node).receive(frame).message for frame in step.frames]
    assert received == [ValveCommand()]
