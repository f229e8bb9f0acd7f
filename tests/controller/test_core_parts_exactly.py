"""The controller's core part by part: what it consumes, when it steps, what it says and sends."""

from __future__ import annotations

import zlib
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.bus.core import Step
from meshpoint.controller.core import ControllerCore
from meshpoint.controller.header import new_header
from meshpoint.controller.sensing.clock_probe import FIRST_OF_A_READ
from meshpoint.controller.settings import ControllerSettings, Timing
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    EEC1,
    ClutchCommand,
    ControllerStatus,
    EdgesLayshaftRise,
    EdgesMainRise,
    FaultCode,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import MainGear, Range, Split, load_sheet
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
T0 = 777_000
FOREIGN_ID = 0x18FEF100


def a_core(armed: bool = True, settings: ControllerSettings | None = None) -> Any:
    header = new_header("1.2.3", SHEET, settings or ControllerSettings(), armed=armed)
    return ControllerCore(header)


def immediate(**timing: int) -> ControllerSettings:
    return ControllerSettings(valve_timing="immediate", timing=Timing(**timing))


def sent(step: Step | list[Frame], kind: type) -> Any:
    """The message of a kind among the frames; None where there is none."""
    codec = CODECS[kind.__name__]
    frames = step.frames if isinstance(step, Step) else step
    found = [frame for frame in frames if frame.can_id == codec.spec.can_id]
    assert len(found) <= 1
    return codec.decode(found[0].data) if found else None


def engine_frame(speed_rpm: float = 900.0, **more: float) -> Frame:
    return Transmitter(Node.ENGINE).encode(EEC1(engine_speed_rad_s=speed_rpm * RPM, **more))


def test_frames_of_a_step_are_counted_and_summed_in_order_of_identifier() -> None:
    """Those of our bus alone: not a stranger's, and not the node's own that an adapter repeats."""
    core = a_core()
    engine, status = engine_frame(), Frame(CODECS["ValveStatus"].spec.can_id, bytes(12))
    own = Frame(0x18FF5F03, bytes(64))
    first = Frame(FIRST_OF_A_READ, bytes(64))
    arrived = [Frame(FOREIGN_ID, b"\x01\x02", False), first, own, status, engine]
    for frame in arrived:
        core.receive(frame)
    told: ControllerStatus = sent(core.step(T0), ControllerStatus)
    assert told.consumed_count == 3
    crc = 0
    for frame in sorted((first, status, engine), key=lambda each: each.can_id):
        crc = zlib.crc32(frame.can_id.to_bytes(4, "little") + frame.data, crc)
    assert told.consumed_crc == crc
    assert core._heard == sorted([arrived[0], first, status, engine], key=lambda f: f.can_id)
    again: ControllerStatus = sent(core.step(T0 + 10_000), ControllerStatus)
    assert (again.consumed_count, again.consumed_crc) == (0, 0)
    assert (again.previous_consumed_count, again.previous_consumed_crc) == (3, crc)


@pytest.mark.parametrize(
    ("can_id", "is_extended", "is_heard"),
    [(0x18FEF103, True, False), (0x18FEF100, True, True), (0x703, False, True)],
)
def test_a_frame_is_the_node_s_own_by_its_address_in_an_extended_identifier(
    can_id: int, is_extended: bool, is_heard: bool
) -> None:
    core = a_core()
    core.receive(Frame(can_id, b"", False, is_extended))
    core.step(T0)
    assert bool(core._heard) is is_heard


def test_twenty_thousand_frames_wait_for_a_step_and_no_more() -> None:
    core = a_core()
    frame = Frame(FOREIGN_ID, b"", False)
    for _ in range(20_003):
        core.receive(frame)
    assert "3 frames dropped: more than 20000 in one step" in core.step(T0).events
    assert len(core._heard) == 20_000
    assert not [line for line in core.step(T0 + 10_000).events if "dropped" in line]


def test_a_controller_that_is_not_armed_says_so_once_and_sends_valves_off_alone() -> None:
    core = a_core(armed=False)
    first = core.step(T0)
    assert [line for line in first.events if "not armed" in line]
    assert not [line for line in core.step(T0 + 10_000).events if "not armed" in line]
    assert not [line for line in a_core().step(T0).events if "not armed" in line]
    assert sent(first, ClutchCommand) is None
    assert sent(first, ValveCommand) == ValveCommand()
    assert sent(a_core().step(T0), ClutchCommand) is not None
    for armed in (False, True):
        last = a_core(armed).shutdown(T0)
        assert last.events == [f"valves off at {T0} us"]
        assert sent(last, ValveCommand) == ValveCommand()
        assert (sent(last, ClutchCommand) == ClutchCommand()) is armed


