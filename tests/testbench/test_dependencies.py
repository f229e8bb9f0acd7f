"""One install runs every command: what the packages import is a plain dependency."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SETTINGS: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = ("controller", "dbc", "firmware", "meshpoint", "rig_sim")
INSTALLS = {"autosar_e2e": "autosar-e2e", "e2e": "autosar-e2e", "can": "python-can"}
"""Where a package is imported by another name than it is installed by."""
OPTIONAL = {"dask": "distributed", "cryptography": "cryptography", "foxglove": "foxglove-sdk",
            "websockets": "websockets",
            "pythonfmu3": "pythonfmu3", "unicorn": "unicorn", "ziglang": "ziglang"}  # fmt: skip
"""Used by `campaign --dask`, `--keys`, `convert`, `fmu` and `--firmware` alone, which name their
extras."""
LOADS_US = {"pytest_plugin.py": "pytest"}
"""A file that is loaded by that package alone."""


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[^A-Za-z0-9._-]", each)[0] for each in requirements}


@pytest.mark.parametrize("folder", FOLDERS)
def test_what_a_folder_imports_is_always_installed(folder: str) -> None:
    plain = names(SETTINGS["project"]["dependencies"])
    for path in (ROOT / folder).rglob("*.py"):
        known = set(sys.stdlib_module_names) | {"meshpoint"} | set(OPTIONAL)
        foreign = set(imports(path)) - known - {LOADS_US.get(path.name)}
        missing = {name for name in foreign if INSTALLS.get(name, name) not in plain}
        assert not missing, f"{path.relative_to(ROOT)} imports {missing}"


def test_the_extras_of_earlier_versions_are_still_names() -> None:
    extras = SETTINGS["project"]["optional-dependencies"]
    assert {"all", "campaign", "plot", "report"} <= set(extras)
    optional = ("dask", "authentication", "mcap", "fmu", "firmware")
    assert names([each for name in optional for each in extras[name]]) == set(OPTIONAL.values())
