"""The controller by its frames and its log: what it consumes, when it steps, what it says."""

from __future__ import annotations

import zlib
from dataclasses import replace
from typing import Any

import pytest

from meshpoint.bus.core import Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.measure.clock import FIRST_OF_A_READ
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings, Timing
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import EEC1, ClutchCommand, ControllerStatus, ValveCommand, ValveStatus
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
T0 = 777_000
FOREIGN_ID = 0x18FEF100


def a_core(armed: bool = True, settings: ControllerSettings | None = None) -> ControllerCore:
    return ControllerCore(new_header("1.2.3", SHEET, settings or ControllerSettings(), armed=armed))


def sent(step: Step, kind: type) -> Any:
    """The message of a kind among the frames; None where there is none."""
    codec = CODECS[kind.__name__]
    found = [frame for frame in step.frames if frame.can_id == codec.spec.can_id]
    assert len(found) <= 1
    return codec.decode(found[0].data) if found else None


def engine_frame(speed_rpm: float = 900.0, **more: float) -> Frame:
    return Transmitter(Node.ENGINE).encode(EEC1(engine_speed_rad_s=speed_rpm * RPM, **more))


def test_frames_of_a_step_are_counted_and_summed_in_order_of_identifier() -> None:
    """Those of our bus alone: not a stranger's, and not the node's own that an adapter repeats.
    The next step says it once more."""
    core = a_core()
    status = Frame(CODECS["ValveStatus"].spec.can_id, bytes(12))
    ours = [Frame(FIRST_OF_A_READ, bytes(64)), status, engine_frame()]
    own = Frame(0x18FF5F03, bytes(64))
    for frame in (Frame(FOREIGN_ID, b"\x01\x02", False), ours[0], own, *ours[1:]):
        core.receive(frame)
    reported: ControllerStatus = sent(core.step(T0), ControllerStatus)
    crc = 0
    for frame in sorted(ours, key=lambda each: each.can_id):
        crc = zlib.crc32(frame.can_id.to_bytes(4, "little") + frame.data, crc)
    assert (reported.consumed_count, reported.consumed_crc) == (3, crc)
    again: ControllerStatus = sent(core.step(T0 + 10_000), ControllerStatus)
    assert (again.consumed_count, again.consumed_crc) == (0, 0)
    assert (again.previous_consumed_count, again.previous_consumed_crc) == (3, crc)


def test_twenty_thousand_frames_wait_for_a_step_and_no_more() -> None:
    core = a_core()
    for _ in range(20_003):
        core.receive(Frame(FOREIGN_ID, b"", False))
    assert "3 frames dropped: more than 20000 in one step" in core.step(T0).events
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
        assert last.events == [f"valves off at {T0 / 1e6:.6f} s of its clock"]
        assert sent(last, ValveCommand) == ValveCommand()
        assert (sent(last, ClutchCommand) == ClutchCommand()) is armed


def test_frames_go_out_by_priority_and_the_status_closes_the_step() -> None:
    ids = [frame.can_id for frame in a_core().step(T0).frames]
    assert ids == sorted(ids)
    assert ids[-1] == CODECS[ControllerStatus.__name__].spec.can_id


@pytest.mark.parametrize("late_us", [0, 1, 3_000])
def test_a_step_says_how_late_it_is_and_ticks_follow_each_other_however_late(late_us: int) -> None:
    """The first one, which was due at no time, is not late; a step between two ticks is early, and
    leaves the next where it is."""
    core = a_core()
    assert core.next_step_us == 0
    for at_us, late in ((T0, 0), (T0 + 10_000 + late_us, late_us), (T0 + 14_000, 0)):
        assert sent(core.step(at_us), ControllerStatus).step_lateness_us == late
    assert core.next_step_us == T0 + 20_000
    core.step(T0 + 57_000)
    assert core.next_step_us == T0 + 60_000


def test_a_step_that_is_made_because_a_read_begins_is_not_late() -> None:
    core = a_core()
    core.step(T0)
    core.receive(Frame(FIRST_OF_A_READ, bytes(64)))
    assert core.next_step_us == 0
    assert sent(core.step(T0 + 1_000), ControllerStatus).step_lateness_us == 0


@pytest.mark.parametrize(
    ("settings", "lead_us"),
    [
        (ControllerSettings(timing=Timing(lead_ms=4)), 4_000),
        (ControllerSettings(timing=Timing(lead_ms=4), valve_timing="immediate"), 8_000),
        (ControllerSettings(timing=Timing(lead_ms=9), valve_timing="immediate"), 9_000),
    ],
)
def test_an_activation_is_as_far_ahead_as_its_frame_needs(
    settings: ControllerSettings, lead_us: int
) -> None:
    """8 ms at least where the step's own frames must be through before the moment of the command.
    After each refusal of the valves a tick more, three at most."""
    core, io = a_core(settings=settings), Transmitter(Node.GEARBOX_IO)
    for k, refused in enumerate((0, 1, 1, 2, 3, 4)):
        core.receive(io.encode(ValveStatus(refused_count=refused)))
        core.step(T0 + 10_000 * k)
        assert core.snapshot is not None
        ahead_us = core.snapshot.earliest_us - core.snapshot.now_us
        own_us = settings.timing.lead_us + 10_000 * min(refused, 3)
        assert ahead_us == max(own_us, lead_us)


def test_a_snapshot_has_the_newest_engine_s_speed_and_torque() -> None:
    """In whole per cent, and by the eighths where the engine says them."""
    core = a_core()
    core.step(T0)
    said = [
        ([(800.0, 0.5, None), (1200.0, 0.25, None)], (1200.0, 0.25, 0.01)),
        ([(1000.0, 0.25, 0.005)], (1000.0, 0.255, 0.00125)),
    ]
    for k, (frames, (rpm, share, step)) in enumerate(said):
        for speed_rpm, torque, fine in frames:
            more = {} if fine is None else {"actual_engine_torque_fine_fraction": fine}
            core.receive(engine_frame(speed_rpm, actual_engine_torque_fraction=torque, **more))
        core.step(T0 + 10_000 * (k + 1))
        known = core.snapshot
        assert known is not None
        assert (known.engine_rad_s, known.engine_torque_share, known.engine_torque_step) == (
            pytest.approx((rpm * RPM, share, step))
        )


def test_other_settings_hold_from_the_next_step_on_and_change_the_run_s_hash() -> None:
    core = a_core()
    before = core.header.run_hash
    core.change_settings(replace(ControllerSettings(), timing=Timing(tick_ms=20)))
    reported = sent(core.step(T0), ControllerStatus)
    assert reported.run_hash_high << 32 | reported.run_hash_low == core.header.run_hash != before
    assert core.next_step_us == T0 + 20_000
