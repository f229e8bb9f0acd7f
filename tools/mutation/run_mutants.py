"""Makes mutants of the product, one small mistake each, and says which of them no test catches.

    python tools/mutation/run_mutants.py [TARGET ...]    all mutants of guard, e2e, link, valves
    ... --changed [BASE]                                 those of lines that differ from BASE
    ... --resume                                         those of which nothing is known yet
    ... --again                                          those that no run before has killed
    ... --wall 60                                        as many as can be run in this many seconds
    ... --document docs/safety.md                        writes what the runs came to; runs nothing

What a run has found holds while the mutated file and the test that caught the mutant are the same;
where none caught it, while all tests are. `--resume` goes on with a run that was ended.

A mutant that no test can catch, because it behaves as the product does, is listed in
equivalent.toml with its reason. Ends with 1 where a mutant survives without being listed, where a
listed one is caught after all, and where an entry names no mutant.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, Final

HERE: Final = Path(__file__).parent
sys.path.insert(0, str(HERE))

from hashes import Hashes  # noqa: E402
from mutator import Mutant, Mutants  # noqa: E402
from targets import ROOT, TARGETS, Target  # noqa: E402

OUT: Final = ROOT / "out" / "mutation"
LISTED: Final = HERE / "equivalent.toml"
BUDGET_S: Final = 30.0
HUNK: Final = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@", re.MULTILINE)
BEGIN, END = "<!-- begin: made by `make mutants` -->", "<!-- end -->"
ENDED_WELL: Final = (0, 5)
"""pytest's exit codes: done, and nothing was run (by pytest itself)."""


def equivalents() -> dict[str, str]:
    """Listed mutants, with the reason of each."""
    with LISTED.open("rb") as file:
        entries = tomllib.load(file)["equivalent"]
    return {entry["mutant"]: entry["reason"] for entry in entries}


@cache
def mutants_in(name: str) -> list[Mutant]:
    """Those of a file."""
    return Mutants(name, (ROOT / name).read_text(encoding="utf-8")).all


def mutants_of(target: Target) -> dict[str, list[Mutant]]:
    """All of them, by file."""
    names = [path.relative_to(ROOT).as_posix() for path in target.paths()]
    return {name: mutants_in(name) for name in names}


def changed_lines(base: str) -> dict[str, set[int]] | None:
    """Lines that differ from where this branch has left `base`, by file; None without a base."""
    since = subprocess.run(
        ["git", "merge-base", "HEAD", base], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if since.returncode:
        return None
    text = subprocess.run(
        ["git", "diff", "--unified=0", "--no-color", since.stdout.strip()],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    found: dict[str, set[int]] = {}
    for part in text.split("\ndiff --git ")[0:]:
        name = re.search(r"^\+\+\+ b/(.*)$", part, re.MULTILINE)
        if name:
            for hunk in HUNK.finditer(part):
                first, count = int(hunk[1]), int(hunk[2] or 1)
                found.setdefault(name[1], set()).update(range(first, first + count))
    return found


def chosen(target: Target, options: argparse.Namespace) -> dict[str, list[str]]:
    """Names of the mutants to run, by file."""
    found = mutants_of(target)
    if options.changed is not None:
        lines = options.lines
        kept = {name: [m for m in all_ if not lines.get(name, set()).isdisjoint(m.where.lines)]
                for name, all_ in found.items()}  # fmt: skip
    else:
        kept = found
    names = {name: [mutant.name for mutant in all_] for name, all_ in kept.items() if all_}
    if options.again or options.resume:
        done = {each["mutant"] for each in results_of(target)
                if options.resume or each["outcome"] == "killed"}  # fmt: skip
        names = {name: [each for each in all_ if each not in done] for name, all_ in names.items()}
    if options.only:
        names = {n: [e for e in all_ if options.only in e] for n, all_ in names.items()}
    return {name: all_ for name, all_ in names.items() if all_}


def results_of(target: Target) -> list[dict[str, Any]]:
    """What the runs before have found and still holds, the newest of each mutant."""
    hashes, newest = Hashes(target), {}
    for path in sorted(OUT.glob(f"{target.name}-*.jsonl"), key=lambda each: each.stat().st_mtime):
        for line in path.read_text(encoding="utf-8").splitlines():
            values = json.loads(line)
            if hashes.hold(values):
                newest[values["mutant"]] = values
    return list(newest.values())


def run_target(
    target: Target, names: dict[str, list[str]], budget_s: float, jobs: int, until_s: float | None
) -> None:
    """Runs them in `jobs` processes, until `until_s` (time.time()); each leaves a file of
    results."""
    tests = [each for each in target.tests if (ROOT / each).exists()]
    hashes = Hashes(target)
    map_path = OUT / f"{target.name}-{hashes.all_code}-{hashes.all_tests}.map.json"
    parts = [{name: all_[k::jobs] for name, all_ in names.items()} for k in range(jobs)]
    running = []
    for k, part in enumerate(parts):
        if k and not map_path.exists():
            _wait_for(map_path, running[0])
        stem = f"{target.name}-{time.strftime('%H%M%S')}-{os.getpid()}-{k}"
        task = OUT / f"{stem}.task.json"
        values = {
            "root": str(ROOT), "mutants": part, "budget_s": budget_s, "map": str(map_path),
            "results": str(OUT / f"{stem}.jsonl"), "until_s": until_s, "target": target.name,
        }  # fmt: skip
        task.write_text(json.dumps(values), encoding="utf-8")
        path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
        # Nobody reads what a failing test says of itself, and to say it takes longer than to fail.
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-m", "not long",
                   "-p", "no:cacheprovider", "--assert=plain", "--tb=native",
                   "-p", "forked_runs", *tests]  # fmt: skip
        environment = os.environ | {"MUTATION_TASK": str(task), "PYTHONPATH": path}
        with task.with_suffix(".log").open("w", encoding="utf-8") as log:
            running.append(
                subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log)
            )
    for each in running:
        if each.wait() not in ENDED_WELL:
            raise SystemExit(f"the run of {target.name} failed: see {OUT}/{target.name}-*.log")


