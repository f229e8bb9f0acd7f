"""Makes rows: each is `meshpoint campaign` in a process of its own, some at a time.

A row's folder holds the campaign as it goes (`--out`), and `row.json` once it is at its end; a row
that has one is not made again. Which product makes it does not matter: the one that is running, or
that of a commit, whose files are written beside (`meshpoint.campaigns.git_reference`).
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from benchmarks.envelope.rows import Row
from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.campaigns.git_reference import Commit, export, find_commit, start
from meshpoint.campaigns.store import CAMPAIGN_FILE, SHIFTS_FILE
from meshpoint.gearbox.reading import read_text
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.gearbox.tables import TABLE_LIMIT_BYTES
from meshpoint.results.output import folder_for

ROOT: Final = Path(__file__).resolve().parents[2]
CODE: Final = ("controller", "dbc", "meshpoint", "rig_sim")
"""What a row depends on."""
OWN: Final = "target_phase"
ROW_FILE: Final = "row.json"
RESULT_FILE: Final = "result.json"
SAID_FILE: Final = "said.log"
SAID_LINES: Final = 6
POLL_S: Final = 0.2
STOP_S: Final = 120.0


@dataclass(frozen=True)
class Product:
    """Whose shifts a table is of, and where its rows are."""

    words: str
    """For people."""
    folder: Path
    sha: str | None = None
    """Of its commit."""
    source: Path | None = None
    """What holds its package; None: the product that is running."""

    def row(self, row: Row) -> Path:
        """A row's folder."""
        return self.folder / row.name

    def table(self, row: Row) -> Path:
        """A row's judged shifts."""
        return self.row(row) / SHIFTS_FILE


def running(out: Path) -> Product:
    """The product that is running."""
    sha, changes = _git("rev-parse", "HEAD").strip(), _git("diff", "HEAD", "--", *CODE)
    if not sha:
        return Product("the product that is running", folder_for(out / "running"))
    if not changes:
        return Product(f"commit {sha[:9]}", folder_for(out / sha[:12]), sha)
    mark = hashlib.sha256(changes.encode()).hexdigest()[:8]
    return Product(f"commit {sha[:9]} with changes", folder_for(out / f"{sha[:12]}-{mark}"), sha)


def _git(*words: str) -> str:
    """What git says of this checkout; nothing where there is none."""
    command = ["git", "-C", str(ROOT), *words]
    try:
        done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout


def of_commit(reference: str, out: Path) -> Product:
    """The product of a commit, written below `out` where it is not there yet."""
    commit: Commit = find_commit(reference)
    folder = folder_for(out / commit.sha[:12])
    source = folder / "product"
    if not source.exists():
        writing = folder / "writing"
        shutil.rmtree(writing, ignore_errors=True)
        if not export(commit, writing):
            raise CommandError(f"{reference}: a commit that holds no product")
        writing.rename(source)
    return Product(f"commit {commit.sha[:9]}", folder, commit.sha, source)


@dataclass(frozen=True)
class Work:
    """A row, and the product that makes it."""

    product: Product
    row: Row
    true_state: bool
    dask: str | None = None

    @property
    def shifts(self) -> int:
        """How many shifts have to be made."""
        row = self.row
        return row.gearboxes * (row.learn + row.judged * (2 if self.true_state else 1))

    @property
    def described(self) -> dict[str, Any]:
        """All that its result depends on but the product."""
        row = {k: v for k, v in vars(self.row).items() if k not in ("changed", "why")}
        return row | {"words": list(self.row.words), "true_state": self.true_state}

    def arguments(self, files: Path) -> list[str]:
        """Of `meshpoint`; what the row changes is written to files in this folder."""
        row = self.row
        words = [
            "campaign", "--preset", "truck", "--strategy", OWN, "--runs", str(row.gearboxes),
            "--learn", str(row.learn), "--judged", str(row.judged), "--seed", str(row.seed),
        ]  # fmt: skip
        built = f'profile = "{row.profile}"\n{row.as_built}'
        words += ["--as-built", _file(files, f"{row.name}.built.toml", built)]
        sheet = row.sheet or "truck12"
        if sheet not in SHEET_NAMES:
            text = f'based_on = "truck12"\nname = "{row.name}"\n{sheet}'
            sheet = _file(files, f"{row.name}.sheet.toml", text)
        words += ["--gearbox", sheet]
        if row.settings:
            words += ["--settings", _file(files, f"{row.name}.settings.toml", row.settings)]
        words += ["--true-state"] if self.true_state else []
        return [*words, *row.words]


