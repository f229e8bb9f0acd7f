"""How far a long command is, is said where there is no terminal too."""

from __future__ import annotations

import pytest

from meshpoint.results.progress import Shown


def test_without_a_terminal_a_line_says_how_far_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    with Shown("campaign", "runs", 4, completed=1, every_s=0.0) as shown:
        shown.advance()
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("campaign: 2 of 4 runs")


def test_work_of_unknown_length_is_counted(capsys: pytest.CaptureFixture[str]) -> None:
    with Shown("reading", "frames", None, every_s=0.0) as shown:
        shown.come_to(12_000, None)
        shown.begin("fitting: brake")
    assert capsys.readouterr().err.splitlines() == [
        "reading: 12,000 frames",
        "fitting: brake: 12,001 frames",
    ]


def test_what_is_soon_over_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Shown("campaign", "runs", 2) as shown:
        shown.advance(2)
    assert capsys.readouterr() == ("", "")


def test_on_a_terminal_a_bar_is_drawn_and_goes_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    with Shown("campaign", "runs", 4, every_s=0.0) as shown:
        shown.advance()
    err = capsys.readouterr().err
    assert "1 of 4 runs" in err
    assert err.endswith("\x1b[2K")
