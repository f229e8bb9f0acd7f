"""The controller as an XCP slave, with pyxcp as the master: it measures a shift, and changes
settings between shifts. What it did is in the log, and a replay repeats it."""

from __future__ import annotations

import math
import random
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import asammdf
import pytest
from loop_bench import Loop
from pyxcp.daq_stim import DaqList, DaqRecorder
from pyxcp.recorder.converter import convert_xmraw
from pyxcp.types import XcpResponseError
from xcp_master import master

from meshpoint.controller.core import ControllerCore
from meshpoint.controller.header import load_header, new_header
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.xcp.measured import (
    FIGURE_BYTES,
    MESSAGE_BYTES,
    MESSAGES,
    SENT_BYTES,
    StepFacts,
)
from meshpoint.controller.xcp.memory import MEASURED_ADDRESS, PAGE_ADDRESS, identity
from meshpoint.controller.xcp.node import XcpNode
from meshpoint.controller.xcp.parameters import PAGE_BYTES, PARAMETERS, ROW_BYTES, Parameter
from meshpoint.controller.xcp_access import XcpAccess
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.dbc.messages import ShiftResult
from meshpoint.dbc.specs import SignalSpec
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.tables import TableError
from meshpoint.testbench.a2l.module import figures
from meshpoint.testbench.logs.consumption import Consumption
from meshpoint.testbench.logs.replay import LogReplay
from meshpoint.testbench.logs.session import Verification
from meshpoint.testbench.version import product_version
from meshpoint.testbench.watch.story import Story
from meshpoint.units import RPM

BOTH = pytest.mark.parametrize("fd", [True, False], ids=["can_fd", "can"])
REFERENCE, WORKING = 0, 1
CONTROLLER, MASTER = 1, 2
STEP, SHIFT_END = 0, 1
AIM = "window.aim_slip_rpm"


def address_of(name: str) -> int:
    (row,) = (i for i, each in enumerate(PARAMETERS) if each.name == name)
    return PAGE_ADDRESS + ROW_BYTES * row


def read(one: Any, name: str) -> float:
    (value,) = struct.unpack("<f", one.shortUpload(ROW_BYTES, address_of(name)))
    return float(value)


def write(one: Any, name: str, value: float) -> None:
    one.setMta(address_of(name))
    one.download(struct.pack("<f", value))


def refusal(call: Any, *given: Any) -> str:
    """The error that a command is answered with."""
    with pytest.raises(XcpResponseError) as error:
        call(*given)
    return str(error.value.args[0])


def settings_of(run: Any) -> ControllerSettings:
    """Those that the next decision of a shift goes by."""
    settings: ControllerSettings = run.core.sequence.settings
    return settings


def verdict(run: Any, folder: Path) -> Any:
    run.header.save(folder)
    (session,) = LogReplay(folder, verify=True).run([frame for _, frame in run.frames])
    return session


@BOTH
def test_a_master_finds_out_what_it_talks_to(fd: bool) -> None:
    with master(fd=fd, alone=True) as (one, _, _):
        said = one.connect()
        assert (said.maxCto, said.maxDto) == ((64, 64) if fd else (8, 8))
        assert one.identifier(1) == identity(product_version())
        assert one.getCommModeInfo().commModeOptional.masterBlockMode
        assert not one.getStatus().sessionStatus.daqRunning
        channels = one.getDaqInfo()["channels"]
        assert [(each["name"], each["cycle"]) for each in channels] == [
            ("step", 10),
            ("end of shift", 0),
        ]
        segment = one.getPagInfo()["segments"][0]
        assert (segment["address"], segment["length"]) == (PAGE_ADDRESS, PAGE_BYTES)
        writable = [each["properties"]["xcpWriteAccessWithEcu"] for each in segment["pages"]]
        assert writable == [False, True]


