"""Broken logs: all of it is accounted for, and what was before the damage is there."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from loop_bench import Loop

from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.cli.main import main
from meshpoint.dbc.frame import Frame

Frames = list[tuple[float, Frame]]


@pytest.fixture
def replayed(
    one_shift: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[Callable[[Frames], Frames]], dict[str, Any]]:
    """The account of one shift's log after a change, and the exit code."""
    one_shift.header.save(tmp_path)

    def replay(change: Callable[[Frames], Frames]) -> dict[str, Any]:
        path = tmp_path / "a.log"
        frames = change([(t * 1e-6, frame) for t, frame in one_shift.frames])
        lines = [
            f"({t + 1e6:.6f}) can0 {f.can_id:0{8 if f.is_extended else 3}X}"
            f"#{'#1' if f.is_fd else ''}{f.data.hex()}\n"
            for t, f in frames
        ]
        path.write_text("".join(lines))
        code = main(["replay", str(path), "--json", "-"])
        found: dict[str, Any] = json.loads(capsys.readouterr().out)
        return found | {"code": code, "lines": len(lines)}

    return replay


def one_of(frames: Frames, number: int) -> int:
    """Index of a protected frame of a sensor."""
    return [i for i, (_, f) in enumerate(frames) if f.can_id == 0x18FF1480][number]


def test_a_whole_log_is_all_good(replayed: Any) -> None:
    found = replayed(lambda frames: frames)
    account = found["account"]
    assert account["frames"] == account["good"] == found["lines"]
    assert not any(account[key] for key in account if key not in ("frames", "good"))


def test_lost_doubled_and_late_frames_are_counted(replayed: Any) -> None:
    def change(frames: Frames) -> Frames:
        at = one_of(frames, 90)
        twice = one_of(frames, 95)
        late, then = one_of(frames, 120), one_of(frames, 121)
        frames[late], frames[then] = (
            (frames[late][0], frames[then][1]),
            (frames[then][0], frames[late][1]),
        )
        frames.insert(twice + 1, frames[twice])
        del frames[at]
        return frames

    account = replayed(change)["account"]
    assert account["doubled"] == 1
    assert account["out_of_order"] == 1
    # The late one was missed first.
    assert account["lost"] == 2


def test_flipped_bits_foreign_traffic_and_another_dbc_are_told_apart(replayed: Any) -> None:
    def change(frames: Frames) -> Frames:
        at = one_of(frames, 90)
        time_s, frame = frames[at]
        flipped = bytes([*frame.data[:20], frame.data[20] ^ 4, *frame.data[21:]])
        frames[at] = time_s, frame._replace(data=flipped)
        foreign = [(time_s, Frame(0x18FEF100, bytes(8), is_fd=False)) for _ in range(5)]
        standard = [(time_s, Frame(0x123, bytes(2), is_fd=False, is_extended=False))]
        other = [(time_s, frame._replace(data=frame.data[:48]))]
        return [*frames[:at], *foreign, *standard, *other, *frames[at:]]

    found = replayed(change)
    account = found["account"]
    assert account["damaged"] == {"EdgesMainRise": 1}
    assert account["foreign"] == {"123": 1, "18FEF100": 5}
    assert account["other_form"] == {"EdgesMainRise": 1}
    assert account["frames"] == account["good"] + 1 + 6 + 1


def test_a_restarted_sensor_side_a_gap_and_a_clock_set_back_are_reported(replayed: Any) -> None:
    def change(frames: Frames) -> Frames:
        half = len(frames) // 2
        later = [(t + 30.0, f) for t, f in frames[half:]]
        again = [(t, f) for t, f in frames[:half]]
        return [*frames[:half], *later, *again]

    account = replayed(change)["account"]
    ((_, for_s),) = account["silent_s"]
    assert for_s == pytest.approx(30.0, abs=0.1)
    ((_, back_s),) = account["clock_set_back_s"]
    assert back_s > 30.0
    assert account["counters_restarted"] > 0


@pytest.mark.parametrize("share", [0.6, 0.95])
def test_a_torn_log_gives_all_before_the_tear_with_its_report(
    one_shift: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str], share: float
) -> None:
    """Exit 2, the page written, and the account of what was read."""
    one_shift.header.save(tmp_path)
    path = tmp_path / "a.log"
    with LogWriter(path, flush_every_s=None) as log:
        for time_us, frame in one_shift.frames:
            log.write(time_us / 1e6, frame)
    content = path.read_bytes()
    line = content.index(b"\n", int(share * len(content))) + 1
    path.write_bytes(content[: line + 20])  # within a line
    page = tmp_path / "page.html"
    assert main(["replay", str(path), "--report", str(page), "--json", "-"]) == 2
    found = json.loads(capsys.readouterr().out)
    assert "the log ends inside this line" in found["sessions"][0]["reason"]
    assert found["account"]["frames"] == pytest.approx(share * len(one_shift.frames), rel=0.1)
    assert [row["to"] for row in found["shifts"]] == [10]
    assert page.stat().st_size > 10_000
