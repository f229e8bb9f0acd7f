"""Controller and rig at the two ends of a bus of emulated CAN controllers, by their real drivers.

What QEMU's controllers cannot do is done by the kernel's other means, and said where: a bit rate by
`tc`, a bus-off by an slcan adapter. No bit timing, no arbitration, no acknowledge is shown here.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from devices import CTU, KVASER, SerialAdapter, hurry, queue_counts, slow
from patience import until
from vcan_bench import LOOK_S, SPEED, Bench, Command, Wire, ip, meshpoint

from meshpoint.cli.table import build_parser

build_parser("check")  # loads the command, before anything is forked
CONGESTED_BIT_S = 1_000
"""By the guest's clock: a frame in half a second, which is less than the controller sends however
slow the machine makes bus time, as that goes on while frames are refused."""
LOST_FRAMES = 30
"""This many are enough to be seen, and too few for an 8-bit counter to come round."""


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """Rig and controller of this test alone, in gear 14, and candump beside them."""
    with Bench(tmp_path, request.param) as bench:
        bench.dump.in_gear(14)
        yield bench


over = pytest.mark.parametrize


def link(device: str) -> dict[str, Any]:
    """What `ip` says of a device."""
    words = ["ip", "-details", "-statistics", "-json", "link", "show", "dev", device]
    reported = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return dict(next(entry for entry in json.loads(reported) if entry))


def no_errors(wire: Wire) -> None:
    """Neither end has counted an error, or lost a frame."""
    for device in (wire.controller, wire.rig):
        reported = link(device)
        assert not any(reported["linkinfo"]["info_xstats"].values()), reported
        for way in ("rx", "tx"):
            assert reported["stats64"][way]["errors"] == reported["stats64"][way]["dropped"] == 0, (
                reported
            )


def lines_of_a_shift(bench: Bench) -> list[str]:
    """candump's lines of a shift into gear 2, in which nothing was wrong on either side."""
    outcome = bench.shift(2)
    assert outcome["ToGear"] == 2
    status = bench.dump.in_gear(2)
    assert status["E2eErrors"] == status["FormatErrors"] == 0
    lines: list[str] = bench.dump.lines()
    assert bench.stop() == [0, 0], bench.story()
    no_errors(bench.wire)
    return lines


@over("bench", [CTU], indirect=True)
def test_over_can_fd_a_gear_is_engaged_and_the_candump_log_verifies(bench: Bench) -> None:
    """The log is cut in mid-run, after a whole step; candump listened at the rig's end."""
    lines = lines_of_a_shift(bench)
    tag = bench.wire.contract.tag("ControllerStatus")
    last = max(number for number, line in enumerate(lines) if tag in line)
    log = bench.folder / "shift.log"
    log.write_text("\n".join(lines[: last + 1]) + "\n")
    verified = meshpoint(bench.folder, "replay", str(log), "--verify")
    assert verified.returncode == 0, verified.printed + verified.said
    assert "identical" in verified.printed


@over("bench", [KVASER], indirect=True)
def test_over_classic_can_a_gear_is_engaged_and_the_log_decodes_and_verifies(bench: Bench) -> None:
    """Its status has no room for step checksums: the controller's record of steps has them."""
    lines = lines_of_a_shift(bench)
    names: Counter[str] = Counter()
    for line in lines:
        seen = bench.wire.contract.parse(line)
        assert len(seen.data) <= 8
        names[seen.name] += 1
        if names[seen.name] <= 5:
            assert seen.values
    assert {"EdgesLayshaft", "ValveOrders", "ControllerStatus1", "TC1", "EEC1"} <= set(names)
    verified = meshpoint(bench.folder, "replay", str(bench.dump.path), "--verify")
    assert verified.returncode == 0, verified.printed + verified.said
    assert "identical" in verified.printed


@over("bench", [CTU], indirect=True)
def test_a_controllers_link_that_goes_down_and_comes_up_is_found_again(bench: Bench) -> None:
    """The rig's stays up: it hears nobody, as on a bus whose other node has lost its plug."""

    def said(text: str) -> None:
        until(
            lambda: text in bench.controller.said,
            f"{text!r}, from the controller",
            patience=bench.patience(),
            say=bench.story,
            poll_s=LOOK_S,
        )

    ip("set", "can2", "down")
    said("bus lost")
    ip("set", "can2", "up")
    said("bus is back")
    bench.dump.mark()
    bench.dump.in_gear(14)
    assert "bus lost" not in bench.rig.said


def missing_frames(bench: Bench) -> Counter[str]:
    """Frames of the controller that the rig's end has not seen, by their 8-bit counters."""
    dbc = bench.wire.contract.dbc
    newest: dict[str, int] = {}
    missing: Counter[str] = Counter()
    for line in bench.dump.lines():
        seen = bench.wire.contract.parse(line)
        if "TransmissionControl" not in dbc.get_message_by_frame_id(seen.can_id).senders:
            continue
        counter = seen.values.get("Counter")
        if counter is None:  # J1939
            continue
        if seen.name in newest:
            missing[seen.name] += (counter - newest[seen.name] - 1) % 256
        newest[seen.name] = counter
    return missing


