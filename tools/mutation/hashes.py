"""By what a result of an earlier run is known to be of the code and tests that are there now."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from targets import ROOT, Target


class Hashes:
    """Of a target's files and tests: by them a result is known to be of what is there now."""

    def __init__(self, target: Target) -> None:
        files = target.paths()
        self.code = {path.relative_to(ROOT).as_posix(): hash_of([path]) for path in files}
        self.all_code = hash_of(files)
        paths = files_under([each for each in target.tests if (ROOT / each).exists()])
        shared = [path for path in paths if not path.name.startswith("test_")]
        self.tests = {
            path.relative_to(ROOT).as_posix(): hash_of([path, *_shared_by(path, shared)])
            for path in paths if path not in shared
        }  # fmt: skip
        self.all_tests = hash_of(paths)

    def of(self, mutant: str, by: str) -> dict[str, str]:
        """What belongs to a result: `by` is the test that caught the mutant."""
        tests = self.tests.get(by.split("::")[0], self.all_tests)
        return {"code": self.code.get(mutant.split("::")[0], ""), "tests": tests}

    def hold(self, values: dict[str, Any]) -> bool:
        """Whether a result is of this code and of these tests."""
        now = self.of(values["mutant"], values["by"])
        return all(values.get(key) == value for key, value in now.items())


def _shared_by(test: Path, shared: list[Path]) -> list[Path]:
    """What is in the folder of a test, and every conftest.py: the other folders are none of its
    business, or a run of some tests would know nothing of a run of others."""
    return [path for path in shared if path.name == "conftest.py" or path.parent == test.parent]


def hash_of(paths: Iterable[Path]) -> str:
    """Of names and contents."""
    hashed = hashlib.sha256()
    for path in paths:
        hashed.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return hashed.hexdigest()[:16]


def files_under(tests: list[str]) -> list[Path]:
    """Those files and folders, and what they share."""
    found = {*(ROOT / "tests").glob("**/conftest.py")}
    for path in (ROOT / each for each in tests):
        found.update(path.glob("**/*.py") if path.is_dir() else [path])
        folder = path if path.is_dir() else path.parent
        found.update(each for each in folder.glob("*.py") if not each.name.startswith("test_"))
    return sorted(found)
