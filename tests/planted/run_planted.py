"""Plants each bug of this folder in a copy of the product, and says what catches it.

    python tests/planted/run_planted.py [NAME ...]

A patch says in its head what it breaks and which tests catch it. A bug is caught where those tests
fail with it. They have to pass without it, which the suite itself shows. Ends with 1 where a bug
is not caught.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
FOLDER = Path(__file__).parent
COPIED = (
    "benchmarks", "controller", "dbc", "firmware", "rig_sim", "meshpoint", "tests", "docs",
    "pyproject.toml",
)  # fmt: skip
BESIDE = ("controller", "dbc", "firmware", "rig_sim")
LONGEST_S = 900.0
IMPORTS_FROM_THE_COPY = """\
import sys
sys.meta_path[:] = [each for each in sys.meta_path if "editable" not in repr(each).lower()]
"""
TESTS_FAILED = 1
"""pytest's exit code; others mean that no test has run."""


class Planted(NamedTuple):
    """A bug."""

    name: str
    breaks: str
    tests: tuple[str, ...]
    path: Path


def planted() -> list[Planted]:
    """All of them, by name."""
    found = []
    for path in sorted(FOLDER.glob("*.patch")):
        lines = path.read_text(encoding="utf-8").splitlines()
        head = dict(line.split(": ", 1) for line in lines[:2])
        found.append(Planted(path.stem, head["Breaks"], tuple(head["Caught-by"].split()), path))
    return found


def copy_of_the_product(folder: Path) -> Path:
    """A tree of its own, imported in place of the installed one."""
    tree = folder / "tree"
    tree.mkdir()
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            left_out = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
            shutil.copytree(source, tree / name, ignore=left_out)
        else:
            shutil.copy(source, tree / name)
    for name in BESIDE:
        (tree / "meshpoint" / name).symlink_to(f"../{name}")
    site = folder / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(IMPORTS_FROM_THE_COPY, encoding="utf-8")
    return tree


def apply(tree: Path, bug: Planted, *options: str) -> None:
    """Puts a bug in, or with `-R` takes it out."""
    command = ["git", "apply", *options, str(bug.path)]
    environment = os.environ | {"GIT_CEILING_DIRECTORIES": str(tree.parent)}
    subprocess.run(command, cwd=tree, check=True, env=environment)


def is_caught(tree: Path, bug: Planted) -> bool:
    """Whether its tests fail with it."""
    path = os.pathsep.join([str(tree.parent / "site"), str(tree)])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider",
         *bug.tests],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"},
        stdout=subprocess.DEVNULL,
        timeout=LONGEST_S,
        check=False,
    )  # fmt: skip
    return done.returncode == TESTS_FAILED


def main(names: list[str]) -> int:
    """Plants those named, or all."""
    bugs = [bug for bug in planted() if not names or bug.name in names]
    missed = []
    with tempfile.TemporaryDirectory() as folder:
        tree = copy_of_the_product(Path(folder))
        for bug in bugs:
            begun_s = time.monotonic()
            apply(tree, bug)
            caught = is_caught(tree, bug)
            apply(tree, bug, "-R")
            if not caught:
                missed.append(bug.name)
            word = "caught" if caught else "MISSED"
            print(
                f"{word} {bug.name} ({time.monotonic() - begun_s:.0f} s): {bug.breaks}", flush=True
            )
    print(f"{len(bugs) - len(missed)} of {len(bugs)} planted bugs caught")
    return 1 if missed or not bugs else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
