"""Simulated seconds a wall second: controller, rig and bench through encoded frames, one core."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Sequence

from controller.settings import ControllerSettings
from gearbox import load_sheet
from testbench.simulate import Setup, simulate

WARM_SHIFTS, SHIFTS = 1, 6
LOOPS = 1_000_000


def loop_s() -> float:
    """A plain Python loop of a million additions: what this machine gives just now."""
    begin = time.perf_counter()
    total = 0
    for i in range(LOOPS):
        total += i
    return time.perf_counter() - begin


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=3)
    namespace = parser.parse_args(argv)
    sheet = load_sheet("thesis")
    simulate(Setup(sheet, ControllerSettings(), shifts=WARM_SHIFTS))
    rates, loops = [], []
    for seed in range(namespace.repeats):
        begin = time.perf_counter()
        result = simulate(Setup(sheet, ControllerSettings(), seed=seed, shifts=SHIFTS))
        rates.append(result.simulated_s / (time.perf_counter() - begin))
        loops.append(loop_s())
    figures = {
        "times_real_time": round(statistics.median(rates), 1),
        "shifts_per_s": round(statistics.median(rates) * SHIFTS / result.simulated_s, 1),
        "million_additions_s": round(statistics.median(loops), 4),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"virtual time: {figures['times_real_time']} x real time, "
            f"{figures['shifts_per_s']} shifts a second "
            f"(a million additions in a plain loop: {figures['million_additions_s']} s)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
