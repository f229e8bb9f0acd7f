"""`python -m benchmarks.studies`: the thesis's figures and tables, ours beside them."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from benchmarks.studies.record import Study, ThesisVerdict
from benchmarks.studies.registry import STUDIES, chosen
from benchmarks.studies.runner import StudyRecord, run_studies
from benchmarks.studies.settings import StudySettings, load_study_settings, shipped_text
from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.base.provenance import provenance
from meshpoint.bench.compiling import prepare
from meshpoint.bus import given_numbers
from meshpoint.cli import arguments
from meshpoint.cli.main import run_parsed
from meshpoint.cli.parsing import Parser, examples
from meshpoint.gearbox.reading import read_text
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES
from meshpoint.results.output import console, folder_for, write_json
from meshpoint.rig_sim.settings import Profile

LIST = "list"
PAGE = "studies.html"
SETTINGS = "studies.toml"
VERDICT_WORDS: dict[ThesisVerdict, str | Text] = {
    ThesisVerdict.AGREES: Text("agrees", "green"),
    ThesisVerdict.DIFFERS: Text("differs", "red"),
    ThesisVerdict.BY_CONSTRUCTION: "by construction",
    ThesisVerdict.NOT_COMPARABLE: "not comparable",
}
MAX_WORKERS = 64


def main(given: Sequence[str] | None = None) -> int:
    """Runs the studies that a command line asks for; returns its exit code."""
    return run_parsed(lambda: parser().parse_args(given))


def parser() -> Parser:
    """The command's arguments."""
    found = Parser(
        prog="python -m benchmarks.studies",
        description="Each study reproduces a figure or table of the thesis with the product's "
        "code and says whether ours agrees, and why. DIR gets a page (studies.html), pictures and "
        "CSV of each study, and studies.toml: the settings, to copy, change and give back with "
        "--settings. A verdict that differs is a result, not a failure.",
        epilog=examples(
            "python -m benchmarks.studies list",
            "python -m benchmarks.studies 6.8 --out out/study",
        ),
    )
    found.add_argument(
        "names",
        nargs="+",
        metavar="NAME",
        help="studies by name or by what they reproduce (6.8 is figure 6.8; `table 6.1`), `all`, "
        "or `list` to see them",
    )
    found.add_argument(
        "--out", type=Path, default=Path("out/study"), metavar="DIR",
        help="folder for the results (default: %(default)s)",
    )  # fmt: skip
    found.add_argument(
        "--settings", type=Path, metavar="FILE", help="TOML; what it names wins over studies.toml"
    )
    found.add_argument(
        "--workers",
        type=given_numbers.whole(1, MAX_WORKERS),
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes; the results do not depend on it (default: one a processor)",
    )
    found.add_argument("--debug", action="store_true", help="show the traceback of an error")
    arguments.add_json(found)
    found.set_defaults(run=run, program=found.prog)
    return found


def run(namespace: argparse.Namespace) -> int:
    """Runs the studies asked for."""
    if LIST in namespace.names:
        return _list(namespace)
    settings = load_study_settings(namespace.settings)
    studies = chosen(namespace.names)
    folder = folder_for(namespace.out)
    prepare(thesis=True)
    out = console(namespace.json)
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console("-"), transient=True) as bar:
        task = bar.add_task("studies", total=None)

        def progress(name: str, done: int, total: int) -> None:
            bar.update(task, description=name, completed=done, total=total)

        records = run_studies(studies, settings, folder, namespace.workers, progress)
    _write(namespace, settings, records)
    if namespace.json != "-":
        out.print(_table(records))
        out.print(f"page {folder / PAGE}")
    return Exit.DONE


def _list(namespace: argparse.Namespace) -> int:
    if namespace.names != [LIST]:
        raise CommandError("list stands alone, without names of studies")
    if namespace.json is not None:
        values = {study.name: {"title": study.title, "of": list(study.of)} for study in STUDIES}
        write_json(namespace.json, values)
    if namespace.json != "-":
        console(namespace.json).print(list_table(STUDIES))
    return Exit.DONE


def list_table(studies: Sequence[Study[Any]]) -> Table:
    """All studies and what they reproduce."""
    table = Table(box=None, pad_edge=False)
    for column in ("study", "of the thesis", ""):
        table.add_column(column, no_wrap=column == "study")
    for study in studies:
        table.add_row(study.name, ", ".join(study.of) or "beyond it", study.title)
    return table


def _write(
    namespace: argparse.Namespace, settings: StudySettings, records: list[StudyRecord]
) -> None:
    from benchmarks.studies.page import write_page

    source = provenance(
        settings.sheet,
        settings.common.seed,
        "thesis and truck, as each study says",
        Profile(settings.common.profile),
    )
    write_page(namespace.out / PAGE, records, {key: str(value) for key, value in source.items()})
    text = shipped_text()
    if namespace.settings is not None:
        text = read_text(namespace.settings, TABLE_LIMIT_BYTES)
    path = namespace.out / SETTINGS
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CommandError(f"{path}: cannot be written: {error.strerror or error}") from error
    if namespace.json is not None:
        write_json(namespace.json, {record.study: record.to_json(source) for record in records})


def _table(records: list[StudyRecord]) -> Table:
    table = Table(box=None, pad_edge=False, show_lines=False)
    for column in ("study", "of the thesis", "sheet,\nprofile", "verdict", "ours"):
        table.add_column(column, no_wrap=column != "ours")
    for record in records:
        for i, statement in enumerate(record.finding.statements):
            of = ", ".join(record.of) or "beyond it"
            first = (record.study, of, ",\n".join(record.gearbox)) if i == 0 else ("", "", "")
            table.add_row(*first, VERDICT_WORDS[statement.verdict], statement.ours)
    return table
