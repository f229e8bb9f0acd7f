"""Bad input on the command line: exit code 2 and one line that says what is allowed."""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from meshpoint.cli.main import main
from meshpoint.cli.parsing import EXAMPLES, subparsers
from meshpoint.cli.table import COMMANDS, MOVED, build_parser, front_parser
from meshpoint.results.output import check_apart, check_writable


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Runs a command that must be refused; its one line, which goes on indented where it names many
    words."""
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = int(stop.code or 0)
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    (first, *more) = err.splitlines()
    assert "error" in first
    assert "error" not in "".join(more)
    assert "usage" not in err
    assert all(line.startswith("  ") and len(line) <= 80 for line in more)
    return " ".join(err.split())


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("simulate --shifts 0", ("shifts", "0", "1")),
        ("simulate --shifts 1.5", ("shifts", "1.5")),
        ("simulate --strategy hope", ("strategy", "hope", "target_phase")),
        ("simulate --preset thesis --pairs 8-9 --shifts 1", ("8-9", "8-10")),
        ("simulate --gearbox lorry --shifts 1", ("lorry", "thesis")),
        ("simulate --settings nowhere.toml --shifts 1", ("nowhere.toml",)),
        ("demo -i virtual --shifts 1 --as-built nowhere.toml", ("nowhere.toml",)),
        ("demo -i virtual --shifts 1 --faults nowhere.toml", ("nowhere.toml",)),
        ("replay nowhere.log", ("nowhere.log",)),
        ("fly", ("fly", "simulate")),
        ("simulate --shiftss 3", ("meshpoint simulate:", "unknown argument --shiftss 3")),
        ("show gearbox --colour", ("meshpoint show:", "unknown argument --colour")),
        ("rig -i carrier-pigeon", ("carrier-pigeon", "socketcan")),
        ("simulate --shifts 1 --json nowhere/run.json", ("nowhere/run.json", "no folder nowhere")),
        ("campaign --runs 1 --json nowhere/run.json", ("no folder nowhere",)),
        ("demo -i virtual --json nowhere/run.json", ("no folder nowhere",)),
        ("study 6.8", ("`meshpoint study` is now `python -m benchmarks.studies`",)),
        ("campaign --faults --hours 2", ("--faults is `python -m benchmarks.swarm`",)),
        ("simulate --shifts 1 --report nowhere/run.html", ("no folder nowhere",)),
        ("show settings nothing", ("nothing", "limits")),
        ("show messages Nothing", ("Nothing", "ValveCommand")),
        ("help nothing", ("nothing", "bus", "simulate")),
        ("help completion csh", ("csh", "bash", "zsh", "fish")),
        ("help simulate bash", ("bash", "help completion")),
        ("health controller", ("`meshpoint check --alive NODE`",)),
        ("help health", ("`meshpoint check --alive NODE`",)),
        ("check --alive engine", ("engine", "controller", "rig")),
        ("replay a.log --gap-rate --verify", ("--verify", "--gap-rate")),
        ("replay a.log --gap-rate --report a.html", ("--report", "--gap-rate")),
        ("replay a.log --profile classic", ("--profile classic", "--gap-rate")),
        ("captures a.csv b.csv -o a.log", ("-o", "one capture", "2")),
    ],
)
def test_a_mistake_is_reported_in_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: str,
    named: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    line = refusal(capsys, *arguments.split())
    for word in named:
        assert word in line
    assert list(tmp_path.iterdir()) == []


def test_a_mistyped_value_is_followed_by_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "--shifts", "x"])
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("meshpoint simulate: error: argument --shifts: 'x', allowed is")
    assert said.endswith(" (help: meshpoint simulate -h)")


def commands(
    parser: argparse.ArgumentParser, above: str = ""
) -> dict[str, argparse.ArgumentParser]:
    """Every command, `show gearbox` as one of its own."""
    found = {}
    for name, inner in subparsers(parser).items():
        found[above + name] = inner
        found |= commands(inner, f"{above}{name} ")
    return found


PARSERS = commands(build_parser())


@pytest.mark.parametrize("name", PARSERS)
def test_each_help_ends_with_examples_that_can_be_given(name: str) -> None:
    help_ = PARSERS[name].format_help()
    title, *lines = help_[help_.rindex("\nexample") + 1 :].strip().splitlines()
    assert title in ("example:", "examples:")
    assert lines
    assert EXAMPLES[name] == tuple(line.strip() for line in lines)
    shown = set()
    for line in lines:
        program, *words = shlex.split(line.partition(">")[0])
        assert program == "meshpoint"
        shown.add(build_parser().parse_args(words).command)
    assert name.split()[0] in shown


@pytest.mark.parametrize("name", PARSERS)
def test_help_fits_80_columns_and_has_pythoncans_arguments_in_one_line(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    help_ = PARSERS[name].format_help()
    assert max(map(len, help_.splitlines())) <= 80
    assert help_.count("--data-bitrate") <= 1
    assert "--bus-kwargs" not in help_
    opens_a_bus = name in (
            "demo", "up", "rig", "controller", "request", "watch", "check", "commission",
            "convert", "help",
        )  # fmt: skip
    assert help_.count("meshpoint help bus") == opens_a_bus


def test_the_page_on_buses_explains_every_argument(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["help", "bus"]) == 0
    page = capsys.readouterr().out
    for option in (
        "-i",
        "-c",
        "-b",
        "--fd",
        "--data-bitrate",
        "--timing",
        "--bus-kwargs",
        "--config",
    ):
        assert f"  {option}" in page
    assert "socketcan, socketcand" in " ".join(page.split())
    assert max(map(len, page.splitlines())) <= 80


@pytest.mark.parametrize(
    ("topic", "begins"), [("simulate", "usage: meshpoint simulate"), ("", "usage: meshpoint")]
)
def test_help_of_a_command_is_its_own(
    capsys: pytest.CaptureFixture[str], topic: str, begins: str
) -> None:
    assert main(["help", *topic.split()]) == 0
    assert capsys.readouterr().out.startswith(begins)


def test_json_that_cannot_be_written_leaves_no_file_behind(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    check_writable(str(path))
    assert not path.exists()
    path.write_text("kept")
    check_writable(str(path))
    assert path.read_text() == "kept"


def test_results_may_go_into_the_folder_that_the_command_makes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    small = "campaign --runs 1 --learn 1 --judged 1 --as-built clean --preset thesis"
    assert main(f"{small} --out made --json made/run.json".split()) == 0
    assert (tmp_path / "made" / "shifts.parquet").exists()
    assert json.loads((tmp_path / "made" / "run.json").read_text())


def test_a_bad_setting_is_named_with_its_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "bench.toml"
    path.write_text("[limits]\nattempts = 99\n")
    line = refusal(capsys, "simulate", "--settings", str(path), "--shifts", "1")
    for word in ("bench.toml", "attempts", "99", "1", "10"):
        assert word in line


def test_simulate_prints_nothing_but_json_where_json_is_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["simulate", "--shifts", "1", "--seed", "3", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [(row["from"], row["to"], row["result"]) for row in report["shifts"]] == [
        (8, 10, "engaged")
    ]


LOADED = """
import sys
from meshpoint.cli.main import main
try:
    main(sys.argv[1:])
