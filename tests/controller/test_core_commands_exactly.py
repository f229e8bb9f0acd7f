"""What the core says of its decisions, and what it sends past its guards."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from test_core_parts_exactly import T0, a_core, sent

from meshpoint.controller.settings import ControllerSettings, Timing
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import is_intact
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    TSC1,
    ClutchAction,
    ClutchCommand,
    ControllerState,
    ControllerStatus,
    FaultCode,
    ShiftDecision,
    ShiftResult,
    TscOverrideMode,
)
from meshpoint.units import RPM


class Scripted:
    """A shift sequence that does as it is told."""

    def __init__(self) -> None:
        self.state = ControllerState.NEUTRAL
        self.then = self.state
        self.refusal: str | None = None
        self.strategy_error: str | None = None
        self.finished: Any = None
        self.decision: Any = None
        self.asked: list[int] = []
        self.steps = 0
        self.blocks: list[tuple[int, Any]] = []
        self.engine_rad_s: float | None = None
        self.engine_share: float | None = None
        self.clutch = ClutchAction.CLOSE
        self.shift: object = None

    def request(self, number: int, _snapshot: Any) -> str | None:
        self.asked.append(number)
        return self.refusal

    def step(self, _snapshot: Any) -> None:
        self.steps += 1
        self.state = self.then

    def blocked(self, row: int, snapshot: Any) -> None:
        self.blocks.append((row, snapshot))


SNAPSHOT: Any = SimpleNamespace(now_us=1_000_000)


def decided(script: Scripted, requested: int | None = None, core: Any = None) -> list[str]:
    core = core or a_core()
    core._sequence = script
    events: list[str] = []
    core._decide(requested, SNAPSHOT, events)
    return events


def test_a_request_that_is_refused_is_said_and_nothing_else_is_done() -> None:
    script = Scripted()
    script.refusal = "no such gear"
    assert decided(script, 7) == ["no such gear"]
    assert (script.asked, script.steps) == ([7], 0)
    script.refusal = None
    assert decided(script, 0) == []
    assert (script.asked, script.steps) == ([7, 0], 1)
    assert decided(script) == []
    assert (script.asked, script.steps) == ([7, 0], 2)


def test_a_change_of_state_and_the_end_of_a_shift_are_said_and_counted() -> None:
    core, script = a_core(), Scripted()
    script.then = ControllerState.CLUTCH_OPENING
    assert decided(script, core=core) == ["neutral -> clutch_opening"]
    assert core.shifts == 0
    script.then, script.finished = ControllerState.NEUTRAL, SimpleNamespace(
        from_number=3, to_number=4, result=ShiftResult.ENGAGED, attempts=2, fault=FaultCode.NONE
    )  # fmt: skip
    assert decided(script, core=core) == [
        "clutch_opening -> neutral",
        "shift 3 -> 4: engaged, 2 fired, fault none",
    ]
    assert core.shifts == 1
    assert decided(script, core=core) == ["shift 3 -> 4: engaged, 2 fired, fault none"]
    assert core.shifts == 2
    assert core.knows == (2, 0)
    assert core.running_shift is script.finished
    script.shift = object()
    assert core.running_shift is script.shift


def test_what_is_wrong_with_a_user_s_strategy_is_said_and_counted_line_by_line() -> None:
    core, script = a_core(), Scripted()
    for line in ("a.py:3: no", "a.py:3: no", "a.py:9: nor"):
        script.strategy_error = line
        assert decided(script, core=core) == [f"own strategy: {line}"]
    assert core.strategy_errors == {"a.py:3: no": 2, "a.py:9: nor": 1}


def a_plan(decision: ShiftDecision) -> Any:
    return SimpleNamespace(
        decision=decision, fire_us=1_005_000, contact_us=1_050_000, phase_rad=0.0,
        phase_sd_rad=0.0, slip_rad_s=20.0 * RPM, misses=False,
    )  # fmt: skip


def test_a_decision_is_said_where_it_differs_from_the_one_before() -> None:
    core, script = a_core(), Scripted()
    script.decision = a_plan(ShiftDecision.RELEASE)
    assert decided(script, core=core) == ["release: contact in 50 ms, at 20.0 rpm"]
    assert decided(script, core=core) == []
    script.decision = a_plan(ShiftDecision.NONE)
    assert decided(script, core=core) == []
    script.decision = a_plan(ShiftDecision.RELEASE)
    assert len(decided(script, core=core)) == 1
    script.decision = None
    assert decided(script, core=core) == []
    script.decision = a_plan(ShiftDecision.RELEASE)
    assert len(decided(script, core=core)) == 1


def test_other_settings_hold_from_the_next_step_on_and_change_the_header() -> None:
    core = a_core()
    other = replace(ControllerSettings(), timing=Timing(tick_ms=20))
    before = core.header.run_hash
    core.change_settings(other)
    assert core.header.settings is other
    assert core.header.run_hash != before
    told = sent(core.step(T0), ControllerStatus)
    assert (told.run_hash_high << 32 | told.run_hash_low) != before
    assert core.next_step_us == T0 + 20_000


def commanded(
    core: Any, script: Scripted, blocked: dict[str, int]
) -> tuple[list[Frame], list[str]]:
    """The frames of a step's end, where the guard blocks by these rows."""
    core._sequence = script
    core._guard.passes = lambda *_: "valves" not in blocked
    driveline = core._driveline_guard
    driveline.passes_clutch = lambda *_: "clutch" not in blocked
    driveline.passes_engine = lambda *_: "engine" not in blocked
    core._guard.blocked_row = blocked.get("valves")
    driveline.blocked_row = blocked.get("clutch", blocked.get("engine"))
    core._guard_view = SimpleNamespace(take=lambda *_: SimpleNamespace(in_doubt=()))
    events: list[str] = []
    return core._commands(T0, SNAPSHOT, events), events


