"""The firmware in the loop against the rig's own board: the same frames, and what it costs.

    python -m benchmarks.bench_firmware --shifts 1000 --profile typical --seed 1
    python -m benchmarks.bench_firmware --firmware cortex-m4 --against native --shifts 40

It is the native build, or the linked image on the emulated board; --against another one, where it
is not the rig's own board. Both runs are made in turn, ten shifts from each seed (a hundred seeds
for 1,000 shifts). Says how many frames were compared and which was the first that differs, and the
speed of each. Ends with 1 where one differs.
"""

from __future__ import annotations

import argparse
import sys
import time
from array import array
from dataclasses import replace
from itertools import zip_longest
from zlib import crc32

from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile
from meshpoint.testbench.firmware.board import Firmware
from meshpoint.testbench.loop.schedules import MIXED
from meshpoint.testbench.loop.setup import Setup
from meshpoint.testbench.loop.simulate import simulate

SHIFTS_A_SEED = 10
OWN = "the rig's own board"


def traffic(setup: Setup) -> tuple[array[int], list[str], float, float]:
    """A checksum of each frame with its time, the contacts, simulated and processor seconds."""
    seen = array("L")

    def take(time_us: int, frame: Frame) -> None:
        seen.append(crc32(frame.data, crc32(b"%d %d" % (time_us, frame.can_id))))

    begun_s = time.process_time()
    result = simulate(setup, take)
    took_s = time.process_time() - begun_s
    return seen, [str(row.to_json()) for row in result.rows], result.simulated_s, took_s


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shifts", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--profile", default="typical", choices=[str(each) for each in Profile])
    kinds = [str(each) for each in Firmware]
    parser.add_argument("--firmware", default=str(Firmware.NATIVE), choices=kinds)
    parser.add_argument("--against", choices=kinds, help="default: the rig's own board")
    given = parser.parse_args()
    against = None if given.against is None else Firmware(given.against)
    frames = different = different_rows = 0
    spent_s, simulated_s = [0.0, 0.0], 0.0
    seeds = range(given.seed, given.seed + -(-given.shifts // SHIFTS_A_SEED))
    for seed in seeds:
        alone = Setup(
            load_sheet("truck12"), ControllerSettings(), seed=seed, shifts=SHIFTS_A_SEED,
            pairs=MIXED, profile=Profile(given.profile), firmware=against,
        )  # fmt: skip
        runs = [
            traffic(each) for each in (alone, replace(alone, firmware=Firmware(given.firmware)))
        ]
        (own, own_rows, simulated, _), (firmware, rows, *_) = runs
        first = next((i for i, (a, b) in enumerate(zip_longest(own, firmware)) if a != b), None)
        frames += len(own)
        simulated_s += simulated
        spent_s = [a + run[3] for a, run in zip(spent_s, runs, strict=True)]
        different += first is not None
        different_rows += sum(a != b for a, b in zip_longest(own_rows, rows))
        if first is not None:
            print(f"seed {seed}: frame {first} of {len(own)} is the first that differs")
    print(
        f"{given.profile}, {len(seeds) * SHIFTS_A_SEED} shifts from seeds {seeds.start} to "
        f"{seeds.stop - 1}: {frames} frames in {simulated_s:.0f} s of bus time, {different} runs "
        f"with another frame, {different_rows} shifts with another row"
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
