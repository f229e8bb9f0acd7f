"""The docstring of a constant or field stands alone: an editor shows it without its neighbours."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]


def explained(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Constants, fields and attributes of a module that have a docstring, and it."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            for named, after in pairwise(node.body):
                match named, after:
                    case (
                        ast.Assign() | ast.AnnAssign(),
                        ast.Expr(value=ast.Constant(value=str(words))),
                    ):
                        yield ast.unparse(named), words.strip()


@pytest.mark.parametrize("package", ("controller", "rig_sim", "dbc", "meshpoint"))
def test_a_constants_docstring_is_a_sentence_of_its_own(package: str) -> None:
    fragments = [
        f"{path.relative_to(ROOT)}: {named}: {words}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for named, words in explained(ast.parse(path.read_text(encoding="utf-8")))
        if words[0].islower() or not words.endswith(".")
    ]
    assert fragments == []
