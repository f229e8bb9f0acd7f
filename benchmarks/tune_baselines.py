"""Tunes the baselines for their own least mean duration: `python -m benchmarks.tune_baselines`.

Preset truck, data sheet truck12, draws of their own (campaign seed 100, which no campaign is judged
on). Each run learns once; every candidate then makes the same shifts on a copy, so candidates are
compared on the same draws. Coordinate by coordinate through the values below until nothing is
better; a shift that gives up costs `GIVEN_UP_MS`. What was found is in
`controller/settings/settings.py`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any, Final

import numpy as np

from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.spec import SEEDS_APART
from meshpoint.controller.settings.settings import ControllerSettings, Window
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Preset, Profile
from meshpoint.units import RPM

TUNING_SEED: Final = 100
LEARN, JUDGED = 4, 2
GIVEN_UP_MS: Final = 2_000.0
ROUNDS: Final = 3
Candidate = tuple[tuple[str, int], ...]
Axes = dict[str, tuple[int, ...]]
VALUES: Final[dict[str, Axes]] = {
    "speed_window": {
        "fire_slip_rad_s": (30, 40, 50),
        "release_slip_rad_s": (15, 25, 35, 45, 60),
    },
    "speed_window_anticipating": {
        "anticipate_slip_rad_s": (15, 20, 25),
        "anticipate_release_rad_s": (5, 10, 15, 20, 25, 35),
    },
}
"""Settings of the window, rpm. Slip at contact is no free choice but what a sleeve may wear at:
`target_phase` plans none above 25 rpm, the anticipating one meets the gear at 25 at most, and what
is fired within 50 arrives at 28 on average."""
ANY_SLIP: Final[dict[str, Axes]] = {
    "speed_window": {
        "fire_slip_rad_s": (50, 60, 70, 85, 100, 115),
        "release_slip_rad_s": (15, 25, 35, 45, 60, 75),
    },
    "speed_window_anticipating": {
        "anticipate_slip_rad_s": (25, 35, 45, 55, 65),
        "anticipate_release_rad_s": (15, 25, 35, 45, 60, 75),
    },
}
"""For time alone, whatever the wear (`--any-slip`)."""


def settings_of(strategy: str, candidate: Candidate) -> ControllerSettings:
    """The defaults with a candidate's window."""
    changes: dict[str, Any] = {name: rpm * RPM for name, rpm in candidate}
    window = dataclasses.replace(Window(), **changes)
    return ControllerSettings(strategy_name=strategy, window=window)


def durations_ms(
    strategy: str, profile: Profile, candidates: list[Candidate], seed: int
) -> list[list[float]]:
    """One run: learned once, then the judged shifts of every candidate."""
    sheet = load_sheet("truck12")
    drawn = draw(seed, sheet, Preset.TRUCK, upshifts(), LEARN + JUDGED, {}, profile)
    learned = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK, drawn)
    for _ in range(LEARN):
        learned.shift()
    learned.prepare()
    found = []
    for candidate in candidates:
        loop = learned.fork()
        loop.use(settings_of(strategy, candidate), knows_all=False)
        rows = [loop.shift() for _ in range(JUDGED)]
        found.append(
            [
                row.duration_ms
                if row is not None and row.result == "engaged" and row.duration_ms is not None
                else GIVEN_UP_MS
                for row in rows
            ]
        )
    return found


def tune(strategy: str, axes: Axes, profile: Profile, runs: int, jobs: int) -> dict[str, Any]:
    """The best candidate of a strategy, with all that were tried."""
    best = {name: values[len(values) // 2] for name, values in axes.items()}
    tried: dict[Candidate, float] = {}
    seeds = range(SEEDS_APART * TUNING_SEED, SEEDS_APART * TUNING_SEED + runs)
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for _ in range(ROUNDS):
            before = dict(best)
            for name, values in axes.items():
                line: list[Candidate] = [tuple((best | {name: value}).items()) for value in values]
                new = [candidate for candidate in line if candidate not in tried]
                if new:
                    work = partial(durations_ms, strategy, profile, new)
                    means = np.mean(list(pool.map(work, seeds)), axis=(0, 2))
                    tried |= dict(zip(new, means.tolist(), strict=True))
                best = dict(min(line, key=tried.__getitem__))
            if best == before:
                break
    return {
        "strategy": strategy,
        "as_built": str(profile),
        "best_rpm": best,
        "mean_ms": tried[tuple(best.items())],
        "tried": [{**dict(c), "mean_ms": round(ms, 1)} for c, ms in tried.items()],
    }


def main(arguments: list[str]) -> int:
    """Prints what was found as JSON, a line a strategy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--strategy", choices=tuple(VALUES), action="append")
    parser.add_argument("--any-slip", action="store_true")
    parser.add_argument("--as-built", type=Profile, choices=tuple(Profile), default=DEFAULT_PROFILE)
    chosen = parser.parse_args(arguments)
    values = ANY_SLIP if chosen.any_slip else VALUES
    for strategy in chosen.strategy or values:
        found = tune(strategy, values[strategy], chosen.as_built, chosen.runs, chosen.jobs)
        sys.stdout.write(json.dumps(found) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
