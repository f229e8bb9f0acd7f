"""The house: one name for everything, and every folder with code is part of the package."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from rules import PRODUCT, ROOT, name_of

OLD_NAMES = {"bus", "controller", "dbc", "gearbox", "rig_sim", "testbench"}
BESIDE = ("tests", "benchmarks")
NEVER_HIDDEN = ("controller", "rig_sim")
"""Packages whose import graph shows all imports."""
MAY_IMPORT = re.compile(
    rf"^\s*(?:from|import) (?:.*[ ,])?(?:{'|'.join(OLD_NAMES)})\b", re.MULTILINE
)


def sources(*folders: str) -> list[Path]:
    """Their Python files."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def imported(text: str) -> set[str]:
    """First names of everything a module imports; none where no line of it can hold an old one."""
    names: set[str] = set()
    if not MAY_IMPORT.search(text):
        return names
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


def hides_imports(text: str) -> bool:
    """Whether a module imports something for the type checker alone."""
    return "TYPE_CHECKING" in text and any(
        isinstance(node, ast.If)
        and "TYPE_CHECKING" in ast.unparse(node.test)
        and any(isinstance(part, (ast.Import, ast.ImportFrom)) for part in node.body)
        for node in ast.walk(ast.parse(text))
    )


def findings() -> Iterator[str]:
    """Old names, folders that are no package or say nothing, hidden imports."""
    for path in sources(*PRODUCT, *BESIDE):
        if names := imported(path.read_text(encoding="utf-8")) & OLD_NAMES:
            yield f"{name_of(path)}: imports {sorted(names)}, not below meshpoint"
    for folder in sorted({path.parent for path in sources(*PRODUCT)}):
        start = folder / "__init__.py"
        if not start.is_file():
            yield f"{name_of(folder)}: no __init__.py, so a wheel would lose it"
        elif not ast.get_docstring(ast.parse(start.read_text(encoding="utf-8"))):
            yield f"{name_of(start)}: does not say what the package is"
    for path in sources(*NEVER_HIDDEN):
        if hides_imports(path.read_text(encoding="utf-8")):
            yield f"{name_of(path)}: an import is hidden from the import graph"
