"""What commands print: rows, summaries, JSON."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.controller.settings.strategy_file import is_file_name
from meshpoint.gearbox.plain_text import plain

if TYPE_CHECKING:
    from meshpoint.results.rows import ShiftRow

WIDTH_WITHOUT_TERMINAL = 130
READ = ("settings", "keys", "faults", "as_built", "gearbox", "map", "dbc")
"""Arguments that name files to read."""
WRITTEN = ("log", "calibration", "out", "output", "json", "report", "junit", "markdown")
"""Arguments that name files to write; lists of them (LOG ...) are read."""
TRIES = "tries/\naborts"
"""The header over `tries`."""
SHIFT_COLUMNS = (
    "from", "to", "strategy", "reference", "duration\nms", "slip\nrpm", "phase\nerror\ndeg",
    "% of\npitch", "contact", TRIES, "result",
)  # fmt: skip


def write_json(target: str, values: dict[str, Any]) -> None:
    """Writes sorted JSON to a file, or to standard output for `-`; piece by piece, since a day's
    text is larger than what it is made of."""
    pieces = json.JSONEncoder(indent=1, sort_keys=True, allow_nan=False).iterencode(values)
    if target == "-":
        sys.stdout.writelines(pieces)
        sys.stdout.write("\n")
        return
    path = Path(target)
    try:
        if path.exists() and not (path.is_file() and os.access(path.resolve().parent, os.W_OK)):
            # A pipe or a device, or a file in a folder that takes no other.
            with path.open("w", encoding="utf-8") as file:
                _write(file, pieces)
        else:
            with beside(path.resolve()) as new, new.open("x", encoding="utf-8") as file:
                _write(file, pieces)
    except OSError as error:
        raise unwritten(path, error) from error


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """A name beside a file, to be written first: whoever reads the file, and an error amid the
    writing, finds the old one or the whole new one."""
    new = path.with_name(f".{path.stem}.new{path.suffix}")
    new.unlink(missing_ok=True)
    try:
        yield new
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def _write(file: TextIO, pieces: Iterable[str]) -> None:
    file.writelines(pieces)
    file.write("\n")


class WordsConsole(Console):
    """A console to which texts are words: no markup in them, and nothing that steers the terminal.
    Colours are for those who ask for them by a style."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """As rich does; here, so that an escape's width counts in a table."""
        return super().render_str(plain(text), **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """As rich does; for texts that were made elsewhere."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=plain(segment.text))


def complain(line: str) -> None:
    """A line on standard error, where it does not get into anybody's results."""
    sys.stderr.write(plain(line) + "\n")
    sys.stderr.flush()


def tell(line: str) -> None:
    """A line on standard output."""
    sys.stdout.write(plain(line) + "\n")


def complain_of_strategy(errors: Mapping[str, int]) -> None:
    """What was wrong with a user's own strategy, and how many shifts it ended."""
    for line, shifts in errors.items():
        complain(f"own strategy: {line} ({counted(shifts)} ended of it)")


def console(json_target: str | None = None) -> Console:
    """Where people read: standard output, or standard error when JSON goes to standard output.

    A pipe or a file has no width, so tables are never cut for one."""
    out = WordsConsole(stderr=json_target == "-")
    if not out.is_terminal:
        out.width = max(out.width, WIDTH_WITHOUT_TERMINAL)
    return out


def folder_for(path: Path) -> Path:
    """Makes the folder, so that a long run does not fail at its end; returns it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"{path}: cannot be made a folder: {error.strerror or error}") from error
    return path


def check_writable(target: str | None, made: Path | None = None) -> None:
    """Finds out before a long run whether its results can be written; leaves no file behind.

    made: a folder that the command makes itself."""
    if target is None or target == "-":
        return
    path = Path(target)
    if not path.parent.is_dir():
        if path.parent == made:
            return
        raise CommandError(f"{path}: there is no folder {path.parent}; make it first")
    was_there = path.exists()
    try:
        with path.open("a", encoding="utf-8"):
            pass
        if not was_there:
            path.unlink()
    except OSError as error:
        raise unwritten(path, error) from error


def check_apart(given: Mapping[str, Any]) -> None:
    """That no two outputs are one file, and none is a file that is read: the one written last would
    be all that is left. given: a command's arguments by name. CommandError names both."""
    named: dict[object, str] = {}
    for name in (*READ, *WRITTEN):
        values = given.get(name)
        reads = name in READ or not isinstance(values, (str, Path))
        for value in values if isinstance(values, list) else [values]:
            key = _file_key(value)
            if key is None:
                continue
            if key in named and not reads:
                raise CommandError(
                    f"{named[key]} and --{name} name one file, {value}: allowed are two files"
                )
            named[key] = "LOG" if reads and name == "log" else f"--{name.replace('_', '-')}"


def _file_key(value: object) -> object:
    """The same for two names of one file; None for what is none: a folder, a pipe, a device."""
    if not isinstance(value, (str, Path)) or str(value) in ("", "-") or str(value).endswith("/"):
        return None
    path = Path(value)
    if path.is_file():
        found = path.stat()
        return found.st_dev, found.st_ino
    return None if path.exists() else path.resolve()


def shown(strategy: str) -> str:
    """A strategy's name as tables have it: of a file of the user's own without its folder."""
    folder, _, name = strategy.replace("\\", "/").rpartition("/")
    return name if folder and is_file_name(name) else strategy


def counted(shifts: int) -> str:
    """This many shifts, in words."""
    return f"{shifts} shift" if shifts == 1 else f"{shifts} shifts"


def broken(name: str, longest: int = 14) -> str:
    """A strategy's name in lines of at most this many characters, where its words allow."""
    lines = [""]
    for part in shown(name).replace("_", "_\n").replace(":", ":\n").split("\n"):
        if lines[-1] and len(lines[-1] + part) > longest:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def number(value: float | None, digits: int, signed: bool = False) -> str:
    """As tables have it; a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"


def tries(attempts: int, aborts: int) -> str:
    """How often a sleeve was fired, and behind a stroke how often it was aborted, if it was."""
    return f"{attempts}/{aborts}" if aborts else str(attempts)


def cells(row: ShiftRow) -> list[str | Text]:
    """A row as the table shows it."""
    words: dict[str | None, str | Text] = {
        "gap": Text("gap", "green"),
        "tooth": Text("tooth", "red"),
        None: "-",
    }
    return [
        str(row.from_),
        str(row.to),
        shown(row.strategy),
        row.reference,
        f"{row.duration_ms:.0f}",
        number(row.slip_rpm, 1, signed=True),
        number(row.phase_error_deg, 2, signed=True),
        number(row.phase_error_pct_of_pitch, 1, signed=True),
        words[row.contact],
        tries(row.attempts, row.aborts),
        row.result,
    ]


def rows_table(title: str, rows: list[ShiftRow]) -> Table:
    """One row a shift, in a terminal of 80 columns too: a name too long for it is folded."""
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    for column in SHIFT_COLUMNS:
        right = column not in ("strategy", "reference", "contact", "result")
        table.add_column(
            column,
            justify="right" if right else "left",
            no_wrap=column not in ("strategy", "result"),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*cells(row))
    return table
