"""`meshpoint simulate`: what its report says, and that a seed is a run."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from acceptance_kit import (
    DBC_FILE,
    FIRST_SEEDS,
    HALF_BACKLASH_DEG,
    MAIN_GEAR_OF,
    OTHER_SEEDS,
    PITCH_DEG,
    SHIFTS,
    THESIS_SHEET,
    assert_ended_well,
    run,
    strict_json,
    words,
)
from acceptance_wire import Recorded

"""The campaign runs twelve commands, two at a time, each within 60 s: one that takes longer is then
named, and not the test that happened to ask first."""

Campaign = dict[tuple[str, int], dict[str, Any]]
SHIFT_KEYS = words(
    "from to strategy reference duration_ms slip_rpm phase_error_deg pitch_deg contact attempts"
)


def rows(campaign: Campaign, strategy: str, seeds: tuple[int, ...]) -> list[dict[str, Any]]:
    return [row for seed in seeds for row in campaign[strategy, seed]["shifts"]]


def known(shifts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in shifts if row["reference"] == "known"]


def gap_rate(shifts: list[dict[str, Any]]) -> float:
    assert shifts
    return sum(row["contact"] == "gap" for row in shifts) / len(shifts)


@pytest.fixture(scope="session")
def issue_report() -> dict[str, Any]:
    """The very command of the issue."""
    outcome = run(*words("simulate --preset thesis --seed 1 --shifts 20 --json -"))
    assert_ended_well(outcome)
    report: dict[str, Any] = outcome.json
    return report


def test_the_report_has_shifts_estimation_and_provenance(issue_report: dict[str, Any]) -> None:
    assert set(issue_report) >= {"shifts", "estimation", "provenance"}
    assert len(issue_report["shifts"]) == 20
    for row in issue_report["shifts"]:
        assert set(row) >= set(SHIFT_KEYS)
    assert {"window", "thesis"} <= set(issue_report["estimation"])
    for figures in issue_report["estimation"].values():
        assert set(figures) >= {"angle_rms_deg", "speed_rms_rpm"}
    assert set(issue_report["provenance"]) >= {
        "seed",
        "dbc_sha256",
        "gearbox_sha256",
        "version",
    }


def test_every_row_is_an_upshift_of_the_main_box_alone(issue_report: dict[str, Any]) -> None:
    for row in issue_report["shifts"]:
        assert isinstance(row["from"], int) and isinstance(row["to"], int)
        assert row["to"] == row["from"] + 2, row
        assert row["strategy"] in ("speed_window", "target_phase")
        assert row["reference"] in ("known", "unknown")
        assert row["contact"] in ("gap", "tooth")
        assert isinstance(row["attempts"], int) and row["attempts"] >= 1
        assert 100.0 < row["duration_ms"] < 5000.0
        assert row["pitch_deg"] == pytest.approx(PITCH_DEG, abs=1e-9)


def test_phase_errors_are_wrapped_within_half_a_pitch(campaign: Campaign) -> None:
    for report in campaign.values():
        for row in report["shifts"]:
            assert math.isfinite(row["phase_error_deg"]) and math.isfinite(row["slip_rpm"])
            assert abs(row["phase_error_deg"]) <= PITCH_DEG / 2 + 1e-9


def test_contact_is_a_gap_exactly_where_the_phase_is_within_half_the_backlash(
    campaign: Campaign,
) -> None:
    for report in campaign.values():
        for row in report["shifts"]:
            in_gap = abs(row["phase_error_deg"]) < HALF_BACKLASH_DEG
            if row["attempts"] == 1:
                assert (row["contact"] == "gap") == in_gap, row


def test_provenance_names_seed_contract_sheet_and_version(issue_report: dict[str, Any]) -> None:
    provenance = issue_report["provenance"]
    assert provenance["seed"] == 1
    assert provenance["dbc_sha256"] == hashlib.sha256(DBC_FILE.read_bytes()).hexdigest()
    shown = run("show", "gearbox", "thesis", "--json", "-").json
    assert provenance["gearbox_sha256"] == shown["sha256"]
    assert isinstance(provenance["version"], str) and provenance["version"]


def test_the_same_seed_gives_the_same_bytes(recorded: Recorded) -> None:
    log = recorded.log.parent.parent / "again.log"
    arguments = words("simulate --preset thesis --seed 1 --shifts 3 --strategy target_phase")
    again = run(*arguments, "--log", log, "--json", "-")
    assert_ended_well(again)
    assert again.out == recorded.outcome.out
    assert log.read_bytes() == recorded.log.read_bytes()


def test_another_seed_gives_another_run(
    recorded: Recorded, simulated: Callable[..., Recorded]
) -> None:
    other = simulated("--seed", 2, "--shifts", 3, "--strategy", "target_phase")
    assert other.log.read_bytes() != recorded.log.read_bytes()
    assert other.report["shifts"] != recorded.report["shifts"]


def test_json_to_a_file_is_the_json_of_the_standard_output(
    recorded: Recorded, tmp_path: Path
) -> None:
    arguments = words("simulate --preset thesis --seed 1 --shifts 3 --strategy target_phase")
    outcome = run(*arguments, "--json", "report.json", cwd=tmp_path)
    assert_ended_well(outcome)
    assert strict_json((tmp_path / "report.json").read_text()) == recorded.report


def test_the_first_engagement_of_a_gear_has_an_unknown_reference(campaign: Campaign) -> None:
    for (strategy, seed), report in campaign.items():
        engaged: set[int] = set()
        for row in report["shifts"]:
            gear = MAIN_GEAR_OF[row["to"]]
            expected = "known" if gear in engaged else "unknown"
            assert row["reference"] == expected, (strategy, seed, row)
            engaged.add(gear)


def test_target_phase_hits_the_gap_nine_times_of_ten_once_the_reference_is_known(
    campaign: Campaign,
) -> None:
    for seed in FIRST_SEEDS + OTHER_SEEDS:
        shifts = known(rows(campaign, "target_phase", (seed,)))
        assert len(shifts) >= SHIFTS - 4
        assert gap_rate(shifts) >= 0.9, f"seed {seed}: {gap_rate(shifts):.3f}"


def test_speed_window_meets_the_gap_by_luck(campaign: Campaign) -> None:
    shifts = rows(campaign, "speed_window", FIRST_SEEDS + OTHER_SEEDS)
    sigma = math.sqrt(0.2 * 0.8 / len(shifts))
    assert gap_rate(shifts) == pytest.approx(0.2, abs=3 * sigma)


def test_target_phase_hits_three_times_as_often_on_the_same_seeds(campaign: Campaign) -> None:
    for seeds in (FIRST_SEEDS, OTHER_SEEDS):
        aimed = gap_rate(known(rows(campaign, "target_phase", seeds)))
        by_luck = gap_rate(rows(campaign, "speed_window", seeds))
        assert aimed >= 3 * by_luck


def test_other_angles_at_start_give_the_same_hit_rate(campaign: Campaign) -> None:
    first = known(rows(campaign, "target_phase", FIRST_SEEDS))
    other = known(rows(campaign, "target_phase", OTHER_SEEDS))
    pooled = gap_rate(first + other)
    sigma = math.sqrt(max(pooled * (1 - pooled), 0.01) * (1 / len(first) + 1 / len(other)))
    assert abs(gap_rate(first) - gap_rate(other)) <= 3 * sigma


def test_the_first_engagement_is_as_lucky_as_speed_window(campaign: Campaign) -> None:
    first = [
        row
        for report in campaign.values()
        for row in report["shifts"]
        if row["reference"] == "unknown"
    ]
    assert gap_rate(first) < 0.75, "the phase looks known before it can be"


def test_the_filter_of_the_thesis_beats_the_window_in_speed(campaign: Campaign) -> None:
    for report in campaign.values():
        window, thesis = report["estimation"]["window"], report["estimation"]["thesis"]
        for figure in (
            estimator[name]
            for estimator in (window, thesis)
            for name in ("angle_rms_deg", "speed_rms_rpm")
        ):
            assert math.isfinite(figure) and figure > 0.0
        assert thesis["speed_rms_rpm"] < window["speed_rms_rpm"]
        assert thesis["angle_rms_deg"] < PITCH_DEG / 2


@pytest.mark.parametrize("estimator", ["window", "thesis"])
@pytest.mark.parametrize("strategy", ["speed_window", "target_phase"])
def test_estimator_and_strategy_can_be_chosen(
    simulated: Callable[..., Recorded], wire: Any, estimator: str, strategy: str
) -> None:
    chosen = simulated("--seed", 5, "--shifts", 2, "--estimator", estimator, "--strategy", strategy)
    assert len(chosen.report["shifts"]) == 2
    status = [
        wire.decode(frame)
        for frame in chosen.frames
        if wire.name(frame.can_id) == "ControllerStatus"
    ]
    expected_estimator = {"window": 0, "thesis": 1}[estimator]
    expected_strategy = {"speed_window": 0, "target_phase": 2}[strategy]
    assert {one["Estimator"] for one in status} == {expected_estimator}
    assert {one["Strategy"] for one in status} == {expected_strategy}


def test_a_sheet_of_ones_own_takes_the_place_of_the_preset(tmp_path: Path) -> None:
    text = THESIS_SHEET.read_text()
    assert "teeth = 48" in text
    (tmp_path / "other.toml").write_text(text.replace("teeth = 48", "teeth = 24"))
    outcome = run(
        *words("simulate --preset thesis --seed 1 --shifts 1 --json - --gearbox"),
        tmp_path / "other.toml",
    )
    assert_ended_well(outcome)
    report = outcome.json
    assert report["shifts"][0]["pitch_deg"] == pytest.approx(15.0)
    # The hash is of the values: a comment changes nothing, a tooth does.
    sums = {}
    for name, changed in (("comment", text + "\n# a comment\n"), ("thesis", text)):
        (tmp_path / f"{name}.toml").write_text(changed)
        sums[name] = run("show", "gearbox", tmp_path / f"{name}.toml", "--json", "-").json["sha256"]
    assert sums["comment"] == sums["thesis"] != report["provenance"]["gearbox_sha256"]


def test_no_shift_is_an_empty_list_or_a_clear_refusal() -> None:
    outcome = run(*words("simulate --preset thesis --seed 1 --shifts 0 --json -"))
    assert "Traceback" not in outcome.err
    assert outcome.code == 2 or (outcome.code == 0 and outcome.json["shifts"] == [])
