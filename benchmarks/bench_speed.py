"""What meshpoint costs beside a commit before: each figure of either, their ratio, and the goal.

    simulate, campaign, replay   processor time of the command with much to do, less that of the
                                 same command with little: what it takes to start is not in it
    start                        processor time of `simulate` up to the controller's first step
    step                         `benchmarks.bench_step`: processor time of a step, calls and files
    live                         `benchmarks.bench_controller_live`: share of a core, memory

The commit is exported to a folder of its own, and both work there by turns: other work on the
machine slows down either. Of the ratios of all turns the median is printed, beside the median of
each. Kernels are compiled before. `--only` names some of the groups.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from meshpoint.campaigns.git_reference import export, find_commit

HERE: Final = Path(__file__).resolve().parents[1]
START: Final = """\
import runpy, sys, pathlib, meshpoint
expected = pathlib.Path(sys.argv.pop(1)).resolve()
found = pathlib.Path(meshpoint.__file__).resolve().parents[1]
if found != expected:
    sys.exit(f"meshpoint of {expected} was to be run, but {found} came first")
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""
TO_FIRST_STEP: Final = """\
import os, sys, time
class Finder:
    def find_spec(self, _name, _path=None, _target=None):
        for room in ("meshpoint.controller.core.core", "meshpoint.controller.core"):
            core = getattr(sys.modules.get(room), "ControllerCore", None)
            if core is not None:
                core.step = first_step
def first_step(_core, _now_us):
    os.write(1, f"{time.process_time()}\\n".encode())
    os._exit(0)
sys.meta_path.insert(0, Finder())
"""
"""Ends the process there and prints its time: by whatever is loaded after the core's module."""
PROFILES: Final = ("typical", "clean")
LITTLE, MUCH = 1, 6
"""Shifts of a run, and runs of a campaign."""


class Tree(NamedTuple):
    """A product with its benchmarks."""

    source: Path
    work: Path
    """A folder for what it writes."""

    def run(self, module: str, *words: str, first: str = "") -> tuple[float, str]:
        """Runs a module with these arguments, after some text of Python. Processor time (s), and
        what it printed."""
        self.work.mkdir(exist_ok=True)
        said = self.work / "said.txt"
        path = os.pathsep.join(filter(None, (str(self.source), os.environ.get("PYTHONPATH"))))
        with said.open("wb") as file:
            process = subprocess.Popen(  # noqa: S603 (the product itself)
                [sys.executable, "-P", "-c", first + START, str(self.source), module, *words],
                stdout=file, stderr=subprocess.STDOUT, cwd=self.work,
                env=os.environ | {"PYTHONPATH": path},
            )  # fmt: skip
            _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        text = said.read_text(encoding="utf-8", errors="replace")
        if process.returncode != 0:
            raise RuntimeError(f"{module} {' '.join(words)} of {self.source}:\n{text}")
        return used.ru_utime + used.ru_stime, text

    def figures(self, module: str, *words: str) -> dict[str, Any]:
        """The figures of a benchmark, which is asked for JSON: the last line that it prints."""
        found: dict[str, Any] = json.loads(self.run(module, "--json", *words)[1].splitlines()[-1])
        return found

    def less(self, many: Sequence[str], few: Sequence[str]) -> float:
        """Processor time (s) of a command of meshpoint, less that of another one."""
        return self.run("meshpoint", *many)[0] - self.run("meshpoint", *few)[0]


Figures = dict[str, float]
GOALS: Final = {
    "simulate typical, s": "ratio 0.50", "simulate clean, s": "ratio 0.50",
    "campaign typical, s": "ratio 0.57", "campaign clean, s": "ratio 0.66",
    "replay --verify, s": "ratio 0.6", "start, s": "1.0",
    "step in gear, ms": "0.25", "step synchronising, ms": "0.8", "longest step, ms": "3",
    "calls in gear": "350", "calls synchronising": "800", "files": "45",
    "live, % of a core": "8", "live, MB": "170",
}  # fmt: skip


def simulate(tree: Tree, turn: int) -> Figures:
    """A virtual shift after the other."""
    given = ("simulate", "--seed", str(1 + turn), "--as-built")
    return {
        f"simulate {of}, s": tree.less(
            (*given, of, "--shifts", str(MUCH)), (*given, of, "--shifts", str(LITTLE))
        )
        for of in PROFILES
    }


