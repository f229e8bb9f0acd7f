"""`meshpoint up`: both nodes in one terminal, from the start to a clean end."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from live_command import POLL_S, LiveCommand, live

from meshpoint.bus.logs.reader import read_log
from meshpoint.bus.pace import PaceFile
from meshpoint.cli.main import main
from meshpoint.cli.table import build_parser
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.run.up import _commands, add_parser

READY = "in gear 8, ready"
PROC = Path("/proc")
pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.skipif(not PROC.is_dir(), reason="finds child processes in /proc"),
]


@pytest.fixture
def bus(channel: str) -> list[str]:
    return ["-i", "meshpoint", "-c", channel]


def children(pid: int) -> dict[str, int]:
    """The nodes that a process has started, by name."""
    found = {}
    for path in PROC.glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            words = (path / "cmdline").read_text().split("\0")
        except (OSError, ValueError):
            continue
        if parent == pid:
            name = (
                "pace"
                if "meshpoint.bus.pace" in words
                else next(iter({"rig", "controller"} & set(words)))
            )
            found[name] = int(path.name)
    return found


def is_there(pid: int) -> bool:
    """Whether a process runs: one that has ended and is not yet collected does not."""
    try:
        return (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until_gone(pids: dict[str, int]) -> None:
    while any(is_there(pid) for pid in pids.values()):
        time.sleep(POLL_S)


def nodes(command: LiveCommand) -> dict[str, int]:
    command.until_said(READY)
    found = children(command.pid)
    assert set(found) == {"pace", "rig", "controller"}
    return found


@pytest.mark.parametrize(
    "firmware", [[], pytest.param(["--firmware", "native"], marks=pytest.mark.long)]
)
def test_a_request_from_elsewhere_shifts_and_ctrl_c_ends_both(
    tmp_path: Path, bus: list[str], firmware: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    with live(tmp_path, "up", *bus, "--seed", "3", *firmware, "--log", str(log)) as command:
        started = nodes(command)
        assert main(["request", "10", *bus, "--timeout", "600"]) == 0
        assert "8 -> 10: engaged" in capsys.readouterr().out
        command.until_said("shift 8 -> 10: engaged")
        assert main(["up", *bus]) == 2
        assert "other nodes are at work on meshpoint channel" in capsys.readouterr().err
        command.signal(signal.SIGINT)
        assert command.end() == 0, command.said
        wait_until_gone(started)
    lines = command.said.splitlines()
    assert {line.partition("|")[0].strip() for line in lines} == {"rig", "controller", "up"}
    assert any("seed 3" in line for line in lines if line.startswith("rig"))
    assert "valves off" in command.said
    receiver = Receiver(*Node)
    messages = [receiver.receive(frame).message for _, frame in read_log(log)]
    last = [message for message in messages if isinstance(message, ValveCommand)][-1]
    actions = [v for name, v in last._asdict().items() if name.endswith("_action")]
    assert set(actions) == {ValveAction.OFF_NOW}
    assert main(["replay", str(log), "--verify"]) == 0


def test_it_keeps_a_bus_time_alone_for_nodes_started_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "bus.time"
    with live(tmp_path, "up", "--pace-only", str(path)) as command:
        command.until(path.exists)
        pace = PaceFile(path)
        command.until(lambda: pace.now_us > 0)
        assert children(command.pid) == {}
        command.signal(signal.SIGTERM)
        assert command.end() == 0, command.said
    assert not path.exists()
    assert main(["up", "--pace-only", str(tmp_path / "nowhere" / "bus.time")]) == 2


def test_both_nodes_get_the_keys_by_which_commands_are_proven(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    namespace = parser.parse_args(["up", "--keys", "k.toml", "--seed", "3"])
    _, (_, rig), (_, controller) = _commands(namespace, tmp_path / "pace")
    for command in (rig, controller):
        assert command[command.index("--keys") + 1] == "k.toml"
    without, *_ = [command for _, command in _commands(parser.parse_args(["up"]), tmp_path / "p")]
    assert "--keys" not in without


def test_the_rig_alone_is_asked_for_the_trucks_other_nodes_and_a_boards_firmware(
    tmp_path: Path,
) -> None:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    namespace = parser.parse_args(["up", "--truck", "--firmware", "native"])
    _, (_, rig), (_, controller) = _commands(namespace, tmp_path / "pace")
    asked = build_parser().parse_args(rig[2:])
    assert (asked.truck_nodes, asked.firmware) == (True, "native")
    assert {"--truck", "--firmware"}.isdisjoint(controller)


@pytest.mark.long
@pytest.mark.parametrize("name", ["controller", "pace"])
def test_a_node_that_dies_ends_all(tmp_path: Path, bus: list[str], name: str) -> None:
    with live(tmp_path, "up", *bus, "--preset", "thesis") as command:
        started = nodes(command)
        os.kill(started[name], signal.SIGKILL)
        assert command.end() == 1, command.said
        wait_until_gone(started)
    assert f"meshpoint up: {name} ended by itself with exit code -9" in command.said


@pytest.mark.long
def test_the_nodes_end_well_where_up_itself_is_killed(tmp_path: Path, bus: list[str]) -> None:
    with live(tmp_path, "up", *bus, "--preset", "thesis") as command:
        started = nodes(command)
        command.signal(signal.SIGKILL)
        wait_until_gone(started)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--settings", "nowhere.toml"], "nowhere.toml: cannot be read"),
        pytest.param(
            ["--faults", "nowhere.toml"],
            "rig ended by itself with exit code 2",
            marks=pytest.mark.long,
        ),
    ],
)
def test_bad_input_is_told_by_whoever_found_it(
    tmp_path: Path, bus: list[str], arguments: list[str], said: str
) -> None:
    with live(tmp_path, "up", *bus, *arguments, "--quiet") as command:
        assert command.end() == 2
    assert said in command.said
    assert "nowhere.toml" in command.said
    assert "Traceback" not in command.said


@pytest.mark.long
def test_not_armed_nothing_is_shifted(
    tmp_path: Path, bus: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with live(tmp_path, "up", *bus, "--preset", "thesis", "--no-arm") as command:
        command.until_said(READY)
        assert main(["request", "10", *bus, "--timeout", "600"]) == 1
        assert "refused" in capsys.readouterr().err
        command.until_said("request for gear 10 refused: the outputs are not armed (--arm)")
        command.signal(signal.SIGTERM)
        assert command.end() == 0, command.said
    assert "outputs not armed" in command.said
