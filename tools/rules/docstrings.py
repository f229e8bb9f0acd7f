"""The docstring of a constant or field stands alone: an editor shows it without its neighbours."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from itertools import pairwise

from rules import PRODUCT, ROOT, name_of


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


def fragments_in(source: str) -> Iterator[str]:
    """What in a module is explained by less than a sentence."""
    for named, words in explained(ast.parse(source)):
        if words[0].islower() or not words.endswith("."):
            yield f"{named}: no sentence of its own: {words}"


def findings() -> Iterator[str]:
    """Of the whole product."""
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for fragment in fragments_in(path.read_text(encoding="utf-8")):
                yield f"{name_of(path)}: {fragment}"
