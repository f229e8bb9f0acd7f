"""`meshpoint captures`: edges of real sensors through the node's edge gate."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from meshpoint.testbench.commands import arguments
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.logs.captures import EDGES_AHEAD, CaptureRow, capture_rows
from meshpoint.testbench.results.output import console, write_json

COUNTS = (
    "file", "wheel", "edges", "numbered", "locked\nafter ms", "lost", "of it\nstood", "doubts",
)  # fmt: skip
ERRORS = ("file", "marks", "wrong", "extra", "constant\nspeed us", "learned\nus", "ratio")
LAYOUT: Final[dict[str, Any]] = {
    "title_justify": "left", "box": None, "pad_edge": False, "collapse_padding": True,
}  # fmt: skip


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "captures",
        description="Reads each .csv of a folder (time in s and one level a channel after each "
        "change, or time and voltage), finds the wheel, numbers its teeth as the node does and "
        f"predicts the edge {EDGES_AHEAD} edges ahead: by constant speed, and by the patterns "
        "learned of one turn and of two where they have been better. "
        "lost: tooth numbers lost after lock; doubts: times edges were withheld until a gap had "
        "shown the count right; marks: gaps or edges of the second channel after lock, wrong: "
        "those that disagree with the count.",
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the folder of captures")
    arguments.add_json(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints the table."""
    if not namespace.folder.is_dir():
        raise CommandError(f"{namespace.folder}: not a folder; allowed is a folder of captures")
    with console("-").status("reading captures"):
        rows = capture_rows(namespace.folder)
    if namespace.json is not None:
        write_json(namespace.json, {"captures": [row.to_json() for row in rows]})
    if namespace.json != "-":
        out = console(namespace.json)
        out.print(counts_table(rows))
        out.print()
        out.print(errors_table(rows))
        for row in rows:
            if row.extra_s:
                times = ", ".join(f"{t:.4f}" for t in row.extra_s)
                out.print(f"{row.file}: extra edges at {times} s", markup=False)
    return Exit.DONE


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
    """How far off the prediction was."""
    title = f"marks of the wheel, and RMS error of an edge predicted {EDGES_AHEAD} ahead"
    table = Table(title=title, **LAYOUT)
    _add_columns(table, ERRORS)
    for row in rows:
        rms = (row.constant_speed_rms_us, row.learned_rms_us)
        table.add_row(
            row.file,
            *map(str, (row.gaps, row.gaps_wrong, len(row.extra_s))),
            *("-" if value is None else f"{value:.1f}" for value in rms),
            "-" if row.ratio is None else f"{row.ratio:.2f}",
        )
    return table


def _add_columns(table: Table, columns: tuple[str, ...]) -> None:
    for column in columns:
        left = column in ("file", "wheel")
        table.add_column(
            column, justify="left" if left else "right", no_wrap=not left, overflow="fold"
        )
