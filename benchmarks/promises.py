"""What the main shaft is promised to do in neutral, and what of it is kept.

    python -m benchmarks.promises --gearboxes 24

Each gearbox (sheet truck12) makes 14 shifts up in one of its ranges. After the first six, in which
the controller learns, its estimate of the main shaft is taken at each step in which that is free:
the angle that it expects 30 and 45 ms later, and the probability that the angle is within half a
gap of that. Later the estimate by the edges that have come since says where the shaft was. Printed:
what was promised in the mean and how often it was kept, and both by tenths of what was promised
(reliability diagram: Bröcker and Smith, Weather and Forecasting 22, 2007).
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from benchmarks.shifts import make_shifts
from meshpoint.bench.setup import Setup
from meshpoint.bus.core import AroundCore, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import ControllerState
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile

SHEET: Final = load_sheet("truck12")
PAIRS: Final = {"low": ((2, 4), (4, 6), (1, 3)), "high": ((8, 10), (10, 12), (7, 9))}
SHIFTS, LEARNED = 14, 6
AHEAD_MS: Final = (30, 45)
SETTLED_US: Final = 60_000
"""After the shaft has become free the estimate is taken from then on."""
FREE: Final = (
    ControllerState.SYNCHRONISING,
    ControllerState.COASTING,
    ControllerState.ENGAGING,
    ControllerState.HALTED,
    ControllerState.RETRACTING,
)
HALF_GAP_RAD: Final = 0.5 * SHEET.dog.backlash_rad
TENTHS: Final = 10


class Promise(NamedTuple):
    """An angle expected at a time, and the probability of being within half a gap of it."""

    ahead_ms: int
    time_us: float
    angle_rad: float
    share: float


class Kept(NamedTuple):
    """A promise whose time has come."""

    range_: str
    ahead_ms: int
    share: float
    is_kept: bool


class Watched(AroundCore[ControllerCore]):
    """A controller whose estimates of a free main shaft are written down and held against those
    of later edges."""

    def __init__(self, core: ControllerCore, range_: str) -> None:
        super().__init__(core)
        self._range, self._open, self._free_us = range_, list[Promise](), math.inf
        self.kept: list[Kept] = []

    def step(self, now_us: int) -> Step:
        step = self._core.step(now_us)
        snapshot = self._core.snapshot
        if snapshot is None:
            return step
        now_us, main = snapshot.now_us, snapshot.main
        is_free = self._core.sequence.state in FREE and snapshot.view.main_box_free
        if main is None or not is_free or self._core.shifts < LEARNED:
            self._open.clear()
            self._free_us = math.inf
            return step
        self._free_us = min(self._free_us, now_us)
        while self._open and self._open[0].time_us <= now_us:
            promise = self._open.pop(0)
            off_rad = abs(main.theta_at(promise.time_us) - promise.angle_rad)
            is_kept = off_rad < HALF_GAP_RAD
            self.kept.append(Kept(self._range, promise.ahead_ms, promise.share, is_kept))
        if now_us - self._free_us >= SETTLED_US:
            for ahead_ms in AHEAD_MS:
                then_us = now_us + 1e3 * ahead_ms
                sd_rad = max(main.theta_sd_at(then_us), 1e-9)
                share = math.erf(HALF_GAP_RAD / (math.sqrt(2.0) * sd_rad))
                self._open.append(Promise(ahead_ms, then_us, main.theta_at(then_us), share))
            self._open.sort(key=lambda each: each.time_us)
        return step


def run(seed: int, profile: Profile) -> list[Kept]:
    """The promises of one gearbox."""
    range_ = ("low", "high")[seed % 2]
    setup = Setup(
        SHEET, ControllerSettings(), profile=profile, seed=seed, shifts=SHIFTS, pairs=PAIRS[range_]
    )
    controller = Watched(ControllerCore(setup.header), range_)
    make_shifts(setup, controller)
    return controller.kept


def figures(kept: Sequence[Kept]) -> dict[str, Any]:
    """How many promises there were, what they said in the mean, and how many were kept."""
    if not kept:
        return {"promises": 0}
    return {
        "promises": len(kept),
        "promised": round(sum(each.share for each in kept) / len(kept), 4),
        "kept": round(sum(each.is_kept for each in kept) / len(kept), 4),
    }


def record(kept: Sequence[Kept]) -> dict[str, Any]:
    """All figures."""
    found: dict[str, Any] = {}
    for ahead_ms in AHEAD_MS:
        of = [each for each in kept if each.ahead_ms == ahead_ms]
        tenths = [
            [each for each in of if min(int(TENTHS * each.share), TENTHS - 1) == tenth]
            for tenth in range(TENTHS)
        ]
        found[f"{ahead_ms}_ms"] = {
            "all": figures(of),
            **{name: figures([each for each in of if each.range_ == name]) for name in PAIRS},
            "by_tenths": [figures(each) for each in tenths],
        }
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.promises",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--gearboxes", type=int, default=24, metavar="N", help="default: 24")
    parser.add_argument("--seed", type=int, default=1, help="of the first gearbox (default: 1)")
    profiles = [each.value for each in Profile]
    parser.add_argument("--as-built", default="typical", choices=profiles, help="default: typical")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    parser.add_argument("--json", nargs="?", const="-", metavar="-")
    asked = parser.parse_args(argv)
    seeds = range(asked.seed, asked.seed + asked.gearboxes)
    work = [(seed, Profile(asked.as_built)) for seed in seeds]
    with multiprocessing.get_context("spawn").Pool(asked.jobs) as pool:
        found = record([each for kept in pool.starmap(run, work, chunksize=1) for each in kept])
    if asked.json:
        print(json.dumps(found))
        return 0
    for ahead, of in found.items():
        for name in ("all", *PAIRS):
            print(f"{ahead.replace('_', ' ')} ahead, {name}: {_words(of[name])}")
        for tenth, each in enumerate(of["by_tenths"]):
            low, high = tenth / TENTHS, (tenth + 1) / TENTHS
            print(f"  promised {low:.1f} to {high:.1f}: {_words(each)}")
    return 0


def _words(of: dict[str, Any]) -> str:
    if of["promises"] == 0:
        return "none"
    return f"{of['promises']} promises, {of['promised']:.3f} promised, {of['kept']:.3f} kept"


if __name__ == "__main__":
    sys.exit(main())
