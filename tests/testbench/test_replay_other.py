"""`replay --strategy`: every recorded shift, the log's outcome never as the other strategy's."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from typing import Any

import pytest
from page_data import page_data

from meshpoint.cli.main import main
from meshpoint.results.rows import ShiftRow

Replayed = tuple[dict[str, Any], dict[str, Any], str]
SHIFTS = 3
RECORDED, OTHER = "speed_window", "target_phase"
DECIDED = {"from_", "to", "strategy", "reference", "request_us", "fault"}
"""What a row may say of the other strategy too; all else of a row came of the recorded commands."""
PREDICTED = {"predicted_phase_deg", "predicted_phase_sd_deg"}


@pytest.fixture(scope="module")
def replayed(
    tmp_path_factory: pytest.TempPathFactory,
) -> Replayed:
    """What `simulate` said of its shifts, what `replay` says of them, and its page."""
    folder = tmp_path_factory.mktemp("replay")
    log, made, page = folder / "x.log", folder / "sim.json", folder / "r.html"
    run = ["simulate", "--preset", "thesis", "--strategy", RECORDED, "--shifts", str(SHIFTS)]
    run += ["--seed", "2"]  # whose flanks its first two shifts tell
    assert main([*run, "--log", str(log), "--json", str(made)]) == 0
    reported = folder / "replay.json"
    asked = ["replay", str(log), "--strategy", OTHER, "--json", str(reported)]
    assert main([*asked, "--report", str(page)]) == 0
    simulated = json.loads(made.read_text())
    return simulated, json.loads(reported.read_text()), page.read_text(encoding="utf-8")


def test_every_recorded_shift_has_its_row_as_the_log_has_it(
    replayed: Replayed,
) -> None:
    simulated, values, _ = replayed
    assert values["mode"] == "open loop"
    assert len(values["shifts"]) == SHIFTS
    for row, was in zip(values["shifts"], simulated["shifts"], strict=True):
        # the bound needs the gearbox as built, which is not on the bus
        assert {name: row["recorded"][name] for name in was} == was | {"bound_ms": None}
        assert (row["from"], row["to"]) == (was["from"], was["to"])
        assert row["recorded"]["strategy"] == RECORDED


def test_no_row_carries_a_recorded_outcome(
    replayed: Replayed,
) -> None:
    outcome = {field.name for field in fields(ShiftRow)} - DECIDED - PREDICTED
    outcome |= {"phase_error_pct_of_pitch"}
    for row in replayed[1]["shifts"]:
        assert row["recorded"]["contact"] in ("gap", "tooth")
        for name in outcome:
            assert row.get(name) is None, name
        assert row["contact_why"]
        said = " ".join(row["events"])
        assert "engaged" not in said
        assert "clutch_closing" not in said


def test_the_aimed_shifts_part_and_say_what_they_expect(
    replayed: Replayed,
) -> None:
    aimed = [row for row in replayed[1]["shifts"] if row["reference"] == "known"]
    assert len(aimed) == SHIFTS - 2
    for row in aimed:
        assert row["strategy"] == OTHER
        assert row["parted"]["commands"]
        assert 0.0 < row["parted"]["at_ms"] < row["judged_to_ms"]
        assert row["fired_ms"] != row["recorded"]["fired_ms"]
        assert abs(row["predicted_phase_deg"]) < 3.75
        assert row["predicted_phase_sd_deg"] > 0.0
    learning = [row for row in replayed[1]["shifts"] if row["reference"] == "unknown"]
    assert [row["strategy"] for row in learning] == [RECORDED, RECORDED]
    assert [row["parted"] for row in learning] == [None, None]


def test_the_page_counts_outcomes_for_the_logs_strategy_alone(
    replayed: Replayed,
) -> None:
    simulated, _, page = replayed
    summary = page[page.index("Summary of the log") : page.index("<h2>What")]
    counted = re.findall(r"<td[^>]*>(?:learning|aimed)</td><td[^>]*>(\w+)</td>", summary)
    assert set(counted) == {RECORDED}
    aimed = [row for row in simulated["shifts"] if row["reference"] == "known"]
    gap = sum(row["contact"] == "gap" for row in aimed)
    assert f"{gap} of {len(aimed)}" in summary
    data = page_data(page)
    assert {trace["name"] for trace in data["overview"]["contacts"]["data"]} == {RECORDED}
    assert len(data["shifts"]) == SHIFTS
    for shift in data["shifts"].values():
        names = [trace["name"] for trace in shift["data"]]
        assert "contact, truth" in names
        assert "replayed" not in shift["title"]
        reported = [row for row in shift["account"] if "would have" in row[0]]
        assert reported
        assert all(row[3] == "not in the log" for row in reported)


def test_both_trajectories_are_drawn_with_the_point_where_they_part(
    replayed: Replayed,
) -> None:
    _, values, page = replayed
    shifts = page_data(page)["shifts"].values()
    for row, shift in zip(values["shifts"], shifts, strict=True):
        names = {trace["name"] for trace in shift["data"]}
        assert {"brake", "brake, replayed"} <= names
        events = {note["text"]: note["x"] for note in shift["annotations"]}
        if row["parted"] is None:
            assert "decisions part" not in events
            continue
        assert "replayed" in names
        assert events["decisions part"] == pytest.approx(row["parted"]["at_ms"], abs=0.01)
        assert events["would fire"] == pytest.approx(row["fired_ms"], abs=0.01)
