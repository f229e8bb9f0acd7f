"""Closed-loop shifts a second a core, and what a second core gives.

A run is what `meshpoint campaign` makes of a seed with its default settings: 6 learning shifts,
then 2 judged ones by each of `speed_window`, `target_phase` and `true_state`, on the truck12 sheet,
through encoded frames of both cores. The seconds are those of the processor, of each run the least
of several repeats, as others may use the machine. The second core's gain is of wall times: the same
runs by one process, and by two at once.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Sequence

from meshpoint.campaigns.draw import upshifts
from meshpoint.campaigns.run import RunResult, run_many, run_one
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

SEED = 2
RUNS = 4
"""Of different gears, temperatures and slopes, so of different length."""


def campaign() -> CampaignSpec:
    """The campaign that the runs are of."""
    return CampaignSpec(
        sheet=load_sheet("truck12"),
        settings=ControllerSettings(),
        preset=Preset.TRUCK,
        strategies=("speed_window", "target_phase"),
        true_state=True,
        pairs=upshifts(),
        learn=6,
        judged=2,
        seed=SEED,
        profile=Profile.CLEAN,
    )


def least_cpu_s(spec: CampaignSpec, jobs: list[Job], repeats: int) -> tuple[int, int, float]:
    """Shifts of all jobs, the judged ones of them, and the processor's seconds, of each job the
    least."""
    shifts, judged, cpu_s = 0, 0, 0.0
    for job in jobs:
        results = [_made(spec, job) for _ in range(repeats)]
        shifts += results[0].shifts
        judged += len(results[0].records)
        cpu_s += min(result.cpu_s for result in results)
    return shifts, judged, cpu_s


def _made(spec: CampaignSpec, job: Job) -> RunResult:
    result = run_one(spec, job)
    if result.error is not None:
        raise RuntimeError(result.error)
    return result


def second_core(spec: CampaignSpec, jobs: list[Job], repeats: int) -> float:
    """How many times as fast two warm processes make twice the runs, wall time; the best of all."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(2) as pool:
        pool.starmap(run_many, [(spec, jobs[:1])] * 2, chunksize=1)  # loaded and compiled
        one_s, two_s = [], []
        for _ in range(repeats):
            began = time.perf_counter()
            pool.apply(run_many, (spec, jobs))
            one_s.append(time.perf_counter() - began)
            began = time.perf_counter()
            pool.starmap(run_many, [(spec, jobs)] * 2, chunksize=1)
            two_s.append(time.perf_counter() - began)
    return 2.0 * min(one_s) / min(two_s)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=5)
    namespace = parser.parse_args(argv)
    spec = campaign()
    jobs = spec.jobs(RUNS)
    least_cpu_s(spec, jobs[:1], 1)
    shifts, judged, cpu_s = least_cpu_s(spec, jobs, namespace.repeats)
    figures = {
        "shifts_per_s_per_core": round(shifts / cpu_s, 1),
        "judged_shifts_per_s_per_core": round(judged / cpu_s, 1),
        "ms_per_shift": round(1e3 * cpu_s / shifts, 1),
        "two_cores_times": round(second_core(spec, jobs, namespace.repeats), 2),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(
            f"campaign: {figures['shifts_per_s_per_core']} closed-loop shifts a second a core "
            f"({figures['ms_per_shift']} ms each), "
            f"{figures['judged_shifts_per_s_per_core']} of them judged; "
            f"two cores {figures['two_cores_times']} x one"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
