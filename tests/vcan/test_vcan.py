"""Controller and rig as two processes on a real vcan0. Each test has nodes of its own."""

from __future__ import annotations

import signal
import subprocess
from collections import Counter

import pytest
from vcan_bench import (
    CLASSIC,
    CLASSIC_VCAN,
    DBC,
    FD,
    GAP_MS,
    PATIENCE_BUS_S,
    VALVES,
    VCAN,
    Bench,
    Values,
    ip,
    meshpoint,
    parse,
)

VCAN_BUS = VCAN.options("vcan0")
PATIENT = ["--timeout", str(PATIENCE_BUS_S)]


def test_a_gear_is_engaged_beside_other_traffic_and_sigterm_ends_both_nodes_well(
    bench: Bench,
) -> None:
    """Asked for by cansend, beside other people's frames, classic and FD. What candump wrote is cut
    after a whole step, decodes, and verifies."""
    traffic = [
        subprocess.Popen(["cangen", "vcan0", "-g", GAP_MS, "-I", can_id, "-L", "8", *more])
        for can_id, more in (("5A5", []), ("1ABCDE77", ["-e", "-f"]))
    ]
    try:
        assert bench.shift(2)["ToGear"] == 2
        status = bench.dump.in_gear(2)
        assert status["ForeignFrames"] > 0
        assert status["E2eErrors"] == status["FormatErrors"] == 0
    finally:
        for one in traffic:
            one.terminate()
            one.wait()
    lines = bench.dump.lines()
    assert bench.stop() == [0, 0], bench.story()
    step = FD.tag("ControllerStatus")
    last = max(number for number, line in enumerate(lines) if step in line)
    log = bench.folder / "shift.log"
    log.write_text("\n".join(lines[: last + 1]) + "\n")
    names: Counter[str] = Counter()
    ours = {message.frame_id for message in DBC.messages}
    for seen in map(parse, lines[: last + 1]):
        if seen.can_id in ours:
            names[seen.name] += 1
            assert names[seen.name] > 5 or seen.values
    assert {"EdgesLayshaftRise", "ValveCommand", "ControllerStatus", "TC1"} <= set(names)
    verified = meshpoint(bench.folder, "replay", str(log), "--verify")
    assert verified.returncode == 0, verified.printed + verified.said
    assert "identical" in verified.printed


@pytest.mark.parametrize("bench", [CLASSIC_VCAN], indirect=True)
def test_over_the_classic_profile_a_gear_is_engaged_and_the_candump_log_verifies(
    bench: Bench,
) -> None:
    """In frames of 8 bytes, which name no steps: the controller's record beside the log does."""
    assert bench.shift(2)["ToGear"] == 2
    status = bench.dump.in_gear(2)
    assert status["E2eErrors"] == status["FormatErrors"] == 0
    assert bench.stop() == [0, 0], bench.story()
    lines = bench.dump.lines()
    assert lines
    assert all("##" not in line and len(CLASSIC.parse(line).data) <= 8 for line in lines)
    verified = meshpoint(bench.folder, "replay", str(bench.dump.path), "--verify")
    assert verified.returncode == 0, verified.printed + verified.said
    assert "identical" in verified.printed


def test_a_bus_that_goes_down_or_is_made_anew_is_found_again(bench: Bench) -> None:
    """In the gear that `meshpoint request` asked for."""
    asked = meshpoint(bench.folder, "request", "2", *VCAN_BUS, *PATIENT)
    assert asked.returncode == 0, asked.said + bench.story()
    assert "-> 2: engaged" in asked.printed or "in gear 2" in asked.printed
    bench.dump.in_gear(2)
    ip("set", "vcan0", "down")
    bench.wait_said("bus lost")
    ip("set", "vcan0", "up")
    bench.wait_said("bus is back")
    bench.dump.mark()
    bench.dump.in_gear(2)
    ip("del", "vcan0")
    bench.wait_said("bus lost", 2)
    ip("add", "dev", "vcan0", "type", "vcan")
    ip("set", "vcan0", "mtu", "72")
    ip("set", "vcan0", "up")
    bench.wait_said("bus is back", 2)
    with bench.another_candump() as dump:
        dump.in_gear(2)


def nothing_driven(status: Values) -> bool:
    return not any(status[f"{v}Energised"] or status[f"{v}Pending"] for v in VALVES)


def test_a_controller_killed_in_mid_shift_leaves_no_valve_driven(bench: Bench) -> None:
    """Expiry is 100 ms of rig time; what is seen of it is read every 10 ms, on either side."""
    braking = bench.shift(2, "ValveStatus", lambda status: bool(status["BrakeEnergised"]))
    bench.controller.signal(signal.SIGKILL)
    bench.controller.wait()
    expired = braking["ExpiredCount"] + 1
    gone = bench.dump.wait("ValveStatus", lambda status: status["ExpiredCount"] == expired)
    # And it stays so: three times as long as a valve command lasts.
    off_us = gone["SampleTime"]
    bench.dump.wait("ValveStatus", lambda s: (s["SampleTime"] - off_us) % 2**32 > 300_000)
    seen = [parse(line) for line in bench.dump.lines()]
    command = DBC.get_message_by_name("ValveCommand").frame_id
    valves = DBC.get_message_by_name("ValveStatus").frame_id
    last = max(number for number, frame in enumerate(seen) if frame.can_id == command)
    before = [frame.values for frame in seen[:last] if frame.can_id == valves][-1]
    after = [frame.values for frame in seen[last:] if frame.can_id == valves]
    off = next(n for n, status in enumerate(after) if status["ExpiredCount"] == expired)
    lasted_us = (after[off]["SampleTime"] - before["SampleTime"]) % 2**32
    assert lasted_us <= 120_000
    assert all(nothing_driven(status) for status in after[off:])
    assert bench.rig.poll() is None
