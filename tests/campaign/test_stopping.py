"""A campaign that stops by itself: at an interval that holds what it says, or with a verdict."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from meshpoint.testbench.campaign.sequential import (
    LEAST_RUNS,
    Estimate,
    Goal,
    looks,
    paired_estimate,
    parse_goal,
)
from meshpoint.testbench.campaign.stopping import Until
from meshpoint.testbench.campaign.verdict import Comparison, Verdict
from meshpoint.testbench.cli import main

ICC = 0.12
SHIFTS = 2
Floats = NDArray[np.float64]


def gaps(rng: np.random.Generator, rate: float, runs: int) -> Floats:
    """Gaps of each run: the rate of a gearbox is drawn, so that its shifts go together."""
    spread = (1.0 - ICC) / ICC
    of_run = rng.beta(rate * spread, (1.0 - rate) * spread, runs)
    return rng.binomial(SHIFTS, of_run).astype(np.float64)


def stopped(rng: np.random.Generator, a: float, b: float, goal: Goal) -> Estimate:
    """One simulated campaign of two strategies with these rates, until its goal."""
    most = 8192
    first, second, n = gaps(rng, a, most), gaps(rng, b, most), np.full(most, float(SHIFTS))
    found = Estimate(math.nan, math.inf, 0)
    for runs in looks(most):
        found = paired_estimate(goal.kind, first[:runs], n[:runs], second[:runs], n[:runs])
        if found.half_width <= goal.half_width:
            break
    return found


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        (0.99, 0.22, "first_contact_gap difference +-2%"),
        pytest.param(0.97, 0.95, "first_contact_gap difference +-2%", marks=pytest.mark.long),
        pytest.param(0.99, 0.22, "first_contact_gap ratio +-0.5", marks=pytest.mark.long),
    ],
)
def test_an_interval_that_was_looked_at_until_narrow_holds_the_truth_as_often_as_it_says(
    a: float, b: float, words: str
) -> None:
    """500 simulated campaigns; 0.93 to 0.97 is three standard deviations of chance around 0.95."""
    rng, goal = np.random.default_rng(7), parse_goal(words)
    truth = a - b if goal.kind == "difference" else a / b
    found = [stopped(rng, a, b, goal) for _ in range(500)]
    assert all(e.half_width <= goal.half_width for e in found)
    assert 0.93 <= np.mean([e.low <= truth <= e.high for e in found]) <= 0.97


def judged(rng: np.random.Generator, before: float, after: float, together: float) -> Comparison:
    """The verdict on one change; `together`: how often before and after share their chance."""
    comparison, spread = Comparison(base_misses=1.0 - before, margin=0.03), (1.0 - ICC) / ICC
    while comparison.verdict is Verdict.OPEN:
        miss = float(rng.beta((1.0 - before) * spread, before * spread))
        worse_miss = min(1.0, miss * (1.0 - after) / (1.0 - before))
        was = rng.random(SHIFTS)
        now = np.where(rng.random(SHIFTS) < together, was, rng.random(SHIFTS))
        missed, misses = was < miss, now < worse_miss
        comparison.take(int((~missed & misses).sum()), int((missed & ~misses).sum()), SHIFTS)
    return comparison


@pytest.mark.parametrize("together", [pytest.param(0.0, marks=pytest.mark.long), 0.9])
def test_a_change_from_99_to_96_per_cent_is_found_and_none_is_not(together: float) -> None:
    """500 simulated changes each; 2 % more than 5 are allowed to chance."""
    rng = np.random.default_rng(3)
    worse = [judged(rng, 0.99, 0.96, together) for _ in range(500)]
    alike = [judged(rng, 0.99, 0.99, together) for _ in range(500)]
    assert np.mean([c.verdict is Verdict.NOT_WORSE for c in worse]) <= 0.07
    assert np.mean([c.verdict is Verdict.WORSE for c in alike]) <= 0.07
    assert np.median([c.pairs for c in worse]) <= 180


def test_shifts_that_never_miss_have_no_interval_of_width_zero() -> None:
    n = np.full(40, 2.0)
    found = paired_estimate("difference", n, n, n, n)
    assert found.value == 0.0
    assert found.half_width > 0.01


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=2, max_size=40))
def test_the_difference_is_that_of_all_shifts_and_turns_its_sign_with_the_strategies(
    hits: list[tuple[int, int]],
) -> None:
    a, b = np.array(hits, dtype=np.float64).T
    n = np.full(a.size, 3.0)
    one, other = (
        paired_estimate("difference", a, n, b, n),
        paired_estimate("difference", b, n, a, n),
    )
    assert one.value == pytest.approx(a.sum() / n.sum() - b.sum() / n.sum())
    assert (one.value, one.half_width) == pytest.approx((-other.value, other.half_width))


def test_it_looks_at_growing_numbers_of_runs_and_at_the_last_one() -> None:
    assert list(looks(100)) == [LEAST_RUNS, 45, 64, 91, 100]
    assert list(looks(5)) == [5]


def test_with_a_budget_nothing_is_begun_that_would_end_after_it() -> None:
    now_s = 0.0
    until = Until(parse_goal("impact_j ratio +-0.001"), ("a", "b"), 100.0, lambda: now_s)
    made = []
    for runs in until.looks(10_000):
        made.append(runs)
        now_s = float(runs)  # a run takes a second
    assert made == [32, 45, 64, 91]
    assert until.to_json()["until"]["stopped_by"] == "budget"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gap difference +-1%", "allowed are first_contact_gap"),
        ("first_contact_gap odds +-1%", "allowed are difference, ratio"),
        ("first_contact_gap difference", "allowed is"),
        ("first_contact_gap difference +-0%", "more than 0"),
        ("first_contact_gap difference +-1.2.3%", "no number"),
    ],
)
def test_a_goal_that_says_nothing_is_an_error_that_says_what_is_allowed(
    text: str, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        parse_goal(text)


def campaign(folder: Path, *more: str) -> int:
    return main([
        "campaign", "--preset", "thesis", "--learn", "2", "--judged", "1", "--seed", "5",
        "--jobs", "1", *more, "--json", str(folder / "x.json"),
    ])  # fmt: skip


@pytest.mark.long
def test_the_same_code_is_not_worse_than_itself_and_a_blunt_estimator_is(tmp_path: Path) -> None:
    own = ["--strategy", "target_phase"]
    base = [*own, "--runs", "3", "--out", str(tmp_path / "base")]
    assert campaign(tmp_path, *base) == 0
    junit = tmp_path / "junit.xml"
    against = ["--runs", "3", "--against", str(tmp_path / "base"), "--junit", str(junit)]
    assert campaign(tmp_path, *own, *against, "--runs", "1") == 0
    values = json.loads((tmp_path / "x.json").read_text())["against"]
    assert (values["worse"], values["better"], values["pairs"]) == (0, 0, 1)
    assert ET.parse(junit).getroot().attrib["failures"] == "0"
    assert campaign(tmp_path, *own, *against, "--estimator", "window") == 1
    values = json.loads((tmp_path / "x.json").read_text())["against"]
    assert values["verdict"] == "worse"
    assert values["worse"] >= 2
    assert ET.parse(junit).getroot().attrib["failures"] == "1"


def test_until_and_against_name_what_they_lack(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    goal = "first_contact_gap difference +-5%"
    assert campaign(tmp_path, "--strategy", "target_phase", "--until", goal) == 2
    assert "name both with --strategy" in capsys.readouterr().err
    assert campaign(tmp_path, "--budget", "5") == 2
    assert "--budget needs --until" in capsys.readouterr().err
    assert campaign(tmp_path, "--against", str(tmp_path / "none")) == 2
    assert "there is no none" in capsys.readouterr().err
