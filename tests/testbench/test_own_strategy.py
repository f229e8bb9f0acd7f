"""A user's own strategy in simulate, replay and campaign, and what becomes of its mistakes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from meshpoint.bus.logs.files import read_logs
from meshpoint.cli.main import main
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ShiftOutcome, ValveAction, ValveCommand
from meshpoint.dbc.node import Node

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_strategy.py"
CLASS = "NextGap"
RUN = ("simulate", "--preset", "thesis", "--seed", "2", "--shifts", "3")


def run(*arguments: object) -> int:
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return int(stop.code or 0)


def simulated(folder: Path, name: str, *arguments: object) -> tuple[int, dict[str, Any]]:
    result = folder / "result.json"
    code = run(*RUN, "--strategy", name, "--json", result, *arguments)
    values: dict[str, Any] = json.loads(result.read_text())
    return code, values


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, dict[str, Any]]:
    """Three shifts by a copy of the example: folder, name, JSON."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copy(EXAMPLE, folder / "mine.py")
    name = f"{folder / 'mine.py'}:{CLASS}"
    code, values = simulated(folder, name, "--log", folder / "x.log")
    assert code == 0
    return folder, name, values


def test_the_example_aims_and_meets_the_gap(recorded: tuple[Path, str, dict[str, Any]]) -> None:
    _, name, values = recorded
    acted = [row["strategy"] for row in values["shifts"]]
    assert acted == ["speed_window", "speed_window", name], "aims once a phase is known"
    assert all(row["result"] == "engaged" for row in values["shifts"])
    assert [row["contact"] for row in values["shifts"]][2:] == ["gap"]
    assert values["summary"]["strategy"] == name
    assert values["summary"]["gap_rate"] == 1.0
    assert "strategy_errors" not in values


def test_the_run_header_knows_the_file_and_carries_no_code(
    recorded: tuple[Path, str, dict[str, Any]],
) -> None:
    folder, name, _ = recorded
    (path,) = folder.glob("header-*.json")
    header = json.loads(path.read_text())
    assert header["settings"]["strategy_name"] == name
    assert len(header["strategy_file"]["sha256"]) == 64
    assert "def contact" not in path.read_text()


def verdicts(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any]]:
    code = run("replay", *arguments, "--json", "-")
    (session,) = json.loads(capsys.readouterr().out)["sessions"]
    return code, session


