"""What a strategy hits that cannot know the phase: the share of phases, in place of the luck."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from campaigns import judged_shift

from benchmarks.studies.teeth import Engagements
from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.record import JudgedShift, gap_share
from meshpoint.campaigns.sequential import estimate, parse_goal
from meshpoint.gearbox import load_sheet
from meshpoint.units import MM, RPM

GOAL = parse_goal("first_contact_gap difference +-1%")


@pytest.mark.parametrize("chamfer_mm", [0.0, 0.4])
@pytest.mark.parametrize("slip_rpm", [-30.0, 30.0])
def test_the_rig_meets_a_gap_at_that_share_of_evenly_spread_phases(
    chamfer_mm: float, slip_rpm: float
) -> None:
    """On either side the chamfer lets in a tooth that comes, and none that goes."""
    sheet, phases = load_sheet("truck12"), 200
    tried = Engagements(
        sheet, (("dog.chamfer_mm", chamfer_mm),), (slip_rpm * RPM,), phases, patience_us=50_000.0
    ).run()
    share = sum(each.gap for each in tried[slip_rpm * RPM]) / phases
    assert share == pytest.approx(gap_share(sheet, 1.0, chamfer_mm * MM), abs=1.01 / phases)


def shifts(rng: np.random.Generator, runs: int) -> list[JudgedShift]:
    """Two of each run and strategy: one misses as the phase comes, one in 1 %."""
    found: list[JudgedShift] = []
    for seed in range(runs):
        share = float(rng.uniform(0.19, 0.23))
        for shift in range(2):
            for strategy, chance in (("speed_window", share), ("target_phase", 0.99)):
                contact = "gap" if rng.random() < chance else "tooth"
                values: dict[str, Any] = {
                    "seed": seed,
                    "shift": shift,
                    "strategy": strategy,
                    "contact": contact,
                }
                found.append(judged_shift(**values, gap_share=share))
    return found


def test_the_share_of_phases_has_the_mean_of_the_hits_and_not_their_luck() -> None:
    """0.99 less 0.21, over 20 campaigns; four standard deviations of chance are allowed."""
    rng = np.random.default_rng(1)
    found = [
        [
            estimate(GOAL, Shifts.of(records), "target_phase", "speed_window", plain=plain)
            for plain in (False, True)
        ]
        for records in (shifts(rng, 100) for _ in range(20))
    ]
    integrated, plain = zip(*found, strict=True)
    assert np.mean([one.value for one in integrated]) == pytest.approx(0.78, abs=0.0064)
    assert np.mean([one.value for one in plain]) == pytest.approx(0.78, abs=0.027)
    assert all(a.half_width < 0.6 * b.half_width for a, b in zip(integrated, plain, strict=True))


def test_a_shift_without_contact_hits_nothing_and_aimed_ones_count_as_they_were() -> None:
    records = shifts(np.random.default_rng(1), 40)
    never = [
        replace(each, contact=None) if each.strategy == "speed_window" else each for each in records
    ]
    aimed = sum(r.contact == "gap" for r in records if r.strategy == "target_phase") / 80
    assert estimate(GOAL, Shifts.of(never), "target_phase", "speed_window").value == pytest.approx(
        aimed
    )
