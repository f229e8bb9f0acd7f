"""Bad input gets one clear line and exit code 2."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pytest
from acceptance_kit import THESIS_SHEET, Outcome, assert_refused, run, words


class Sheet(NamedTuple):
    """A data sheet spoilt in one place, and what its refusal must name."""

    spoil: Callable[[str], str]
    named: tuple[str, ...]


def replaced(old: str, new: str) -> Callable[[str], str]:
    def spoil(text: str) -> str:
        assert old in text, f"the sheet no longer holds {old!r}"
        return text.replace(old, new, 1)

    return spoil


TORQUE = "max_torque_nm = 100.0"
SHEETS = {
    "unknown key": Sheet(replaced(TORQUE, TORQUE + "\nmax_torqe_nm = 100.0"), ("max_torqe_nm",)),
    "unknown table": Sheet(lambda text: text + "\n[turbo]\nboost_bar = 1.0\n", ("turbo",)),
    "missing key": Sheet(replaced(TORQUE, ""), ("max_torque_nm",)),
    "nan": Sheet(replaced(TORQUE, "max_torque_nm = nan"), ("max_torque_nm",)),
    "inf": Sheet(replaced(TORQUE, "max_torque_nm = inf"), ("max_torque_nm",)),
    "negative": Sheet(replaced(TORQUE, "max_torque_nm = -100.0"), ("max_torque_nm", "-100")),
    "too large": Sheet(replaced(TORQUE, "max_torque_nm = 1e12"), ("max_torque_nm",)),
    "text": Sheet(replaced(TORQUE, 'max_torque_nm = "100"'), ("max_torque_nm",)),
    "true": Sheet(replaced(TORQUE, "max_torque_nm = true"), ("max_torque_nm",)),
    "half a tooth": Sheet(replaced("teeth = 48", "teeth = 48.5"), ("teeth",)),
    "no tooth": Sheet(replaced("teeth = 48", "teeth = 0"), ("teeth",)),
    "teeth without end": Sheet(replaced("teeth = 48", "teeth = 10000000000000000000"), ("teeth",)),
    "not toml": Sheet(lambda text: "this is = = not toml [", ()),
    "empty": Sheet(lambda text: "", ()),
    "table for a number": Sheet(
        replaced(TORQUE, "max_torque_nm = { value = 100.0 }"), ("max_torque_nm",)
    ),
    "number for a table": Sheet(
        lambda text: "brake = 3\n" + text.replace("[brake]", "[brakes]"), ("brake",)
    ),
}

SIMULATE = words("simulate --preset thesis --seed 1 --shifts 1")
# arguments; words that the error names
COMMANDS: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "no command": ([], ()),
    "unknown command": (["fly"], ("fly", "simulate")),
    "negative shifts": ([*SIMULATE[:-1], "-1"], ("shifts", "-1")),
    "shifts no number": ([*SIMULATE[:-1], "many"], ("shifts", "many")),
    "negative seed": (["simulate", "--seed", "-1", "--shifts", "1"], ("seed", "-1")),
    "seed no number": (["simulate", "--seed", "x", "--shifts", "1"], ("seed", "x")),
    "unknown strategy": (
        [*SIMULATE, "--strategy", "hope"],
        ("strategy", "hope", "speed_window", "target_phase"),
    ),
    "unknown estimator": (
        [*SIMULATE, "--estimator", "oracle"],
        ("estimator", "oracle", "window", "thesis"),
    ),
    "unknown preset": (["simulate", "--preset", "car"], ("preset", "car", "thesis")),
    "unknown option": ([*SIMULATE, "--colour", "red"], ("--colour",)),
    "no folder for the log": ([*SIMULATE, "--log", "taken/run.log"], ("taken",)),
    "no folder for the json": ([*SIMULATE, "--json", "taken/run.json"], ("taken",)),
    "log of unknown ending": ([*SIMULATE, "--log", "run.xyz"], ("run.xyz",)),
    "interface of the controller": (
        ["controller", "-i", "nosuchbus", "-c", "x"],
        ("nosuchbus", "socketcan"),
    ),
    "interface of the rig": (["rig", "-i", "nosuchbus", "-c", "x"], ("nosuchbus",)),
    "interface of the request": (["request", "10", "-i", "nosuchbus", "-c", "x"], ("nosuchbus",)),
    "interface of the demo": (["demo", "-i", "nosuchbus", "--shifts", "1"], ("nosuchbus",)),
    "missing channel": (["controller", "-i", "socketcan"], ("channel",)),
    "a device that is not there": (["controller", "-i", "socketcan", "-c", "nocan9"], ("nocan9",)),
    "a socket nobody may make": (
        ["rig", "-i", "meshpoint", "-c", "unix:taken/bus.sock"],
        ("taken",),
    ),
    "a channel of unknown kind": (
        ["rig", "-i", "meshpoint", "-c", "carrier-pigeon:1"],
        ("pigeon",),
    ),
    "a host that is not this one": (
        ["rig", "-i", "meshpoint", "-c", "tcp:192.0.2.1:29536"],
        ("192.0.2.1",),
    ),
    "a gear that is none": (["request", "99", "-i", "virtual", "-c", "x"], ("99",)),
    "a gear that is no number": (["request", "ten", "-i", "virtual", "-c", "x"], ("ten",)),
    "speed zero": (["rig", "--speed", "0", "-i", "virtual", "-c", "x"], ("speed", "0")),
    "speed negative": (["controller", "--speed", "-1", "-i", "virtual", "-c", "x"], ("speed",)),
    "speed nan": (["rig", "--speed", "nan", "-i", "virtual", "-c", "x"], ("speed", "nan")),
    "speed of the demo": (["demo", "--speed", "inf", "-i", "virtual"], ("speed", "inf")),
    "shifts of the demo": (["demo", "--shifts", "-4", "-i", "virtual"], ("shifts", "-4")),
    "a file for the folder of the demo": (
        ["demo", "-i", "virtual", "--shifts", "1", "--out", "taken"],
        ("taken",),
    ),
    "sheet of the rig": (
        ["rig", "--gearbox", "none.toml", "-i", "virtual", "-c", "x"],
        ("none.toml",),
    ),
}


@pytest.fixture(scope="session")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Outcome]:
    """All the commands, two at a time; a command that starts to work instead counts as ended."""
    folder = tmp_path_factory.mktemp("bad")
    (folder / "taken").write_text("a file")
    whole = THESIS_SHEET.read_text()
    commands: dict[str, list[str]] = {name: args for name, (args, _) in COMMANDS.items()}
    for name, sheet in SHEETS.items():
        path = folder / f"{name.replace(' ', '-')}.toml"
        path.write_text(sheet.spoil(whole))
        commands[f"sheet: {name}"] = [*SIMULATE, "--gearbox", str(path)]
    (folder / "binary.toml").write_bytes(bytes(range(256)))
    commands["sheet: binary"] = [*SIMULATE, "--gearbox", "binary.toml"]
    commands["sheet: folder"] = [*SIMULATE, "--gearbox", "."]
    commands["sheet: absent"] = [*SIMULATE, "--gearbox", "absent.toml"]

    def attempt(arguments: list[str]) -> Outcome:
        try:
            return run(*arguments, cwd=folder)
        except AssertionError as error:
            return Outcome(-1, "", str(error), 40.0)

    with ThreadPoolExecutor(max_workers=2) as pool:
        return dict(zip(commands, pool.map(attempt, commands.values()), strict=True))


@pytest.mark.parametrize("name", COMMANDS)
def test_a_bad_command_is_refused_in_one_line(refusals: dict[str, Outcome], name: str) -> None:
    assert_refused(refusals[name], *COMMANDS[name][1])


@pytest.mark.parametrize("name", SHEETS)
def test_a_malformed_sheet_is_refused_by_file_and_key(
    refusals: dict[str, Outcome], name: str
) -> None:
    outcome = refusals[f"sheet: {name}"]
    assert_refused(outcome, f"{name.replace(' ', '-')}.toml", *SHEETS[name].named)


@pytest.mark.parametrize("name", ["negative", "too large", "nan", "no tooth"])
def test_a_value_out_of_range_is_reported_the_range(
    refusals: dict[str, Outcome], name: str
) -> None:
    line = refusals[f"sheet: {name}"].err.lower()
    hints = ("allowed", "must be", "between", "range", "..", "expected", "at least")
    assert any(word in line for word in hints), refusals[f"sheet: {name}"].text


@pytest.mark.parametrize(
    ("name", "file"), [("binary", "binary.toml"), ("absent", "absent.toml"), ("folder", ".")]
)
def test_what_is_no_sheet_is_refused_by_name(
    refusals: dict[str, Outcome], name: str, file: str
) -> None:
    assert_refused(refusals[f"sheet: {name}"], file)


def test_a_refused_command_leaves_nothing_behind(tmp_path: Path) -> None:
    run(*SIMULATE, "--strategy", "hope", "--log", "run.log", "--json", "run.json", cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["controller", "rig", "request", "demo"])
def test_the_bus_arguments_are_those_of_python_can(command: str) -> None:
    outcome = run(command, "--help")
    assert outcome.code == 0
    for option in words("-i --interface -c --channel --fd -b --bitrate --data-bitrate --config"):
        assert option in outcome.out, f"{command} has no {option}"
