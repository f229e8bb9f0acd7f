"""Runs that several statements look at: each expensive one happens once a session."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from acceptance_kit import (
    Frame,
    Outcome,
    Wire,
    assert_ended_well,
    read_log,
    run,
    run_many,
    words,
)

STRATEGIES = ("speed_window", "target_phase")
FIRST_SEEDS = (1, 2, 3)
OTHER_SEEDS = (101, 202, 303)
SHIFTS = 60


@pytest.fixture(scope="session")
def wire() -> Wire:
    return Wire()


class Recorded(NamedTuple):
    """One `simulate` run: its output, its log, and the log's frames."""

    outcome: Outcome
    log: Path
    frames: list[Frame]

    @property
    def report(self) -> dict[str, Any]:
        report: dict[str, Any] = self.outcome.json
        return report


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Recorded]:
    """Run `simulate` with these arguments once a session; ask again and get the same run."""
    kept: dict[tuple[object, ...], Recorded] = {}

    def simulate(*arguments: object) -> Recorded:
        if arguments not in kept:
            log = tmp_path_factory.mktemp("simulated") / "run.log"
            outcome = run("simulate", "--preset", "thesis", *arguments, "--log", log, "--json", "-")
            assert_ended_well(outcome)
            kept[arguments] = Recorded(outcome, log, read_log(log))
        return kept[arguments]

    return simulate


@pytest.fixture(scope="session")
def recorded(simulated: Callable[..., Recorded]) -> Recorded:
    """Three aimed shifts with everything recorded."""
    return simulated("--seed", 1, "--shifts", 3, "--strategy", "target_phase")


@pytest.fixture(scope="session")
def campaign() -> dict[tuple[str, int], dict[str, Any]]:
    """Reports of 60 shifts with each strategy and seed."""
    keys = [(strategy, seed) for seed in FIRST_SEEDS + OTHER_SEEDS for strategy in STRATEGIES]
    outcomes = run_many(
        [
            [
                *words(f"simulate --preset thesis --seed {seed} --shifts {SHIFTS}"),
                *words(f"--strategy {strategy} --json -"),
            ]
            for strategy, seed in keys
        ]
    )
    for outcome in outcomes:
        assert_ended_well(outcome)
    return {key: outcome.json for key, outcome in zip(keys, outcomes, strict=True)}


@pytest.fixture
def channel() -> Iterator[str]:
    """A private channel: a socket path short enough for the system's limit."""
    with tempfile.TemporaryDirectory(prefix="mp-", ignore_cleanup_errors=True) as folder:
        yield f"unix:{folder}/bus.sock"
