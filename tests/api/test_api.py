"""What `import meshpoint` gives: cheap, typed, documented, and the same as the commands."""

from __future__ import annotations

import dataclasses
import inspect
import json
import pkgutil
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pytest
from recorded_run import Recorded

import meshpoint
from meshpoint.api import reference
from meshpoint.api.runs import Replay
from meshpoint.campaigns import campaign_command as commands
from meshpoint.cli.main import main
from meshpoint.replays.session import Session, Verification

ROOT = Path(__file__).parents[2]
HEAVY = (
    "numpy",
    "can",
    "cantools",
    "numba",
    "pyarrow",
    "matplotlib",
    "meshpoint.base",
    "meshpoint.results",
)


def test_importing_it_loads_nothing_heavy() -> None:
    code = f"import sys, meshpoint; print([m for m in {HEAVY} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_no_package_takes_the_place_of_a_name() -> None:
    """Once imported, `meshpoint.NAME` would be the package."""
    packages = {found.name for found in pkgutil.iter_modules(meshpoint.__path__)}
    assert {"api", "run"} <= packages
    assert not packages & set(meshpoint.__all__)


def test_every_name_is_there_and_says_what_it_is() -> None:
    for name in meshpoint.__all__:
        value = getattr(meshpoint, name)
        if name not in ("__version__", "messages"):
            assert inspect.getdoc(value), name
            assert f"`{name}" in (ROOT / "docs" / "api.md").read_text(), name
    assert set(meshpoint.__all__) <= set(dir(meshpoint))
    with pytest.raises(AttributeError, match="has no attribute 'shift'"):
        _ = meshpoint.shift


def test_the_two_lists_of_names_are_one() -> None:
    from meshpoint import api

    assert meshpoint.__all__ == api.__all__


