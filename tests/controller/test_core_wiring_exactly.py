"""What the core hands from part to part in a step, and to those who look on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from calibration_example import SHEET as THESIS
from calibration_example import example
from test_core_parts_exactly import SHEET, T0, a_core, immediate, sent
from test_observer_exactly import Noted

from meshpoint.controller.core import ControllerCore
from meshpoint.controller.follower import Follower
from meshpoint.controller.header import new_header
from meshpoint.controller.sensing.clock_probe import FIRST_OF_A_READ
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift.valve_board import ValveName
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerStatus,
    EdgesInputRise,
    ShiftOutcome,
    Strategy,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import MainGear


def test_a_brake_s_valve_reacts_after_the_sheet_s_delay_before_it_is_learned() -> None:
    """12 ms, for whom learns nothing."""
    base = replace(ControllerSettings(), estimator_name="thesis")
    core = a_core(settings=base)
    assert core.sequence.brake.off_delay_us == core.sequence.brake.on_delay_us == 12_000


def test_a_calibration_is_taken_up_at_the_start_and_handed_out_with_the_run_s_shifts() -> None:
    core: Any = ControllerCore(new_header("0", THESIS, ControllerSettings(), example()))
    assert core.sequence.delays.records().second.samples == 6.5
    assert core.observer.noise().shifts == 12
    core.shifts = 3
    kept = core.calibration("now")
    assert (kept.provenance.shifts, kept.provenance.written) == (15, "now")


def test_before_its_first_step_a_core_knows_and_wakes_for_nothing() -> None:
    core = a_core()
    assert core.snapshot is None
    assert core.shifts == 0
    assert core.strategy_errors == {}
    core._due_us = T0
    assert core.next_step_us == T0


def test_what_is_learned_of_plates_and_driveline_is_the_observer_s_in_each_step() -> None:
    core = a_core()
    core.sequence.driveline.pressed_nm = 17.0
    core.sequence.kiss = Noted(share=0.42)
    core.step(T0)
    assert (core.observer.pressed_nm, core.observer.kiss_share) == (17.0, 0.42)


def test_a_step_looks_first_then_decides_then_learns() -> None:
    core, order = a_core(), list[str]()
    observer = core.observer
    for owner, name in ((observer, "take"), (core._speeds, "take"), (core, "_decide"),
                        (observer, "learn"), (core, "_commands")):  # fmt: skip
        own = getattr(owner, name)
        label = f"{type(owner).__name__}.{name}"

        def noted(*args: Any, own: Any = own, label: str = label) -> Any:
            order.append(label)
            return own(*args)

        setattr(owner, name, noted)
    core.step(T0)
    assert order == [
        "Observer.take", "ShaftSpeeds.take", "ControllerCore._decide", "Observer.learn",
        "ControllerCore._commands",
    ]  # fmt: skip


def test_a_gear_that_was_asked_for_comes_to_the_sequence() -> None:
    core, asked = a_core(), list[int | None]()
    core._decide = lambda requested, *_: asked.append(requested)
    bench = Transmitter(Node.BENCH)
    for gear in (3, 7):
        core.receive(bench.encode(TC1(requested_gear=gear)))
    core.step(T0)
    core.step(T0 + 10_000)
    assert asked == [7, None]


def test_ticks_move_the_phase_of_the_steps_and_steps_between_are_only_seen() -> None:
    core = a_core()
    phase = core._phase = Noted(sooner_us=0)
    core.step(T0)
    core.step(T0 + 4_000)
    core.step(T0 + 10_000)
    assert [call[0] for call in phase.calls] == ["take", "between", "take"]
    assert phase.calls[0][2] == core.observer.clock.now_us(T0)


def test_a_refusal_of_the_valves_leads_to_a_look_at_the_clock_at_once() -> None:
    core, io = a_core(), Transmitter(Node.GEARBOX_IO)
    repeats: list[int] = []
    core._probe.repeat = lambda: repeats.append(1)
    for k, refused in enumerate((0, 0, 1, 1)):
        core.receive(io.encode(ValveStatus(refused_count=refused)))
        core.step(T0 + 10_000 * k)
    assert len(repeats) == 1
    assert core._lead_us == 4_000 + 10_000


def test_a_step_for_the_clock_stamps_it_with_the_read_that_it_was_made_for() -> None:
    core, io = a_core(), Transmitter(Node.GEARBOX_IO)
    stamps: list[tuple[int, int]] = []
    own = core.observer.clock.stamp
    core.observer.clock.stamp = lambda *args: stamps.append(args) or own(*args)
    read = io.encode(EdgesInputRise(read_time_us=123_000))
    assert read.can_id == FIRST_OF_A_READ
    core.receive(read)
    assert not core._probe.is_due
    core.step(T0)
    stamps.clear()
    core.receive(io.encode(EdgesInputRise(read_time_us=133_000)))
    assert core._probe.is_due
    core.step(T0 + 5_000)
    assert stamps[0] == (133_000, T0 + 5_000)


def test_blocks_of_both_guards_are_told_together() -> None:
    core = a_core()
    core._guard.blocks, core._driveline_guard.blocks = 5, 2
    assert sent(core.step(T0), ControllerStatus).guard_blocks == 7


def test_a_block_without_a_row_is_row_nought() -> None:
    core, blocks = a_core(), list[int]()
    core._guard.passes = lambda *_: False
    core._guard.blocked_row = None
    core.sequence.blocked = lambda row, _snapshot: blocks.append(row)
    core.step(T0)
    assert blocks == [0]


def test_channels_go_silent_where_no_step_hears_of_them() -> None:
    core, io = a_core(), Transmitter(Node.GEARBOX_IO)
    for k in range(100):
        if k < 20:
            core.receive(io.encode(ValveStatus()))
        core.step(T0 + 10_000 * k)
        if k == 19:
            assert core._receiver.valid(ValveStatus)
    assert not core._receiver.valid(ValveStatus)


def test_hardware_that_cannot_schedule_is_sent_what_holds_when_the_frame_arrives() -> None:
    """A switch in 0.6 ms, a wire of 0.9 ms: it is on by then."""
    core = a_core(settings=immediate(wire_us=900))
    core.step(T0)
    now_us = core.observer.clock.now_us(T0 + 10_000)
    core._guard.passes = lambda *_: True
    core._board.schedule(ValveName.BRAKE, True, now_us + 600, now_us)
    frames = core._commands(T0 + 10_000, replace(core.snapshot, now_us=now_us), [])
    assert sent(frames, ValveCommand).brake_action is ValveAction.ON_NOW
    core._board.schedule(ValveName.BRAKE, True, now_us + 1_000, now_us)
    frames = core._commands(T0 + 10_000, replace(core.snapshot, now_us=now_us), [])
    assert sent(frames, ValveCommand).brake_action is ValveAction.OFF_NOW


def test_at_the_end_no_valve_is_left_to_be_switched() -> None:
    core = a_core()
    core._board.schedule(ValveName.MAIN_FIRST, True, 10_000, 0)
    core.shutdown(T0)
    assert not core._board.driven(ValveName.MAIN_FIRST, 20_000)


def test_what_the_reporter_says_goes_out_but_what_nobody_reads() -> None:
    core = a_core()
    ids = {frame.can_id for frame in core.step(T0).frames}
    assert len(ids) > 5
    kinds: list[Any] = []
    core._transmitter = SimpleNamespace(leave_unread=kinds.append)
    core.leave_unread([ShiftOutcome])
    assert kinds == [[ShiftOutcome]]


def test_other_settings_reach_the_sequence() -> None:
    core, given = a_core(), list[ControllerSettings]()
    core.sequence.change_settings = given.append
    other = ControllerSettings().with_strategy("speed_window")
    core.change_settings(other)
    assert given == [other]
    assert sent(core.step(T0), ControllerStatus).strategy is Strategy.SPEED_WINDOW


def test_a_gear_that_another_engaged_is_learned_from_how_its_tooth_moves_alone() -> None:
    core, locks = a_core(), list[Any]()
    core.observer.references.locked = lambda *args, **how: locks.append((args, how))
    core.engaged_by_another(MainGear.THIRD)
    assert locks == [((MainGear.THIRD, 0.0), {"straight": False})]


@pytest.mark.parametrize("keeps", [False, True])
def test_a_core_that_goes_on_by_a_follower_s_estimates_has_all_that_is_his(keeps: bool) -> None:
    """But for the guard, which stays the one of its own sheet; and its drifts where it is told."""
    core = a_core()
    other = replace(ControllerSettings(), estimator_name="thesis").with_strategy("speed_window")
    follower = Follower(new_header("0", SHEET, other))
    guard, drifts = core._guard, core.sequence.drifts
    changed: list[ControllerSettings] = []
    own = core.sequence.change_settings
    core.sequence.change_settings = lambda settings: changed.append(settings) or own(settings)
    core.estimate_by(follower, keeps_drifts=keeps)
    assert core.header is follower.header
    assert core.observer is follower.observer
    assert core._settings is follower.header.settings
    assert core._speeds is follower.speeds
    sequence = core.sequence
    assert sequence.references is follower.observer.references
    assert (sequence.brake, sequence.delays) == (follower.brake, follower.delays)
    assert sequence.sheet is follower.header.sheet
    assert sequence.drifts is (drifts if keeps else follower.drifts)
    assert changed == [other]
    assert core._guard is guard
    told = sent(core.step(T0), ControllerStatus)
    assert told.run_hash_high << 32 | told.run_hash_low == follower.header.run_hash
    assert core.snapshot.layshaft is follower.observer.layshaft


def test_predictions_may_be_another_s() -> None:
    core, source = a_core(), object()
    core.take_predictor_from(source)
    assert core.sequence.predictor_source is source
