"""A campaign that stops by itself: at an interval that holds what it says, or when time is over."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import campaign, small_spec
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.studies.campaign_statistics_run import CoverageRun
from meshpoint.campaigns.run import RunResult
from meshpoint.campaigns.runner import run_all
from meshpoint.campaigns.sequential import (
    LEAST_RUNS,
    against_known,
    looks,
    paired_estimate,
    parse_goal,
)
from meshpoint.campaigns.spec import Job
from meshpoint.campaigns.stopping import Until


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        (0.99, 0.22, "first_contact_gap difference +-2%"),
        (0.97, 0.95, "first_contact_gap difference +-2%"),
        (0.99, 0.22, "first_contact_gap ratio +-0.5"),
    ],
)
def test_an_interval_that_was_looked_at_until_narrow_holds_the_truth_as_often_as_it_says(
    a: float, b: float, words: str
) -> None:
    """500 simulated campaigns; 0.93 to 0.97 is three standard deviations of chance around 0.95."""
    simulated = CoverageRun(words, (a, b), icc=0.12, shifts=2, runs=2048, campaigns=500, seed=7)
    found = simulated.run()
    assert found.median_runs < 2048
    assert 0.93 <= found.held <= 0.97


@pytest.mark.parametrize(
    ("own", "half_width", "icc"),
    [pytest.param(0.95, 2, 0.12, marks=pytest.mark.long), (0.98, 1, 0.31), (0.995, 1, 0.12)],
)
def test_an_interval_against_a_rate_that_is_integrated_holds_the_truth_as_often_as_it_says(
    own: float, half_width: int, icc: float
) -> None:
    """What is left of chance is in few gearboxes that miss: the more they differ, the less their
    own spread says of it. Where hardly any misses, an interval may hold more than it says."""
    words = f"first_contact_gap difference +-{half_width}%"
    found = CoverageRun(words, (own, 0.22), icc, 6, 2048, 500, 7, is_integrated=True).run()
    assert found.median_runs < 2048
    assert 0.92 <= found.held <= (0.99 if own > 0.99 else 0.97)


def test_a_hundred_runs_without_a_miss_are_enough_for_an_interval_of_one_per_cent() -> None:
    """By Student's t over runs it took 142, whatever was judged in each."""
    few, many, hits = np.full(64, 1.0), np.full(64, 6.0), np.full(64, 6.0)
    found = against_known("difference", hits, many, 0.21 * few, few)
    assert found.value == pytest.approx(0.79)
    assert found.half_width < 0.01
    assert against_known("difference", few, few, 0.21 * few, few).half_width > 0.01


def test_a_ratio_to_a_rate_that_may_be_none_is_not_known() -> None:
    one = np.ones(32)
    assert against_known("ratio", one, one, 0.0 * one, one).to_json()["ci95"] == [None, None]
    found = against_known("ratio", one, one, 0.5 * one, one)
    assert found.value == 2.0
    assert found.low < 2.0 <= found.high <= 2.0 + 1e-9


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
    assert list(looks(100)) == [LEAST_RUNS, 38, 45, 54, 64, 76, 91, 100]
    assert list(looks(5)) == [5]


def test_with_a_budget_nothing_is_begun_that_would_end_after_it() -> None:
    now_s = 0.0
    until = Until(parse_goal("impact_j ratio +-0.001"), ("a", "b"), 100.0, lambda: now_s)
    made = []
    for runs in until.looks(10_000):
        made.append(runs)
        now_s = float(runs)  # a run takes a second
    assert made == [32, 38, 45, 54, 64, 76, 91]
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


def test_a_budget_is_held_within_a_step_and_what_was_made_is_the_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One run is always made; a second would take longer than the budget."""
    goal = ("--until", "duration_ms ratio +-0.0001", "--budget", "0.001", "--jobs", "1")
    found = campaign(tmp_path, "--learn", "0", *goal)
    assert found.code == 0
    assert found.values["runs"] == 1
    assert len({row["seed"] for row in found.table}) == 1
    assert found.values["until"]["stopped_by"] == "budget"
    assert "stopped by budget" in capsys.readouterr().out


class Worker:
    """Takes ten seconds for each run that it is given, at once."""

    now_s = 0.0

    def submit(self, _work: object, _spec: object, jobs: list[Job]) -> Future[list[RunResult]]:
        self.now_s += 10.0
        done: Future[list[RunResult]] = Future()
        done.set_result([RunResult(job) for job in jobs])
        return done


@pytest.mark.parametrize(("at_once", "most"), [(1, 10), (2, 8)])
def test_no_run_is_begun_that_would_end_after_the_budget(at_once: int, most: int) -> None:
    """Of 100 s, at 10 s a run; two at a time take twice as long each."""
    worker, taken = Worker(), list[RunResult]()
    until = Until(parse_goal("impact_j ratio +-0.001"), ("a", "b"), 100.0, lambda: worker.now_s)
    assert next(until.looks(64)) == 32
    jobs = [Job(seed) for seed in range(1, 33)]
    place: Any = worker
    made = run_all(
        small_spec(), jobs, place, taken.extend,
        lambda: until.may_begin(len(taken), at_once), at_once,
    )  # fmt: skip
    assert made
    assert [result.job for result in taken] == jobs[:most]
    assert until.to_json()["until"]["stopped_by"] == "budget"
