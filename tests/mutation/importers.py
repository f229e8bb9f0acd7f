"""Which files of the product are made of which others: by what they import."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from pathlib import Path

from targets import ROOT

PACKAGE = "meshpoint."


def importers_of(path: str, files: Iterable[str]) -> set[str]:
    """Of `files` those that import the file at `path`, or one that does, and so on."""
    imported = {each: _imports(Path(each)) for each in files}
    found, new = set[str](), {path}
    while new:
        names = {_module(Path(each)) for each in new}
        new = {each for each, theirs in imported.items() if theirs & names} - found - {path}
        found |= new
    return found


def _module(path: Path) -> str:
    return PACKAGE + ".".join(path.relative_to(ROOT).with_suffix("").parts)


def _imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
            found.add(str(node.module))
    return found
