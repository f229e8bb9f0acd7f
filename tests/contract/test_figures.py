"""Measured figures are in docs/figures.toml, and documents show them as they are there.

A table of results is any table of the documents below, but one that `<!-- given -->` stands above:
its figures are limits or conditions, not results.
"""

from __future__ import annotations

import datetime as dt
import re
import runpy
import subprocess
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
"""A table that another tool writes, held by tests/tools/test_mutator.py."""
KEYS = {"command", "commit", "date", "machine", "conditions", "of", "figures"}
FOUND = figures.measurements()
OLDER = {name: figures.is_older(measurement) for name, measurement in FOUND.items()}
A, B = (
    {"commit": commit, "date": dt.date(2026, 1, day), "rig": "that was stiff",
     "figures": {"x": {"unit": "", "value": day}}}
    for day, commit in ((1, "1111111"), (2, "2222222"))
)  # fmt: skip


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
    assert figures.filled(document, FOUND, OLDER) == document, "make figures"
    assert not re.search("^<!-- (figure|as of)", document, re.MULTILINE), "ends a paragraph there"


@pytest.mark.parametrize("path", [*figures.documents()], ids=lambda path: path.name)
def test_a_section_says_of_what_code_its_figures_are(path: Path) -> None:
    assert figures.undated(path.read_text(encoding="utf-8"), FOUND) == set()


def test_every_figure_is_shown_somewhere() -> None:
    shown = "".join(path.read_text(encoding="utf-8") for path in figures.documents())
    names = {mark["name"] for mark in figures.MARK.finditer(shown)}
    assert names == set(figures.texts(FOUND))


@pytest.mark.parametrize("name", FOUND)
def test_a_measurement_says_what_it_is_of(name: str) -> None:
    found = FOUND[name]
    assert found.keys() - {"file", "rig"} == KEYS
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
        'title\n\n[a]\ncommit = "1111111"\nrig = "that was stiff"\n'
        '\n[a.figures]\nb = {unit = "%", value = 1.0}\n'
        '\n[c]\ncommit = "2222222"\n\n[c.figures]\nb = {unit = "%", value = 5.0}\n'
    )
    figure = {"json": "at.0", "unit": "%", "value": 1.0}
    new = figure | figures.taken({"at": [{"rate": 0.98765, "ci95": [0.9, 1.0]}]}, figure)
    assert figures.shown(new) == "98.8 % (90.0 to 100.0)"
    assert str(figures.taken({"at": 7.0}, {"json": "at", "unit": ""})) == "{'value': 7}"
    text = figures.rewritten(old, "a", {"commit": "3333333", "rig": None}, {"b": new})
    assert text == old.replace('1111111"\nrig = "that was stiff', "3333333").replace(
        '{unit = "%", value = 1.0}',
        '{json = "at.0", unit = "%", value = 98.8, interval = [90.0, 100.0]}',
    )


def test_a_mark_of_a_figure_that_is_not_in_the_file_is_an_error() -> None:
    with pytest.raises(KeyError, match=r"a\.b"):
        figures.filled("<!-- figure: a.b -->3<!-- / -->", {}, {})
    with pytest.raises(KeyError, match="b"):
        figures.filled("<!-- as of: b* --><!-- / -->", {"a": A}, {"a": True})


def dated(names: str, **older: bool | None) -> str:
    """What a document says of the measurements that a mark of it names."""
    mark = f"<!-- as of: {names} -->before<!-- / -->"
    text: str = figures.filled(mark, {"a_1": A, "a_2": A, "b": B}, older)
    return text.removeprefix(f"<!-- as of: {names} -->").removesuffix("<!-- / -->")


def test_a_figure_of_which_the_code_has_changed_is_shown_with_its_commit() -> None:
    old = "as of commit 1111111 (2026-01-01), not of today's code: of a rig that was stiff"
    assert dated("a_1, a_2", a_1=True, a_2=True) == old
    assert dated("a_*", a_1=True, a_2=True) == old
    new = "of commit 2222222 (2026-01-02), today's code"
    assert dated("b", b=False) == new
    assert dated("a_1, b, a_2", a_1=True, a_2=True, b=False) == f"{old}; `b` {new}"


def test_where_git_does_not_know_a_commit_a_document_stays_as_it_is() -> None:
    assert dated("a_1, b", a_1=True, b=None) == "before"


def test_a_section_that_shows_figures_without_their_commit_is_found() -> None:
    shown, of = "<!-- figure: b.x -->2<!-- / -->", "<!-- as of: b --><!-- / -->"
    assert figures.undated(f"# One\n{shown}\n{of}\n", {"b": B}) == set()
    assert figures.undated(f"# One\n{shown}\n## Two\n{of}\n", {"b": B}) == {"b"}


def test_code_differs_from_a_commit_as_soon_as_a_file_of_it_is_changed_or_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(figures.git.__globals__, "ROOT", tmp_path)
    for name in ("of/code.py", "other.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1\n", encoding="utf-8")
    if not figures.git("init"):
        pytest.skip("no git on this machine")
    figures.git("add", ".")
    figures.git("-c", "user.name=a", "-c", "user.email=a@b", "commit", "-m", "first")
    commit = figures.git("rev-parse", "HEAD")
    assert figures.differs(commit, ["of"]) is False
    (tmp_path / "other.py").write_text("2\n", encoding="utf-8")
    assert figures.differs(commit, ["of"]) is False
    (tmp_path / "of" / "new.py").write_text("2\n", encoding="utf-8")
    assert figures.differs(commit, ["of"]) is True
    (tmp_path / "of" / "new.py").unlink()
    (tmp_path / "of" / "code.py").write_text("2\n", encoding="utf-8")
    assert figures.differs(commit, ["of"]) is True
    assert figures.differs("0" * 40, ["of"]) is None


def test_what_is_in_no_commit_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    names = figures.make.__globals__
    monkeypatch.setitem(names, "differs", lambda commit, _paths: commit == "HEAD")
    monkeypatch.setitem(names, "run", lambda _measurement: pytest.fail("measured"))
    with pytest.raises(ValueError, match="in no commit; a measurement is of a commit"):
        figures.make("typical")


def test_what_is_old_is_measured_where_a_command_gives_it_and_the_others_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[str] = []

    def make(name: str) -> None:
        made.append(name)
        if name == "typical":
            raise subprocess.CalledProcessError(1, "meshpoint")

    names = figures.make_all.__globals__
    monkeypatch.setitem(names, "make", make)
    fresh = FOUND["clean"]["conditions"]
    monkeypatch.setitem(names, "is_older", lambda each: each["conditions"] != fresh)
    assert not figures.make_all()
    said = capsys.readouterr().out
    assert {"typical", "alone_edges_40"} <= set(made)
    assert "clean" not in made
    assert "of today's code: clean" in said
    assert "not measured: typical: " in said
    assert "by hand: pace: clean, clean_true, typical: python -m benchmarks.bench_campaign" in said
    assert set(re.findall("^by hand: (\\w+)", said, re.MULTILINE)) == (
        set(FOUND) - set(made) - {"clean"}
    )
