"""Replays of long logs: memory by shift and not by frame, several at a time, and Ctrl-C."""

from __future__ import annotations

import gc
import json
import os
import shutil
import signal
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from meshpoint.base.exits import Exit
from meshpoint.cli.main import main
from meshpoint.logs import log_progress
from meshpoint.logs.logged_frames import expected_frames
from meshpoint.replays.replay_rows import ReplayRows
from meshpoint.results.output import write_json
from meshpoint.results.progress import Shown

SHORT, LONG = 1, 2
SHIFTS_OF_A_DAY = 24 * 120
"""One shift each half minute."""
LEFT_BYTES = 100e6
"""Of 300 MB, beside 200 MB of program and libraries."""
Logs = dict[int, Path]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Logs:
    made = {}
    for shifts in (SHORT, LONG):
        made[shifts] = tmp_path_factory.mktemp("scale") / "x.log"
        run = ["simulate", "--preset", "thesis", "--strategy", "speed_window"]
        assert main([*run, "--shifts", str(shifts), "--log", str(made[shifts])]) == 0
    return made


def peak_bytes(log: Path, *more: str) -> int:
    gc.collect()
    tracemalloc.start()
    try:
        assert main(["replay", str(log), *more]) == 0
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.long
@pytest.mark.parametrize("more", [("--verify",), ("--strategy", "target_phase")])
def test_memory_grows_with_the_shifts_alone(logs: Logs, more: tuple[str, ...]) -> None:
    """A day with a shift each half minute stays below 300 MB; frames are not kept."""
    assert main(["replay", str(logs[SHORT]), *more]) == 0  # what is loaded once
    small, large = (peak_bytes(logs[shifts], *more) for shifts in (SHORT, LONG))
    a_shift = (large - small) / (LONG - SHORT)
    assert a_shift * SHIFTS_OF_A_DAY < LEFT_BYTES
    assert large - small < 0.2 * logs[LONG].stat().st_size


def test_a_day_s_record_is_written_without_its_whole_text_in_memory(tmp_path: Path) -> None:
    shift = {f"figure_{k}": k / 7 for k in range(20)}
    values, out = {"shifts": [shift] * SHIFTS_OF_A_DAY}, tmp_path / "day.json"
    gc.collect()
    tracemalloc.start()
    try:
        write_json(str(out), values)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert json.loads(out.read_text()) == values
    assert peak < 0.2 * out.stat().st_size


@pytest.mark.long
def test_several_at_a_time_give_what_one_after_the_other_gives(
    logs: Logs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    half = tmp_path / "half.log"
    lines = logs[SHORT].read_bytes().splitlines(keepends=True)
    half.write_bytes(b"".join(lines[: len(lines) // 2]))
    for header in logs[SHORT].parent.glob("header-*.json"):
        shutil.copy(header, tmp_path)
    names = [str(logs[SHORT]), str(half)]
    reported = {}
    for jobs in ("1", "2"):
        out = tmp_path / f"{jobs}.json"
        given = ["replay", *names, "--verify", "--jobs", jobs, "--json", str(out)]
        assert main(given) == 0
        reported[jobs] = out.read_text(), capsys.readouterr().out
    assert reported["1"] == reported["2"]
    values = json.loads(reported["1"][0])
    assert [replay["log"] for replay in values["replays"]] == names
    assert [len(replay["shifts"]) for replay in values["replays"]] == [SHORT, 0]


def test_a_log_that_cannot_be_read_hides_none_of_the_others(logs: Logs, tmp_path: Path) -> None:
    bad, out = tmp_path / "bad.log", tmp_path / "out.json"
    bad.write_text("no log\n")
    given = ["replay", str(bad), str(logs[SHORT]), "--jobs", "1", "--json", str(out)]
    assert main(given) == Exit.BAD_INPUT
    values = json.loads(out.read_text())["replays"]
    assert "line 1" in values[0]["error"]
    assert len(values[1]["shifts"]) == SHORT


def test_ctrl_c_leaves_what_there_is_and_says_so(
    logs: Logs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGINT in the middle of the log: its rows so far, a page that says so, exit code 130."""
    out, page = tmp_path / "out.json", tmp_path / "page.html"
    logged = ReplayRows.logged
    seen = [0]

    def count(self: Any, frame: Any) -> None:
        seen[0] += 1
        if seen[0] == 4_000:
            os.kill(os.getpid(), signal.SIGINT)
        logged(self, frame)

    monkeypatch.setattr(ReplayRows, "logged", count)
    given = ["replay", str(logs[LONG]), "--json", str(out), "--report", str(page)]
    assert main(given) == Exit.INTERRUPTED
    values = json.loads(out.read_text())
    assert values["interrupted"] is True
    assert 0 < len(values["shifts"]) < LONG
    assert "it was interrupted" in values["sessions"][-1]["reason"]
    assert "Interrupted: what came later" in page.read_text(encoding="utf-8")


def test_the_bar_s_length_is_about_the_number_of_frames(logs: Logs, tmp_path: Path) -> None:
    lines = logs[LONG].read_bytes().count(b"\n")
    expected = expected_frames([logs[LONG]])
    assert expected is not None
    assert 0.8 * lines < expected < 1.25 * lines
    assert expected_frames([tmp_path / "x.blf"]) is None


@pytest.mark.parametrize(("bus", "expected"), [(None, 600), (None, 10**6), ("virtual", 600)])
def test_the_bar_counts_each_frame_once_and_never_past_its_total(
    logs: Logs, monkeypatch: pytest.MonkeyPatch, bus: str | None, expected: int
) -> None:
    shown: list[tuple[int, int | None]] = []

    class Seen(Shown):
        def come_to(self, completed: int, total: int | None) -> None:
            super().come_to(completed, total)
            shown.append((completed, total))

    monkeypatch.setattr(log_progress, "Shown", Seen)
    monkeypatch.setattr(log_progress, "expected_frames", lambda _: expected)
    with log_progress.logged_frames([logs[SHORT]], bus, lambda: False) as read:
        frames = sum(1 for _ in read)
    counts = [count for count, _ in shown]
    assert counts == sorted(counts)
    assert counts[-1] == frames > 600
    if bus is None:
        assert [total for _, total in shown] == [max(count, expected) for count in counts]
    else:
        assert {total for _, total in shown} == {None}
