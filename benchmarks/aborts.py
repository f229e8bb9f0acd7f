"""Sleeves that are stopped short of the teeth by valves that are slower than they have ever been.

    python -m benchmarks.aborts --aborts 10000

Each gearbox (sheet truck12, profile typical) makes two upshifts, in which its sleeves are learned.
In those after that, once the old gear is out, the valve that drives the sleeve shuts late, and the
one that is to stop it opens late, by up to 12 ms more than was learned; and each firing is said to
meet a tooth, so that the sleeve is stopped as late as what was learned allows. What must not come
of it: a contact outside the guard's slip window, a state that the rig counts as a violation (but
for both valves of a sleeve being open at once, which is the fault itself). The rest is printed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import statistics
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any, Final
from unittest import mock

import numpy as np

from meshpoint import Bench, ShiftRow
from meshpoint.controller.plan.target_phase import TargetPhase
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.valve_name import OPPOSITE, SLEEVE_VALVE
from meshpoint.dbc.messages import BenchFault, ControllerState, RigFault
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.units import RPM

PAIRS: Final = ((8, 10), (2, 4), (7, 9), (4, 6))
LEARNED: Final = 2
SHIFTS: Final = 8
MOST_LATE_MS: Final = 12.0
"""A valve of the sheet is 12 ms late as built."""
STREAM: Final = 0xAB0
FREE: Final = ControllerState.SYNCHRONISING
"""Of the controller, once the old gear is out."""
NUMBERS: Final = itertools.count(1)
"""Of the faults sent."""


def always(*_asked: Any) -> bool:
    """Another contact would be better."""
    return True


def slow_shift(
    bench: Bench, pair: tuple[int, int], late_ms: tuple[float, float]
) -> ShiftRow | None:
    """A shift whose valves are late by so much from neutral on; None where it came to none."""
    before, target = len(bench.shifts), DRIVE_GEARS[pair[1]].main
    bench.begin(pair[1], pair[0])
    bench.run_until(lambda bench: bench.shift_is_over or bench.status.state is FREE)
    slow_off = BenchFault(
        RigFault.VALVE_SLOW_OFF, int(SLEEVE_VALVE[target]), next(NUMBERS), 0, late_ms[0]
    )
    slow_on = BenchFault(
        RigFault.VALVE_SLOW_ON, int(OPPOSITE[target]), next(NUMBERS), 0, late_ms[1]
    )
    bench.send(slow_off)
    bench.send(slow_on)
    bench.run_until(lambda bench: len(bench.shifts) > before or bench.shift_is_over)
    bench.send(BenchFault(RigFault.NO_FAULT, 0, next(NUMBERS), 0, 0.0))
    bench.run_until(lambda bench: bench.shift_is_over)
    return bench.shifts[-1] if len(bench.shifts) > before else None


def run(seed: int) -> tuple[list[ShiftRow], list[str]]:
    """One gearbox: its shifts, and what the rig says must not be."""
    rng, pair = np.random.Generator(np.random.PCG64([seed, STREAM])), PAIRS[seed % len(PAIRS)]
    with Bench(gearbox="truck12", seed=seed, as_built="typical", gear=pair[0]) as bench:
        for _ in range(LEARNED):
            bench.shift(pair[1], pair[0])
        with mock.patch.object(TargetPhase, "is_to_go_back", always):
            late_ms = rng.uniform(0.0, MOST_LATE_MS, (SHIFTS, 2))
            rows = [slow_shift(bench, pair, (off, on)) for off, on in late_ms.tolist()]
        said = [event.text for event in bench.events if "VIOLATION" in event.text]
    return [row for row in rows if row], [text for text in said if "BOTH_VALVES" not in text]


def main(argv: Sequence[str] | None = None) -> int:
    """Prints what came of it; 1 where something must not have."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--aborts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    namespace = parser.parse_args(argv)
    shifts, violations, first = list[ShiftRow](), list[str](), 100_000 * namespace.seed
    with multiprocessing.get_context("spawn").Pool(namespace.jobs) as pool:
        for gearbox in pool.imap(run, range(first, first + namespace.aborts)):
            shifts += gearbox[0]
            violations += gearbox[1]
            aborts = sum(row.aborts for row in shifts)
            print(f"\r{aborts} aborts", end="", file=sys.stderr, flush=True)
            if aborts >= namespace.aborts:
                break
        pool.terminate()
    print(file=sys.stderr)
    window_rpm = ControllerSettings().guard.slip_high_rad_s / RPM
    slips_rpm = [abs(row.slip_rpm) for row in shifts if row.slip_rpm is not None]
    impacts_j = [row.impact_j for row in shifts]
    figures = {
        "shifts": len(shifts),
        "aborts": sum(row.aborts for row in shifts),
        "first_on_tooth": sum(row.contact == "tooth" for row in shifts),
        "slip_most_rpm": round(max(slips_rpm), 1),
        "outside_window": sum(slip > window_rpm for slip in slips_rpm),
        "impact_mean_j": round(statistics.fmean(impacts_j), 3),
        "impact_most_j": round(max(impacts_j), 2),
        "results": Counter(f"{row.result} ({row.fault})" for row in shifts),
        "violations": len(violations),
    }
    print(json.dumps(figures) if namespace.json else figures)
    for line in violations[:5]:
        print(line, file=sys.stderr)
    return 1 if violations or figures["outside_window"] else 0


if __name__ == "__main__":
    sys.exit(main())