def test_the_reference_is_what_the_docstrings_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`make reference` writes it anew."""
    assert reference.main([str(ROOT / "docs" / "reference" / "api.md"), "--check"]) == 0
    stale = tmp_path / "api.md"
    stale.write_text("old")
    assert reference.main([str(stale), "--check"]) == 1
    assert "out of date" in capsys.readouterr().err and stale.read_text() == "old"
    assert reference.main([str(stale)]) == 0
    assert stale.read_text() == reference.api_page()


def test_a_sentence_of_the_reference_is_not_torn_at_a_colon() -> None:
    page = reference.api_page()
    assert page.count("at most three\n  times: once it is, the controller can aim") == 2


def test_the_reference_says_what_each_figure_of_a_shift_means() -> None:
    entry = reference.api_page().partition("## class `ShiftRow`")[2].partition("\n## ")[0]
    for field in dataclasses.fields(meshpoint.ShiftRow):
        assert f"\n- `{field.name}`: " in entry, field.name


def test_simulate_is_the_command(tmp_path: Path) -> None:
    target = tmp_path / "run.json"
    command = ["simulate", "--shifts", "1", "--seed", "5", "--preset", "thesis"]
    assert main([*command, "--json", str(target)]) == 0
    seen = []
    mine = meshpoint.simulate(1, seed=5, preset="thesis", on_shift=seen.append)
    assert mine.to_json() == json.loads(target.read_text())
    assert mine.summary.shifts == 1 and len(seen) == 1
    assert mine.table().column("contact").to_pylist() == [mine.shifts[0].contact]


def test_campaign_is_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "prepare", lambda **_: 0)  # compiles in a process of its own
    target, small = tmp_path / "campaign.json", {"learn": 0, "judged": 1, "preset": "thesis"}
    words = [f"--{name}={value}" for name, value in small.items()]
    command = ["campaign", "--runs", "1", "--jobs", "1", "--strategy", "speed_window", *words]
    assert main([*command, "--json", str(target)]) == 0
    mine = meshpoint.campaign(1, strategies=["speed_window"], **small)
    assert mine.values == json.loads(target.read_text())
    assert mine.table().num_rows == len(mine.shifts) == 1


def test_a_log_as_arrow_tables(recorded: Recorded) -> None:
    log = meshpoint.Log(recorded.log)
    frames, counts = log.frames(), log.counts()
    assert frames.num_rows == counts.total()
    assert frames.column("data")[0].as_py() == next(iter(log))[1].data
    status = log.messages(meshpoint.messages.ControllerStatus)
    assert status.num_rows == counts["ControllerStatus"]
    assert status.column("step_number").to_pylist() == list(range(status.num_rows))
    assert "IN_GEAR" in status.column("state").to_pylist()
    edges = log.messages("EdgesLayshaftRise")
    assert edges.schema.field("timestamp_low_us").type == pa.list_(pa.int64())
    assert len(edges.column("timestamp_low_us")[0].as_py()) == 27
    with pytest.raises(KeyError, match="no message of the DBC"):
        log.messages("Nothing")


def test_the_shifts_of_a_log_are_those_of_the_bench(recorded: Recorded, tmp_path: Path) -> None:
    log = meshpoint.Log(recorded.log)
    rows = log.shifts()
    assert rows == [recorded.learning, recorded.aimed]
    table = meshpoint.shifts_table(rows)
    assert table.column("contact").to_pylist() == [row.contact for row in rows]
    assert "braking_ms" in table.column_names
    assert table.column_names == [
        *(key for key in rows[0].to_json() if key != "phases"),
        *rows[0].to_json()["phases"],
    ]
    kinds = {field.name: str(field.type) for field in meshpoint.shifts_table([]).schema}
    assert kinds == {field.name: str(field.type) for field in table.schema}
    assert (kinds["bound_ms"], kinds["contact_us"], kinds["contact"]) == (
        "double",
        "int64",
        "string",
    )
    page = log.report(tmp_path / "run.html", title="Mine")
    assert "Mine" in page.read_text() and "gear 8 to 10" in page.read_text()


def test_a_log_without_its_header_needs_the_data_sheet(recorded: Recorded, tmp_path: Path) -> None:
    alone = tmp_path / "run.log"
    alone.write_bytes(recorded.log.read_bytes())
    with pytest.raises(meshpoint.TableError, match="gearbox= names the data sheet"):
        meshpoint.Log(alone).shifts()
    assert meshpoint.Log(alone).shifts(gearbox="thesis")[1].contact == recorded.aimed.contact
    found = meshpoint.Log(alone, header_dir=recorded.log.parent).shifts()
    assert found == [recorded.learning, recorded.aimed]


def test_a_replay_verifies_and_asks_another_strategy(recorded: Recorded) -> None:
    verified = meshpoint.replay(recorded.log)
    assert verified.verdict is meshpoint.Verification.IDENTICAL
    assert [row.contact for row in verified.shifts] == [
        recorded.learning.contact, recorded.aimed.contact,
    ]  # fmt: skip
    asked = meshpoint.replay(recorded.log, strategy="speed_window")
    judged = [row.judged for row in asked.judged]
    assert [shift.strategy for shift in judged] == ["speed_window", "speed_window"]
    assert judged[1].fired_ms != judged[1].recorded.fired_ms
    with pytest.raises(ValueError, match="nothing but strategy"):
        meshpoint.replay(recorded.log, estimator="window", verify=True)


@pytest.mark.parametrize("verdict", Verification)
def test_every_verdict_of_a_log_is_that_of_its_replay(verdict: Verification) -> None:
    assert Replay([Session(verdict=verdict)]).verdict is verdict
    whole = Session(verdict=Verification.IDENTICAL)
    assert Replay([whole, Session(verdict=verdict), whole]).verdict is verdict


def test_a_difference_is_worse_than_what_cannot_be_verified() -> None:
    worst = (Verification.DIFFERS, Verification.NOT_VERIFIABLE, Verification.IN_PARTS)
    sessions = [Session(verdict=verdict) for verdict in worst]
    assert [Replay(sessions[k:]).verdict for k in range(3)] == list(worst)
