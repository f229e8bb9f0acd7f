"""The firmware in the loop against the rig's own board: the same frames, and what it costs.

    python -m benchmarks.bench_firmware --shifts 1000 --profile typical --seed 1
    python -m benchmarks.bench_firmware --firmware cortex-m4 --against native --shifts 40

Of the native build, or the linked image on the emulated board; --against another one, where it is
not the rig's own board. Both runs are made in turn, ten shifts from each seed (a hundred seeds for
1,000 shifts). Says how many frames were compared and which was the first that differs, the speed of
each, and how many of the aimed shifts met a gap first with each. Ends with 1 where a frame differs.
"""

from __future__ import annotations

import argparse
import sys
import time
from array import array
from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest
from zlib import crc32

import numpy as np

from meshpoint.bench.schedules import SCHEDULES
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.campaigns.intervals import rate_interval
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.firmware.board import Firmware
from meshpoint.gearbox import load_sheet
from meshpoint.results.rows import ShiftRow, is_aimed
from meshpoint.rig_sim.settings import Profile

SHIFTS_A_SEED = 10
OWN = "the rig's own board"


def traffic(setup: Setup) -> tuple[array[int], list[ShiftRow], float, float]:
    """A checksum of each frame with its time, the shifts, simulated and processor seconds."""
    seen = array("L")

    def take(time_us: int, frame: Frame) -> None:
        seen.append(crc32(frame.data, crc32(b"%d %d" % (time_us, frame.can_id))))

    begun_s = time.process_time()
    result = simulate(setup, take)
    took_s = time.process_time() - begun_s
    return seen, result.rows, result.simulated_s, took_s


def gap_rates(pairs: Sequence[tuple[int, ShiftRow, ShiftRow]]) -> str:
    """Of the shifts that aimed in both runs, with the seed of each: how many met a gap first."""
    aimed = [pair for pair in pairs if is_aimed(pair[1]) and is_aimed(pair[2])]
    if not aimed:
        return "no shift aimed"
    _, clusters = np.unique([seed for seed, *_ in aimed], return_inverse=True)
    hits = np.array([[row.contact == "gap" for row in rows] for _, *rows in aimed])
    own, firmware = (
        f"{side.mean():.1%} ({' to '.join(f'{end:.1%}' for end in rate_interval(side, clusters))})"
        for side in hits.T
    )
    more = hits[:, 1].mean() - hits[:, 0].mean()
    otherwise = hits[:, 0] != hits[:, 1]
    _, most = rate_interval(otherwise, clusters)
    return (
        f"{len(aimed)} shifts aimed in both: first contact in a gap {own} with the rig's own "
        f"board, {firmware} with the firmware; difference {more:+.1%}, {otherwise.sum()} met "
        f"otherwise (at most {most:.1%}; 95 %, by gearbox)"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shifts", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--profile", default="typical", choices=[str(each) for each in Profile])
    parser.add_argument("--firmware", type=Firmware, default="native", choices=list(Firmware))
    parser.add_argument("--against", type=Firmware, choices=list(Firmware),
                        help="default: the rig's own board")  # fmt: skip
    parser.add_argument("--pairs", default="mixed", choices=list(SCHEDULES))
    given = parser.parse_args()
    pairs: list[tuple[int, ShiftRow, ShiftRow]] = []
    frames = different = different_rows = 0
    spent_s, simulated_s = [0.0, 0.0], 0.0
    seeds = range(given.seed, given.seed + -(-given.shifts // SHIFTS_A_SEED))
    for seed in seeds:
        alone = Setup(
            load_sheet("truck12"), ControllerSettings(), seed=seed, shifts=SHIFTS_A_SEED,
            pairs=SCHEDULES[given.pairs], profile=Profile(given.profile), firmware=given.against,
        )  # fmt: skip
        runs = [traffic(each) for each in (alone, replace(alone, firmware=given.firmware))]
        (own, own_rows, simulated, _), (firmware, rows, *_) = runs
        first = next((i for i, (a, b) in enumerate(zip_longest(own, firmware)) if a != b), None)
        frames += len(own)
        simulated_s += simulated
        spent_s = [a + run[3] for a, run in zip(spent_s, runs, strict=True)]
        different += first is not None
        different_rows += sum(a != b for a, b in zip_longest(own_rows, rows))
        pairs += [(seed, *both) for both in zip(own_rows, rows, strict=True)]
        if first is not None:
            print(f"seed {seed}: frame {first} of {len(own)} is the first that differs")
    print(gap_rates(pairs))
    print(
        f"{given.firmware}, {given.profile}, --pairs {given.pairs}, "
        f"{len(seeds) * SHIFTS_A_SEED} shifts from seeds {seeds.start} to {seeds.stop - 1}: "
        f"{frames} frames in {simulated_s:.0f} s of bus time, {different} runs with another frame, "
        f"{different_rows} shifts with another row"
    )
    alone_x, firmware_x = (simulated_s / each for each in spent_s)
    print(
        f"{alone_x:.1f} x real time with {given.against or OWN}, "
        f"{firmware_x:.1f} x with {given.firmware} ({firmware_x / alone_x:.2f} of it); a "
        f"second of the bus costs {1e3 / firmware_x - 1e3 / alone_x:.0f} ms more; processor time, "
        "one core"
    )
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