def test_frames_go_out_by_priority_and_the_status_closes_the_step() -> None:
    frames = a_core().step(T0).frames
    ids = [frame.can_id for frame in frames]
    assert ids == sorted(ids)
    assert ids[-1] == CODECS[ControllerStatus.__name__].spec.can_id


@pytest.mark.parametrize("late_us", [0, 1, 9_999])
def test_ticks_follow_each_other_however_late_a_step_is(late_us: int) -> None:
    core = a_core()
    assert core.next_step_us == 0
    core.step(T0)
    assert core.next_step_us == T0 + 10_000
    core.step(T0 + 10_000 + late_us)
    assert core.next_step_us == T0 + 20_000
    core.step(T0 + 57_000)
    assert core.next_step_us == T0 + 60_000


def test_a_step_between_ticks_leaves_the_next_tick_where_it_is() -> None:
    core = a_core()
    core.step(T0)
    assert not core._is_tick(T0 + 9_999)
    assert core._is_tick(T0 + 10_000)
    core.step(T0 + 4_000)
    assert core.next_step_us == T0 + 10_000


@pytest.mark.parametrize(("sooner_us", "next_us"), [(300, 9_700), (-300, 10_300), (10_500, 1)])
def test_the_sensors_cycle_moves_the_next_tick_but_never_into_the_past(
    sooner_us: int, next_us: int
) -> None:
    core = a_core()
    core._phase = SimpleNamespace(sooner_us=sooner_us)
    core._plan_next_step(T0, T0)
    assert core.next_step_us == T0 + next_us


@pytest.mark.parametrize(
    ("ahead_us", "wake_us", "due_us"),
    [
        (None, None, 10_000),
        (3_000, 2_100, 10_000),
        (900, 0, 10_000),
        (500, 0, 10_000),
        (10_900, 10_000, 10_000),
        (10_901, 10_001, 20_000),
        (18_899, 17_999, 20_000),
        (18_900, 18_000, 10_000),
    ],
)
def test_a_switch_that_the_valves_cannot_schedule_wakes_the_controller_by_the_wire_s_time(
    ahead_us: int | None, wake_us: int | None, due_us: int
) -> None:
    """0.9 ms before it. A tick less than 8 ms before the switch is left out: its frames would still
    stand before the command. The sensor clock is half a second behind here."""
    core = a_core(settings=immediate(wire_us=900))
    sensor_us = T0 - 500_000
    asked: list[int] = []

    def switch(now_us: int) -> int | None:
        asked.append(now_us)
        return None if ahead_us is None else sensor_us + max(ahead_us, 900)

    planned: list[tuple[int, int | None]] = []
    core._board = SimpleNamespace(next_switch_us=switch)
    core._probe = SimpleNamespace(plan=lambda *args: planned.append(args), is_due=False)
    core._plan_next_step(T0, sensor_us)
    assert asked == [sensor_us + 900]
    assert core._due_us == T0 + due_us
    expected_us = None if wake_us is None else T0 + wake_us
    assert core._wake_us == expected_us
    assert planned == [(T0, expected_us)]
    assert core.next_step_us == min(T0 + due_us, T0 + due_us if wake_us is None else T0 + wake_us)


def test_valves_that_schedule_are_sent_nothing_ahead() -> None:
    assert a_core()._ahead_us == 0
    assert a_core(settings=immediate(wire_us=700))._ahead_us == 700


@pytest.mark.parametrize(
    ("settings", "more_us", "lead_us"),
    [
        (ControllerSettings(timing=Timing(lead_ms=4)), 0, 4_000),
        (ControllerSettings(timing=Timing(lead_ms=4)), 20_000, 24_000),
        (immediate(lead_ms=4), 0, 8_000),
        (immediate(lead_ms=9), 0, 9_000),
        (immediate(lead_ms=4), 10_000, 14_000),
    ],
)
def test_an_activation_is_as_far_ahead_as_its_frame_needs(
    settings: ControllerSettings, more_us: int, lead_us: int
) -> None:
    """What a refusal has added comes on top; 8 ms at least where the step's own frames must be
    through before the moment of the command."""
    core = a_core(settings=settings)
    core._refused.more_us = more_us
    assert core._lead_us == lead_us
    core.step(T0)
    snapshot = core.snapshot
    assert snapshot.earliest_us - snapshot.now_us == lead_us