def _wait_for(path: Path, process: subprocess.Popen[bytes]) -> None:
    while not path.exists() and process.poll() is None:
        time.sleep(0.5)


def judge(target: Target, names: dict[str, list[str]], listed: dict[str, str], boxed: bool) -> int:
    """Says what came of them. Returns how many are amiss; `boxed`: some may not have been run."""
    asked = {each for all_ in names.values() for each in all_}
    came = {each["mutant"]: each for each in results_of(target) if each["mutant"] in asked}
    left = sorted(name for name, each in came.items() if each["outcome"] != "killed")
    unlisted = [name for name in left if name not in listed]
    caught = sorted(name for name in listed if name in came and name not in left)
    counts = Counter(each["outcome"] for each in came.values())
    killed = counts["killed"] - len(caught)
    real = len(came) - sum(name in listed for name in came)
    share = 100.0 * killed / real if real else 100.0
    print(f"{target.name}: {len(came)} mutants, {killed} of {real} killed ({share:.1f} %), "
          f"{len(came) - real} listed as equivalent")  # fmt: skip
    for name in unlisted:
        print(f"  {came[name]['outcome']}: {name}")
    for name in caught:
        print(f"  listed as equivalent, but killed: {name}")
    missing = len(asked) - len(came)
    if missing:
        print(f"  not run{' in this time' if boxed else ''}: {missing}")
    return len(unlisted) + len(caught) + (0 if boxed else missing)


def document(path: Path, listed: dict[str, str]) -> None:
    """Writes the table into a document, between its marks."""
    before, _, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    path.write_text(f"{before}{BEGIN}\n{table(listed)}{END}{after}", encoding="utf-8")


def table(listed: dict[str, str]) -> str:
    """How many mutants there are, how many are listed, and what the newest runs came to."""
    lines = [
        "| part | mutants | listed as equivalent | run | killed or listed |",
        "|---|---|---|---|---|",
    ]
    for target in TARGETS:
        names = {m.name for all_ in mutants_of(target).values() for m in all_}
        came = {e["mutant"]: e["outcome"] for e in results_of(target) if e["mutant"] in names}
        good = sum(outcome == "killed" or name in listed for name, outcome in came.items())
        count = sum(name in listed for name in names)
        lines.append(f"| {target.name} | {len(names)} | {count} | {len(came)} | {good} |")
    return "\n".join(lines) + "\n"


def stale(listed: dict[str, str]) -> list[str]:
    """Entries that name no mutant."""
    files = {each.split("::")[0] for each in listed}
    there = {m.name for name in files if (ROOT / name).exists() for m in mutants_in(name)}
    return [name for name in listed if name not in there]


def main(arguments: list[str]) -> int:
    """Runs what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])  # type: ignore[union-attr]
    parser.add_argument("targets", nargs="*", help=", ".join(each.name for each in TARGETS))
    parser.add_argument(
        "--changed", nargs="?", const="origin/main", metavar="BASE",
        help="only lines that differ from where this branch has left BASE",
    )  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="those of which nothing is known yet")
    parser.add_argument("--again", action="store_true", help="those that no run before has killed")
    parser.add_argument("--only", metavar="TEXT", help="those whose name has this text")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--budget", type=float, default=BUDGET_S, metavar="S",
        help="processor seconds of tests for one mutant (default: %(default)g)",
    )  # fmt: skip
    parser.add_argument("--wall", type=float, metavar="S", help="no more after this many seconds")
    parser.add_argument("--document", type=Path, metavar="FILE", help="writes its table")
    options = parser.parse_args(arguments)
    if options.document:
        document(options.document, equivalents())
        return 0
    unknown = set(options.targets) - {each.name for each in TARGETS}
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    if options.changed is not None:
        options.lines = changed_lines(options.changed)
        if options.lines is None:
            print(f"no {options.changed} to compare with here: no mutants are made")
            return 0
    OUT.mkdir(parents=True, exist_ok=True)
    listed, begun_s = equivalents(), time.monotonic()
    amiss, anything = 0, False
    until_s = None if options.wall is None else time.time() + options.wall
    for target in TARGETS:
        if target.name in options.targets or not options.targets:
            names = chosen(target, options)
            if names:
                anything = True
                run_target(target, names, options.budget, options.jobs, until_s)
                amiss += judge(target, names, listed, until_s is not None)
    if not anything:
        what = f"of lines that differ from {options.changed}" if options.changed else "to run"
        print(f"no mutants {what}")
    for name in stale(listed):
        amiss += 1
        print(f"names no mutant: {name}")
    print(f"{time.monotonic() - begun_s:.0f} s, {amiss} amiss")
    return 1 if amiss else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
