"""Which mutants are tried without the compiler.

What is compiled shows a tracer no lines, has its constants for good, and takes half a minute to be
compiled anew. In plain Python a mutant of a kernel costs no more than any other.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from importers import importers_of
from mutator import Mutants, Where
from targets import ROOT

DECORATORS: Final = frozenset({"compiled", "bare", "inlined"})
"""Those of `controller/jit.py`."""
COMPILED, PLAIN_PYTHON = "compiled", "plain"


def is_compiled(source: str, where: Where) -> bool:
    """Whether the mutant is in a kernel."""
    if not where.qualname:
        return False
    return _is_decorator(source.splitlines()[where.first_line - 1])


def as_they_run(names: dict[str, list[str]]) -> dict[str, dict[str, list[str]]]:
    """These mutants, by file, apart: those that are tried without the compiler, and all others."""
    found: dict[str, dict[str, list[str]]] = {COMPILED: {}, PLAIN_PYTHON: {}}
    kernels = _files_with_kernels()
    for name, wanted in names.items():
        path = ROOT / name
        source = path.read_text(encoding="utf-8")
        is_used = bool(kernels & {str(path), *importers_of(str(path), kernels)})
        for mutant in Mutants(name, source).all:
            if mutant.name in wanted:
                is_constant = bool(mutant.where.constants) and is_used
                plain = is_constant or is_compiled(source, mutant.where)
                how = PLAIN_PYTHON if plain else COMPILED
                found[how].setdefault(name, []).append(mutant.name)
    return found


def _files_with_kernels() -> set[str]:
    return {
        str(path)
        for path in ROOT.glob("controller/**/*.py")
        if _has_kernels(path.read_text(encoding="utf-8").splitlines())
    }


def _has_kernels(lines: Iterable[str]) -> bool:
    return any(_is_decorator(line) for line in lines)


def _is_decorator(line: str) -> bool:
    line = line.strip()
    return line.startswith("@") and line[1:].partition("(")[0] in DECORATORS
