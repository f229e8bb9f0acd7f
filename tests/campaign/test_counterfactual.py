"""Another strategy's landing worked out from a log, beside the branched bench."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from campaigns import small_spec
from scipy.stats import chi2

from meshpoint.base.provenance import product_version
from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.replays.landing import MOST_SD_SHARE, STUDENT_95
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Verification
from meshpoint.report.judged import Judged
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import DEG

SHIFTS = 4
pytestmark = pytest.mark.long
RECORDED, OTHER = "speed_window", "target_phase"
CHANCE = 0.999
ALIKE = 1
"""Of the shifts, before a phase is known."""
Pairs = list[tuple[Judged, ShiftRow]]


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    """Each recorded shift as judged, and what the same bench did with the other strategy."""
    settings = ControllerSettings(strategy_name=RECORDED)
    spec = small_spec(Preset.THESIS, settings=settings)
    drawn = draw(15, spec.sheet, spec.preset, spec.pairs, SHIFTS + 1, {})
    loop = ClosedLoop(spec.sheet, settings, spec.preset, drawn, log=[])
    truth = []
    for _ in range(SHIFTS):
        loop.prepare()
        branch = loop.fork()
        branch.use(replace(settings, strategy_name=OTHER), knows_all=False)
        row = branch.shift()
        assert row is not None
        truth.append(row)
        loop.shift()
    loop.prepare()
    folder = tmp_path_factory.mktemp("log")
    return list(zip(judge(folder, settings, loop), truth, strict=True))


def judge(folder: Path, settings: ControllerSettings, loop: ClosedLoop) -> list[Judged]:
    spec = small_spec(Preset.THESIS)
    new_header(product_version(), spec.sheet, settings).save(folder)
    open_loop = OpenLoop(
        lambda header: replace(header, settings=header.settings.with_strategy(OTHER))
    )
    assert loop.log is not None
    replay = LogReplay(folder, verify=True, onlooker=open_loop)
    (session,) = replay.run([frame for _, frame in loop.log])
    assert session.verdict is Verification.IDENTICAL, str(session)
    return list(open_loop.judged.values())


def test_the_true_landing_lies_where_the_log_says(compared: Pairs) -> None:
    """Errors over their standard deviations: no larger than chance gives in 999 cases of 1,000."""
    spec = small_spec(Preset.THESIS)
    target_deg = ControllerSettings().aim.target_rad_share * spec.sheet.dog.backlash_rad / 2 / DEG
    squares = []
    for shift, true in compared:
        found = shift.counterfactual
        assert found is not None
        if not found.decidable:
            continue
        assert found.phase_deg is not None
        assert found.phase_low_deg is not None
        assert true.phase_error_deg is not None
        assert true.contact_us is not None
        half = found.phase_deg - found.phase_low_deg
        assert half <= STUDENT_95 * MOST_SD_SHARE * true.pitch_deg
        error = true.phase_error_deg + target_deg - found.phase_deg
        error -= true.pitch_deg * math.floor(error / true.pitch_deg + 0.5)
        true_ms = (true.contact_us - true.request_us) / 1000
        assert found.contact_ms == pytest.approx(true_ms, abs=12.0)
        squares.append((STUDENT_95 * error / half) ** 2)
    assert len(squares) == SHIFTS - ALIKE
    assert sum(squares) < chi2.ppf(CHANCE, len(squares))


def test_what_was_commanded_alike_has_no_counterfactual(compared: Pairs) -> None:
    """Before a phase is known both do the same: what came of it is the log's, and stays there."""
    alike = [shift for shift, _ in compared if shift.parted is None]
    assert len(alike) == ALIKE
    for shift in alike:
        assert shift.counterfactual is not None
        assert not shift.counterfactual.decidable
        assert shift.counterfactual.phase_deg is None
        assert "the log's" in shift.counterfactual.why


def test_a_row_carries_the_landing_under_its_own_name_and_no_contact(compared: Pairs) -> None:
    for shift, true in compared:
        row = shift.to_json()
        assert row["contact"] is None
        reported = row["counterfactual"]
        assert reported["decidable"] is (reported["why"] is None)
        assert (reported["contact_probability"] is None) is not reported["decidable"]
        assert "phase_error_deg" not in row
        # the recorded contact is another one than that worked out
        assert true.contact in ("gap", "tooth")


def test_a_decision_before_the_trajectories_part_is_the_firing_that_is_reported(
    compared: Pairs,
) -> None:
    for shift, _ in compared:
        found = shift.counterfactual
        if found is None or not found.trajectory:
            continue
        assert shift.trajectory_parted_ms is not None
        assert found.trajectory[0][0] >= shift.trajectory_parted_ms - 10.0
        assert found.trajectory[-1][0] == pytest.approx(found.contact_ms)
        phases = [phase for _, _, phase in found.trajectory]
        assert phases == sorted(phases)  # the slip is positive: the phase only grows
