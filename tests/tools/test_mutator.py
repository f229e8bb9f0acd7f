"""The mutator: each mutant differs from the product in one place, is a program, and keeps its name.

Whether the tests catch them takes a run of its own: `make mutants`.
"""

from __future__ import annotations

import ast

import pytest
from mutator import Mutants
from run_mutants import BEGIN, ROOT, equivalents, mutants_of, stale, table
from targets import TARGETS, Target


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_each_mutant_is_one_change_that_is_taken_back(target: Target) -> None:
    found = mutants_of(target)
    assert sum(map(len, found.values())) > 90
    for mutants in found.values():
        assert len({mutant.name for mutant in mutants}) == len(mutants)
    name, _ = min(found.items(), key=lambda each: (not each[1], len(each[1])))
    file = Mutants(name, (ROOT / name).read_text(encoding="utf-8"))
    before = ast.dump(file.tree)
    for mutant in file.all:
        mutant.apply()
        assert ast.dump(file.tree) != before
        compile(file.tree, name, "exec")
        mutant.undo()
    assert ast.dump(file.tree) == before


def test_every_listed_mutant_exists_and_has_a_reason() -> None:
    listed = equivalents()
    assert stale(listed) == []
    assert all(len(reason) > 20 for reason in listed.values())


def test_the_document_counts_the_mutants_that_there_are() -> None:
    """What the runs came to is written by them; how many there are and are listed is held here."""
    said = (ROOT / "docs/safety.md").read_text(encoding="utf-8").partition(BEGIN)[2]
    counts = [line.split("|")[1:4] for line in table(equivalents()).splitlines()]
    there = [line.split("|")[1:4] for line in said.strip().splitlines()[: len(counts)]]
    assert there == counts
