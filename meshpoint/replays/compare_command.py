"""`meshpoint compare`: two logs, two records of `--json`, or two settings files, also by what they
decide on a log."""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from rich.table import Table

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus.logs.files import log_files, read_logs
from meshpoint.controller.settings.settings import load_settings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox.reading import UnreadableError, read_text
from meshpoint.replays.decisions import (
    COLUMNS,
    decide,
    decided_json,
    decided_rows,
    knew_heading,
)
from meshpoint.replays.log_difference import CoreParting, LogDifference
from meshpoint.report.compared import compared_page
from meshpoint.results.better import Outcome, by_pairs, sentence
from meshpoint.results.difference import Allowed, Difference, differences
from meshpoint.results.output import check_writable, console, write_json

OF_A_RECORD: Final = ("log", "logs", "version", "provenance", "headers", "run_hash")
"""What two records of the same thing may always differ in."""
MOST_ROWS: Final = 40
RECORD_LIMIT_BYTES: Final = 512 * 1024 * 1024
"""Of a table on the terminal; page and JSON have all."""
Rows = list[tuple[str, ...]]
Tables = list[tuple[str, tuple[str, ...], Rows]]


class Compared(NamedTuple):
    """What a comparison came to: words, tables (heading, columns, rows), values for JSON."""

    is_same: bool
    verdict: str
    tables: Tables
    values: dict[str, Any]
    code: int | None = None
    """The exit code where it is neither 'the same' nor 'they differ'."""
    on_terminal: int | None = None
    """How many of the tables are shown there, from the first; None: all. The page has all."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "compare",
        description="Two logs message by message, and the first step at which the two controllers "
        "part, with what each knew there; two records of --json (of two versions, strategies or "
        "replays of a log) shift by shift; or two settings files, with --log by what they decide "
        "in each shift of a log. Exit code 1 where they differ beyond the tolerances.",
    )
    parser.add_argument("a", type=Path, metavar="A", help="log, folder of logs, .json or .toml")
    parser.add_argument("b", type=Path, metavar="B", help="another one of the same kind")
    parser.add_argument(
        "--log",
        type=Path,
        metavar="LOG",
        help="what controllers with the settings A and B decide in each shift of this log, and the "
        "first step at which they part",
    )
    parser.add_argument("--header-dir", type=Path, metavar="DIR", help="where its run headers are")
    parser.add_argument(
        "--tolerance",
        action="append",
        type=_tolerance,
        default=[],
        metavar="[NAME=]VALUE",
        help="numbers that differ by no more are equal, in their unit; of one name or pattern, or "
        "of all (default: 0). May be given again",
    )
    parser.add_argument(
        "--ignore",
        action="append",
        default=[],
        metavar="NAME",
        help="a field, message or Message.signal that is not compared; * stands for anything. May "
        "be given again",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write a page (HTML)")
    parser.add_argument(
        "--json", metavar="FILE|-", help="write the results as JSON to a file, or - for stdout"
    )
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Compares."""
    a, b = namespace.a, namespace.b
    check_writable(None if namespace.report is None else str(namespace.report))
    named = {name: value for name, value in namespace.tolerance if name}
    common = [value for name, value in namespace.tolerance if not name]
    kind = _kind(a)
    if kind != _kind(b):
        raise CommandError(f"{a} and {b}: allowed are two logs, two .json or two .toml")
    ignored = tuple(namespace.ignore) + (OF_A_RECORD if kind == "record" else ())
    allowed = Allowed(max(common, default=0.0), named, ignored)
    if namespace.log is not None:
        compared = _decisions(namespace, kind, allowed)
    else:
        compared = _compared(kind, a, b, allowed)
    title = f"{a} and {b}" + (f" on {namespace.log}" if namespace.log is not None else "")
    _tell(namespace, title, compared)
    if compared.code is not None:
        return compared.code
    return Exit.DONE if compared.is_same else Exit.FAILED


def _compared(kind: str, a: Path, b: Path, allowed: Allowed) -> Compared:
    return {"log": _logs, "record": _records, "settings": _settings}[kind](a, b, allowed)


