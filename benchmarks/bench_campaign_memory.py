"""Peak memory of a campaign of many shifts: from its table on disk to JSON, report and table.

The shifts are synthetic: those of a few runs that were made, over and over with other seeds, their
figures stretched by a random factor of each run. They are stored as a campaign stores them, and
`meshpoint campaign --resume` reads them and does everything that comes after the last run. That is
measured in a process of its own: the most memory it ever had (VmHWM of Linux), and its seconds.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.bench_campaign import campaign
from meshpoint.campaigns.columns import FIELDS, ShiftColumns, Shifts
from meshpoint.campaigns.run import run_one
from meshpoint.campaigns.spec import SEEDS_APART, CampaignSpec
from meshpoint.campaigns.store import Store

SHIFTS = 100_000
STRATEGIES = ("speed_window", "target_phase")
MADE = 4
"""Runs that are made for it."""
CHILD = """
import sys, time
from meshpoint.cli.main import main
code = main(sys.argv[1:])
status = open("/proc/self/status").read()
print(status.partition("VmHWM:")[2].split()[0], time.process_time(), file=sys.stderr)
sys.exit(code)
"""
STRETCHED = ("duration_ms", "slip_rpm", "phase_error_deg", "impact_j", "delay_ms", "bound_ms")


def stored(folder: Path, runs: int) -> None:
    """A campaign at its end, as `--resume` finds it."""
    spec = dataclasses.replace(campaign(), strategies=STRATEGIES, true_state=False)
    store = Store(folder, spec, resume=False)
    store.finish(synthetic(spec, runs))


def synthetic(spec: CampaignSpec, runs: int) -> Shifts:
    """This many runs made of a few."""
    made = Shifts.of(record for job in spec.jobs(MADE) for record in run_one(spec, job).records)
    rng = np.random.default_rng(1)
    seeds = made.column("seed") - SEEDS_APART * spec.seed
    rows_of = [np.flatnonzero(seeds == seed) for seed in range(MADE)]
    chosen = rng.integers(0, MADE, runs)
    rows = np.concatenate([rows_of[k] for k in chosen])
    run = np.repeat(np.arange(runs), [rows_of[k].size for k in chosen])
    factor = rng.uniform(0.9, 1.1, runs)[run]
    columns = {name: made.column(name)[rows] for name in FIELDS}
    columns["seed"] = SEEDS_APART * spec.seed + run
    for name in STRETCHED:
        columns[name] = columns[name] * factor
    many = ShiftColumns()
    many.extend_by(columns, dict.fromkeys(FIELDS, made.words))
    return many.all()


def measured(folder: Path, runs: int) -> dict[str, float]:
    """What the command took, in a process that does nothing else."""
    command = [
        "campaign", "--resume", "--out", str(folder), "--runs", str(runs), "--jobs", "1",
        "--strategy", ",".join(STRATEGIES), "--gearbox", "truck12", "--as-built", "clean",
        "--seed", str(campaign().seed), "--json", str(folder / "figures.json"),
    ]  # fmt: skip
    began_s = time.perf_counter()
    done = subprocess.run(  # noqa: S603 (the product itself)
        [sys.executable, "-c", CHILD, *command], capture_output=True, text=True, check=True
    )
    peak_kb, cpu_s = done.stderr.split()[-2:]
    return {
        "peak_mb": round(int(peak_kb) / 1e3),
        "cpu_s": round(float(cpu_s), 1),
        "wall_s": round(time.perf_counter() - began_s, 1),
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--shifts", type=int, default=SHIFTS, help="judged ones, of both strategies"
    )
    parser.add_argument("--json", action="store_true")
    namespace = parser.parse_args(argv)
    runs = namespace.shifts // (len(STRATEGIES) * campaign().judged)
    with tempfile.TemporaryDirectory() as folder:
        stored(Path(folder), runs)
        figures = measured(Path(folder), runs)
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"campaign of {namespace.shifts} judged shifts: {figures['peak_mb']:.0f} MB at most, "
            f"{figures['cpu_s']} s of the processor, {figures['wall_s']} s"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