@BOTH
def test_a_whole_page_is_read_in_blocks_and_its_checksum_fits(fd: bool) -> None:
    with master(fd=fd, alone=True) as (one, run, _):
        one.connect()
        one.setMta(PAGE_ADDRESS)
        content = one.fetch(PAGE_BYTES)
        for row, each in enumerate(PARAMETERS):
            of_row = content[ROW_BYTES * row : ROW_BYTES * (row + 1)]
            assert each.unpacked(of_row) == pytest.approx(each.of(settings_of(run)), rel=1e-6)
        one.setMta(PAGE_ADDRESS)
        said = one.buildChecksum(PAGE_BYTES)
        assert (str(said.checksumType), said.checksum) == ("XCP_CRC_32", crc_32(bytes(content)))
        one.disconnect()


def crc_32(content: bytes) -> int:
    """IEEE 802.3's, bit by bit."""
    crc = 0xFFFF_FFFF
    for byte in content:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB8_8320 if crc & 1 else 0)
    return crc ^ 0xFFFF_FFFF


@BOTH
def test_a_changed_setting_is_used_by_the_next_shift_and_never_in_one(
    fd: bool, tmp_path: Path
) -> None:
    with master(requests=[(300_000, 10)], fd=fd) as (one, loop, cable):
        one.connect()
        assert read(one, AIM) == 18.0
        cable.until(lambda: loop.core.sequence.shift is not None)
        write(one, AIM, 24.0)
        assert read(one, AIM) == 24.0
        assert loop.core.sequence.shift is not None
        assert settings_of(loop) == ControllerSettings()
        cable.until(lambda: bool(loop.outcomes))
        cable.pass_time(20_000)
        assert [each.result for each in loop.outcomes] == [ShiftResult.ENGAGED]
        before = ControllerSettings()
        window = replace(before.window, aim_slip_rad_s=24.0 * RPM)
        assert settings_of(loop) == replace(before, window=window)
        cable.pass_time(50_000)
    session = verdict(loop, tmp_path)
    assert session.verdict is Verification.IDENTICAL, session.reason


def test_the_log_of_a_tuned_shift_is_repeated_to_the_byte(tmp_path: Path) -> None:
    """The header holds the reference page; what the master changed comes from the log. Without its
    commands the run is another one."""
    with master(requests=[(1_000_000, 10)]) as (one, loop, cable):
        one.connect()
        write(one, "window.contact_high_rpm", 12.0)
        write(one, AIM, 9.0)
        cable.until(lambda: bool(loop.outcomes))
        assert loop.core.header == loop.header
    session = verdict(loop, tmp_path)
    assert session.verdict is Verification.IDENTICAL, session.reason
    account = Consumption()
    for _, frame in loop.frames:
        account.take(frame)
    assert (account.missing, account.changed) == (0, 0)
    silent = [frame for _, frame in loop.frames if frame.can_id != XCP_COMMAND_ID]
    (session,) = LogReplay(tmp_path, verify=True).run(silent)
    assert session.verdict is Verification.NOT_VERIFIABLE


def test_another_node_that_answers_in_the_controllers_place_is_told(tmp_path: Path) -> None:
    with master(requests=[]) as (one, loop, cable):
        one.connect()
        cable.pass_time(200_000)
    frames = [frame for _, frame in loop.frames]
    middle = len(frames) // 2
    forged = [*frames[:middle], Frame(XCP_RESPONSE_ID, b"\xff" * 8), *frames[middle:]]
    loop.header.save(tmp_path)
    (session,) = LogReplay(tmp_path, verify=True).run(forged)
    assert session.verdict is Verification.IDENTICAL, session.reason
    assert session.intruders == {XCP_RESPONSE_ID: 1}


