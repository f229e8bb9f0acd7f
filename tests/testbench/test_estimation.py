"""The figures of the estimators, side by side on the same edges, where they are asked for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import meshpoint
from meshpoint.bench.simulate import Setup, simulate
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.results.monitor import Monitor
from meshpoint.rig_sim import Preset, RigCore, RigSettings

SHEET = load_sheet("thesis")
WRAPS_EARLY = 3
"""A seed whose sensor clock wraps before the first shift."""


def test_every_estimator_is_scored_though_the_clock_wraps_before_the_first_shift() -> None:
    rig = RigCore(SHEET, RigSettings(seed=WRAPS_EARLY, preset=Preset.THESIS))
    wraps_us = (1 << 32) - rig.truth.clock_start_us
    setup = Setup(SHEET, ControllerSettings(), Preset.THESIS, WRAPS_EARLY, shifts=3)
    result = simulate(setup, monitor=Monitor(SHEET, setup.settings))
    assert (result.rows[0].request_us - rig.truth.clock_start_us) % (1 << 32) > wraps_us
    window, thesis, crossing = (result.estimation[n] for n in ("window", "thesis", "crossing"))
    assert thesis["speed_rms_rpm"] < window["speed_rms_rpm"]
    assert thesis["angle_rms_deg"] < window["angle_rms_deg"]
    assert crossing["speed_rms_rpm"] < 1.0


ONE_SHIFT = ["simulate", "--preset", "thesis", "--seed", "5", "--shifts", "1"]
SCORED, HOW_TO = "estimator crossing: angle RMS", "--score-estimators"


def test_a_run_on_the_screen_scores_no_estimator_and_says_how_to(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(ONE_SHIFT) == 0
    plain = capsys.readouterr().out
    assert SCORED not in plain and HOW_TO in plain
    assert main([*ONE_SHIFT, "--score-estimators"]) == 0
    scored = capsys.readouterr().out
    assert SCORED in scored and HOW_TO not in scored
    shifts, _, _ = plain.partition("Estimators")
    assert scored.startswith(shifts), "the same shifts"


def test_results_that_show_the_scores_have_them_unless_told_not_to(tmp_path: Path) -> None:
    with_scores, without = tmp_path / "with.json", tmp_path / "without.json"
    log = str(tmp_path / "run.log")  # which takes the messages too that nobody else reads
    assert main([*ONE_SHIFT, "--json", str(with_scores), "--log", log]) == 0
    assert main([*ONE_SHIFT, "--json", str(without), "--no-score-estimators"]) == 0
    found, bare = json.loads(with_scores.read_text()), json.loads(without.read_text())
    assert set(found["estimation"]) == {"window", "thesis", "crossing"}
    assert bare == found | {"estimation": {}}
    mine = meshpoint.simulate(1, seed=5, preset="thesis", score_estimators=False)
    assert mine.to_json() == bare


def test_a_report_has_the_scores(tmp_path: Path) -> None:
    page = tmp_path / "run.html"
    assert main([*ONE_SHIFT, "--report", str(page)]) == 0
    assert SCORED in page.read_text(encoding="utf-8")