@over("bench", [CTU], indirect=True)
def test_a_transmit_queue_of_ten_that_is_full_loses_nothing_untold(bench: Bench) -> None:
    """The kernel refuses frames (ENOBUFS); what it counts, the node has reported, to the frame."""
    ip("set", "can2", "txqueuelen", "10")
    slow("can2", CONGESTED_BIT_S)
    assert queue_counts("can2")["limit"] == 10
    until(
        lambda: queue_counts("can2")["drops"] >= LOST_FRAMES,
        "a queue that is full",
        patience=bench.patience(),
        say=lambda: f"{queue_counts('can2')}{bench.story()}",
        poll_s=LOOK_S,
    )
    hurry("can2")
    bench.dump.mark()
    outcome = bench.shift(2)
    assert outcome["ToGear"] == 2
    assert bench.stop() == [0, 0], bench.story()
    refused = queue_counts("can2")["drops"]
    reported = re.findall(
        r"frame 0x\w+ not sent: .*No buffer space available.* \((\d+) frames refused, (\d+) so far",
        bench.controller.said,
    )
    assert sum(int(count) for count, _ in reported) == int(reported[-1][1]) == refused
    missing = missing_frames(bench)
    assert missing["ValveCommand"] > 0
    assert missing.total() <= refused, missing


def findings_of(folder: Path, *words: str) -> dict[str, dict[str, str]]:
    """What `meshpoint check` finds of an interface, by subject."""
    record = folder / "check.json"
    checked = meshpoint(folder, "check", *words, "--seconds", "0.5", "--json", str(record))
    assert checked.returncode == 1, "nobody speaks there"
    found = json.loads(record.read_text())["findings"]
    return {one["subject"]: one for one in found if one["group"] == "interface"}


@over("wire", [KVASER, CTU])
def test_check_finds_nothing_wrong_with_a_device_that_is_set_up_as_documented(
    wire: Wire, tmp_path: Path
) -> None:
    wire.prepare()
    found = findings_of(tmp_path, *wire.options(wire.controller))
    assert {"link", "CAN FD", "bit rate", "sample point", "restart-ms", "transmit queue"} <= set(
        found
    )
    assert {one["verdict"] for one in found.values()} == {"good"}, found


def test_the_fd_profile_is_refused_on_a_classic_controller_with_both_ways_out(
    tmp_path: Path,
) -> None:
    KVASER.prepare()
    for node in ("controller", "rig"):
        refused = meshpoint(tmp_path, node, "-i", "socketcan", "-c", "can0")
        assert refused.returncode == 2, refused.said
        assert "can0 is set up for classic CAN, but CAN FD is needed" in refused.said
        assert "dbitrate 2000000 dsample-point 0.8 fd on`" in refused.said
        assert "start controller and rig with --profile classic" in refused.said
    fd = subprocess.run(
        ["ip", "link", "set", "can0", "type", "can", "dbitrate", "2000000", "fd", "on"],
        check=False,
    )
    assert fd.returncode != 0, "the first way out is for adapters that have CAN FD"


def test_a_bus_off_that_nothing_restarts_is_told_by_node_and_check(tmp_path: Path) -> None:
    """By an slcan adapter: QEMU's controllers have no error counters, and never go bus-off."""
    with SerialAdapter() as adapter:
        ip("set", adapter.device, "type", "can", "bitrate", "500000")
        ip("set", adapter.device, "up")
        words = ["-i", "socketcan", "-c", adapter.device, "--profile", "classic"]
        cheap = ["--estimator", "thesis", "--strategy", "speed_window", "--speed", str(SPEED)]
        headers = ["--header-dir", str(tmp_path)]
        node = Command(tmp_path, "controller", "--no-arm", *cheap, *headers, *words)

        def until_said(text: str) -> None:
            until(lambda: text in node.said, f"{text!r} from the node", say=lambda: node.said)

        until(lambda: b"\rT" in adapter.heard, "a frame of the node", say=lambda: node.said)
        adapter.say("sb256256")
        until_said("CAN controller is bus-off (1 so far)")
        assert "With restart-ms 0 it never does by itself" in node.said
        silent = len(adapter.heard)
        found = findings_of(tmp_path, *words)
        assert found["controller state"]["verdict"] == "bad"
        assert "BUS-OFF" in found["controller state"]["text"]
        assert "restart-ms is 0" in found["controller state"]["text"]
        assert len(adapter.heard) == silent
        ip("set", adapter.device, "down")
        until_said("bus lost")
        ip("set", adapter.device, "up")
        until_said("bus is back")
        until(lambda: b"\rT" in adapter.heard[silent:], "a frame after it", say=lambda: node.said)
        node.signal(signal.SIGTERM)
        assert node.wait() == 0, node.said
