"""A change against what was before it: how often the verdict is wrong, and what it takes in."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.studies.campaign_statistics_run import Kind, VerdictRun
from meshpoint.base.exits import Exit
from meshpoint.campaigns.verdict import Comparison, Counts, PairedRun, Verdict, evidence
from meshpoint.cli.main import main

SEED = 3
COMMON = (
    "campaign", "--preset", "thesis", "--learn", "0", "--judged", "3", "--seed", str(SEED),
    "--jobs", "1",
)  # fmt: skip
Rows = list[dict[str, Any]]


def simulated(kind: Kind, fall: float, *, has_baseline: bool = True) -> VerdictRun:
    return VerdictRun(
        kind, (0.01, 0.01 + fall), icc=0.12, shifts=2, margin=0.03, runs=500,
        has_baseline=has_baseline, changes=100, seed=5,
    )  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    [
        Kind.BREAKS,
        Kind.INDEPENDENT,
        pytest.param(Kind.HALF, marks=pytest.mark.long),
        pytest.param(Kind.SAME_GEARBOXES, marks=pytest.mark.long),
    ],
)
def test_a_change_from_99_to_96_per_cent_is_found_and_none_is_not(kind: Kind) -> None:
    """5 % of errors are allowed; of 100 changes, 5 more to chance. The study has 500."""
    worse, alike = simulated(kind, 0.03).run(), simulated(kind, 0.0).run()
    assert worse.not_worse <= 0.1
    assert alike.worse <= 0.1
    assert worse.worse >= 0.88
    assert worse.median <= 150


def test_against_a_commit_no_change_is_called_worse_more_often_either() -> None:
    assert simulated(Kind.INDEPENDENT, 0.0, has_baseline=False).run().worse <= 0.1


def counts(worse: int, better: int = 0, *, pairs: int = 100, **more: int) -> Counts:
    return Counts(pairs, worse, better, **more)


def test_evidence_grows_with_worse_pairs_and_falls_with_better_ones_and_with_misses_before() -> (
    None
):
    base = {"unpaired": 900, "unpaired_misses": 9}
    found = [evidence(counts(worse, **base), 0.03) for worse in range(12)]
    assert found == sorted(found)
    assert found[0] < -2.0
    assert found[-1] > 8.0
    known = evidence(counts(6, **base), 0.03)
    assert evidence(counts(6, better=3, **base), 0.03) < known
    assert evidence(counts(6, unpaired=900, unpaired_misses=60), 0.03) < known
    assert evidence(counts(6), 0.03) < known


def test_pairs_without_any_difference_say_that_nothing_is_worse() -> None:
    comparison = Comparison(margin=0.03)
    for seed in range(100):
        comparison.take(PairedRun(seed, 0, 0, 0, 2))
    assert comparison.look() is Verdict.NOT_WORSE


def test_worse_pairs_of_one_run_say_less_than_those_of_several() -> None:
    alone, together = Comparison(0.03, 1000, 10), Comparison(0.03, 1000, 10)
    for seed in range(40):
        alone.take(PairedRun(seed, int(seed < 6), 0, 0, 3))
        together.take(PairedRun(seed, 3 * (seed < 2), 0, 0, 3))
    alone.look()
    together.look()
    assert alone.worse == together.worse == 6
    assert alone.evidence > 1.5 * together.evidence


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six shifts fired without aiming, as a campaign's folder."""
    folder = tmp_path_factory.mktemp("made")
    settings = folder / "speed.toml"
    settings.write_text('strategy = "speed_window"\n')
    out = folder / "after"
    more = ["--settings", str(settings), "--strategy", "speed_window", "--out", str(out)]
    assert main([*COMMON, *more, "--runs", "2", "--json", str(folder / "x.json")]) == 0
    return folder


def many(table: Path, runs: int, contact: Callable[[int, int], str]) -> Rows:
    """As many runs like the first, with contacts by run and shift."""
    rows = [row for row in pq.read_table(table).to_pylist() if row["seed"] == SEED * 10**6]
    return [
        row | {"seed": SEED * 10**6 + run, "contact": contact(run, row["shift"])}
        for run in range(runs)
        for row in rows
    ]


def write(table: Path, rows: Rows) -> None:
    table.parent.mkdir(exist_ok=True)
    pq.write_table(pa.Table.from_pylist(rows, schema=pq.read_schema(table)), table)


Judge = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture
def judge(made: Path, tmp_path: Path) -> Judge:
    """The command on records that are there already; none is made."""

    def run(before: Rows | None, after: Rows, *more: str) -> tuple[int, dict[str, Any]]:
        out, base = tmp_path / "after", tmp_path / "before"
        for folder in (out, base):
            shutil.copytree(made / "after", folder)
        write(out / "shifts.parquet", after)
        if before is not None:
            write(base / "shifts.parquet", before)
        code = main([
            *COMMON, "--settings", str(made / "speed.toml"), "--out", str(out), "--resume",
            "--against", str(base), "--json", str(tmp_path / "x.json"),
            "--junit", str(tmp_path / "x.xml"), "--markdown", str(tmp_path / "x.md"), *more,
        ])  # fmt: skip
        found = tmp_path / "x.json"
        return code, json.loads(found.read_text()) if found.is_file() else {}

    return run