finally:
    sys.stderr.write("\\n" + " ".join(sys.modules))
"""
HEAVY = {"can", "cantools", "matplotlib", "numba", "numpy", "rich", "scipy", "meshpoint.dbc"}


@pytest.mark.parametrize("arguments", ["--help", "--version", "fly", "--fly", "--help simulate"])
def test_a_line_that_names_no_command_loads_none(arguments: str) -> None:
    """Counted in modules, not in time: a bare interpreter has some 60, all that is here 1,000."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments.split()],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    loaded = set(done.stderr.splitlines()[-1].split())
    assert done.returncode in (0, 2)
    assert not loaded & HEAVY
    assert len(loaded) < 180


@pytest.mark.parametrize(
    "command", ["campaign", pytest.param("replay", marks=pytest.mark.long), "controller"]
)
def test_a_command_loads_no_library_that_one_file_format_or_one_figure_needs(command: str) -> None:
    """asammdf with pandas is for MF4 logs, all of scipy's statistics for one quantile."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, command, "--help"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    loaded = set(done.stderr.splitlines()[-1].split())
    assert "can" in loaded
    assert not loaded & {"asammdf", "pandas", "scipy.stats", "matplotlib"}


def test_help_before_a_command_is_loaded_is_the_same() -> None:
    assert front_parser().format_help() == build_parser().format_help()


def test_the_first_help_has_every_command_once_by_task(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["-h"])
    shown = capsys.readouterr().out.splitlines()
    assert max(map(len, shown)) <= 80
    lines = [f"  {name:10}  {command.summary}" for name, command in COMMANDS.items()]
    assert [line for line in shown if line in lines] == lines
    for name, command in COMMANDS.items():
        above = shown[: shown.index(f"  {name:10}  {command.summary}")]
        titles = [line for line in above if line.endswith(":") and not line.startswith(" ")]
        assert titles[-1] == f"{command.task}:"
    assert not [name for name in MOVED if any(line.startswith(f"  {name} ") for line in shown)]


@pytest.mark.parametrize("name", MOVED)
def test_a_command_of_old_says_where_it_has_gone(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Whatever is given behind it; and the command that it names is there."""
    line = refusal(capsys, name, "x", "--help")
    assert line.startswith(f"meshpoint: error: `meshpoint {name}` is now `")
    program, *now = line.split("`")[3].split()
    if program == "meshpoint":
        parser = PARSERS.get(" ".join(now[:2]), PARSERS[now[0]])
        assert all(word in parser.format_help() for word in now if word.startswith("-"))