def test_the_log_is_verified_with_the_same_file_and_not_without(
    recorded: tuple[Path, str, dict[str, Any]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, name, _ = recorded
    log = folder / "x.log"
    code, session = verdicts(capsys, log, "--verify", "--strategy", name)
    assert (code, session["verdict"]) == (0, "identical")
    assert session["steps"] > 300

    moved = tmp_path / "elsewhere.py"
    shutil.copy(EXAMPLE, moved)
    code, session = verdicts(capsys, log, "--verify", "--strategy", f"{moved}:{CLASS}")
    assert (code, session["verdict"]) == (0, "identical"), "the content counts, not the place"

    code, session = verdicts(capsys, log, "--verify")
    assert (code, session["verdict"]) == (3, "not verifiable")
    assert f"name it with --strategy {name}" in session["reason"]

    moved.write_text(EXAMPLE.read_text().replace("30 * RPM", "31 * RPM"))
    code, session = verdicts(capsys, log, "--verify", "--strategy", f"{moved}:{CLASS}")
    assert (code, session["verdict"]) == (3, "not verifiable")
    assert f"own strategy {name} has changed" in session["reason"]

    code, session = verdicts(capsys, log, "--verify", "--strategy", "target_phase")
    assert (code, session["verdict"]) == (3, "not verifiable")
    assert "asked for is target_phase" in session["reason"]


@pytest.mark.long
def test_it_is_asked_what_it_would_have_commanded_on_another_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulated(tmp_path, "target_phase", "--log", tmp_path / "x.log")
    name = f"{EXAMPLE}:{CLASS}"
    capsys.readouterr()
    assert run("replay", tmp_path / "x.log", "--strategy", name, "--json", "-") == 0
    values = json.loads(capsys.readouterr().out)
    acted = [(row["strategy"], row["recorded"]["strategy"]) for row in values["shifts"]]
    assert acted[-1] == (name, "target_phase")
    assert all(session["verdict"] == "identical" for session in values["sessions"])


def test_of_its_own_log_another_is_not_asked_without_it(
    recorded: tuple[Path, str, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    """The state in which each shift was begun is that of the strategy that made the log."""
    folder, name, _ = recorded
    code, session = verdicts(capsys, folder / "x.log", "--strategy", "speed_window")
    assert (code, session["verdict"]) == (3, "not verifiable")
    assert f"own strategy {name} made this log" in session["reason"]


def campaign(tmp_path: Path, *arguments: object) -> tuple[int, dict[str, Any]]:
    result = tmp_path / "campaign.json"
    code = run(
        "campaign", "--preset", "thesis", "--runs", "2", "--learn", "1", "--judged", "1",
        "--json", result, *arguments,
    )  # fmt: skip
    values: dict[str, Any] = json.loads(result.read_text())
    return code, values


@pytest.mark.long
def test_a_campaign_compares_it_with_ours_in_other_processes(tmp_path: Path) -> None:
    name = f"{EXAMPLE}:{CLASS}"
    given = ("--strategy", f"speed_window,{name}", "--runs", "1")
    code, here = campaign(tmp_path, *given, "--jobs", "1")
    assert code == 0
    assert set(here["strategies"]) == {"speed_window", name}
    assert here["strategies"][name]["shifts"] == 1
    assert len(here["campaign"]["strategy_files"][name]) == 64
    assert campaign(tmp_path, *given, "--jobs", "2") == (0, here)


GOOD = """
class Mine:
    aims = False
    fire_slip_rad_s = 3.0
    def __init__(self, sheet, settings):
        pass
    def release(self, predictor, now_us, earliest_us):
        return earliest_us, earliest_us + 100_000
    def contact(self, predictor, now_us, earliest_us):
        if predictor.slip_rad_s(now_us) > 3.0:
            return None
        return earliest_us + predictor.delay_us
"""


def written(folder: Path, old: str = "", new: str = "") -> str:
    assert old in GOOD
    path = folder / "mine.py"
    path.write_text(GOOD.replace(old, new, 1) if old else GOOD)
    return f"{path}:Mine"


def test_a_strategy_that_does_not_aim_acts_from_the_first_shift(tmp_path: Path) -> None:
    later = "earliest_us + 50_000 * (predictor.slip_rad_s(now_us) > 35.0), earliest_us + 200_000"
    name = written(tmp_path, "earliest_us, earliest_us + 100_000", later)
    code, values = simulated(tmp_path, name, "--shifts", "2")
    assert code == 0
    assert {row["strategy"] for row in values["shifts"]} == {name}
    assert all(row["result"] == "engaged" for row in values["shifts"])


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("\nclass", "\nimport nowhere_to_be_found\nclass", ":2: ModuleNotFoundError"),
        ("\nclass Mine:", "\nclass Mine", ":2: SyntaxError"),
        ("class Mine", "class Yours", ":1: there is no class Mine"),
        ("def release", "def loosen", "class Mine has no method release()"),
        ("aims = False", "aims = 1", "has aims = 1, allowed is True or False"),
        ("        pass", "        raise SystemExit(4)", ":6: SystemExit: 4"),
        ("sheet, settings):", "sheet):", ":5: TypeError"),
        ("= 3.0", "= float('nan')", "fire_slip_rad_s is nan, allowed is a number from -100 to 100"),
        ("    fire_slip_rad_s = 3.0\n", "", "AttributeError"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_by_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, reported: str
) -> None:
    name = written(tmp_path, old, new)
    for command in (RUN, ("campaign", "--preset", "thesis", "--runs", "1")):
        assert run(*command, "--strategy", name) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert "Traceback" not in err
        assert str(tmp_path / "mine.py:") in err
        assert reported in err


def test_a_file_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*RUN, "--strategy", tmp_path / "none.py:Mine") == 2
    assert f"{tmp_path / 'none.py'}: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("return None", "return 1 / 0", ":11: ZeroDivisionError: division by zero"),
        ("return None", "return 'soon'", ":9: contact() is 'soon'"),
        ("return None", "raise SystemExit", ":11: SystemExit"),
        ("return earliest_us, earliest", "return earliest", ":7: release() returned"),
    ],
)
def test_a_mistake_in_mid_shift_is_named_by_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, reported: str
) -> None:
    code, values = simulated(tmp_path, written(tmp_path, old, new), "--shifts", "1")
    err = capsys.readouterr().err
    assert code == 1
    assert "Traceback" not in err
    assert f"own strategy: {tmp_path / 'mine.py'}{reported}" in err
    (row,) = values["shifts"]
    assert (row["result"], row["fault"]) == ("ended_in_neutral", "synchronise_failed")
    assert row["attempts"] == 0, "no sleeve was fired"
    assert sum(values["strategy_errors"].values()) == 1


