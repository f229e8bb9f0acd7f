"""Measured figures are in docs/figures.toml, and documents show them as they are there.

A table of results is any table of the documents below, but one that `<!-- given -->` stands above:
its figures are limits or conditions, not results.
"""

from __future__ import annotations

import datetime as dt
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]
figures = SimpleNamespace(**runpy.run_path(str(ROOT / "tools" / "figures.py")))
OF_RESULTS = [
    ROOT / name
    for name in (
        "README.md", "docs/strategy.md", "docs/safety.md", "docs/campaign.md", "docs/estimation.md",
        "docs/shifts.md", "docs/frame_to_valve.md",
    )
]  # fmt: skip
GIVEN = "<!-- given -->"
COUNTED = "<!-- begin: made by `make mutants` -->"
"""A table that another tool writes, held by tests/mutation/test_mutator.py."""
KEYS = {"command", "commit", "date", "machine", "conditions", "of", "figures"}
FOUND = figures.measurements()


def unmarked(document: str) -> list[str]:
    """The cells of tables of results, right of a row's name, that begin with an unmarked figure."""
    found, above, is_given = [], "", False
    for line in document.splitlines():
        if not line.startswith("|"):
            above = line or above
            continue
        if above:
            is_given, above = above in (GIVEN, COUNTED), ""
        elif not is_given:
            cells = (cell.strip() for cell in line.strip("|").split("|")[1:])
            found += [cell for cell in cells if re.match(r"[*~<>+-]*\d", cell)]
    return found


@pytest.mark.parametrize("path", OF_RESULTS, ids=lambda path: path.name)
def test_every_figure_in_a_table_of_results_comes_from_the_file(path: Path) -> None:
    assert unmarked(path.read_text(encoding="utf-8")) == []


def test_a_figure_that_does_not_is_found() -> None:
    table = "\n| a | b |\n|---|---|\n| 5 ms | 12.5 % |\n| x | <!-- figure: a.b -->3<!-- / --> |\n"
    assert unmarked("Words." + table) == ["12.5 %"]
    assert unmarked(GIVEN + table) == []
    assert unmarked(GIVEN + table + "\nWords." + table) == ["12.5 %"]


@pytest.mark.parametrize("path", [*figures.documents()], ids=lambda path: path.name)
def test_a_document_shows_a_figure_as_the_file_has_it(path: Path) -> None:
    document = path.read_text(encoding="utf-8")
    assert figures.filled(document, figures.texts(FOUND)) == document, "make figures"
    assert "\n<!-- figure" not in document, "Markdown ends a paragraph there"


def test_every_figure_is_shown_somewhere() -> None:
    shown = "".join(path.read_text(encoding="utf-8") for path in figures.documents())
    names = {mark["name"] for mark in figures.MARK.finditer(shown)}
    assert names == set(figures.texts(FOUND))


@pytest.mark.parametrize("name", FOUND)
def test_a_measurement_says_what_it_is_of(name: str) -> None:
    found = FOUND[name]
    assert found.keys() - {"file"} == KEYS
    assert re.fullmatch("[0-9a-f]{7}", found["commit"])
    assert found["commit"] != "0000000"
    assert all((ROOT / path).exists() for path in found["of"])
    assert ("FILE" in found["command"].split()) == ("file" in found)
    for figure in found["figures"].values():
        assert figure["unit"] in figures.DIGITS
        low, high = figure.get("interval", (figure["value"], figure["value"]))
        assert low <= figure["value"] <= high


@pytest.mark.parametrize("name", FOUND)
def test_no_code_has_changed_much_later_than_it_was_measured(name: str) -> None:
    """As far as git knows: an archive and a shallow clone do not say when code was changed."""
    found = FOUND[name]
    changed = figures.code_changed(found["of"])
    assert not figures.is_too_old(found["date"], changed), f"make figures NAME={name}"


def test_a_figure_is_too_old_beyond_the_margin_alone() -> None:
    measured = dt.date(2026, 1, 1)
    last = measured + dt.timedelta(figures.MARGIN_DAYS)
    assert not figures.is_too_old(measured, last)
    assert figures.is_too_old(measured, last + dt.timedelta(1))
    assert not figures.is_too_old(measured, None)


def test_a_new_measurement_is_written_in_the_place_of_the_old_one() -> None:
    old = (
        'title\n\n[a]\ncommit = "1111111"\n\n[a.figures]\nb = {unit = "%", value = 1.0}\n'
        '\n[c]\ncommit = "2222222"\n\n[c.figures]\nb = {unit = "%", value = 5.0}\n'
    )
    figure = {"json": "at.0", "unit": "%", "value": 1.0}
    new = figure | figures.taken({"at": [{"rate": 0.98765, "ci95": [0.9, 1.0]}]}, figure)
    assert figures.shown(new) == "98.8 % (90.0 to 100.0)"
    assert str(figures.taken({"at": 7.0}, {"json": "at", "unit": ""})) == "{'value': 7}"
    text = figures.rewritten(old, "a", {"commit": "3333333"}, {"b": new})
    assert text == old.replace("1111111", "3333333").replace(
        '{unit = "%", value = 1.0}',
        '{json = "at.0", unit = "%", value = 98.8, interval = [90.0, 100.0]}',
    )


def test_a_mark_of_a_figure_that_is_not_in_the_file_is_an_error() -> None:
    with pytest.raises(KeyError, match=r"a\.b"):
        figures.filled("<!-- figure: a.b -->3<!-- / -->", {})
