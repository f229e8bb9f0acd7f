"""docs/reference/faults.md: each of its scenarios is run, and held against its line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.swarm.episode import declared
from benchmarks.swarm.events import BUS_KINDS, NODE_KINDS, RIG_KINDS
from benchmarks.swarm.named import BEGIN, END, HEAD, NAMED, Named, run_named, table_row

DOCS = Path(__file__).parents[2] / "docs"
DOCUMENT = DOCS / "reference" / "faults.md"
TICK_MS = 10.0
STALE_MS = 51.0
"""50 ms, and the microseconds between the fault and the step that it is counted from."""
IN_THE_SUITE = ("hall_dropout", "bus_drop", "controller_restarted")
"""One of each side; all of them by `make long`."""
STALE = [named for named in NAMED if named.kind in ("bus_drop", "bus_bit_flip", "bus_duplicate")
         and named.value == 1.0 and named.target in (1, 2, 3)]  # fmt: skip


def lines() -> list[str]:
    text = DOCUMENT.read_text(encoding="utf-8")
    return text.split(BEGIN + HEAD)[1].split(END)[0].strip().splitlines()


def test_every_fault_of_the_list_has_a_scenario() -> None:
    assert {named.kind for named in NAMED} == {*RIG_KINDS, *BUS_KINDS, *NODE_KINDS}


def scenarios() -> Iterator[Any]:
    """Each with its line's number; of a kind in the suite the first."""
    left = set(IN_THE_SUITE)
    for k, named in enumerate(NAMED):
        marks = () if named.kind in left else (pytest.mark.long,)
        left.discard(named.kind)
        yield pytest.param(k, named, id=f"{k}-{named.kind}", marks=marks)
    assert not left


@pytest.mark.parametrize(("k", "named"), list(scenarios()))
def test_a_fault_is_found_and_ends_as_the_document_says(k: int, named: Named) -> None:
    outcome = run_named(named)
    assert outcome.broken == []
    *there, found, by, result = (cell.strip() for cell in lines()[k].split("|")[1:-1])
    *here, found_now, by_now, result_now = (
        cell.strip() for cell in table_row(outcome).split("|")[1:-1]
    )
    assert (there, by, result) == (here, by_now, result_now)
    if found == "-" or found_now == "-":
        assert found == found_now
    else:
        assert abs(float(found) - float(found_now)) <= TICK_MS
    if named in STALE:
        assert outcome.found_ms is not None
        assert outcome.found_ms <= STALE_MS


def test_the_table_has_a_line_a_scenario() -> None:
    assert len(lines()) == len(NAMED)


def test_every_row_of_the_guard_stands_against_a_hazard() -> None:
    text = (DOCS / "safety.md").read_text(encoding="utf-8")
    table = text.split("| hazard |")[1].split("\n\n")[0]
    rows = {
        row.strip() for line in table.splitlines()[2:] for row in line.split("|")[-2].split(",")
    }
    assert rows - {"-"} == set(declared()["guard_rows"])
