"""Simulated seconds a second of the processor: controller, rig and bench through encoded frames.

The run is a function of its seed, so it is repeated, and of each 30 ms of simulated time the least
processor time counts: other work slows this one down even while it has the processor.
The rate of the whole runs by the wall's clock is printed beside it, and what a plain loop takes, by
which figures of two machines, or of a busy one and itself, can be compared.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import time
from collections.abc import Sequence

from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile

WARM_SHIFTS, SHIFTS = 1, 6
SLICE_US = 30_000
LOOPS = 1_000_000


def loop_s() -> float:
    """A plain Python loop of a million additions: what this machine gives just now."""
    begin = time.process_time()
    total = 0
    for i in range(LOOPS):
        total += i
    return time.process_time() - begin


def timed_run(setup: Setup) -> tuple[float, list[float], float]:
    """Simulated seconds of one run, the processor's seconds of its slices, and wall seconds."""
    marks: list[float] = []
    next_us = 0

    def mark(time_us: int, _frame: Frame) -> None:
        nonlocal next_us
        if time_us >= next_us:
            marks.append(time.process_time())
            next_us += SLICE_US

    began_s = time.perf_counter()
    result = simulate(setup, on_frame=mark)
    wall_s = time.perf_counter() - began_s
    marks.append(time.process_time())
    return result.simulated_s, [b - a for a, b in itertools.pairwise(marks)], wall_s


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=8)
    namespace = parser.parse_args(argv)
    setup = Setup(
        load_sheet("thesis"), ControllerSettings(), profile=Profile.CLEAN, seed=2, shifts=SHIFTS
    )
    simulate(Setup(setup.sheet, setup.settings, profile=Profile.CLEAN, shifts=WARM_SHIFTS))
    loops = [loop_s() for _ in range(5)]
    runs = [timed_run(setup) for _ in range(namespace.repeats)]
    simulated_s = runs[0][0]
    undisturbed_s = sum(min(slices) for slices in zip(*(run[1] for run in runs), strict=True))
    wall_s = statistics.median(run[2] for run in runs)
    figures = {
        "times_real_time": round(simulated_s / undisturbed_s, 1),
        "times_real_time_as_run": round(simulated_s / wall_s, 1),
        "shifts_per_s": round(SHIFTS / undisturbed_s, 1),
        "million_additions_s": round(min(loops), 4),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"virtual time: {figures['times_real_time']} x real time "
            f"({figures['times_real_time_as_run']} x by the wall's clock just now), "
            f"{figures['shifts_per_s']} shifts a second "
            f"(a million additions in a plain loop: {figures['million_additions_s']} s)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