def numbers_of(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    """The arguments that are made from their words: all but texts and paths."""
    return [action for action in parser._actions if action.type not in (None, str, Path)]


MAY_BE_NEGATIVE = ("--threshold",)
"""A voltage."""
LISTS = {"--sweep": "window.aim_slip_rpm={}", "--tolerance": "slip_rpm={}"}
"""How an argument names its number, where it is not alone."""


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", "1e999", "-1"])
def test_no_command_takes_a_number_that_is_none(word: str) -> None:
    looked_at = 0
    for name, parser in PARSERS.items():
        for action in numbers_of(parser):
            option = action.option_strings[-1] if action.option_strings else action.dest
            if word == "-1" and option in (*MAY_BE_NEGATIVE, "--sweep"):
                continue
            given = LISTS.get(option, "{}").format(word)
            looked_at += 1
            with pytest.raises(argparse.ArgumentTypeError, match="allowed"):
                pytest.fail(f"{name} {option} {given}: taken as {action.type(given)}")
    assert looked_at > 60


@pytest.mark.parametrize(
    "arguments",
    [
        "request 10 --timeout nan",
        "request 10 --timeout=-1",
        "check --seconds nan",
        "check --seconds 0",
        "check --turn --turn-seconds inf",
        "watch --for nan",
        "watch --speed=-1",
        "campaign --until x --budget nan",
        "rig --main-speed 1e9",
        "convert --live 70000",
        "rig --bitrate=-500000",
        "captures wheel.csv --threshold nan",
        "simulate --bus-load nan",
    ],
)
def test_a_number_out_of_range_is_refused_before_anything_is_opened(
    capsys: pytest.CaptureFixture[str], arguments: str
) -> None:
    assert "allowed" in refusal(capsys, *arguments.split())


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("simulate --log x --json x", ("--log", "--json")),
        ("simulate --log x.log --json ./x.log", ("--log", "--json")),
        ("simulate --report x --junit x", ("--report", "--junit")),
        ("simulate --junit x --markdown sub/../x", ("--junit", "--markdown")),
        ("simulate --settings own.toml --json own.toml", ("--settings", "--json")),
        ("up --log x --calibration x", ("--log", "--calibration")),
        ("replay own.toml --json own.toml", ("LOG", "--json")),
        ("identify own.toml --json linked.toml", ("LOG", "--json")),
        ("identify a.log -o b.toml --json b.toml", ("--output", "--json")),
        ("campaign --junit x --markdown x", ("--junit", "--markdown")),
        ("commission --out x --json x", ("--out", "--json")),
    ],
)
def test_two_outputs_are_two_files_and_none_is_one_that_is_read(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: str,
    named: tuple[str, str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "own.toml").write_text("")
    (tmp_path / "linked.toml").hardlink_to(tmp_path / "own.toml")
    assert f"{named[0]} and {named[1]} name one file" in refusal(capsys, *arguments.split())
    assert (tmp_path / "own.toml").read_text() == ""
    assert len(list(tmp_path.iterdir())) == 3


def test_outputs_that_nobody_keeps_may_be_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "gearbox", "--json", "/dev/null"]) == 0
    check_apart({"log": "/dev/null", "json": "/dev/null", "report": Path("/dev/null")})
    check_apart({"out": Path("here"), "log": "here/", "json": "-"})


@pytest.mark.parametrize(
    ("word", "meant"),
    [("simulat", "did you mean simulate? "), ("xyz", "")],
)
def test_a_mistyped_command_is_answered_with_the_nearest(
    word: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([word])
    assert f"error: {meant}argument COMMAND: invalid choice" in capsys.readouterr().err