def campaign(tree: Tree, turn: int) -> Figures:
    """Runs of a campaign, one after the other."""
    found = {}
    for of in PROFILES:
        given = ("campaign", "--jobs", "1", "--strategy", "target_phase", "--learn", "2")
        given += ("--judged", "2", "--seed", str(1 + turn), "--as-built", of, "--runs")
        found[f"campaign {of}, s"] = tree.less((*given, str(1 + LITTLE)), (*given, str(LITTLE)))
    return found


def replay(tree: Tree, turn: int) -> Figures:
    """A log of its own."""
    logs = {}
    for shifts in (MUCH, LITTLE):
        logs[shifts] = str(tree.work / f"{turn}-{shifts}.log")
        given = ("--seed", str(1 + turn), "--as-built", "clean", "--shifts", str(shifts))
        tree.run("meshpoint", "simulate", *given, "--log", logs[shifts])
    verified = [("replay", logs[shifts], "--verify") for shifts in (MUCH, LITTLE)]
    return {"replay --verify, s": tree.less(*verified)}


def start(tree: Tree, _turn: int) -> Figures:
    """Before the first step."""
    said = tree.run("meshpoint", "simulate", "--shifts", "1", first=TO_FIRST_STEP)[1]
    return {"start, s": float(said.splitlines()[-1])}


def step(tree: Tree, _turn: int) -> Figures:
    """A step of the controller, by state."""
    found = tree.figures("benchmarks.bench_step", "--repeats", "3")["states"]
    in_gear, synchronising, every = (found[n] for n in ("IN_GEAR", "SYNCHRONISING", "ALL"))
    return {
        "step in gear, ms": in_gear["mean_ms"],
        "step synchronising, ms": synchronising["mean_ms"],
        "longest step, ms": every["longest_ms"],
        "calls in gear": in_gear["calls"],
        "calls synchronising": synchronising["calls"],
        "files": every["files"],
    }


def live(tree: Tree, _turn: int) -> Figures:
    """The controller as a process."""
    found = tree.figures("benchmarks.bench_controller_live", "--windows", "2")
    return {"live, % of a core": found["core_percent"], "live, MB": found["memory_mb"]}


GROUPS: Final[dict[str, Callable[[Tree, int], Figures]]] = {
    "simulate": simulate, "campaign": campaign, "replay": replay, "start": start, "step": step,
    "live": live,
}  # fmt: skip


def compare(
    trees: tuple[Tree, Tree], measure: Callable[[Tree, int], Figures], turns: int
) -> dict[str, tuple[float, float, float]]:
    """Of each figure the median of the commit before, that of now, and that of their ratios."""
    pairs: dict[str, list[tuple[float, float]]] = {}
    for turn in range(turns):
        order = trees if turn % 2 == 0 else trees[::-1]
        by_tree = {tree: measure(tree, turn) for tree in order}
        before, now = (by_tree[tree] for tree in trees)
        for name in now:
            pairs.setdefault(name, []).append((before[name], now[name]))
    return {
        name: (
            statistics.median(before for before, _ in each),
            statistics.median(now for _, now in each),
            statistics.median(now / before for before, now in each),
        )
        for name, each in pairs.items()
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", required=True, metavar="COMMIT")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    namespace = parser.parse_args(argv)
    commit = find_commit(namespace.against)
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as name:
        folder = Path(name)
        before = folder / "source"
        if not export(commit, before):
            parser.error(f"{commit} does not hold the product")
        trees = Tree(before, folder / "before"), Tree(HERE, folder / "now")
        for tree in trees:  # compiled
            tree.run("meshpoint", "simulate", "--shifts", "1", "--as-built", "clean")
        print(f"{'':24}{'before':>10}{'now':>10}{'ratio':>8}  goal; before is {commit}")
        for group in namespace.only:
            for figure, (was, now, ratio) in compare(trees, GROUPS[group], namespace.turns).items():
                print(f"{figure:24}{was:10.3f}{now:10.3f}{ratio:8.2f}  {GOALS[figure]}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