def _file(folder: Path, name: str, text: str) -> str:
    path = folder_for(folder) / name
    path.write_text(text, encoding="utf-8")
    return str(path.resolve())


@dataclass
class Made:
    """A row at its end."""

    of: dict[str, Any]
    """What it was to be."""
    seconds: float
    values: dict[str, Any] = field(default_factory=dict)
    """The campaign's JSON."""
    failed: str = ""
    """Why there is none."""


def made(work: Work) -> Made | None:
    """A row that was made before; None where there is none. CommandError where it is another."""
    path = work.product.row(work.row) / ROW_FILE
    if not path.is_file():
        return None
    found = Made(**json.loads(read_text(path, TABLE_LIMIT_BYTES)))
    if found.of | {"true_state": True} != work.described | {"true_state": True} or (
        work.true_state and not found.of["true_state"]
    ):
        raise CommandError(f"{path.parent}: is of another table; give another --out")
    return found


def make(
    works: Iterable[Work], files: Path, jobs: int, ended: Callable[[Work, Made], None]
) -> None:
    """Makes rows, `jobs` at a time, and hands each over at its end. What is at work when it is
    interrupted comes to the end of its gearbox; made anew it goes on from there."""
    waiting, at_work = iter(works), dict[subprocess.Popen[bytes], tuple[Work, float]]()
    with _ended(at_work):
        while True:
            while len(at_work) < jobs and (work := next(waiting, None)) is not None:
                at_work[_start(work, files)] = work, time.monotonic()
            if not at_work:
                return
            for process in [each for each in at_work if each.poll() is not None]:
                work, began_s = at_work.pop(process)
                ended(work, _end(work, process.returncode, time.monotonic() - began_s))
            time.sleep(POLL_S)


@contextmanager
def _ended(processes: Iterable[subprocess.Popen[bytes]]) -> Iterator[None]:
    try:
        yield
    finally:
        for process in list(processes):
            process.terminate()
        for process in list(processes):
            try:
                process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _start(work: Work, files: Path) -> subprocess.Popen[bytes]:
    folder = folder_for(work.product.row(work.row))
    where = ["--jobs", "1"] if work.dask is None else ["--dask", work.dask]
    kept = ["--out", str(folder), "--json", str(folder / RESULT_FILE)]
    words = [*work.arguments(files), *where, *kept]
    if (folder / CAMPAIGN_FILE).is_file():
        words.append("--resume")
    return start(work.product.source, words, folder / SAID_FILE)


def _end(work: Work, code: int, seconds: float) -> Made:
    folder = work.product.row(work.row)
    result = folder / RESULT_FILE
    found = Made(work.described, round(seconds, 1))
    values = json.loads(result.read_text(encoding="utf-8")) if result.is_file() else {}
    if code in (Exit.DONE, Exit.FAILED) and values and "interrupted" not in values:
        found.values = values
        text = json.dumps(vars(found))
        (folder / ROW_FILE).write_text(text, encoding="utf-8")
        return found
    said = (folder / SAID_FILE).read_text(encoding="utf-8", errors="replace").strip().splitlines()
    found.failed = "\n".join([f"its campaign ended with {code}", *said[-SAID_LINES:]])
    if code == Exit.INTERRUPTED:
        raise KeyboardInterrupt
    return found
