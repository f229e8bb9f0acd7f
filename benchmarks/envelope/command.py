"""`python -m benchmarks.envelope`: every kind of shift, sheet and sensor in one table."""

from __future__ import annotations

import argparse
import datetime as dt
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from benchmarks.envelope.making import OWN, Made, Product, Work, made, make, of_commit, running
from benchmarks.envelope.rows import ROWS, Row
from benchmarks.envelope.table import cells, figures, markdown, on_screen
from benchmarks.envelope.verdict import DOUBT, FELL, WORDS, pairs, verdicts
from meshpoint.base.errors import CommandError, RunError
from meshpoint.base.exits import Exit
from meshpoint.bench.compiling import prepare
from meshpoint.bus import given_numbers
from meshpoint.cli import arguments
from meshpoint.cli.main import run_parsed
from meshpoint.cli.parsing import Parser, examples
from meshpoint.results.junit import write_text
from meshpoint.results.output import complain, console, folder_for, tell, write_json

DESCRIPTION: Final = """\
The proving ground. A change that helps the ordinary upshift may cost another sheet, a worse sensor
or a downshift what nobody looks at. Each row of the table is one such case: a campaign of gearboxes
drawn by seed (meshpoint campaign), with one thing changed. The rows are in
benchmarks/envelope/rows.py, --list shows them, docs/envelope.md is the table as it was made last.

  the whole table          under an hour on two quiet processors
  --quick                  ten minutes: fewer gearboxes, without the true state
  --only ROW,...           these rows alone
  --against COMMIT         the rows of that commit's product too, on the same draws, and of each row
                           whether it fell by more than chance: in first contacts in a gap, shifts
                           not engaged, time or impact. The number of rows is counted. A doubtful
                           row is made again alone: --only ROW --draws 4 --seed 1 --out elsewhere
  --out DIR --resume       goes on where it was: a row that is at its end is not made again

Exit code 1: a row fell; 4: a row is doubtful and none fell. A change that takes a belief away, or
brings one, is kept only if no row falls (docs/change.md)."""


def main(given: Sequence[str] | None = None) -> int:
    """Makes the rows that a command line asks for; returns its exit code."""
    return run_parsed(lambda: parser().parse_args(given))


def parser() -> Parser:
    """The command's arguments."""
    found = Parser(
        prog="python -m benchmarks.envelope",
        description=DESCRIPTION,
        epilog=examples(
            "python -m benchmarks.envelope --quick",
            "python -m benchmarks.envelope --only hall_40,gap_8 --against HEAD~1",
            "python -m benchmarks.envelope --resume --markdown docs/envelope.md",
        ),
    )
    found.add_argument("--only", type=_names, metavar="ROW,...", help="rows to make (default: all)")
    found.add_argument("--list", action="store_true", help="show the rows and make none")
    found.add_argument(
        "--quick", action="store_true", help="a third of the draws, without the true state"
    )
    found.add_argument(
        "--draws", type=given_numbers.whole(1, 100), default=1, metavar="N",
        help="this many times the gearboxes of each row (default: 1)",
    )  # fmt: skip
    found.add_argument(
        "--seed", type=given_numbers.whole(0, 1_000_000), default=0, metavar="N",
        help="other draws: added to each row's seed (default: 0)",
    )  # fmt: skip
    found.add_argument(
        "--of", metavar="COMMIT", help="of the product of a git commit (default: that which runs)"
    )
    found.add_argument(
        "--against", metavar="COMMIT", help="a verdict a row against the product of a git commit"
    )
    where = found.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=given_numbers.whole(1, 1024), default=os.cpu_count() or 1, metavar="J",
        help="rows made at a time, a process each (default: one a processor)",
    )  # fmt: skip
    where.add_argument(
        "--dask", metavar="ADDRESS", help="a Dask scheduler, as tcp://host:8786: one row at a time"
    )
    found.add_argument(
        "--out", type=Path, metavar="DIR",
        help="a folder a row, by commit (default: out/envelope, with --quick out/envelope-quick)",
    )  # fmt: skip
    found.add_argument("--resume", action="store_true", help="go on with the table in --out")
    found.add_argument(
        "--markdown", type=Path, metavar="FILE", help="the table as a page (docs/envelope.md)"
    )
    found.add_argument("--debug", action="store_true", help="show the traceback of an error")
    arguments.add_json(found)
    found.set_defaults(run=run, program=found.prog)
    return found


def _names(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(text.split(",")))
    for name in names:
        if name not in ROWS:
            raise argparse.ArgumentTypeError(f"{name!r}, allowed are {', '.join(ROWS)}")
    return names


def run(namespace: argparse.Namespace) -> int:
    """Makes the table."""
    rows = _rows(namespace)
    if namespace.list:
        for row in rows:
            print(f"{row.name:14s} {row.changed}: {row.why}")
        return Exit.DONE
    out = namespace.out or Path("out", "envelope-quick" if namespace.quick else "envelope")
    folder = folder_for(out)
    product = running(folder) if namespace.of is None else of_commit(namespace.of, folder)
    before = None if namespace.against is None else of_commit(namespace.against, folder)
    if before is not None and before.folder == product.folder:
        raise CommandError(f"--against {namespace.against}: is what is judged")
    works = [
        Work(each, row, true_state=not namespace.quick and each is product, dask=namespace.dask)
        for row in rows
        for each in (product, *([] if before is None else [before]))
    ]
    if namespace.dask is None:
        prepare()
    found = _made(namespace, works, folder / "given")
    values = _values(namespace, rows, product, before, found)
    return _write(namespace, values)


