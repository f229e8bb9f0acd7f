"""Ctrl-C in a long run: what is finished is kept, and said to be a part."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from live_command import live

from meshpoint.bus.logs.reader import read_log
from meshpoint.cli.interrupt import interruptible
from meshpoint.cli.main import run_parsed
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ShiftOutcome

OUTCOME = f"{CODECS[ShiftOutcome.__name__].spec.can_id:08X}##"
pytestmark = pytest.mark.timeout(900)


@pytest.mark.long
def test_simulate_keeps_the_finished_shifts(tmp_path: Path) -> None:
    log, out = tmp_path / "run.log", tmp_path / "run.json"
    simulate = ["simulate", "--preset", "thesis", "--shifts", "100000"]
    with live(tmp_path, *simulate, "--log", str(log), "--json", str(out)) as command:
        command.until(lambda: log.exists() and log.read_text().count(OUTCOME) >= 2)
        assert not out.exists()
        command.signal(signal.SIGINT)
        assert command.end() == 130, command.said
    result = json.loads(out.read_text())
    assert result["interrupted"] is True
    assert len(result["shifts"]) == result["summary"]["shifts"] >= 2
    kept = f"interrupted: {len(result['shifts'])} of 100000 shifts are in the results"
    assert kept in command.said
    assert sum(1 for _ in read_log(log)) > 1000


@pytest.mark.long
def test_campaign_keeps_the_finished_runs(tmp_path: Path) -> None:
    out, folder = tmp_path / "run.json", tmp_path / "out"
    campaign = ["campaign", "--preset", "thesis", "--runs", "1000", "--learn", "1", "--judged", "1"]
    with live(
        tmp_path, *campaign, "--jobs", "1", "--out", str(folder), "--json", str(out)
    ) as command:
        command.until(lambda: any((folder / "parts").glob("*")))
        command.signal(signal.SIGINT)
        assert command.end() == 130, command.said
    result = json.loads(out.read_text())
    assert result["interrupted"] is True
    assert 1 <= result["runs"] < 1000
    assert f"interrupted: {result['runs']} of 1000 runs done" in command.said


@pytest.mark.check
def test_ctrl_c_ends_a_demo_and_its_nodes(tmp_path: Path) -> None:
    """While the nodes start, when their log has begun. Before that compiled code is loaded, and
    numba's callback into Python may swallow a Ctrl-C; a second one then ends it."""
    with live(tmp_path, "demo", "--out", "out") as command:
        command.until((tmp_path / "out" / "target_phase.log").exists)
        command.press_ctrl_c()
        assert command.end() == 130, command.said
    assert "Traceback" not in command.said
    assert command.said.split()[-1] == "interrupted"


def test_ctrl_c_while_a_command_is_loaded_ends_it_with_a_word(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def parse() -> argparse.Namespace:
        raise KeyboardInterrupt

    assert run_parsed(parse) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.fixture
def usual_interrupt() -> Iterator[None]:
    """Ctrl-C as in a terminal: a shell starts what runs in the background with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_sigterm_is_noted_as_ctrl_c_is_and_a_second_one_acts_as_usual() -> None:
    seen = []
    before = signal.signal(signal.SIGTERM, lambda *_: seen.append("usual"))
    try:
        with interruptible() as interrupted:
            signal.raise_signal(signal.SIGTERM)
            assert interrupted() and not seen
            signal.raise_signal(signal.SIGTERM)
            assert seen == ["usual"]
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.usefixtures("usual_interrupt")
def test_the_first_interrupt_is_noted_and_the_second_acts_as_usual() -> None:
    with interruptible() as interrupted:
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_in_another_thread_nothing_is_caught() -> None:
    seen = []

    def run() -> None:
        with interruptible() as interrupted:
            seen.append(interrupted())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [False]