def test_a_log_tells_what_was_set_and_when() -> None:
    """Not what was refused."""
    with master(requests=[]) as (one, loop, cable):
        one.connect()
        write(one, AIM, 24.0)
        refusal(write, one, AIM, 240.0)
        one.setMta(address_of("window.contact_high_rpm"))
        one.download(struct.pack("<2f", 90.0, 60.0))
        one.setCalPage(CONTROLLER, 0, REFERENCE)
        one.copyCalPage(0, REFERENCE, 0, WORKING)
        cable.pass_time(50_000)
    story = Story()
    lines = [
        line.words
        for time_us, frame in loop.frames
        for line in story.receive(time_us / 1e6, frame)
        if line.who == "tool"
    ]
    assert lines == [
        "sets window.aim_slip_rpm = 24 (XCP)",
        "sets window.contact_high_rpm = 90 (XCP)",
        "sets window.contact_low_rpm = 60 (XCP)",
        "has the controller use the reference page (XCP)",
        "copies the reference page to the working page (XCP)",
    ]


def test_a_header_keeps_what_a_master_may_do(tmp_path: Path) -> None:
    sheet = load_sheet("thesis")
    header = new_header("1", sheet, ControllerSettings(), xcp=XcpAccess.READ)
    header.save(tmp_path)
    assert load_header(tmp_path, header.run_hash) == header
    assert header.run_hash != new_header("1", sheet, ControllerSettings()).run_hash


def test_a_thousand_downloads_leave_every_setting_in_its_range(tmp_path: Path) -> None:
    """A value is taken where its limits and those of the others allow it, and nothing of it is
    where they do not."""
    draw = random.Random(47)
    with master(alone=True) as (one, run, _):
        one.connect()
        expected, taken = ControllerSettings(), 0
        for _ in range(1_000):
            parameter = draw.choice(PARAMETERS)
            content = drawn(parameter, draw)
            wanted = changed(expected, parameter, content)
            one.setMta(address_of(parameter.name))
            if wanted is None:
                assert "OUT_OF_RANGE" in refusal(one.download, content)
            else:
                one.download(content)
                expected, taken = wanted, taken + 1
            assert settings_of(run) == expected
        assert 300 < taken < 700
    session = verdict(run, tmp_path)
    assert session.verdict is Verification.IDENTICAL, session.reason


def drawn(parameter: Parameter, draw: random.Random) -> bytes:
    """Inside the limits, beyond them, or anything."""
    low, high = parameter.rule.low, parameter.rule.high
    width = high - low
    value = draw.choice(
        [draw.uniform(low, high), low, high, high + draw.random() * width, low - 0.1 * width]
    )
    if draw.random() < 0.2 or (value < 0 and parameter.is_whole):
        return draw.randbytes(ROW_BYTES)
    return parameter.packed(value)


def changed(
    settings: ControllerSettings, parameter: Parameter, content: bytes
) -> ControllerSettings | None:
    """The settings as a file with this value would give them; None where that would be refused."""
    value = parameter.unpacked(content)
    low, high = (
        parameter.unpacked(parameter.packed(each))
        for each in (parameter.rule.low, parameter.rule.high)
    )
    if not (math.isfinite(value) and low <= value <= high):
        return None
    before = getattr(settings, parameter.group)
    reference = getattr(ControllerSettings(), parameter.group)
    si = min(max(value, parameter.rule.low), parameter.rule.high) * parameter.rule.si
    if content == parameter.packed(parameter.of(ControllerSettings())):
        si = getattr(reference, parameter.attribute)
    number = value if parameter.is_whole else si
    try:
        group = replace(before, **{parameter.attribute: number})
        return replace(settings, **{parameter.group: group})
    except TableError:
        return None