def _rows(namespace: argparse.Namespace) -> list[Row]:
    chosen = [ROWS[name] for name in namespace.only or ROWS]
    rows = [row.quick() if namespace.quick else row for row in chosen]
    return [row.drawn(namespace.draws, namespace.seed) for row in rows]


def _made(namespace: argparse.Namespace, works: list[Work], files: Path) -> dict[Work, Made]:
    """All rows, those made before as they are. RunError where one has come to no end."""
    found = {work: ready for work in works if (ready := made(work)) is not None}
    if found and not namespace.resume:
        raise CommandError(
            f"{works[0].product.folder.parent}: holds rows already; --resume goes on with them, "
            "another --out begins anew"
        )
    left = [work for work in works if work not in found]
    pace, lost = _Pace(left), list[str]()

    def ended(work: Work, row: Made) -> None:
        if row.failed:
            lost.append(f"{work.row.name}, {work.product.words}: {row.failed}")
            complain(lost[-1])
            return
        found[work] = row
        tell(pace.line(work, row))

    jobs = 1 if namespace.dask is not None else namespace.jobs
    make(left, files, jobs, ended)
    if lost and not found:
        raise RunError(f"no row came to its end: {lost[0]}")
    return found


class _Pace:
    """How far it is, and how long it may take yet."""

    def __init__(self, works: list[Work]) -> None:
        self._began_s = time.monotonic()
        self._all, self._left = len(works), {work: work.shifts for work in works}
        self._shifts = sum(self._left.values())

    def line(self, work: Work, row: Made) -> str:
        """One more row."""
        self._left.pop(work)
        left = sum(self._left.values())
        spent_s = time.monotonic() - self._began_s
        some_s = spent_s * left / max(1, self._shifts - left)
        shifts, gap = cells(figures(row))[:2]
        return (
            f"{self._all - len(self._left)} of {self._all}: {work.row.name}, {work.product.words}, "
            f"{shifts} shifts, first in gap {gap}, {row.seconds:.0f} s; "
            f"some {some_s / 60:.0f} min left"
        )


def _values(
    namespace: argparse.Namespace,
    rows: list[Row],
    product: Product,
    before: Product | None,
    found: dict[Work, Made],
) -> dict[str, Any]:
    """As `--json` has it."""
    own = {work.row.name: figures(row) for work, row in found.items() if work.product is product}
    values: dict[str, Any] = {
        "conditions": _conditions(namespace, rows, product),
        "rows": {row.name: own[row.name] for row in rows if row.name in own},
    }
    if before is not None:
        then = {work.row.name: work.row for work in found if work.product is before}
        judged = verdicts(
            {
                name: pairs(before.table(row), product.table(row), OWN)
                for name, row in then.items()
                if name in own
            }
        )
        values["against"] = before.words
        for name, verdict in judged.items():
            values["rows"][name]["against"] = verdict
    return values


def _conditions(namespace: argparse.Namespace, rows: list[Row], product: Product) -> dict[str, Any]:
    seeds = sorted({row.seed for row in rows})
    today = dt.datetime.now(dt.UTC).date().isoformat()
    machine = f"{os.cpu_count()} processors, {platform.machine()}"
    draws = "a part of the draws (--quick)" if namespace.quick else "all draws"
    some = f"{len(rows)} of {len(ROWS)} rows, " if len(rows) < len(ROWS) else ""
    return {
        "product": product.words,
        "commit": product.sha,
        "date": today,
        "machine": machine,
        "quick": namespace.quick,
        "draws": namespace.draws,
        "seeds": seeds,
        "words": f"Simulated: {product.words}, {today}, `{OWN}`, sheet `truck12` unless said, "
        f"{some}{draws}, seeds {' and '.join(map(str, seeds))}; {machine}.",
    }


def _write(namespace: argparse.Namespace, values: dict[str, Any]) -> int:
    """Everything that was asked for; the command's exit code."""
    if namespace.json is not None:
        write_json(namespace.json, values)
    if namespace.markdown is not None:
        write_text(namespace.markdown, markdown(values))
    if namespace.json != "-":
        out = console(namespace.json)
        out.print(on_screen(values["rows"], values["conditions"]["words"]))
        for name, found in values["rows"].items():
            if (judged := found.get("against", {})).get("in"):
                out.print(f"{name}: {WORDS[judged['verdict']]}, in {', '.join(judged['in'])}")
    return _exit(values["rows"])


def _exit(rows: dict[str, Any]) -> Exit:
    judged = {found["against"]["verdict"] for found in rows.values() if "against" in found}
    if FELL in judged or any(found["failed_runs"] for found in rows.values()):
        return Exit.FAILED
    return Exit.NOT_DECIDED if DOUBT in judged else Exit.DONE