def _tell(namespace: argparse.Namespace, title: str, compared: Compared) -> None:
    """Page and JSON; on the terminal the verdict, then the tables."""
    if namespace.report is not None:
        page = compared_page(f"meshpoint compare: {title}", compared.verdict, compared.tables)
        namespace.report.write_text(page, encoding="utf-8", newline="\n")
    if namespace.json is not None:
        names = {"a": str(namespace.a), "b": str(namespace.b)}
        values = {**names, "same": compared.is_same, **compared.values}
        write_json(namespace.json, values)
    out = console(namespace.json)
    out.print(compared.verdict)
    if namespace.json != "-":
        for heading, columns, rows in compared.tables[: compared.on_terminal]:
            if rows:
                out.print(compared_table(heading, columns, rows))


def _tolerance(text: str) -> tuple[str, float]:
    name, _, value = text.rpartition("=")
    try:
        tolerance = float(value)
    except ValueError:
        tolerance = -1.0
    if not 0.0 <= tolerance < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r}, allowed is VALUE or NAME=VALUE, 0 or more")
    return name, tolerance


def _kind(path: Path) -> str:
    return {".json": "record", ".toml": "settings"}.get(path.suffix.lower(), "log")


def compared_table(heading: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Rows of text, not more than a terminal is read for."""
    more = f" ({len(rows)}, {MOST_ROWS} shown)" if len(rows) > MOST_ROWS else ""
    table = Table(title=heading + more, title_justify="left", box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows[:MOST_ROWS]:
        table.add_row(*row)
    return table


def _settings(a: Path, b: Path, allowed: Allowed) -> Compared:
    """Every setting that differs, files and defaults taken together."""
    found = list(differences(load_settings(a).values(), load_settings(b).values(), allowed))
    tables: Tables = [("Settings that differ (SI units)", ("setting", "A", "B"), _rows(found))]
    return Compared(not found, _verdict(len(found), "settings"), tables, {"settings": _json(found)})


def _decisions(namespace: argparse.Namespace, kind: str, allowed: Allowed) -> Compared:
    """Shift by shift what both settings decide, and what each knew where they part; the terminal
    has the first parting alone."""
    if kind != "settings":
        raise CommandError(f"--log {namespace.log}: A and B must be two .toml")
    decided = decide(namespace.a, namespace.b, namespace.log, namespace.header_dir, allowed)
    tables: Tables = [("Shifts of the log as A and B decide them", COLUMNS, decided_rows(decided))]
    for number, shift in enumerate(decided.shifts, 1):
        if shift.parting is not None:
            heading = knew_heading(number, shift.parting)
            tables.append((heading, ("signal", "A", "B"), _knew_rows(*shift.parting.knew)))
    count = decided.differing
    verdict = f"of {len(decided.shifts)} shifts {count} differ" if count else _verdict(0, "shifts")
    if decided.unfinished:
        verdict += f"; {decided.unfinished} unfinished ones were not judged"
    if decided.incomplete:
        verdict += f"; {decided.incomplete}"
    code = Exit.BAD_INPUT if decided.incomplete and not count else None
    return Compared(not count, verdict, tables, decided_json(decided), code, on_terminal=2)


def _records(a: Path, b: Path, allowed: Allowed) -> Compared:
    """Shift by shift, then everything else."""
    left, right = load_record(a), load_record(b)
    found = list(differences(left, right, allowed))
    by_shift: dict[str, list[Difference]] = defaultdict(list)
    rest = []
    for one in found:
        where = _shift_of(one.path)
        if where is None:
            rest.append(one)
        else:
            by_shift[where].append(one)
    shifts: Rows = [
        (where, str(len(each)), ", ".join(one.path[len(where) + 1 :] for one in each))
        for where, each in by_shift.items()
    ]
    tables: Tables = [
        ("Shifts that differ", ("shift", "fields", "which"), shifts),
        ("Fields that differ, shift by shift", ("field", "A", "B", "B - A"), _rows_sized(found)),
    ]
    if rest:
        tables.append(("Beside the shifts", ("field", "A", "B"), _rows(rest)))
    better = _better(left, right) if by_shift else ""
    verdict = " ".join(filter(None, (_verdict(len(found), "fields"), better)))
    values = {"shifts": sorted(by_shift), "differences": _json(found), "verdict": better}
    return Compared(not found, verdict, tables, values)


def _better(left: Any, right: Any) -> str:
    """Whether the shifts of B were better than those of A, where both made the same ones; empty
    where they did not."""
    sides = [side.get("shifts") if isinstance(side, dict) else None for side in (left, right)]
    a, b = ([row for row in side or [] if isinstance(row, dict)] for side in sides)
    gears = [[(row.get("from"), row.get("to")) for row in side] for side in (a, b)]
    if not a or gears[0] != gears[1]:
        return ""
    pairs = [(Outcome.of(mine), Outcome.of(theirs)) for mine, theirs in zip(b, a, strict=True)]
    return sentence("B", "A", len(pairs), by_pairs(pairs))


def _shift_of(path: str) -> str | None:
    """The row of a shift that a path leads into."""
    parts = path.split(".")
    for k, part in enumerate(parts[:-1]):
        if part == "shifts" and parts[k + 1].isdigit():
            return ".".join(parts[: k + 2])
    return None


def load_record(path: Path) -> Any:
    """The values of a --json record. CommandError where it is none."""
    try:
        return json.loads(read_text(path, RECORD_LIMIT_BYTES))
    except UnreadableError as error:
        raise CommandError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise CommandError(f"{path}: not JSON: {error}") from error


def _logs(a: Path, b: Path, allowed: Allowed) -> Compared:
    """Message by message, and where the controllers part."""
    difference = LogDifference(allowed)
    difference.run(_frames(a), _frames(b))
    differing = [message for message in difference.messages.values() if not message.is_same]
    rows: Rows = []
    for message in sorted(differing, key=lambda message: message.name):
        first, signals = message.first or (min(message.frames), [])
        largest = ", ".join(f"{name} {size:g}" for name, size in message.largest.items())
        counts = " / ".join(map(str, message.frames))
        shown = ", ".join(f"{one.path}: {one.a} / {one.b}" for one in signals[:3])
        rows.append((message.name, counts, str(message.differing), str(first), shown, largest))
    columns = ("message", "frames A / B", "differ", "first, from 0", "there A / B", "at most by")
    tables: Tables = [("Messages that differ", columns, rows), *_parting(difference.parting)]
    values = {
        "messages": [
            {
                "name": message.name,
                "frames": message.frames,
                "differing": message.differing,
                "first": None if message.first is None else message.first[0],
                "largest": message.largest,
            }
            for message in differing
        ],
        "parting": _parting_values(difference.parting),
    }
    return Compared(not differing, _verdict(len(differing), "messages"), tables, values)


def _frames(path: Path) -> Iterator[Frame]:
    for _, frame in read_logs(log_files([path])):
        yield frame


def _parting(parting: CoreParting) -> Tables:
    if parting.step is None or parting.a is None or parting.b is None:
        return []
    inputs = (
        "the same up to there" if parting.inputs is None else f"differ from {parting.inputs} on"
    )
    heading = (
        f"The controllers part at step {parting.step} in {', '.join(parting.messages)}; what they "
        f"consumed: {inputs}. What each knew there"
    )
    return [(heading, ("signal", "A", "B"), _knew_rows(parting.a.knew, parting.b.knew))]


def _knew_rows(a: dict[str, Any], b: dict[str, Any]) -> Rows:
    names = [*a, *(name for name in b if name not in a)]
    return [(name, _text(a.get(name, "-")), _text(b.get(name, "-"))) for name in names]


def _parting_values(parting: CoreParting) -> dict[str, Any]:
    def side(said: Any) -> Any:
        return None if said is None else {"time_us": said.time_us, "knew": said.knew}

    return {
        "step": parting.step,
        "inputs_differ_from": parting.inputs,
        "messages": list(parting.messages),
        "a": side(parting.a),
        "b": side(parting.b),
    }


def _verdict(count: int, what: str) -> str:
    return "the same, within the tolerances" if count == 0 else f"{count} {what} differ"


def _rows(found: Sequence[Difference]) -> Rows:
    return [(one.path, _text(one.a), _text(one.b)) for one in found]


def _rows_sized(found: Sequence[Difference]) -> Rows:
    return [
        (one.path, _text(one.a), _text(one.b), "" if one.size is None else f"{one.size:+.6g}")
        for one in found
        if _shift_of(one.path) is not None
    ]


def _text(value: Any) -> str:
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _json(found: Sequence[Difference]) -> list[dict[str, Any]]:
    return [{"path": one.path, "a": one.a, "b": one.b} for one in found]
