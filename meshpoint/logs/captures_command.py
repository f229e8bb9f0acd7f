"""`meshpoint captures`: edges of real sensors through the node's edge gate, or as a log."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.cli import arguments
from meshpoint.logs import log_of_capture as capture_log
from meshpoint.logs.capture_prediction import EDGES_AHEAD
from meshpoint.logs.capture_ways import Refused, capture_rows
from meshpoint.logs.captures import CaptureRow
from meshpoint.results.output import complain, console, write_json

COUNTS = (
    "file", "wheel", "edges", "numbered", "locked\nafter ms", "lost", "of it\nstood", "doubts",
)  # fmt: skip
ERRORS = ("file", "teeth\nchecked", "wrong", "extra", "constant\nus", "turn ago\nus", "in use\nus")
LAYOUT: Final[dict[str, Any]] = {
    "title_justify": "left", "box": None, "pad_edge": False, "collapse_padding": True,
}  # fmt: skip


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "captures",
        description="Reads captures (a time, then one level or voltage a channel; docs/edges.md), "
        "tries their channels and edges in turn, finds the wheel, numbers its teeth as the node "
        f"does and predicts the edge {EDGES_AHEAD} edges ahead. "
        "lost: tooth numbers lost after lock; doubts: times edges were withheld until a gap had "
        "shown the count right; teeth checked: edges whose tooth the whole file shows as well, "
        "wrong: those numbered otherwise; constant, turn ago, in use: RMS error of the time by "
        "constant speed, by the turn before scaled to the speed, and by whatever was best so far. "
        "A file that gives no row is named with the reason. With -o the edges of one capture "
        "become a log of edge frames for `meshpoint replay`.",
    )
    parser.add_argument(
        "paths", type=Path, nargs="+", metavar="DIR|FILE", help="captures, or folders of .csv files"
    )
    capture_log.add_arguments(parser)
    arguments.add_json(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints the table. Bad input if no file gives a row."""
    files, asked = _files(namespace.paths), capture_log.asked_of(namespace)
    refused: list[Refused] = []
    if namespace.output is not None:
        if len(files) != 1:
            raise CommandError(f"-o writes one capture as a log, {len(files)} are given")
        rows = [capture_log.write_log(namespace, files[0], asked)]
    else:
        with console("-").status("reading captures"):
            rows, refused = capture_rows(files, asked)
    if namespace.json is not None:
        values = {
            "captures": [row.to_json() for row in rows],
            "refused": [{"file": r.file, "reason": r.reason} for r in refused],
        }
        write_json(namespace.json, values)
    if namespace.json != "-" and rows and namespace.output is None:
        _show(console(namespace.json), rows)
    _complain(refused)
    return Exit.DONE if rows else Exit.BAD_INPUT


def _files(paths: list[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        found = sorted(path.glob("*.csv")) if path.is_dir() else [path]
        if not found:
            raise CommandError(f"{path}: no .csv file in it")
        files += found
    return files


def _show(out: Any, rows: list[CaptureRow]) -> None:
    out.print(counts_table(rows))
    out.print()
    out.print(errors_table(rows))
    for row in rows:
        out.print(f"{row.file}: channel {row.channel!r}, edges: {row.polarity}")
        if row.extra_s:
            times = ", ".join(f"{t:.4f}" for t in row.extra_s)
            out.print(f"{row.file}: extra edges at {times} s")


def _complain(refused: list[Refused]) -> None:
    for file in refused:
        complain(f"{file.file}: {file.reason}")


def counts_table(rows: list[CaptureRow]) -> Table:
    """What was numbered, and what was lost again."""
    table = Table(title="captured edges", **LAYOUT)
    _add_columns(table, COUNTS)
    for row in rows:
        counts = (row.lost, row.stood, row.doubts)
        table.add_row(
            row.file, row.wheel, str(row.edges), str(row.numbered), f"{row.locked_after_ms:.1f}",
            *map(str, counts),
        )  # fmt: skip
    return table


def errors_table(rows: list[CaptureRow]) -> Table:
    """How many teeth were wrong, and how far off the prediction was."""
    title = f"teeth, and RMS error of an edge predicted {EDGES_AHEAD} ahead"
    table = Table(title=title, **LAYOUT)
    _add_columns(table, ERRORS)
    for row in rows:
        rms = (row.constant_speed_rms_us, row.turn_ago_rms_us, row.learned_rms_us)
        table.add_row(
            row.file,
            *map(str, (row.checked, row.wrong, len(row.extra_s))),
            *("-" if value is None else f"{value:.1f}" for value in rms),
        )
    return table


def _add_columns(table: Table, columns: tuple[str, ...]) -> None:
    for column in columns:
        left = column in ("file", "wheel")
        table.add_column(
            column, justify="left" if left else "right", no_wrap=not left, overflow="fold"
        )
