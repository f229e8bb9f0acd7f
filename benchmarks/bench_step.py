"""What one step of the controller costs: its time, and what is called in it.

    time    of each step of a run, processor time, the least of several repeats: a run is a function
            of its seed, so a step is the same each time, and other work slows it down in few of
            them. Mean and longest by the state that the step begins in; the tick is 10 ms
    calls   functions of meshpoint that a step enters in Python, and files that they are in;
            compiled kernels and libraries are none

The run is of sheet truck12 by the profile asked for, after one that warms all up.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Sequence
from types import FrameType
from typing import Any, Final, NamedTuple

import meshpoint
import meshpoint.controller
import meshpoint.dbc
from benchmarks.shifts import make_shifts
from meshpoint.bench.setup import Setup
from meshpoint.bus.core import AroundCore, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile

SEED: Final = 2
OURS: Final = tuple(
    folder for of in (meshpoint, meshpoint.controller, meshpoint.dbc) for folder in of.__path__
)
"""Folders: an environment inside the repository is none of them."""


class Taken(NamedTuple):
    """One step."""

    state: str
    ms: float
    calls: int
    files: int


class Measured(AroundCore[ControllerCore]):
    """A controller whose steps are timed, or whose calls are counted."""

    def __init__(self, core: ControllerCore, counts: bool) -> None:
        super().__init__(core)
        self._counts = counts
        self.steps: list[Taken] = []

    def step(self, now_us: int) -> Step:
        state, files, calls = self._core.sequence.state.name, set[str](), 0

        def called(frame: FrameType, event: str, _given: Any) -> None:
            nonlocal calls
            if event == "call" and frame.f_code.co_filename.startswith(OURS):
                calls += 1
                files.add(frame.f_code.co_filename)

        sys.setprofile(called if self._counts else None)
        began_ns = time.process_time_ns()
        step = self._core.step(now_us)
        ms = 1e-6 * (time.process_time_ns() - began_ns)
        sys.setprofile(None)
        self.steps.append(Taken(state, ms, calls, len(files)))
        return step


def run(profile: Profile, shifts: int, counts: bool = False) -> list[Taken]:
    """The steps of one run."""
    setup = Setup(
        load_sheet("truck12"), ControllerSettings(), profile=profile, seed=SEED, shifts=shifts
    )
    controller = Measured(ControllerCore(setup.header), counts)
    make_shifts(setup, controller)
    return controller.steps


def by_state(steps: Sequence[Taken], least_ms: Sequence[float]) -> dict[str, dict[str, float]]:
    """Figures of the steps that begin in each state, and of all."""
    names = sorted({step.state for step in steps})
    found = {}
    for name in ("ALL", *names):
        of = [k for k, step in enumerate(steps) if name in ("ALL", step.state)]
        times = [least_ms[k] for k in of]
        found[name] = {
            "steps": len(of),
            "mean_ms": round(statistics.fmean(times), 3),
            "longest_ms": round(max(times), 2),
            "calls": round(statistics.fmean(steps[k].calls for k in of)),
            "files": max(steps[k].files for k in of),
        }
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--shifts", type=int, default=6)
    parser.add_argument("--profile", choices=["clean", "typical"], default="typical")
    namespace = parser.parse_args(argv)
    profile = Profile(namespace.profile)
    run(profile, 1)
    runs = [run(profile, namespace.shifts) for _ in range(namespace.repeats)]
    least_ms = [min(step.ms for step in each) for each in zip(*runs, strict=True)]
    figures = by_state(run(profile, namespace.shifts, counts=True), least_ms)
    if namespace.json:
        print(json.dumps({"profile": profile.value, "states": figures}))
        return 0
    print(f"a step of the controller, truck12, {profile.value}, {namespace.shifts} shifts:")
    for name, of in figures.items():
        print(
            f"  {name.lower():16} {of['steps']:5} steps, mean {of['mean_ms']:6.3f} ms, longest "
            f"{of['longest_ms']:6.2f} ms; {of['calls']:5} calls in at most {of['files']:3} files"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