def test_a_change_that_misses_more_ends_with_exit_code_1_and_says_so_everywhere(
    made: Path, judge: Judge, tmp_path: Path
) -> None:
    table = made / "after" / "shifts.parquet"
    before = many(table, 100, lambda _run, _shift: "gap")
    after = many(table, 100, lambda run, shift: "tooth" if (run + shift) % 5 == 0 else "gap")
    code, values = judge(before, after)
    assert code == Exit.FAILED
    assert values["against"]["verdict"] == "worse"
    assert values["runs"] == values["against"]["runs"] < 100
    assert values["against"]["baseline"] == {"shifts": 300, "misses": 0}
    suite = ET.parse(tmp_path / "x.xml").getroot()
    assert suite.attrib["failures"] == "1"
    text = (tmp_path / "x.md").read_text()
    assert "| verdict | worse |" in text
    assert "| speed_window |" in text


def test_no_change_ends_with_0_and_too_few_runs_with_4(
    made: Path, judge: Judge, tmp_path: Path
) -> None:
    table = made / "after" / "shifts.parquet"
    alike = many(table, 100, lambda run, _shift: "tooth" if run % 50 == 0 else "gap")
    code, values = judge(alike, alike)
    assert (code, values["against"]["verdict"]) == (Exit.DONE, "not worse")
    assert values["against"]["missed_by_both"] > 0
    assert ET.parse(tmp_path / "x.xml").getroot().attrib["failures"] == "0"
    for folder in ("before", "after"):
        shutil.rmtree(tmp_path / folder)
    few = [row for row in alike if row["seed"] < alike[0]["seed"] + 10]
    code, values = judge(few, few, "--runs", "10")
    assert (code, values["against"]["verdict"]) == (Exit.NOT_DECIDED, "not decided")
    assert ET.parse(tmp_path / "x.xml").getroot().attrib["failures"] == "1"


@pytest.mark.parametrize(
    ("figure", "words"), [("duration_ms", "time"), ("impact_j", "impact at contact")]
)
def test_shifts_that_meet_the_gap_as_before_but_are_slower_or_harder_are_worse(
    figure: str, words: str, made: Path, judge: Judge, tmp_path: Path
) -> None:
    table = made / "after" / "shifts.parquet"
    before = [row | {"impact_j": 2.0} for row in many(table, 100, lambda _run, _shift: "gap")]
    after = [row | {figure: 1.4 * row[figure]} for row in before]
    code, values = judge(before, after)
    assert code == Exit.FAILED
    against = values["against"]
    assert against["verdict"] == "worse"
    assert against["judged"][figure]["verdict"] == "worse"
    assert against["judged"][figure]["ratio"] == pytest.approx(1.4)
    other = {"duration_ms", "impact_j"} - {figure}
    assert {against["judged"][name]["verdict"] for name in other} == {"not worse"}
    assert f"| {words} | worse: 1.400 times that before" in (tmp_path / "x.md").read_text()
    failure = ET.parse(tmp_path / "x.xml").getroot().find(".//failure")
    assert failure is not None
    assert words in failure.attrib["message"]


def test_impacts_that_an_older_version_counted_otherwise_are_not_judged(
    made: Path, judge: Judge, tmp_path: Path
) -> None:
    """It counted them up to the shift's end: a gear that locks later has impacts now alone."""
    table = made / "after" / "shifts.parquet"
    rows = many(table, 100, lambda _run, _shift: "gap")
    after = [row | {"impact_j": 2.0} for row in rows]
    old = [{k: v for k, v in row.items() if k != "impact_complete"} for row in rows]
    older = tmp_path / "old" / "shifts.parquet"
    older.parent.mkdir()
    pq.write_table(pa.Table.from_pylist(old), older)
    code, values = judge(None, after, "--against", str(older.parent))
    assert (code, values["against"]["verdict"]) == (Exit.DONE, "not worse")
    assert values["against"]["judged"]["impact_j"]["verdict"].startswith("not judged: the version")
    assert "| impact at contact | not judged: the version before" in (tmp_path / "x.md").read_text()


def test_a_margin_says_how_much_slower_is_worse(made: Path, judge: Judge) -> None:
    before = many(made / "after" / "shifts.parquet", 100, lambda _run, _shift: "gap")
    after = [row | {"duration_ms": 1.04 * row["duration_ms"]} for row in before]
    assert judge(before, after, "--margin-time", "20")[0] == Exit.DONE


