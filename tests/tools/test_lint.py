"""The rules of tools/rules find what they are for; `make lint` holds the repository to them."""

from __future__ import annotations

from types import SimpleNamespace

import lint
import pytest
from rules.bench import wrong_with
from rules.decisions import missing_in, row_of
from rules.docstrings import fragments_in
from rules.glossary import retired_in
from rules.house import hides_imports, imported
from rules.opening import readings
from rules.printing import prints
from rules.releases import wrong_in


def test_a_finding_is_said_with_its_rule_and_ends_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(lint.RULES, "glossary", SimpleNamespace(findings=lambda: ["a.md: word"]))
    monkeypatch.setitem(lint.RULES, "house", SimpleNamespace(findings=list))
    assert lint.main(["house"]) == 0
    assert capsys.readouterr().out == "1 rules of tools/rules: 0 findings\n"
    assert lint.main(["house", "glossary"]) == 1
    assert "a.md: word [glossary]\n" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        lint.main(["spelling"])


def test_a_word_is_found_as_a_whole_and_over_a_line_s_end() -> None:
    assert retired_in("it was drawn\nanew") == ["drawn anew"]
    assert retired_in("Told by nobody") == ["told"]
    assert retired_in("untold, of course; `told`, [x](drawn-anew.md)") == []


def test_the_table_s_row_of_a_decision_is_what_the_record_says() -> None:
    status = "**Status.** Accepted 2026-11-22 (most).\n0026 and\n0027 are folded in."
    record = f"# 0016 A filter\n\n{status}\n\n**Decided.** All.\n"
    row = "| [0016 A filter](0016-cloud.md) | Accepted 2026-11-22 | 0026, 0027 |"
    assert row_of("0016-cloud.md", record) == row
    assert row_of("0016-cloud.md", record.replace("0016", "0017")) is None
    assert row_of("0016-cloud.md", record.replace("Status", "State")) is None


def test_a_decision_that_there_is_not_is_found() -> None:
    text = "decision\n0007, docs/decisions/0016-cloud.md, decisions 0016 and 0x0027"
    assert missing_in(text, ["0016-cloud.md"]) == ["0007"]


@pytest.mark.parametrize(
    "line",
    [
        "open(path)", "open(path, 'rb')", "path.open('rb')", "path.open(mode='r')",
        "path.read_text()", "Path(name).read_bytes()", "os.open(path, 0)", "gzip.open(path)",
        "can.util.load_file_config(path)", "np.loadtxt(path)",
    ],
)  # fmt: skip
def test_a_file_opened_to_be_read_is_found(line: str) -> None:
    assert list(readings(line)) == [1]


@pytest.mark.parametrize(
    "line", ["open(path, 'w')", "path.open('x')", "chain.open(3)", "open_regular(path)"]
)
def test_what_writes_or_opens_no_file_is_not(line: str) -> None:
    assert not list(readings(line))


@pytest.mark.parametrize(
    ("words", "is_sentence"),
    [("A limit of the guard.", True), ("a limit of the guard.", False), ("A limit", False)],
)
def test_a_docstring_that_is_no_sentence_is_found(words: str, is_sentence: bool) -> None:
    assert (list(fragments_in(f'LIMIT = 1\n"""{words}"""\n')) == []) is is_sentence


@pytest.mark.parametrize(
    ("line", "is_bare"),
    [
        ("print(1)", True), ("sys.stderr.write('x')", True), ("Text.from_markup(x)", True),
        ("from rich.markup import escape", True), ("say('x')", False), ("print_all = 1", False),
    ],
)  # fmt: skip
def test_what_prints_past_the_one_place_is_found(line: str, is_bare: bool) -> None:
    assert prints(line) is is_bare


def test_an_old_name_and_a_hidden_import_are_found() -> None:
    assert "controller" in imported("from controller.core import Controller\n")
    assert "dbc" in imported("import dbc\n")
    assert not imported("from meshpoint.controller.core.core import Controller\n") & {"controller"}
    hidden = "if TYPE_CHECKING:\n    from a import b\n"
    assert hides_imports(hidden)
    assert not hides_imports(hidden.replace("from a import b", "x = 1"))


@pytest.mark.parametrize(
    ("command", "is_wrong"),
    [
        ("meshpoint check $BUS", False), ("meshpoint check", True), ("meshpoint chek $BUS", True),
        ("meshpoint watch $BUS --no-such-option", True),
    ],
)  # fmt: skip
def test_a_command_that_cannot_be_typed_is_found(command: str, is_wrong: bool) -> None:
    assert bool(wrong_with(command)) is is_wrong


CHANGELOG = "# Changelog\n\n## [Unreleased]\n\n## [0.2.0] - 2027-01-31\n\n### Added\n\n- A gear.\n"


@pytest.mark.parametrize(
    ("changelog", "found"),
    [
        (CHANGELOG, []),
        (CHANGELOG.replace("[0.2.0]", "[0.1.0]"), ["no section [0.2.0]"]),
        (CHANGELOG.replace("## [Unreleased]\n", ""), ["does not begin with [Unreleased]"]),
        (CHANGELOG.replace("Added", "Wishes"), ["no heading of Keep a Changelog: Wishes"]),
        (CHANGELOG + "- One more.\n" * 120, ["more than 120 lines"]),
    ],
)
def test_a_changelog_is_short_and_has_the_version_under_known_headings(
    changelog: str, found: list[str]
) -> None:
    said = list(wrong_in(changelog, "0.2.0"))
    assert [line[: len(start)] for line, start in zip(said, found, strict=True)] == found
