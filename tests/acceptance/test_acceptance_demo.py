"""`meshpoint demo`: two strategies, a table, files, and a log that verifies itself."""

from __future__ import annotations

import math
import re
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import can
import pytest
from acceptance_bus import open_bus
from acceptance_kit import Outcome, assert_ended_well, kill_group, run, start, strict_json
from acceptance_wire import CANDUMP_LINE, Wire, read_log, verdict_of
from patience import HANG_S

SHIFTS_VIRTUAL = 4
SHIFTS_TWO_PROCESSES = 2


class Demo(NamedTuple):
    """One demo that has run, the folder it wrote, and how many upshifts it was asked for."""

    outcome: Outcome
    folder: Path
    shifts: int

    @property
    def report(self) -> dict[str, Any]:
        report: dict[str, Any] = strict_json((self.folder / "run.json").read_text())
        return report

    @property
    def logs(self) -> list[Path]:
        return sorted(self.folder.rglob("*.log"))


@pytest.fixture(scope="session")
def one_process(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("demo") / "virtual"
    arguments = ["-i", "virtual", "--shifts", SHIFTS_VIRTUAL, "--seed", 1, "--out", folder]
    return Demo(run("demo", *arguments), folder, SHIFTS_VIRTUAL)


@pytest.fixture(scope="session")
def two_processes(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    folder = tmp_path_factory.mktemp("demo") / "default"
    arguments = ["--shifts", SHIFTS_TWO_PROCESSES, "--seed", 2, "--out", folder]
    return Demo(run("demo", *arguments), folder, SHIFTS_TWO_PROCESSES)


@pytest.fixture(scope="session", params=["one_process", "two_processes"])
def demo(request: pytest.FixtureRequest) -> Demo:
    demo: Demo = request.getfixturevalue(request.param)
    return demo


def test_the_demo_ends_well(demo: Demo) -> None:
    assert_ended_well(demo.outcome)


def test_run_json_has_every_shift_of_both_strategies(demo: Demo) -> None:
    report = demo.report
    assert {"shifts", "provenance"} <= set(report)
    assert len(report["shifts"]) == 2 * demo.shifts
    for row in report["shifts"]:
        assert row["contact"] in ("gap", "tooth")
        assert row["reference"] in ("known", "unknown")
        assert math.isfinite(row["phase_error_deg"]) and abs(row["phase_error_deg"]) <= 3.75
        assert 100.0 < row["duration_ms"] < 5000.0


def test_the_table_has_one_row_a_shift_and_a_summary_of_both_strategies(demo: Demo) -> None:
    lines = demo.outcome.out.splitlines()
    shift_rows = [
        line
        for line in lines
        if re.search(r"\b(gap|tooth)\b", line)
        and re.search(r"\b(known|unknown)\b", line)
        and len(re.findall(r"-?\d+(?:\.\d+)?", line)) >= 6
    ]
    assert len(shift_rows) == 2 * demo.shifts, demo.outcome.out
    for strategy in ("speed_window", "target_phase"):
        assert any(strategy in line for line in lines)


def test_every_shift_reached_its_gear_live(demo: Demo, wire: Wire) -> None:
    outcomes = [
        wire.decode(frame)
        for log in demo.logs
        for frame in read_log(log)
        if wire.name(frame.can_id) == "ShiftOutcome"
    ]
    assert len(outcomes) == 2 * demo.shifts
    assert {outcome["Result"] for outcome in outcomes} == {1}


def test_the_logs_are_candump_text_of_frames_of_the_contract(demo: Demo, wire: Wire) -> None:
    assert demo.logs, [path.name for path in demo.folder.rglob("*")]
    for log in demo.logs:
        for line in log.read_text().splitlines():
            assert CANDUMP_LINE.match(line), line
        assert {frame.can_id for frame in read_log(log)} <= set(wire.messages)


def test_the_log_of_the_demo_misses_no_frame(demo: Demo, wire: Wire) -> None:
    for log in demo.logs:
        last: dict[int, int] = {}
        lost: dict[str, int] = {}
        for frame in read_log(log):
            if wire.data_id(frame.can_id) is None:
                continue
            if frame.can_id in last and (frame.data[2] - last[frame.can_id]) % 256 != 1:
                name = str(wire.name(frame.can_id))
                lost[name] = lost.get(name, 0) + 1
            last[frame.can_id] = frame.data[2]
            assert wire.crc_holds(frame)
        # The commander of a node may be started anew between the strategies.
        assert all(count <= 1 for count in lost.values()), lost


def test_the_plot_is_a_picture(demo: Demo) -> None:
    pictures = list(demo.folder.rglob("*.png"))
    assert pictures
    for picture in pictures:
        raw = picture.read_bytes()
        assert raw.startswith(b"\x89PNG\r\n\x1a\n")
        width, height = struct.unpack(">II", raw[16:24])
        assert width >= 400 and height >= 300 and len(raw) > 10_000


def test_the_demo_verifies_its_own_log_and_says_so(demo: Demo) -> None:
    assert "identical" in demo.outcome.out.lower(), demo.outcome.text


def test_replay_verifies_the_log_of_the_demo_again(demo: Demo) -> None:
    for log in demo.logs:
        outcome = run("replay", log, "--verify")
        assert_ended_well(outcome)
        assert verdict_of(outcome) == "identical", outcome.text


def test_reference_is_unknown_at_the_first_engagement_alone(demo: Demo) -> None:
    aimed = demo.report["shifts"][demo.shifts :]
    seen: set[int] = set()
    for row in aimed:
        assert (row["reference"] == "unknown") == (row["to"] not in seen), row
        seen.add(row["to"])
    assert demo.report["shifts"][0]["reference"] == "unknown"


class Witness(NamedTuple):
    """A demo on a channel of its own, and a log of it that another tool wrote."""

    demo: Demo
    log: Path


@pytest.fixture
def witnessed(channel: str, tmp_path: Path) -> Iterator[Witness]:
    folder = tmp_path / "demo"
    log = tmp_path / "witness" / "witness.log"
    log.parent.mkdir()
    bus = open_bus(channel)
    writer = can.CanutilsLogWriter(str(log))
    stop = threading.Event()

    def listen() -> None:
        while not stop.is_set():
            message = bus.recv(0.1)
            if message is not None:
                writer.on_message_received(message)

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    arguments = ["-i", "meshpoint", "-c", channel, "--shifts", 1, "--seed", 3, "--out", folder]
    process = start("demo", *arguments, cwd=tmp_path)
    try:
        out, err = process.communicate(timeout=HANG_S)
        outcome = Outcome(process.returncode, out, err)
        stop.set()
        thread.join(2)
        writer.stop()
        yield Witness(Demo(outcome, folder, 1), log)
    finally:
        stop.set()
        thread.join(2)
        kill_group(process)
        bus.shutdown()


def test_a_candump_log_of_the_same_run_verifies_too(witnessed: Witness, wire: Wire) -> None:
    assert_ended_well(witnessed.demo.outcome)
    own = witnessed.demo.logs[0]
    # The header is saved beside the log: with it beside the witness's log, that one verifies.
    for path in own.parent.iterdir():
        if path.name.startswith("header"):
            (witnessed.log.parent / path.name).write_bytes(path.read_bytes())
    seen = read_log(witnessed.log)
    assert {wire.name(frame.can_id) for frame in seen} >= {"ValveCommand", "EdgesLayshaftRise"}
    outcome = run("replay", witnessed.log, "--verify")
    assert verdict_of(outcome) == "identical", outcome.text
