"""Which functions use a constant of a file: in it, and in what imports it."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from pathlib import Path

from targets import ROOT

PACKAGE = "meshpoint."


def users_of(path: str, names: Iterable[str], files: Iterable[str]) -> list[tuple[str, range]]:
    """The lines of each function that names one of these constants of the file at `path`, in it and
    in what imports it."""
    wanted, found = set(names), []
    for file in [path, *sorted(_direct_importers_of(path, files))]:
        for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                read = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
                if read & wanted:
                    last = node.end_lineno or node.lineno
                    found.append((file, range(node.body[0].lineno, last + 1)))
    return found


def _direct_importers_of(path: str, files: Iterable[str]) -> set[str]:
    name = _module(Path(path))
    return {each for each in files if each != path and name in _imports(Path(each))}


def _module(path: Path) -> str:
    return PACKAGE + ".".join(path.relative_to(ROOT).with_suffix("").parts)


def _imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
            found.add(str(node.module))
    return found
