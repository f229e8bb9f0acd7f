"""Rig and controller as two processes on a bus of their own, watched by a third party."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from acceptance_bus import Listener, processes_naming
from acceptance_kit import EXPIRY_US, Outcome, assert_ended_well, kill_group, run, start, words
from acceptance_wire import Wire, us_between
from patience import HANG_S, until

IN_GEAR = 1
ENGAGED = 1
VALVES = words(
    "Brake SplitLow SplitHigh MainFirst MainSecond MainCrawl MainThird RangeLow RangeHigh"
)


class Bench:
    """Rig, controller and a listener on one private channel."""

    def __init__(self, channel: str, wire: Wire, cwd: Path, apart_s: float = 0.0) -> None:
        """The controller starts so long before the rig, or after it where negative."""
        self.channel, self.wire, self.cwd = channel, wire, cwd
        self.started: list[subprocess.Popen[str]] = []
        # Bus time that waits for a node which the machine stops, so that these tests judge the
        # nodes and not the machine.
        self.pace = cwd / "pace"
        self.started.append(start("up", "--pace-only", self.pace, cwd=cwd))
        while not self.pace.exists() or not self.pace.stat().st_size:
            time.sleep(0.01)
        if apart_s > 0.0:
            self.controller = self.node("controller")
            time.sleep(apart_s)
            self.rig = self.node("rig", "--as-built", "clean")
        else:
            self.rig = self.node("rig", "--as-built", "clean")
            time.sleep(-apart_s)
            self.controller = self.node("controller")
        self.listener = Listener(channel, wire)

    def node(self, name: str, *arguments: object) -> subprocess.Popen[str]:
        pace = ["--pace", self.pace] if name in ("rig", "controller") else []
        bus = ["-i", "meshpoint", "-c", self.channel]
        process = start(name, *bus, *pace, *arguments, cwd=self.cwd)
        self.started.append(process)
        return process

    def request(self, gear: int) -> Outcome:
        return run("request", gear, "-i", "meshpoint", "-c", self.channel)

    def in_gear(self, gear: int, since: int = 0) -> int:
        """Wait until the controller stands in this gear, with every channel valid."""
        for process in (self.rig, self.controller):
            if process.poll() is not None:
                raise AssertionError(f"a node ended: {process.communicate()}")
        return self.listener.wait(
            "ControllerStatus",
            lambda status: (
                status["State"] == IN_GEAR
                and status["CurrentGear"] == gear
                and status["InvalidChannels"] == 0
            ),
            since=since,
        )

    def start_shift(self, gear: int) -> None:
        self.node("request", gear)

    def braking(self, since: int) -> int:
        """Wait until the brake valve is driven, in mid-shift."""
        return self.listener.wait(
            "ValveStatus", lambda status: bool(status["BrakeEnergised"]), since=since
        )

    def close(self) -> None:
        self.listener.close()
        for process in self.started:
            kill_group(process)


def all_off(command: dict[str, Any]) -> bool:
    return all(command[f"{valve}Action"] == 0 for valve in VALVES)


def nothing_driven(status: dict[str, Any]) -> bool:
    return not any(status[f"{v}Energised"] or status[f"{v}Pending"] for v in VALVES)


def end(process: subprocess.Popen[str], number: int) -> Outcome:
    """Signal a node and wait for its end."""
    os.kill(process.pid, number)
    out, err = process.communicate(timeout=HANG_S)
    return Outcome(process.returncode, out, err)


@pytest.fixture
def bench(channel: str, wire: Wire, tmp_path: Path) -> Iterator[Bench]:
    with contextlib.closing(Bench(channel, wire, tmp_path)) as bench:
        yield bench


def test_a_request_moves_the_rig_to_the_gear(bench: Bench) -> None:
    since = bench.in_gear(8)
    assert_ended_well(bench.request(10))
    at = bench.listener.wait("ShiftOutcome", since=since)
    outcome = bench.wire.decode(bench.listener.frames[at])
    assert (outcome["FromGear"], outcome["ToGear"]) == (8, 10)
    assert outcome["Result"] == ENGAGED
    bench.in_gear(10, since=at)

    # The truth agrees: the second gear of the main box locked, nothing lost on the way.
    locked = [one for one in bench.listener.of("ReferenceEngagement", since) if one["Event"] == 4]
    assert locked and locked[-1]["Gear"] == 3
    counters: dict[int, int] = {}
    for frame in bench.listener.frames:
        if frame.can_id in bench.wire.messages and bench.wire.data_id(frame.can_id) is not None:
            before = counters.get(frame.can_id)
            assert before is None or (frame.data[2] - before) % 256 == 1
            assert bench.wire.crc_holds(frame)
            counters[frame.can_id] = frame.data[2]


def test_bad_frames_are_counted_and_the_run_goes_on(bench: Bench) -> None:
    bench.in_gear(8)
    listener, wire = bench.listener, bench.wire
    before = wire.decode(listener.last("ControllerStatus"))
    edges = wire.ids["EdgesLayshaftRise"]
    for _ in range(3):
        listener.send(edges, bytes(8))
    listener.send(wire.ids["ValveStatus"], bytes(8), fd=False)
    listener.send(0x1ABCDEF0, b"\1\2\3", fd=False)
    listener.send(0x1ABCDEF1, bytes(64))
    listener.send(0x123, b"\1", extended=False, fd=False)
    listener.send(0x7FF, b"", extended=False, fd=False)
    listener.send(0x18FFFFFE, bytes(8), fd=False)
    wrong = ("EdgesMainRise", "EdgesInputFall", "GearboxSensors", "SleevesMain")
    for name in wrong:
        frame = listener.last(name)
        listener.send(frame.can_id, frame.data[:-1] + bytes([frame.data[-1] ^ 0x55]))
    since = listener.position()
    at = listener.wait(
        "ControllerStatus",
        lambda status: status["StepNumber"] > before["StepNumber"] + 50,
        since=since,
    )
    after = wire.decode(listener.frames[at])
    counted = {
        name: (after[name] - before[name]) % 65536
        for name in ("FormatErrors", "ForeignFrames", "E2eErrors")
    }
    assert counted == {"FormatErrors": 4, "ForeignFrames": 5, "E2eErrors": 4}
    assert after["State"] == IN_GEAR

    assert_ended_well(bench.request(10))
    bench.in_gear(10, since=at)


def test_spoofed_reference_frames_move_nothing(bench: Bench) -> None:
    bench.in_gear(8)
    listener, wire = bench.listener, bench.wire
    before = wire.decode(listener.last("ControllerStatus"))
    speed_before = wire.decode(listener.last("ControllerEstimates"))["LayshaftSpeed"]
    since = listener.position()
    for counter in range(40):
        angles = {f"Angle{i:02}": 1000.0 * counter % 92000 for i in range(5)}
        speeds = {f"Speed{i:02}": -4000.0 for i in range(5)}
        spoofs: dict[str, dict[str, float]] = {
            "ReferenceEncoder": {"SampleTime": 5, **angles, **speeds},
            "ReferencePhase": {"SampleTime": 5, "MainSpeed": 9000.0, "PhaseSecond": 3.0},
            "ReferenceEngagement": {"Event": 4, "Gear": 4, "Phase": 3.0, "Slip": -500.0},
        }
        for name, values in spoofs.items():
            listener.send(wire.ids[name], wire.encode(name, counter, **values))
        time.sleep(0.01)
    at = listener.wait(
        "ControllerStatus",
        lambda status: status["StepNumber"] > before["StepNumber"] + 60,
        since=since,
    )
    after = wire.decode(listener.frames[at])
    assert after["State"] == IN_GEAR and after["CurrentGear"] == 8
    for name in ("E2eErrors", "FormatErrors", "ForeignFrames", "ReferenceKnown", "ActiveFault"):
        assert after[name] == before[name], name
    assert all(all_off(command) for command in listener.of("ValveCommand", since, at))
    for estimate in listener.of("ControllerEstimates", since, at):
        assert estimate["LayshaftSpeed"] == pytest.approx(speed_before, abs=30.0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["SIGTERM", "SIGINT"])
def test_a_signal_in_mid_shift_ends_both_nodes_with_the_valves_off(
    bench: Bench, number: int
) -> None:
    since = bench.in_gear(8)
    bench.start_shift(10)
    bench.braking(since)
    for node in (bench.controller, bench.rig):
        outcome = end(node, number)
        assert_ended_well(outcome)
        time.sleep(0.1)
    assert all_off(bench.listener.of("ValveCommand", since)[-1])
    assert nothing_driven(bench.listener.of("ValveStatus", since)[-1])


def test_the_valves_expire_when_the_controller_is_killed(bench: Bench) -> None:
    since = bench.in_gear(8)
    bench.start_shift(10)
    bench.braking(since)
    os.kill(bench.controller.pid, signal.SIGKILL)
    bench.controller.wait(HANG_S)
    listener, wire = bench.listener, bench.wire
    # Bus time stands for a second before it gives a node up. Then the valves stay off.
    off = listener.wait("ValveStatus", nothing_driven, since=listener.position())
    off_us = wire.decode(listener.frames[off])["SampleTime"]
    listener.wait(
        "ValveStatus", lambda s: us_between(off_us, s["SampleTime"]) > 10 * EXPIRY_US, since=off
    )
    valve_command = wire.ids["ValveCommand"]
    last = max(
        index for index, frame in enumerate(listener.frames) if frame.can_id == valve_command
    )
    before = listener.of("ValveStatus", since, last)[-1]
    after = listener.of("ValveStatus", last)
    assert not nothing_driven(after[0]), "the valves were off before the controller was killed"
    off = next(index for index, status in enumerate(after) if nothing_driven(status))
    lasted_us = us_between(before["SampleTime"], after[off]["SampleTime"])
    assert lasted_us <= EXPIRY_US + 20_000  # status comes every 10 ms, on either side
    assert all(nothing_driven(status) for status in after[off:])
    assert after[-1]["ExpiredCount"] == before["ExpiredCount"] + 1
    assert bench.rig.poll() is None


def test_a_controller_that_starts_anew_finds_its_gear(bench: Bench) -> None:
    bench.in_gear(8)
    os.kill(bench.controller.pid, signal.SIGKILL)
    bench.controller.wait(HANG_S)
    since = bench.listener.position()
    bench.controller = bench.node("controller")
    since = bench.in_gear(8, since=since)
    assert_ended_well(bench.request(10))
    bench.in_gear(10, since=since)


@pytest.mark.parametrize("apart_s", [2.0, -2.0], ids=["controller first", "rig first"])
def test_the_nodes_may_start_in_either_order(
    channel: str, wire: Wire, tmp_path: Path, apart_s: float
) -> None:
    with contextlib.closing(Bench(channel, wire, tmp_path, apart_s)) as bench:
        bench.in_gear(8)


def test_a_bus_that_goes_away_is_said_and_found_again(bench: Bench, wire: Wire) -> None:
    bench.in_gear(8)
    own = {process.pid for process in bench.started}
    hubs = [
        (pid, line)
        for pid, line in processes_naming(bench.channel.removeprefix("unix:"))
        if pid not in own and pid != os.getpid()
    ]
    assert len(hubs) == 1, f"expected one process that holds the bus, found {hubs}"
    os.kill(hubs[0][0], signal.SIGKILL)
    time.sleep(2.5)
    assert bench.rig.poll() is None and bench.controller.poll() is None
    bench.listener.close()
    bench.listener = Listener(bench.channel, wire)
    bench.in_gear(8)
    assert_ended_well(bench.request(10))
    bench.in_gear(10)
    ended = end(bench.controller, signal.SIGTERM)
    assert ended.code == 0
    said = (ended.out + ended.err).lower()
    assert "bus" in said and any(word in said for word in ("again", "retry", "lost", "gone")), said


def test_a_request_that_nobody_hears_ends_by_itself(channel: str) -> None:
    outcome = run("request", 10, "-i", "meshpoint", "-c", channel)
    assert "Traceback" not in outcome.err
    assert outcome.code != 0, "nobody answered, and the command calls it a success"


def test_speed_scales_the_clocks_of_both(channel: str, wire: Wire, tmp_path: Path) -> None:
    """Over the wall's time as the same frames came, for as long as it takes: what the machine makes
    late counts the less the longer it lasts, while a clock not scaled stays wrong."""
    rig = start("rig", "--speed", 2, "-i", "meshpoint", "-c", channel, cwd=tmp_path)
    controller = start("controller", "--speed", 2, "-i", "meshpoint", "-c", channel, cwd=tmp_path)
    listener = Listener(channel, wire)

    def speed(name: str, clock: str) -> float:
        wanted = wire.ids[name]
        frames = [frame for frame in listener.frames[first:] if frame.can_id == wanted]
        if len(frames) < 300:
            return 0.0
        one, other = (wire.decode(frame)[clock] for frame in (frames[0], frames[-1]))
        return us_between(one, other) / 1e6 / (frames[-1].time_s - frames[0].time_s)

    def speeds() -> list[float]:
        return [speed("ControllerStatus", "StepTime"), speed("EdgesMainRise", "ReadTime")]

    try:
        first = listener.wait("ControllerStatus", lambda s: s["State"] == IN_GEAR)
        until(
            lambda: speeds() == pytest.approx([2.0, 2.0], rel=0.1),
            "both clocks twice as fast as the wall",
            say=speeds,
            poll_s=0.5,
        )
    finally:
        listener.close()
        for process in (rig, controller):
            kill_group(process)