def test_a_master_that_may_only_read_changes_nothing() -> None:
    with master(xcp=XcpAccess.READ) as (one, loop, cable):
        assert not one.connect().resource.calpag
        assert not one.getPageInfo(0, WORKING).properties.xcp_write_access_with_ecu
        one.setMta(address_of(AIM))
        assert "WRITE_PROTECTED" in refusal(one.download, struct.pack("<f", 20.0))
        assert "WRITE_PROTECTED" in refusal(one.setCalPage, CONTROLLER, 0, REFERENCE)
        assert "WRITE_PROTECTED" in refusal(one.copyCalPage, 0, REFERENCE, 0, WORKING)
        assert read(one, AIM) == 18.0
        cable.pass_time(50_000)
        assert settings_of(loop) == ControllerSettings()


def test_without_xcp_nothing_is_answered() -> None:
    loop = Loop(xcp=XcpAccess.OFF)
    loop.until(lambda: False, 200_000)
    loop.core.receive(Frame(XCP_COMMAND_ID, b"\xff\x00"))
    loop.until(lambda: False, 400_000)
    assert XCP_RESPONSE_ID not in {frame.can_id for _, frame in loop.frames}


def test_pages_are_switched_and_copied() -> None:
    with master(alone=True) as (one, run, cable):
        one.connect()
        write(one, AIM, 30.0)
        cable.pass_time(20_000)
        assert settings_of(run).window.aim_slip_rad_s == 30.0 * RPM
        one.setCalPage(CONTROLLER | MASTER, 0, REFERENCE)
        cable.pass_time(20_000)
        assert settings_of(run) == ControllerSettings()
        assert read(one, AIM) == 18.0
        assert one.getCalPage(CONTROLLER, 0) == REFERENCE
        one.setMta(address_of(AIM))
        assert "WRITE_PROTECTED" in refusal(one.download, struct.pack("<f", 20.0))
        one.setCalPage(CONTROLLER | MASTER, 0, WORKING)
        assert read(one, AIM) == 30.0
        one.copyCalPage(0, REFERENCE, 0, WORKING)
        assert read(one, AIM) == 18.0
        cable.pass_time(20_000)
        assert settings_of(run) == ControllerSettings()


@BOTH
def test_values_that_only_suit_each_other_go_in_one_block(fd: bool) -> None:
    """contact_low_rpm must be less than contact_high_rpm: alone neither could be set."""
    with master(fd=fd, alone=True) as (one, run, cable):
        one.connect()
        one.setMta(address_of("window.contact_high_rpm"))
        assert "OUT_OF_RANGE" in refusal(one.download, struct.pack("<f", -50.0))
        both = struct.pack("<2f", 90.0, 60.0)
        one.setMta(address_of("window.contact_high_rpm"))
        if fd:
            one.download(both)
        else:
            one.download(both[:6], len(both))
            one.downloadNext(both[6:], 2, last=True)
        cable.pass_time(20_000)
        window = settings_of(run).window
        assert (window.contact_high_rad_s, window.contact_low_rad_s) == (90.0 * RPM, 60.0 * RPM)


def test_of_a_block_with_a_hole_nothing_is_written() -> None:
    with master(fd=False, alone=True) as (one, _, _):
        one.connect()
        one.setMta(address_of(AIM))
        one.download(struct.pack("<f", 20.0) + b"12", 8)
        assert "SEQUENCE" in refusal(one.downloadNext, b"34", 1, True)
        one.download(struct.pack("<f", 20.0) + b"12", 8)
        assert "SEQUENCE" in refusal(one.download, struct.pack("<f", 21.0))
        assert "SEQUENCE" in refusal(one.downloadNext, b"34", 2, True)
        assert read(one, AIM) == 18.0


def test_a_part_of_a_value_is_not_written() -> None:
    with master(alone=True) as (one, _, _):
        one.connect()
        one.setMta(address_of(AIM))
        assert "OUT_OF_RANGE" in refusal(one.download, b"\0\0")
        one.setMta(address_of(AIM) + 2)
        assert "OUT_OF_RANGE" in refusal(one.download, struct.pack("<f", 20.0))
        assert read(one, AIM) == 18.0