@pytest.mark.parametrize(
    ("blocked", "said"),
    [
        ({}, []),
        ({"valves": 4}, ["guard blocked a valve command: row 4"]),
        ({"clutch": 17}, ["guard blocked a clutch command: row 17"]),
        ({"engine": 18}, ["guard blocked an engine request: row 18"]),
    ],
)
def test_in_place_of_what_the_guard_blocks_the_safe_command_goes_out(
    blocked: dict[str, int], said: list[str]
) -> None:
    core, script = a_core(), Scripted()
    script.engine_rad_s = 150.0
    frames, events = commanded(core, script, blocked)
    assert events == said
    assert script.blocks == ([(4, SNAPSHOT)] if "valves" in blocked else [])
    closes = "clutch" not in blocked
    assert sent(frames, ClutchCommand).action is (
        ClutchAction.CLOSE if closes else ClutchAction.OPEN
    )
    request: TSC1 = sent(frames, TSC1)
    mode = TscOverrideMode
    assert request.override_control_mode is (
        mode.OVERRIDE_DISABLED if "engine" in blocked else mode.SPEED_CONTROL
    )
    assert (request.requested_speed_rad_s is None) is ("engine" in blocked)
    assert request.message_counter == 0
    assert core._engine_requests == 1


def test_an_engine_is_asked_for_speed_or_torque_and_told_once_when_that_ends() -> None:
    """Counters go on from request to request; each has its checksum. 12.4 % are 12 and three
    eighths."""
    core, script, seen = a_core(), Scripted(), []
    for speed, share in ((None, None), (150.0, None), (None, 0.124), (150.0, 0.1), (None, 0.0),
                         (None, None), (None, None), (120.0, None)):  # fmt: skip
        script.engine_rad_s, script.engine_share = speed, share
        frames, _ = commanded(core, script, {})
        request: TSC1 | None = sent(frames, TSC1)
        if request is None:
            seen.append(None)
            continue
        assert all(is_intact(f) for f in frames if f.can_id == CODECS["TSC1"].spec.can_id)
        seen.append((request.message_counter, int(request.override_control_mode),
                     request.requested_speed_rad_s, request.requested_torque_fraction,
                     request.requested_torque_fine_fraction))  # fmt: skip
    near = pytest.approx
    assert seen == [
        None,
        (0, 1, near(150.0, abs=0.01), None, None),
        (1, 2, None, near(0.12), near(0.00375)),
        (2, 1, near(150.0, abs=0.01), None, None),
        (3, 2, None, near(0.0), near(0.0)),
        (4, 0, None, None, None),
        None,
        (5, 1, near(120.0, abs=0.01), None, None),
    ]
