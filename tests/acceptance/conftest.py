"""Runs that several statements look at: each expensive one happens once a session."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from acceptance_kit import (
    FIRST_SEEDS,
    OTHER_SEEDS,
    PREPARED,
    SHIFTS,
    STRATEGIES,
    assert_ended_well,
    run,
    run_many,
    words,
)
from acceptance_wire import Recorded, Wire, read_log


@pytest.fixture(scope="session", autouse=True)
def prepared() -> Iterator[None]:
    """End the processes that run the commands."""
    yield
    PREPARED.close()


@pytest.fixture(scope="session")
def wire() -> Wire:
    return Wire()


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