def test_shifts_that_were_not_drawn_alike_are_no_pairs(
    made: Path, judge: Judge, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = many(made / "after" / "shifts.parquet", 2, lambda _run, _shift: "gap")
    other = [row | {"layshaft_rpm": row["layshaft_rpm"] + 1.0} for row in rows]
    code, _ = judge(other, rows)
    assert code == Exit.BAD_INPUT
    assert "was not drawn alike: layshaft_rpm" in capsys.readouterr().err


def test_what_is_no_baseline_is_said(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(*arguments: str) -> str:
        assert main([*COMMON, *arguments]) == Exit.BAD_INPUT
        return capsys.readouterr().err

    goal = "first_contact_gap difference +-5%"
    assert "name both with --strategy" in said("--strategy", "target_phase", "--until", goal)
    assert "--budget needs --until" in said("--budget", "5")
    assert "there is no none.parquet" in said("--against", str(tmp_path / "none.parquet"))
    base = str(made / "after")
    assert "no shift with strategy target_phase" in said("--against", base)
    assert "is one of --seed 4" in said(
        "--settings", str(made / "speed.toml"), "--seed", "4", "--against", base
    )
    assert "no commit of" in said("--against", "no-such-branch")
    assert "leave out --dask and --resume" in said(
        "--against", "HEAD", "--resume", "--out", str(tmp_path / "out")
    )
    monkeypatch.chdir(tmp_path)
    git(tmp_path, "init", "--quiet")
    (tmp_path / "notes.txt").write_text("nothing that a campaign reads")
    commit(tmp_path)
    assert "nothing would differ" in said("--against", "HEAD")


def git(folder: Path, *arguments: str) -> None:
    given = ["-c", "user.name=a", "-c", "user.email=a@b", *arguments]
    subprocess.run(["git", "-C", str(folder), *given], check=True, capture_output=True)


def commit(folder: Path) -> None:
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "x")


PRODUCT = """\
import json, pathlib, shutil, sys, time
def main(words):
    out = pathlib.Path(words[words.index("--out") + 1])
    (out / "parts").mkdir(parents=True)
    (out / "words.json").write_text(json.dumps(words))
    settings = pathlib.Path(words[words.index("--settings") + 1])
    if "broken" in settings.read_text():
        sys.exit("its settings are broken")
    shutil.copy(pathlib.Path(__file__).with_name("made.parquet"), out / "parts/000001.parquet")
    time.sleep(600)  # until it is ended
"""
"""A product that is quick: the shifts it makes are in its repository."""


@pytest.fixture
def repository(made: Path, tmp_path: Path) -> Path:
    """Its commit never misses; its settings file is another one in the working tree."""
    top = tmp_path / "repository"
    for path in ("meshpoint", "controller", "rig_sim", "dbc"):
        (top / path).mkdir(parents=True)
        (top / path / "__init__.py").touch()
    for name in ("controller", "rig_sim", "dbc"):
        (top / name / "core.py").touch()
    (top / "meshpoint/__main__.py").write_text(PRODUCT)
    table = made / "after" / "shifts.parquet"
    rows = [row | {"contact": "gap"} for row in pq.read_table(table).to_pylist()]
    schema = pq.read_schema(table)
    made_before = top / "meshpoint/made.parquet"
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), made_before)
    (top / "speed.toml").write_text('strategy = "speed_window"\n# as committed\n')
    git(tmp_path, "init", "--quiet", str(top))
    commit(top)
    (top / "meshpoint/__main__.py").write_text("raise SystemExit('not this one')")
    (top / "speed.toml").write_text('strategy = "speed_window"\n')
    return top


def test_a_commit_runs_its_own_product_with_its_own_settings_and_is_ended(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(repository)
    out = tmp_path / "out"
    code = main([
        *COMMON, "--settings", "speed.toml", "--runs", "2", "--out", str(out),
        "--profile", "classic", "--against", "HEAD", "--json", str(tmp_path / "x.json"),
    ])  # fmt: skip
    assert code == Exit.NOT_DECIDED
    values = json.loads((tmp_path / "x.json").read_text())["against"]
    assert values["pairs"] == values["baseline"]["shifts"] == 6
    assert values["misses_before"] == 0.0
    assert values["worse"] >= 2
    words = json.loads((out / "before" / "words.json").read_text())
    assert words[words.index("--strategy") + 1] == "speed_window"
    assert words[words.index("--judged") + 1] == "3"
    assert words[words.index("--profile") + 1] == "classic"
    settings = Path(words[words.index("--settings") + 1])
    assert settings != repository / "speed.toml"
    assert not settings.exists()  # the exported files are gone


def test_a_commit_whose_product_fails_is_said_with_its_own_words(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    (repository / "speed.toml").write_text('strategy = "speed_window"\n# broken\n')
    git(repository, "commit", "--quiet", "--message", "y", "speed.toml")
    (repository / "speed.toml").write_text('strategy = "speed_window"\n')
    monkeypatch.chdir(repository)
    assert main([*COMMON, "--settings", "speed.toml", "--runs", "1", "--against", "HEAD"]) == 1
    assert "its settings are broken" in capsys.readouterr().err