def test_a_value_that_is_there_already_is_no_change() -> None:
    with master() as (one, loop, cable):
        one.connect()
        write(one, AIM, 18.0)
        cable.pass_time(50_000)
        assert not [line for line in loop.events if "XCP" in line]
        write(one, AIM, 19.5)
        cable.pass_time(50_000)
        assert [line for line in loop.events if f"XCP: {AIM} 18 -> 19.5" in line]


def test_a_master_of_the_other_kind_of_frames_is_not_heard_in_a_session() -> None:
    with master(fd=False, alone=True) as (one, run, cable):
        one.connect()
        one.setMta(address_of(AIM))
        run.core.receive(Frame(XCP_COMMAND_ID, b"\xf0\x04" + struct.pack("<f", 20.0), is_fd=True))
        cable.pass_time(50_000)
        assert read(one, AIM) == 18.0


def test_what_is_wrong_is_answered_as_the_standard_has_it() -> None:
    with master(alone=True) as (one, _, _):
        one.connect()
        assert "CMD_UNKNOWN" in refusal(one.getSeed, 0, 1)
        assert "ACCESS_DENIED" in refusal(one.shortUpload, 4, 0x5000_0000)
        assert "ACCESS_DENIED" in refusal(one.shortUpload, 4, PAGE_ADDRESS + PAGE_BYTES - 2)
        assert "OUT_OF_RANGE" in refusal(one.shortUpload, 4, PAGE_ADDRESS, 1)
        assert "SEGMENT_NOT_VALID" in refusal(one.setCalPage, MASTER, 3, WORKING)
        assert "PAGE_NOT_VALID" in refusal(one.setCalPage, MASTER, 0, 2)
        assert "MODE_NOT_VALID" in refusal(one.setCalPage, 0, 0, WORKING)
        assert "OUT_OF_RANGE" in refusal(one.getDaqEventInfo, 2)
        assert "OUT_OF_RANGE" in refusal(one.setDaqPtr, 0, 0, 0)
        assert "MEMORY_OVERFLOW" in refusal(one.allocDaq, 200)
        one.freeDaq()
        one.allocDaq(1)
        assert "MEMORY_OVERFLOW" in refusal(one.allocOdt, 0, 200)
        one.allocOdt(0, 1)
        one.allocOdtEntry(0, 0, 2)
        assert "DAQ_CONFIG" in refusal(one.startStopDaqList, 1, 0)
        one.setDaqPtr(0, 0, 0)
        assert "ACCESS_DENIED" in refusal(one.writeDaq, 0xFF, 4, 0, 0x5000_0000)
        assert "OUT_OF_RANGE" in refusal(one.writeDaq, 3, 1, 0, MEASURED_ADDRESS)
        one.writeDaq(0xFF, 40, 0, MEASURED_ADDRESS)
        assert "OUT_OF_RANGE" in refusal(one.writeDaq, 0xFF, 40, 0, MEASURED_ADDRESS)
        one.writeDaq(0xFF, 4, 0, MEASURED_ADDRESS)
        assert "OUT_OF_RANGE" in refusal(one.setDaqListMode, 0x10, 0, 7, 1, 0)
        one.setDaqListMode(0x10, 0, STEP, 1, 0)
        one.startStopDaqList(1, 0)
        assert one.getStatus().sessionStatus.daqRunning
        assert "DAQ_ACTIVE" in refusal(one.setDaqPtr, 0, 0, 0)
        one.startStopSynch(0)
        assert not one.getStatus().sessionStatus.daqRunning


TYPES = {(8, False): "U8", (8, True): "I8", (16, False): "U16", (16, True): "I16",
         (32, False): "U32", (32, True): "I32"}  # fmt: skip
HEADER_BITS = 24
"""CRC and counter of a protected frame."""


