"""What others wrote (names in files, logs, on the bus) reaches a terminal as words, never as orders
to it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.text import Text

from meshpoint.campaigns.table import records_table
from meshpoint.cli.main import main
from meshpoint.cli.show_gearbox import sheet_toml
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.plain_text import plain
from meshpoint.results.output import complain, console

RED = "\x1b[31mred"
TURNED = "a\u202eb\u2066c\u200fd"
MARKUP = "[/nope][red]x[/]"


def sheet_named(folder: Path, name: str) -> Path:
    """The sheet of the thesis under another name."""
    text = sheet_toml(load_sheet("thesis"))
    assert '\nname = "thesis"' in text
    path = folder / "own.toml"
    # What JSON escapes, TOML reads.
    path.write_text(text.replace('name = "thesis"', f"name = {json.dumps(name)}"), "utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (RED, "\\x1b[31mred"),
        ("\x9b31m\x7f\x00", "\\x9b31m\\x7f\\x00"),
        (TURNED, "a\\u202eb\\u2066c\\u200fd"),
        ("bell\a return\r", "bell\\x07 return\\x0d"),
        ("file\udcff", "file\\udcff"),
        ("a line\n\tanother, \u00fc\u4e2d", "a line\n\tanother, \u00fc\u4e2d"),
    ],
)
def test_what_steers_a_terminal_is_shown_as_an_escape(text: str, shown: str) -> None:
    assert plain(text) == shown


@pytest.mark.parametrize("more", [(), ("--toml",)])
@pytest.mark.parametrize("name", [RED, TURNED, MARKUP])
def test_a_sheet_s_name_is_shown_as_it_is_written(
    name: str, more: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", "gearbox", str(sheet_named(tmp_path, name)), *more]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "\u202e" not in out
    if name == MARKUP:
        assert MARKUP in out
    if more:
        again = tmp_path / "again.toml"
        again.write_text(out, encoding="utf-8")
        assert load_sheet(again).name == name


def test_an_error_that_quotes_a_file_steers_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text('"\\u001b[31mred\\u202e" = 1\n', encoding="utf-8")
    assert main(["show", "gearbox", str(path)]) == 2
    err = capsys.readouterr().err
    assert "\\x1b[31mred\\u202e" in err
    assert "\x1b" not in err


def test_a_strategy_s_name_in_an_error_steers_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--strategy", f"{tmp_path}/{RED}.py:Own"]) == 2
    err = capsys.readouterr().err
    assert "\\x1b[31mred.py: cannot be read" in err
    assert "\x1b" not in err


def test_words_in_a_table_or_a_picture_steer_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """Titles, cells and texts that were put together elsewhere."""
    out = console()
    table = records_table(f"run {MARKUP} {RED}", [])
    table.add_row(MARKUP, RED, TURNED)
    out.print(table)
    out.print(Text(f"{MARKUP} {RED}"))
    out.print(f"{MARKUP} {RED}")
    said = capsys.readouterr().out
    assert "\x1b" not in said
    assert said.count("\\x1b[31mred") == 4
    assert said.count(MARKUP) == 4


def test_what_a_node_says_of_its_peers_steers_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    complain(f"rig: {RED}")
    assert capsys.readouterr().err == "rig: \\x1b[31mred\n"
