"""`replay --verify` never calls a log with a hole identical, whatever the format can tell."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from loop_bench import Loop

from meshpoint.base.exits import Exit
from meshpoint.bus.logs.reader import FORMATS
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.cli.main import main
from meshpoint.dbc.layout import CODECS

HOLE_BYTES = 16


@pytest.fixture
def recorded(one_shift: Loop, tmp_path: Path) -> Callable[[str], Path]:
    one_shift.header.save(tmp_path)

    def write(ending: str) -> Path:
        path = tmp_path / f"run{ending}"
        with LogWriter(path, flush_every_s=None) as log:
            for number, (time_us, frame) in enumerate(one_shift.frames):
                log.write(time_us / 1e6, frame)
                if number % 1000 == 999:
                    log.flush()
        return path

    return write


@pytest.mark.parametrize("ending", FORMATS)
def test_zeros_anywhere_in_a_log_are_not_called_identical(
    ending: str, recorded: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(ending)
    assert main(["replay", str(path), "--verify"]) == Exit.DONE
    content = path.read_bytes()
    at = int(0.6 * len(content))
    if ending == ".blf":
        at = content.rindex(b"LOBJ", 0, at)
    path.write_bytes(content[:at] + bytes(HOLE_BYTES) + content[at + HOLE_BYTES :])
    assert main(["replay", str(path), "--verify"]) == Exit.NOT_VERIFIABLE
    said = capsys.readouterr().out.split("run 1 of 1: ")[-1]
    assert said.startswith("not verifiable at step ")
    assert path.name in " ".join(said.split())


@pytest.mark.parametrize("ending", [".blf", ".asc"])
def test_a_log_that_was_not_completed_is_not_called_identical(
    ending: str, recorded: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """All that is in it agrees, but its end may be missing."""
    path = recorded(ending)
    content = path.read_bytes()
    if ending == ".blf":
        path.write_bytes(content[:16] + (144).to_bytes(8, "little") + content[24:])
    else:
        path.write_bytes(content[: content.rindex(b"End Trigger")])
    assert main(["replay", str(path), "--verify"]) == Exit.NOT_VERIFIABLE
    assert "every step before it agrees" in " ".join(capsys.readouterr().out.split())


def test_missing_lines_of_a_text_log_are_not_called_identical(
    recorded: Callable[[str], Path],
) -> None:
    """What is left is a well-formed log: only the steps tell. Frames behind the last status belong
    to no step."""
    path = recorded(".log")
    lines = path.read_text().splitlines(keepends=True)
    status = f" {CODECS['ControllerStatus'].spec.can_id:08X}#"
    last = max(i for i, line in enumerate(lines) if status in line)
    draw = random.Random(1)
    for _ in range(6):
        at = draw.randrange(300, last - 30)
        path.write_text("".join(lines[:at] + lines[at + draw.choice((1, 3, 20)) :]))
        assert main(["replay", str(path), "--verify"]) != Exit.DONE
