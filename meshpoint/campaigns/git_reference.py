"""A commit as the baseline: its product is exported beside this one and makes the same draws.

`git archive` writes the commit's files to a folder of its own, so nothing of the checkout is
touched. Where they hold the product, that product is run, by this Python and with the packages
installed here; else the one that is running, with the commit's settings and data sheets. It works
beside this campaign and stops with it.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tarfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from meshpoint.base.errors import CommandError, RunError
from meshpoint.campaigns.baseline import Outcome, Outcomes, outcome_tables, read_outcomes
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox.tables import TableError, load_toml

POLL_S: Final = 0.2
BESIDE: Final = ("controller", "rig_sim", "dbc", "firmware")
"""Folders of a checkout that are packages below `meshpoint` where it is installed."""
PRODUCT: Final = ("meshpoint/__main__.py", "controller/__init__.py", "rig_sim/core.py")
"""What a checkout of the product has."""
START: Final = """\
import sys, pathlib, meshpoint
expected = pathlib.Path(sys.argv.pop(1)).resolve()
found = pathlib.Path(meshpoint.__file__).resolve().parents[1]
if found != expected:
    sys.exit(f"the product of {expected} was to be run, but {found} came first")
from meshpoint.__main__ import main
sys.exit(main(sys.argv[1:]))
"""
ERROR_LINES: Final = 12
STOP_S: Final = 60.0


@dataclass(frozen=True)
class Commit:
    """A commit of a checkout."""

    reference: str
    sha: str
    top: Path

    def __str__(self) -> str:
        """For people."""
        return f"{self.reference} ({self.sha[:12]} of {self.top})"


def find_commit(reference: str) -> Commit:
    """The commit of the checkout that this is run in, or else of the one that the product is run
    from. CommandError where there is none."""
    tops = [top for where in (Path.cwd(), _package().parent) if (top := _top(where)) is not None]
    if not tops:
        raise CommandError(
            f"--against {reference}: no such file or folder, and as a git commit it is not to be "
            f"had: neither {Path.cwd()} nor {_package().parent} is in a git checkout"
        )
    for top in tops:
        found = _git(top, "rev-parse", "--verify", "--quiet", reference + "^{commit}")
        if found is not None:
            return Commit(reference, found.decode().strip(), top)
    raise CommandError(
        f"--against {reference}: no such file or folder, and no commit of {tops[0]}; a shallow "
        "clone has the newest alone (git fetch --unshallow)"
    )


def export(commit: Commit, folder: Path) -> bool:
    """Writes the commit's files. Whether they hold the product; it is then laid out as installed.

    RunError where git gives none."""
    archive = _git(commit.top, "archive", "--format=tar", commit.sha)
    if archive is None:
        raise RunError(f"--against {commit}: git archive failed")
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(folder, filter=_within)  # noqa: S202 (what data_filter lets through)
    if not all((folder / path).is_file() for path in PRODUCT):
        return False
    for name in BESIDE:
        if (folder / name).is_dir():
            (folder / name).rename(folder / "meshpoint" / name)
    return True


def _within(member: tarfile.TarInfo, folder: str) -> tarfile.TarInfo | None:
    """A file of a commit; links out of the checkout are left out, the product has none."""
    try:
        return tarfile.data_filter(member, folder)
    except tarfile.FilterError:
        return None


def as_of(commit: Commit, exported: Path, path: str) -> str:
    """A file named on the command line as the commit has it; where it has none, as it is."""
    here = Path(path).resolve()
    if here.is_relative_to(commit.top):
        then = exported / here.relative_to(commit.top)
        if then.is_file():
            return str(then)
    return str(here) if here.is_file() else path


def own_strategy(settings: str | None) -> str:
    """The controller's own strategy by this settings file."""
    if settings is None:
        return ControllerSettings().strategy_name
    try:
        values = load_toml(Path(settings))
    except TableError as error:
        raise CommandError(f"--against: {error}") from error
    return str(values.get("strategy", ControllerSettings().strategy_name))


def start(source: Path | None, command: list[str], said: Path) -> subprocess.Popen[bytes]:
    """A process with these arguments of `meshpoint`; what it says goes to a file. `source`: the
    folder that holds its package, None for the product that is running."""
    source = _package().parent if source is None else source
    path = os.pathsep.join(filter(None, (str(source), os.environ.get("PYTHONPATH"))))
    with said.open("wb") as file:
        return subprocess.Popen(  # noqa: S603 (the product itself)
            [sys.executable, "-P", "-c", START, str(source), *command],
            stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
            env=os.environ | {"PYTHONPATH": path},
        )  # fmt: skip


class GitBaseline:
    """The product of a commit at work in a process of its own. Ends it when closed."""

    def __init__(
        self, commit: Commit, work: Path, command: list[str], source: Path | None, strategy: str
    ) -> None:
        """`command`: arguments of `meshpoint` that make its campaign in `work`; `source`: the
        folder that holds its package, None for the product that is running."""
        self.name = str(commit)
        self._commit, self._work, self._strategy = commit, work, strategy
        work.mkdir(parents=True, exist_ok=True)
        self._said = work / "before.log"
        self._process = start(source, command, self._said)
        self._seen: dict[Path, Outcomes] = {}

    def first(self, seeds: list[int]) -> Outcomes:
        """These runs, waited for. RunError where the process ends without them."""
        while True:
            code = self._process.poll()  # before reading: what it wrote last is then there
            found = self._read()
            if code is not None or all(seed in found for seed in seeds):
                break
            time.sleep(POLL_S)
        if not any(seed in found for seed in seeds):
            raise RunError(f"--against {self._commit}: {self._why(code)}")
        return {seed: found[seed] for seed in seeds if seed in found}

    def close(self) -> None:
        """Ends the process: what it would still make nobody asks for."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _read(self) -> dict[int, Mapping[int, Outcome]]:
        found: dict[int, Mapping[int, Outcome]] = {}
        for table in outcome_tables(self._work):
            try:
                if table not in self._seen:
                    self._seen[table] = read_outcomes([table], self._strategy)
            except CommandError:
                if table.exists():
                    raise
                return self._read()  # its parts have just become one table
            found.update(self._seen[table])
        return found

    def _why(self, code: int | None) -> str:
        said = self._said.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return "\n".join([f"its campaign ended with {code}", *said[-ERROR_LINES:]])


def _package() -> Path:
    """The folder of the package that is running."""
    return Path(__file__).resolve().parents[1]


def _top(where: Path) -> Path | None:
    """The folder of the checkout that this one is in."""
    found = _git(where, "rev-parse", "--show-toplevel")
    return None if found is None else Path(found.decode().strip()).resolve()


def _git(where: Path, *arguments: str) -> bytes | None:
    """What git says; None where it refuses. CommandError where there is no git."""
    git = shutil.which("git")
    if git is None:
        raise CommandError("--against: a commit is asked for, and git is not installed")
    result = subprocess.run(  # noqa: S603 (found above)
        [git, "-C", str(where), *arguments], capture_output=True, check=False
    )
    return result.stdout if result.returncode == 0 else None
