"""A plugin of pytest: one file is imported as a mutant. Environment: MUTATED_FILE is imported from
MUTATED_SOURCE. The first test that fails is named in a file beside that.

To be used with --assert=plain: pytest's own import of what a plugin's distribution brings, which
the product is, goes by this one otherwise. A run that has not imported the mutant ends with
NOT_IMPORTED.
"""

from __future__ import annotations

import importlib.machinery
import os
from pathlib import Path
from types import CodeType
from typing import Any

import pytest
from first_failure import judge_by_first_failure
from targets import NOT_IMPORTED, caught_by

_FILE = os.environ["MUTATED_FILE"]
_SOURCE_FILE = Path(os.environ["MUTATED_SOURCE"])
_SOURCE = _SOURCE_FILE.read_text(encoding="utf-8")
_get_code: Any = importlib.machinery.SourceFileLoader.get_code
_imported: list[str] = []


def _mutated(self: Any, fullname: str) -> CodeType | None:
    if os.path.realpath(self.path) == _FILE:
        _imported.append(fullname)
        return compile(_SOURCE, _FILE, "exec")
    code: CodeType | None = _get_code(self, fullname)
    return code


importlib.machinery.SourceFileLoader.get_code = _mutated  # type: ignore[method-assign]


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Before the tests are loaded."""
    judge_by_first_failure()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Names the test that has caught the mutant."""
    if report.failed:
        caught_by(_SOURCE_FILE).write_text(report.nodeid, encoding="utf-8")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A mutant that was never there has not survived."""
    if not _imported:
        session.exitstatus = NOT_IMPORTED
