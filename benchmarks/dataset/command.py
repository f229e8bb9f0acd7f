"""`python -m benchmarks.dataset`: makes a set of shifts, its baselines and their scores.

    python -m benchmarks.dataset --out DIR

Two hundred upshifts and a hundred downshifts, as Parquet and MF4 with a data sheet; the same
arguments write the same bytes. What is in it, and the task: docs/dataset.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Final, Protocol

from benchmarks.dataset.data_sheet import Scores, judged, write_sheet
from benchmarks.dataset.gearbox_figures import gearbox_figures
from benchmarks.dataset.mf4_files import write_mf4
from benchmarks.dataset.parquet_files import write_parquet
from benchmarks.dataset.parts import ShiftParts, parts_of
from benchmarks.dataset.plan import LEARNED, MOMENTS, SHEET, STRATEGIES, Gearbox, Plan
from benchmarks.dataset.recording import SETTINGS, record
from benchmarks.dataset.reference import NoReferenceError
from meshpoint.gearbox import load_sheet

BASELINES: Final = ("hold", "thesis", "ours")
TASK: Final = Path(__file__).parent / "task"
LICENCE: Final = Path(__file__).parents[2] / "LICENSE"
BAD_INPUT: Final = 2
Made = tuple[list[ShiftParts], Counter[str]]


class Workers(Protocol):
    """Where gearboxes are made."""

    def __call__(self, gearboxes: Iterable[Gearbox], /) -> Iterator[Made]:
        """The shifts of each, in their order."""


def make(gearbox: Gearbox) -> Made:
    """The shifts of one gearbox, and what was left out."""
    sheet, found = load_sheet(SHEET), list[ShiftParts]()
    recorded, left = record(gearbox)
    for each in recorded:
        try:
            found.append(parts_of(each, sheet))
        except NoReferenceError:
            left["without an estimate of the phase"] += 1
    return found, left


@contextmanager
def workers(jobs: int) -> Iterator[Workers]:
    """This process, or this number of their own; what they make is the same."""
    if jobs == 1:
        yield lambda gearboxes: map(make, gearboxes)
        return
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield lambda gearboxes: pool.imap(make, gearboxes)


def shifts_of(plan: Plan, jobs: int) -> Made:
    """All shifts of a set, by kind and gearbox; each kind is ended by its count."""
    found, left = list[ShiftParts](), Counter[str]()
    with workers(jobs) as work:
        for kind, wanted in plan.wanted.items():
            mine, gearboxes = list[ShiftParts](), plan.gearboxes(kind)
            while len(mine) < wanted:
                lacking = -(-(wanted - len(mine)) // (MOMENTS * len(STRATEGIES)))
                for shifts, unfit in work(list(islice(gearboxes, lacking))):
                    mine += shifts
                    left += unfit
                    _say(f"\r{kind}s: {min(len(mine), wanted)} of {wanted}")
            found += mine[:wanted]
            _say("\n")
    return found, left


def write_set(folder: Path, plan: Plan, jobs: int) -> Scores:
    """A whole set; the scores of its baselines."""
    shifts, left = shifts_of(plan, jobs)
    write_parquet(folder, shifts)
    figures = gearbox_figures(load_sheet(SHEET), SETTINGS)
    (folder / "gearbox.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    for number, shift in enumerate(shifts, start=1):
        _say(f"\rMF4: {number} of {len(shifts)}")
        write_mf4(folder / "mf4" / f"{shift.shift['shift']}.mf4", shift)
    _say("\n")
    (folder / "task").mkdir()
    for file in (*sorted(TASK.glob("*.py")), LICENCE):
        shutil.copyfile(file, folder / "task" / file.name)
    scores = baseline_scores(folder, judged(shifts))
    write_sheet(folder, plan, shifts, left, scores)
    _write_sums(folder)
    return scores


def baseline_scores(folder: Path, split: str) -> Scores:
    """Runs each baseline as a stranger would, and scores it."""
    scores: Scores = {}
    (folder / "baselines").mkdir(exist_ok=True)
    for name in BASELINES:
        predictions = folder / "baselines" / f"{name}.csv"
        _task(folder, f"{name}.py", str(folder), "-o", str(predictions))
        truth = str(folder / "truth" / "contacts.parquet")
        said = _task(folder, "score.py", str(predictions), truth, "--split", split, "--json")
        scores[name] = json.loads(said)
    return scores


def _task(folder: Path, name: str, *arguments: str) -> str:
    # -B: no compiled files in the set.
    command = [sys.executable, "-B", str(folder / "task" / name), *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout  # noqa: S603


def _write_sums(folder: Path) -> None:
    """SHA256SUMS, as `sha256sum --check` reads it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}\n"
        for path in files
    ]
    (folder / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    """Makes a set; 2 where it cannot be put there."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.dataset",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    parser.add_argument("--upshifts", type=_count, default=200, help="default: 200")
    parser.add_argument("--downshifts", type=_count, default=100, help="default: 100")
    parser.add_argument("--seed", type=int, default=7, help="of the set (default: 7)")
    parser.add_argument("--learn", type=_count, default=LEARNED, metavar="N",
                        help=f"shifts before those of the set (default: {LEARNED})")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    asked = parser.parse_args(argv)
    if asked.out.exists() and (not asked.out.is_dir() or any(asked.out.iterdir())):
        parser.error(f"--out {asked.out}: there is something already, allowed is a new folder")
    if asked.upshifts + asked.downshifts == 0:
        parser.error("--upshifts 0 --downshifts 0: allowed is one shift at least")
    plan = Plan(asked.upshifts, asked.downshifts, asked.seed, asked.learn)
    asked.out.mkdir(parents=True, exist_ok=True)
    scores = write_set(asked.out, plan, asked.jobs)
    size = sum(path.stat().st_size for path in asked.out.rglob("*") if path.is_file())
    for name, rows in scores.items():
        print(f"{name}: {json.dumps(rows['all'])}")
    print(f"{asked.out}: {asked.upshifts + asked.downshifts} shifts, {size / 1e6:.1f} MB")
    return 0


def _count(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r}, allowed is a whole number from 0")
    return int(text)


def _say(text: str) -> None:
    print(text, end="", file=sys.stderr, flush=True)