def test_after_a_mistake_all_valves_are_off_and_the_node_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, log = written(tmp_path, "return None", "return 1 / 0"), tmp_path / "x.log"
    _, values = simulated(tmp_path, name, "--shifts", "2", "--log", log)
    assert [row["result"] for row in values["shifts"]] == ["ended_in_neutral"] * 2
    receiver, driven, ended = Receiver(*Node), set[ValveAction](), 0
    for _, frame in read_logs([log]):
        message = receiver.receive(frame).message
        if isinstance(message, ValveCommand):
            driven = {action for action in message if isinstance(action, ValveAction)}
        elif isinstance(message, ShiftOutcome):
            # Of the same step: the valve frame has the lower identifier.
            assert driven == {ValveAction.OFF_NOW}
            ended += 1
    assert ended == 2
    assert driven == {ValveAction.OFF_NOW}
    capsys.readouterr()
    assert run("replay", log, "--verify", "--strategy", name) == 1
    out, err = capsys.readouterr()
    assert "identical" in out
    assert "mine.py:11: ZeroDivisionError: division by zero (2 shifts ended of it)" in err


def test_a_mistake_asked_about_a_log_ends_each_shift_by_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recorded controller goes on, so every shift is judged and the mistake counted."""
    simulated(tmp_path, "speed_window", "--log", tmp_path / "x.log", "--shifts", "2")
    name = written(tmp_path, "return None", "return 1 / 0")
    capsys.readouterr()
    assert run("replay", tmp_path / "x.log", "--strategy", name, "--json", "-") == 1
    out, err = capsys.readouterr()
    rows = json.loads(out)["shifts"]
    assert {(row["status"], row["fault"]) for row in rows} == {("ended", "synchronise_failed")}
    assert {row["recorded"]["result"] for row in rows} == {"engaged"}
    assert {(row["fired_ms"], row["contact"]) for row in rows} == {(None, None)}
    assert "no firing was decided" in rows[0]["contact_why"]
    assert f"division by zero ({len(rows)} shifts ended of it)" in err


def test_a_mistake_in_a_campaign_is_named_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = written(tmp_path, "return None", "return 1 / 0")
    few = ("--runs", "1", "--jobs", "1")
    code, values = campaign(tmp_path, "--strategy", f"{name},speed_window", *few)
    assert code == 1
    assert values["failed"] == []
    assert values["strategies"]["speed_window"]["not_engaged"] == 0
    assert values["strategies"][name]["not_engaged"] == 1
    reported = "mine.py:11: ZeroDivisionError: division by zero (1 shift ended of it)"
    assert reported in capsys.readouterr().err
