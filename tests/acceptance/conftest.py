"""Runs that several statements look at: each expensive one happens once a session."""

from __future__ import annotations

import sys
import tempfile
import time
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
    Recorded,
    Wire,
    assert_ended_well,
    read_log,
    run,
    run_many,
    words,
)


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


@pytest.fixture
def channel() -> Iterator[str]:
    """A private channel: a socket path short enough for the system's limit."""
    with tempfile.TemporaryDirectory(prefix="mp-", ignore_cleanup_errors=True) as folder:
        yield f"unix:{folder}/bus.sock"


STALL_LIMIT_S = 0.04
"""A valve command expires 100 ms after the last: a machine that stops its processes for half of
that now and then cannot run the nodes in real time, whatever they do."""
PROBE_S = 3.0


@pytest.fixture(scope="session")
def longest_stall_s() -> float:
    """How long this machine keeps a waking process from the processor, at worst over 3 s."""
    end = time.perf_counter() + PROBE_S
    longest = 0.0
    while (before := time.perf_counter()) < end:
        time.sleep(0.001)
        longest = max(longest, time.perf_counter() - before - 0.001)
    return longest


@pytest.fixture
def real_time(longest_stall_s: float) -> None:
    """For a test by the wall clock: it wants a machine that keeps time."""
    stall_s = longest_stall_s
    if stall_s > STALL_LIMIT_S:
        pytest.skip(f"this machine stops processes for {1e3 * stall_s:.0f} ms: no real time here")
