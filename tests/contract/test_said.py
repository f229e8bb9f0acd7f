"""Messages go to people in one way, by which nothing that others wrote steers their
terminal."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ONE_PLACE = "meshpoint/testbench/results/output.py"
OWN_WORDS = {
    "meshpoint/testbench/help/reference.py": "names of pages of ours",
    "meshpoint/testbench/replay/command.py": "what a console of ours printed, kept for its place",
}
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


def test_whatever_is_printed_goes_through_one_place() -> None:
    texts = {
        path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
        for path in (ROOT / "meshpoint" / "testbench").rglob("*.py")
    }
    found = {
        name
        for name, text in texts.items()
        if any(word in text for word in WORDS)
        and any(is_bare(node) for node in ast.walk(ast.parse(text)))
    }
    assert ONE_PLACE in found
    assert found - OWN_WORDS.keys() == {ONE_PLACE}
    assert OWN_WORDS.keys() <= found, "an exception that is none any more"
