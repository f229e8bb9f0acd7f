"""The controller as an XCP slave, with pyxcp as the master: it measures a shift, and changes
settings between shifts. What it did is in the log, and a replay repeats it."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import pytest
from loop_bench import Loop
from xcp_master import AIM, address_of, master, read, refusal, settings_of, verdict, write

from meshpoint.base.version import product_version
from meshpoint.controller.settings.header import XcpAccess, load_header, new_header
from meshpoint.controller.settings.settings import ControllerSettings, SettingsFile
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, XCP_RESPONSE_ID
from meshpoint.dbc.messages import ShiftResult
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.keys import groups_of
from meshpoint.logs.consumption import Consumption
from meshpoint.logs.story import Story
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Verification
from meshpoint.units import RPM
from meshpoint.xcp.memory import (
    MEASURED_ADDRESS,
    PAGE_ADDRESS,
    PAGE_BYTES,
    PARAMETERS,
    ROW_BYTES,
    identity,
)

BOTH = pytest.mark.parametrize("fd", [True, False], ids=["can_fd", "can"])
REFERENCE, WORKING = 0, 1
CONTROLLER, MASTER = 1, 2
STEP, SHIFT_END = 0, 1


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


def test_the_page_in_use_is_the_controller_s_whatever_the_master_looks_at() -> None:
    with master(alone=True) as (one, run, cable):
        one.connect()
        write(one, AIM, 30.0)
        one.setCalPage(CONTROLLER, 0, REFERENCE)
        cable.pass_time(20_000)
        assert settings_of(run).window.aim_slip_rad_s == 18.0 * RPM
        assert read(one, AIM) == 30.0, "the master still sees the working page"
        pages = [one.getCalPage(each, 0) for each in (CONTROLLER, MASTER)]
        assert pages == [REFERENCE, WORKING]
        write(one, AIM, 25.0)
        cable.pass_time(20_000)
        assert settings_of(run).window.aim_slip_rad_s == 18.0 * RPM
        one.setCalPage(CONTROLLER, 0, WORKING)
        one.setCalPage(MASTER, 0, REFERENCE)
        cable.pass_time(20_000)
        assert settings_of(run).window.aim_slip_rad_s == 25.0 * RPM
        assert read(one, AIM) == 18.0
        pages = [one.getCalPage(each, 0) for each in (CONTROLLER, MASTER)]
        assert pages == [WORKING, REFERENCE]


def test_no_limit_of_the_guard_is_offered_to_a_master() -> None:
    """Nor is the tick, nor anything behind the last of the settings."""
    groups = {group.name: group for group in groups_of(SettingsFile)}
    guards = {key.path for key in groups["guard"].keys} | {"limits.valve_on_ms"}
    offered = {each.name for each in PARAMETERS}
    assert guards & {key.path for group in groups.values() for key in group.keys} == guards
    assert offered & guards == set()
    assert {name.partition(".")[0] for name in offered} == {
        "window", "aim", "prices", "limits", "engine",
    }  # fmt: skip
    with master(alone=True) as (one, run, _):
        one.connect()
        one.setMta(PAGE_ADDRESS + PAGE_BYTES)
        assert "ACCESS_DENIED" in refusal(one.download, struct.pack("<f", 1.0))
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
