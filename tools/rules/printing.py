"""Messages go to people in one way, by which nothing that others wrote steers their terminal."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from rules import ROOT, name_of

ONE_PLACE = "meshpoint/results/output.py"
OWN_WORDS = {
    "meshpoint/api/reference.py": "names of pages of ours",
    "meshpoint/cli/reference.py": "names of pages of ours",
    "meshpoint/replays/replay_command.py": "what a console of ours printed, kept for its place",
}
BELOW = ("bus", "gearbox", "kernels")
"""Packages of meshpoint that cannot import it."""
RICH = {"rich.markup", "rich.pretty"}
WORDS = ("print", "Console", "from_markup", "stderr", *RICH)
"""One of these is in each file that `is_bare` finds something in."""


def is_bare(node: ast.AST) -> bool:
    """Whether it prints past the one place, or gives markup a meaning."""
    if isinstance(node, ast.ImportFrom):
        return node.module in RICH
    if not isinstance(node, ast.Call):
        return False
    name = node.func
    if isinstance(name, ast.Name):
        return name.id in ("print", "Console")
    return isinstance(name, ast.Attribute) and (
        name.attr == "from_markup" or (name.attr == "write" and "stderr" in ast.dump(name.value))
    )


def prints(source: str) -> bool:
    """Whether a module does so anywhere."""
    return any(word in source for word in WORDS) and any(
        is_bare(node) for node in ast.walk(ast.parse(source))
    )


def findings() -> Iterator[str]:
    """Of all above the bus; and exceptions that are none any more."""
    found = {
        name_of(path)
        for path in sorted((ROOT / "meshpoint").rglob("*.py"))
        if path.relative_to(ROOT).parts[1] not in BELOW and prints(path.read_text(encoding="utf-8"))
    }
    for name in sorted(found - OWN_WORDS.keys() - {ONE_PLACE}):
        yield f"{name}: prints past {ONE_PLACE}"
    for name in sorted({ONE_PLACE, *OWN_WORDS} - found):
        yield f"{name}: prints nothing any more, but tools/rules/printing.py names it"
