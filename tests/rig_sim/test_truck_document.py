"""docs/gearbox.md lists every parameter as `truck.toml` has it."""

from __future__ import annotations

from pathlib import Path

from meshpoint.rig_sim.truck.as_built import parameters

DOCUMENT = Path(__file__).parents[2] / "docs" / "gearbox.md"


def test_the_table_of_parameters_is_that_of_the_file() -> None:
    rows = [line for line in DOCUMENT.read_text().splitlines() if line.startswith("| `")]
    expected = []
    for name, q in parameters().items():
        note, _, source = q.note.rpartition("; ")
        numbers = f"{q.default:g} | {q.deviation:g} | {q.low:g}..{q.high:g}"
        expected.append(f"| `{name}` | {numbers} | {note} | {source} |")
    table = rows[-len(expected) :]
    assert table == expected