def measurable(name: str) -> list[tuple[str, int, SignalSpec]]:
    """Signals of a message that fill whole bytes: name, address, layout."""
    ((number, spec),) = ((i, each) for i, each in enumerate(MESSAGES) if each.name == name)
    start = MEASURED_ADDRESS + MESSAGE_BYTES * number
    return [
        (f"{name}.{signal.name}", start + signal.start_bit // 8, signal)
        for signal in spec.signals
        if (signal.bits, signal.signed) in TYPES and signal.start_bit >= HEADER_BITS
    ]


def daq_list(name: str, event: int, most: int) -> DaqList:
    rows = [
        (row, address, 0, TYPES[signal.bits, signal.signed])
        for row, address, signal in measurable(name)[:most]
    ]
    return DaqList(name, event, False, True, rows)


def raw(signal: SignalSpec, data: bytes) -> int:
    first, size = signal.start_bit // 8, signal.bits // 8
    return int.from_bytes(data[first : first + size], "little", signed=signal.signed)


@BOTH
def test_a_recorded_shift_holds_what_the_frames_held(fd: bool, tmp_path: Path) -> None:
    """pyxcp records, and writes an MF4 of it: every sample is the frame's of the same step, bit for
    bit, at sensor time."""
    named = {"ControllerEstimates": STEP, "ControllerStatus": STEP, "ShiftOutcome": SHIFT_END}
    most = 99 if fd else 4  # what a bus of 8 bytes has room for
    lists = [daq_list(name, event, most) for name, event in named.items()]
    recorder = DaqRecorder(lists, str(tmp_path / "shift"))
    with master(fd=fd, policy=recorder, requests=[]) as (one, loop, cable):
        one.connect()
        recorder.setup()
        recorder.start()
        loop.operator.ask(10, loop.time.now_us + 800_000)
        cable.until(lambda: bool(loop.outcomes))
        cable.pass_time(100_000)
        recorder.stop()
        one.disconnect()
    assert len(loop.outcomes) == 1
    convert_xmraw("mdf", str(tmp_path / "shift.xmraw"), str(tmp_path / "shift.mf4"))
    with asammdf.MDF(tmp_path / "shift.mf4") as recorded:
        for name in named:
            sent = [
                frame.data
                for _, frame in loop.frames
                if frame.can_id == next(m.can_id for m in MESSAGES if m.name == name)
            ]
            for row, _, signal in measurable(name)[:most]:
                samples = [int(each) for each in recorded.get(row).samples]
                held = [raw(signal, data) for data in sent]
                assert is_within(samples, held), row
                assert len(samples) > 100 or name == "ShiftOutcome"
        stamps = recorded.get("ControllerStatus.StepNumber").timestamps
        steps = recorded.get("ControllerStatus.StepNumber").samples
        ticks = {round((b - a) / (m - n), 6) for a, b, n, m in zip(
            stamps[:-1], stamps[1:], steps[:-1].astype(int), steps[1:].astype(int), strict=True
        )}  # fmt: skip
        assert max(ticks) <= 0.0101


def is_within(few: list[int], many: list[int]) -> bool:
    """Whether the samples stand in the frames as a whole, one after another."""
    return any(few == many[i : i + len(few)] for i in range(len(many) - len(few) + 1))


def test_sleeve_guard_and_learned_figures_are_measured() -> None:
    with master(shifts=2, requests=[]) as (one, loop, cable):
        one.connect()
        cable.until(lambda: len(loop.outcomes) > 1, 20_000_000)
        cable.pass_time(100_000)
        names = [name for name, _, _ in figures()]
        one.setMta(MEASURED_ADDRESS + SENT_BYTES)
        content = one.fetch(FIGURE_BYTES * len(names))
        values = dict(zip(names, struct.unpack(f"<{len(names)}f", content), strict=True))
        kept = loop.core.calibration("")
        assert kept.brake is not None
        assert values["learned.brake.gain"] == pytest.approx(kept.brake.gain, rel=1e-6)
        assert values["learned.brake.drag_nm"] == pytest.approx(kept.brake.drag_nm, rel=1e-6)
        assert math.isnan(values["learned.sleeves.crawl.delay_ms"])
        assert abs(values["sleeve.first_second_mm"]) < 13.0
        assert values["guard.row"] == 0.0


def random_commands(draw: random.Random) -> list[Frame]:
    """Now and then some that open a session, and write where a setting is."""
    if draw.random() < 0.02:
        return [Frame(XCP_COMMAND_ID, b"\xff\x00", is_fd=bool(draw.getrandbits(1)))]
    if draw.random() < 0.2:
        address = PAGE_ADDRESS + ROW_BYTES * draw.randrange(len(PARAMETERS))
        number = drawn(draw.choice(PARAMETERS), draw)
        point, write = b"\xf6\0\0\0" + struct.pack("<I", address), b"\xf0\x04" + number
        return [Frame(XCP_COMMAND_ID, each, is_fd=False) for each in (point, write)]
    length = draw.choice((0, 1, 2, 4, 7, 8, 8, 8, 12, 64))
    content = draw.randbytes(length)
    if length and draw.random() < 0.7:
        content = bytes([draw.randrange(0xC0, 0x100)]) + content[1:]
    if length >= 8 and draw.random() < 0.5:
        address = draw.choice((PAGE_ADDRESS, MEASURED_ADDRESS)) + draw.randrange(200)
        content = content[:3] + struct.pack("<BI", 0, address) + content[8:]
    return [Frame(XCP_COMMAND_ID, content, is_fd=length > 8)]


def test_a_hundred_thousand_random_frames_spoil_no_setting() -> None:
    draw, sheet = random.Random(4_711), load_sheet("thesis")
    node = XcpNode(product_version(), ControllerSettings(), XcpAccess.WRITE)
    kept = ControllerCore(new_header("1", sheet, ControllerSettings())).calibration("")
    facts = StepFacts((0.0,) * 4, 0, lambda: kept)
    sent, changes, before = 0, 0, node.settings
    for step in range(12_500):
        for command in [each for _ in range(8) for each in random_commands(draw)]:
            node.receive(command)
        frames, _ = node.step([], facts, 10_000 * step, shift_ended=step % 9 == 0)
        sent += len(frames)
        if node.settings != before:
            before, changes = node.settings, changes + 1
            for each in PARAMETERS:
                margin = 1e-12 * abs(each.rule.high)
                value = each.of(before)
                assert each.rule.low - margin <= value <= each.rule.high + margin, each.name
    assert sent > 20_000
    assert changes > 20


def test_random_frames_move_no_valve() -> None:
    draw = random.Random(17)

    def noisy(frame: Frame) -> list[Frame]:
        return [frame, *random_commands(draw)]

    loop = Loop([], xcp=XcpAccess.WRITE, receiving=noisy).run(2_000_000)
    assert len(loop.sent_as("ValveCommand")) > 150
    assert all(set(frame.data[3:]) == {0} for frame in loop.sent_as("ValveCommand"))
    assert loop.valves_driven == ()
    assert any(frame.can_id == XCP_RESPONSE_ID for _, frame in loop.frames)


def test_a_shift_amid_random_frames_is_the_same_shift(tmp_path: Path) -> None:
    """As long as none of them is a good download."""
    draw = random.Random(7)

    def noisy(frame: Frame) -> list[Frame]:
        if frame.can_id & 0xFF != 0x80:
            return [frame]
        return [frame, Frame(XCP_COMMAND_ID, draw.randbytes(8), is_fd=False)]

    quiet = Loop([(300_000, 10)]).run(2_500_000)
    loud = Loop([(300_000, 10)], xcp=XcpAccess.READ, receiving=noisy).run(2_500_000)
    assert [each.result for each in quiet.outcomes] == [each.result for each in loud.outcomes]
    assert quiet.sent_as("ValveCommand") == loud.sent_as("ValveCommand")