def test_a_snapshot_has_the_newest_engine_s_speed_and_torque() -> None:
    core = a_core()
    core.step(T0)
    assert (core.snapshot.engine_rad_s, core.snapshot.engine_torque_share) == (None, None)
    assert core.snapshot.engine_torque_step == 0.01
    for rpm, torque in ((800.0, 0.5), (1200.0, 0.25)):
        core.receive(engine_frame(rpm, actual_engine_torque_fraction=torque))
    core.step(T0 + 10_000)
    assert core.snapshot.engine_rad_s == pytest.approx(1200.0 * RPM)
    assert core.snapshot.engine_torque_share == pytest.approx(0.25)
    assert core.snapshot.engine_torque_step == 0.01
    core.receive(engine_frame(1000.0, actual_engine_torque_fraction=0.25,
                              actual_engine_torque_fine_fraction=0.005))  # fmt: skip
    core.step(T0 + 20_000)
    assert core.snapshot.engine_torque_share == pytest.approx(0.255)
    assert core.snapshot.engine_torque_step == pytest.approx(0.00125)


POSITIONS = {SleevesMain, SleevesAux, GearboxSensors}
SPEEDS = {EdgesLayshaftRise, EdgesMainRise}
ALL = POSITIONS | SPEEDS | {ValveStatus}


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({}, FaultCode.NONE),
        ({"valid": ALL - {SleevesMain}}, FaultCode.POSITION_STALE),
        ({"valid": ALL - {SleevesAux}}, FaultCode.POSITION_STALE),
        ({"valid": ALL - {GearboxSensors}}, FaultCode.POSITION_STALE),
        ({"complete": False}, FaultCode.POSITION_STALE),
        ({"oldest_us": 1_000_000 - 45_001}, FaultCode.POSITION_STALE),
        ({"oldest_us": 1_000_000 - 45_000}, FaultCode.NONE),
        ({"valid": ALL - {EdgesLayshaftRise}}, FaultCode.SPEED_STALE),
        ({"valid": ALL - {EdgesMainRise}}, FaultCode.SPEED_STALE),
        ({"layshaft": None}, FaultCode.SPEED_STALE),
        ({"main": None}, FaultCode.SPEED_STALE),
        ({"free": True}, FaultCode.NONE),
        ({"free": True, "is_finite": False}, FaultCode.SPEED_STALE),
        ({"free": False, "is_finite": False}, FaultCode.NONE),
        ({"valid": ALL - {ValveStatus}}, FaultCode.VALVE_LINK_LOST),
        ({"valid": ALL - {ValveStatus}, "main": None}, FaultCode.SPEED_STALE),
        ({"valid": SPEEDS, "main": None}, FaultCode.POSITION_STALE),
        ({"propeller": None}, FaultCode.NONE),
        ({"layshaft": None, "gear": MainGear.NEUTRAL}, FaultCode.SPEED_STALE),
        ({"layshaft": None, "gear": MainGear.NEUTRAL, "split": None}, FaultCode.NONE),
        ({"main": None, "gear": MainGear.NEUTRAL, "range": None}, FaultCode.NONE),
        ({"layshaft": None, "gear": MainGear.FIRST, "split": None}, FaultCode.SPEED_STALE),
        (
            {"propeller": None, "gear": MainGear.NEUTRAL, "split": None},
            FaultCode.SPEED_STALE,
        ),
        (
            {"valid": ALL - {EdgesMainRise}, "gear": MainGear.NEUTRAL, "split": None},
            FaultCode.SPEED_STALE,
        ),
    ],
)
def test_of_what_is_missing_the_most_serious_is_said(
    changed: dict[str, Any], fault: FaultCode
) -> None:
    core, has = a_core(), {"valid": ALL, "complete": True, "oldest_us": 999_000, "layshaft": 90.0,
                           "main": 80.0, "propeller": 70.0, "free": False, "is_finite": True,
                           "gear": MainGear.FIRST, "split": Split.LOW,
                           "range": Range.LOW} | changed  # fmt: skip
    valid: set[type] = has["valid"]
    core._receiver = SimpleNamespace(
        all_valid=lambda kinds: set(kinds) <= valid, valid=lambda kind: kind in valid
    )
    view = SimpleNamespace(
        complete=has["complete"],
        oldest_us=has["oldest_us"],
        main_gear=has["gear"],
        split=has["split"],
        range_=has["range"],
    )
    state = SimpleNamespace(is_finite=has["is_finite"])
    tracker = SimpleNamespace(free=has["free"], latest=lambda: state)
    core._observer = SimpleNamespace(view=view, layshaft=tracker)
    core._speeds = SimpleNamespace(
        layshaft=has["layshaft"], main=has["main"], propeller=has["propeller"]
    )
    assert core._lost(1_000_000) is fault
