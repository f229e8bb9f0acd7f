"""`simulate --fail-if`: figures against limits; JUnit and Markdown beside."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from meshpoint.cli.main import main
from meshpoint.results.limits import MEANINGS, Limit, figures, judge, parse_limit
from meshpoint.results.rows import ShiftRow, summarise

ROOT = Path(__file__).parents[2]
ROW = ShiftRow(
    from_=8, to=10, strategy="target_phase", reference="known", result="engaged",
    duration_ms=400.0, slip_rpm=10.0, phase_error_deg=0.3, pitch_deg=7.5, contact="gap",
    attempts=1, predicted_phase_deg=0.1, predicted_phase_sd_deg=0.2, delay_ms=45.0, request_us=0,
    contact_us=300_000, end_us=400_000, fault="none",
)  # fmt: skip
MISSED = replace(
    ROW,
    contact="tooth",
    duration_ms=700.0,
    attempts=2,
    aborts=2,
    blocked=1,
    ratchets=3,
    impact_j=0.5,
)
NEUTRAL = replace(ROW, result="ended_in_neutral", contact=None, reference="unknown")


def judged(text: str, *rows: ShiftRow) -> tuple[float | None, bool]:
    found = judge([parse_limit(text)], summarise("target_phase", list(rows)), rows)[0]
    return found.value, found.failed


@pytest.mark.parametrize(
    ("text", "value", "failed"),
    [
        ("first_contact_gap < 0.95", 0.5, True),
        ("first_contact_gap < 50%", 0.5, False),
        ("first_contact_gap<=50%", 0.5, True),
        ("engaged < 1", 2 / 3, True),
        ("reference_known >= 0.5", 2 / 3, True),
        ("duration_ms_mean > 550", 550.0, False),
        ("duration_ms_max >= 7e2", 700.0, True),
        ("phase_error_rms_deg > 0.3", 0.3, False),
        ("attempts_max > 1", 2.0, True),
        ("aborted > 0.3", 1 / 3, True),
        ("aborts_max > 2", 2.0, False),
        ("blocked > 1", 1.0, False),
        ("ratchets > 2", 3.0, True),
        ("impact_j_max > 0.4", 0.5, True),
    ],
)
def test_a_gate_fails_where_its_figure_is_so(text: str, value: float, failed: bool) -> None:
    found, is_failed = judged(text, ROW, MISSED, NEUTRAL)
    assert found == pytest.approx(value)
    assert is_failed is failed


def test_a_figure_that_no_shift_has_keeps_no_limit() -> None:
    assert judged("first_contact_gap < 0.95", NEUTRAL) == (None, True)
    assert judged("duration_ms_max > 1000", NEUTRAL) == (None, True)


def test_every_figure_is_there_and_documented() -> None:
    assert set(figures(summarise("target_phase", [ROW]), [ROW])) == set(MEANINGS)
    page = (ROOT / "docs" / "ci.md").read_text()
    for name in MEANINGS:
        assert f"| `{name}` |" in page


@pytest.mark.parametrize(
    "text",
    ["", "gap < 0.9", "engaged", "engaged = 1", "engaged < x", "engaged < 1e", "engaged < -"],
)
def test_what_is_no_gate_is_said(text: str) -> None:
    with pytest.raises(ValueError, match=r"allowed is FIGURE < LIMIT|is no number"):
        parse_limit(text)
    assert parse_limit(" engaged<100 % ".replace(" %", "%")) == Limit("engaged", "<", 1.0)


def test_the_command_ends_with_1_and_leaves_what_ci_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["simulate", "--shifts", "1", "--preset", "thesis"]
    files = {name: tmp_path / name for name in ("run.json", "junit.xml", "run.md")}
    left = ["--json", str(files["run.json"]), "--junit", str(files["junit.xml"])]
    limits = ["--fail-if", "engaged < 1", "--fail-if", "duration_ms_max > 100"]
    assert main([*command, *left, "--markdown", str(files["run.md"]), *limits]) == 1
    said = capsys.readouterr()
    assert "failed: duration_ms_max is" in said.err
    assert "passed: engaged is 1 (fails if engaged < 1)" in said.out
    kept = json.loads(files["run.json"].read_text())["gates"]
    assert [limit["failed"] for limit in kept] == [False, True]
    suite = ET.fromstring(files["junit.xml"].read_text())
    assert (suite.get("tests"), suite.get("failures")) == ("3", "1")
    assert suite.find("testcase[@name='not duration_ms_max > 100']/failure") is not None
    page = files["run.md"].read_text()
    assert "| `duration_ms_max > 100` |" in page and "**failed**" in page
    assert "| 8 to 10 | speed_window | unknown |" in page


def test_a_gate_that_is_none_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "--fail-if", "gap < 1"])
    assert ended.value.code == 2
    assert "first_contact_gap" in capsys.readouterr().err
