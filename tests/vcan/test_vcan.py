"""Controller and rig as two processes on a real vcan0: three shifts and two outages, one story."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from vcan_bench import (
    BUS,
    DBC,
    PATIENCE_S,
    VALVES,
    Candump,
    Nodes,
    Values,
    ip,
    meshpoint,
    parse,
)

pytestmark = pytest.mark.timeout(4 * PATIENCE_S)

ENGAGED = 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("vcan")


@pytest.fixture(scope="module")
def dump(folder: Path) -> Iterator[Candump]:
    dump = Candump(folder / "candump.log")
    yield dump
    dump.stop()


@pytest.fixture(scope="module")
def nodes(folder: Path, dump: Candump) -> Iterator[Nodes]:
    nodes = Nodes(folder)
    yield nodes
    nodes.stop()


def ask_by_cansend(gear: int) -> None:
    """J1939 TC1 as any tool on the bus would send it."""
    message = DBC.get_message_by_name("TC1")
    data = message.encode({signal.name: signal.maximum for signal in message.signals}, strict=False)
    values = message.decode(data, decode_choices=False) | {"RequestedGear": gear}
    data = message.encode(values, strict=False)
    subprocess.run(["cansend", "vcan0", f"{message.frame_id:08X}#{data.hex()}"], check=True)


def test_a_gear_asked_for_by_cansend_is_engaged_beside_other_traffic(
    nodes: Nodes, dump: Candump
) -> None:
    dump.in_gear(14)
    # Other people's frames, classic and FD, foreign to our DBC, all through the shift.
    traffic = [
        subprocess.Popen(["cangen", "vcan0", "-g", "20", "-I", can_id, "-L", "8", *more])
        for can_id, more in (("5A5", []), ("1ABCDE77", ["-e", "-f"]))
    ]
    try:
        ask_by_cansend(2)
        outcome = dump.wait("ShiftOutcome")
    finally:
        for one in traffic:
            one.terminate()
            one.wait()
    assert (outcome["FromGear"], outcome["ToGear"]) == (14, 2)
    assert outcome["Result"] == ENGAGED
    status = dump.in_gear(2)
    assert status["ForeignFrames"] > 0
    assert status["E2eErrors"] == status["FormatErrors"] == 0


def test_a_gear_asked_for_by_meshpoint_request_is_engaged(
    nodes: Nodes, dump: Candump, folder: Path
) -> None:
    asked = meshpoint(folder, "request", "4", *BUS, "--timeout", str(PATIENCE_S))
    assert asked.returncode == 0, asked.said
    assert "2 -> 4: engaged" in asked.printed or "in gear 4" in asked.printed
    dump.in_gear(4)


def test_the_candump_log_decodes_and_verifies(nodes: Nodes, dump: Candump, folder: Path) -> None:
    """The log is cut here, in mid-run, after a whole step."""
    lines = dump.lines()
    status = f" {DBC.get_message_by_name('ControllerStatus').frame_id:08X}#"
    last = max(number for number, line in enumerate(lines) if status in line)
    log = folder / "shifts.log"
    log.write_text("\n".join(lines[: last + 1]) + "\n")
    names: dict[str, int] = {}
    for line in lines[: last + 1]:
        seen = parse(line)
        if seen.can_id in (0x5A5, 0x1ABCDE77):
            continue
        message = DBC.get_message_by_frame_id(seen.can_id)
        names[message.name] = names.get(message.name, 0) + 1
        if names[message.name] <= 20:
            assert seen.values
    assert {"EdgesLayshaftRise", "ValveCommand", "ControllerStatus", "TC1"} <= set(names)
    verified = meshpoint(folder, "replay", str(log), "--verify")
    assert verified.returncode == 0, verified.printed + verified.said
    assert "identical" in verified.printed


def test_a_link_that_goes_down_and_comes_up_is_found_again(nodes: Nodes, dump: Candump) -> None:
    ip("set", "vcan0", "down")
    nodes.wait_said(nodes.controller, "bus lost")
    nodes.wait_said(nodes.rig, "bus lost")
    ip("set", "vcan0", "up")
    nodes.wait_said(nodes.controller, "bus is back")
    nodes.wait_said(nodes.rig, "bus is back")
    dump.mark()
    dump.in_gear(4)


def test_a_device_that_is_deleted_and_made_anew_is_found_again(
    nodes: Nodes, dump: Candump, folder: Path
) -> None:
    ip("del", "vcan0")
    nodes.wait_said(nodes.controller, "bus lost", times=2)
    nodes.wait_said(nodes.rig, "bus lost", times=2)
    ip("add", "dev", "vcan0", "type", "vcan")
    ip("set", "vcan0", "mtu", "72")
    ip("set", "vcan0", "up")
    nodes.wait_said(nodes.controller, "bus is back", times=2)
    nodes.wait_said(nodes.rig, "bus is back", times=2)
    again = Candump(folder / "again.log")
    try:
        again.in_gear(4)
    finally:
        again.stop()


def nothing_driven(status: Values) -> bool:
    return not any(status[f"{v}Energised"] or status[f"{v}Pending"] for v in VALVES)


def test_a_controller_killed_in_mid_shift_leaves_no_valve_driven(
    nodes: Nodes, folder: Path
) -> None:
    """Expiry is 100 ms of rig time; what is seen of it is read every 10 ms, on either side."""
    dump = Candump(folder / "killed.log")
    try:
        dump.in_gear(4)
        ask_by_cansend(6)
        braking = dump.wait("ValveStatus", lambda status: bool(status["BrakeEnergised"]))
        nodes.controller.signal(signal.SIGKILL)
        nodes.controller.wait()
        expired = braking["ExpiredCount"] + 1
        dump.wait("ValveStatus", lambda status: status["ExpiredCount"] == expired)
        time.sleep(1.0)
    finally:
        dump.stop()
    seen = [parse(line) for line in dump.lines()]
    command = DBC.get_message_by_name("ValveCommand").frame_id
    valves = DBC.get_message_by_name("ValveStatus").frame_id
    last = max(number for number, frame in enumerate(seen) if frame.can_id == command)
    before = [frame.values for frame in seen[:last] if frame.can_id == valves][-1]
    after = [frame.values for frame in seen[last:] if frame.can_id == valves]
    gone = next(n for n, status in enumerate(after) if status["ExpiredCount"] == expired)
    lasted_us = (after[gone]["SampleTime"] - before["SampleTime"]) % 2**32
    assert lasted_us <= 120_000
    assert all(nothing_driven(status) for status in after[gone:])
    assert nodes.rig.poll() is None


def test_sigterm_ends_the_rig_well(nodes: Nodes) -> None:
    codes = nodes.stop()
    assert codes[1] == 0, nodes.rig.said
