"""What is kept of a link outage, step by step, and which records of one are read."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from meshpoint.bus.core import Step
from meshpoint.bus.records import Records
from meshpoint.controller import outage_record
from meshpoint.controller.outage_record import (
    OutageError,
    OutageRecord,
    StepInput,
    load_outages,
    record_name,
)
from meshpoint.dbc.frame import Frame

HASH = 0xAB
PLAIN = Frame(0x123, b"\x01\xff", True, True)


class Echo:
    """A core that says what it was asked."""

    next_step_us = 7

    def __init__(self) -> None:
        self.got: list[Frame] = []

    def receive(self, frame: Frame) -> None:
        self.got.append(frame)

    def step(self, now_us: int) -> Step:
        return Step([PLAIN], [f"step {now_us}"])

    def shutdown(self, now_us: int) -> Step:
        return Step([], [f"end {now_us}"])


class Run:
    """A core with its memory, whose frames can be lost."""

    def __init__(self, folder: Path) -> None:
        self.lost, self.core, self.folder = 0, Echo(), folder
        self.records = Records(folder)
        self.kept = OutageRecord(self.core, self.records, HASH, lambda: self.lost)
        self.lines: list[str] = []
        self.unwritten: list[str] = []
        self._number = 0

    def steps(self, count: int, lost: int = 0) -> None:
        """So many steps; before each of them so many frames were lost."""
        for _ in range(count):
            self.lost += lost
            now_us = 10_000 * self._number
            step = self.kept.step(now_us)
            assert step.events[0] == f"step {now_us}"
            self.lines += step.events[1:]
            self.unwritten += self.records.write()
            self._number += 1

    def end(self) -> Step:
        """The core's end, and what the driver does then."""
        step = self.kept.shutdown(77)
        self.unwritten += self.records.close()
        return step

    @property
    def numbers(self) -> list[int]:
        return list(load_outages(self.folder, HASH))


def test_while_frames_go_on_being_lost_the_record_goes_on(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.steps(5)
    run.steps(150, lost=1)
    run.steps(200)
    assert run.numbers == list(range(154 + 100))


def test_an_outage_late_in_a_run_is_kept_with_two_seconds_before_and_one_after(
    tmp_path: Path,
) -> None:
    run = Run(tmp_path)
    run.steps(250)
    run.steps(30, lost=3)
    run.steps(300)
    assert run.numbers == list(range(50, 279 + 100))
    assert len(run.lines) == 1


def test_after_an_outage_too_long_to_be_kept_the_next_one_is_kept_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outage_record, "MOST_STEPS", 250)
    run = Run(tmp_path)
    run.steps(200)
    run.steps(500, lost=1)
    assert len(run.lines) == 1
    assert run.numbers == list(range(250))
    run.steps(101)
    run.steps(1, lost=1)
    run.steps(200)
    assert len(run.lines) == 2
    assert run.numbers[250:] == list(range(801 - 200, 801 + 50))


def test_a_record_is_named_by_its_first_step_and_said_once(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.steps(30)
    run.steps(40, lost=1)
    run.steps(100)
    name = "outage-00000000000000ab-0.jsonl"
    assert run.lines == [f"outage: what its steps were made of goes to {name}"]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_second_outage_has_a_record_of_its_own(tmp_path: Path) -> None:
    run = Run(tmp_path)
    for _ in range(2):
        run.steps(50)
        run.steps(1, lost=1)
        run.steps(350)
    assert len(run.lines) == len(list(tmp_path.iterdir())) == 2


def test_a_loss_before_the_first_step_leaves_nothing_to_keep(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.steps(1, lost=2)
    run.steps(3)
    assert not run.lines
    assert not list(tmp_path.iterdir())


def test_frames_are_kept_with_the_step_that_consumed_them_and_handed_on(tmp_path: Path) -> None:
    run = Run(tmp_path)
    other = Frame(0x1FFFFFFF, bytes(64), False, False)
    for frame in (PLAIN, other):
        run.kept.receive(frame)
    run.steps(2)
    run.kept.receive(other)
    run.steps(1, lost=1)
    run.end()
    assert run.core.got == [PLAIN, other, other]
    assert run.kept.next_step_us == 7
    found = load_outages(tmp_path, HASH)
    assert found == {
        0: StepInput(0, 0, [PLAIN, other]),
        1: StepInput(1, 10_000, []),
        2: StepInput(2, 20_000, [other]),
    }


def test_the_end_of_a_run_closes_its_record_and_notices_a_last_loss(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.steps(4)
    run.lost = 1
    step = run.end()
    assert [line.split(":")[0] for line in step.events] == ["end 77", "outage"]
    assert run.numbers == [0, 1, 2, 3]


def test_a_step_writes_nothing_itself(tmp_path: Path) -> None:
    """The driver has it written, once the step's frames are on their way."""
    run = Run(tmp_path)
    run.steps(3)
    run.lost += 1
    run.kept.step(30_000)
    assert not list(tmp_path.iterdir())
    run.records.write()
    assert run.numbers == [0, 1, 2, 3]


def test_a_folder_that_cannot_be_written_to_is_named_once_and_all_lines_are_counted(
    tmp_path: Path,
) -> None:
    run = Run(tmp_path / "none")
    run.steps(2)
    run.steps(3, lost=1)
    run.end()
    assert len(run.unwritten) == 1
    assert f"{tmp_path / 'none'}" in run.unwritten[0]
    assert run.records.lost_lines == 5


def test_what_a_record_would_be_written_to_is_a_file_of_its_own(tmp_path: Path) -> None:
    """Neither a pipe, which would be waited for, nor what somebody's link points to."""
    other = tmp_path / "other"
    other.write_text("untouched", encoding="utf-8")
    (tmp_path / record_name(HASH, 0)).symlink_to(other)
    run = Run(tmp_path)
    run.steps(2)
    run.steps(1, lost=1)
    os.mkfifo(tmp_path / record_name(HASH, 5))
    run.records.put(record_name(HASH, 5), "line")
    run.end()
    assert other.read_text(encoding="utf-8") == "untouched"
    assert run.records.lost_lines == 4


def test_two_seconds_before_an_outage_and_two_hours_of_it_are_kept() -> None:
    """A step is 10 ms."""
    assert outage_record.BEFORE_STEPS == 2 * 100
    assert outage_record.MOST_STEPS == 2 * 3600 * 100


def test_a_second_record_may_be_as_long_as_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("BEFORE_STEPS", 10), ("AFTER_STEPS", 50), ("MOST_STEPS", 80)):
        monkeypatch.setattr(outage_record, name, value)
    run = Run(tmp_path)
    for _ in range(2):
        run.steps(60)
        run.steps(1, lost=1)
        run.steps(60)
    lengths = [len(path.read_text("utf-8").splitlines()) for path in tmp_path.iterdir()]
    assert len(lengths) == 2
    assert min(lengths) >= 50


def test_a_run_that_ends_before_its_first_step_has_no_record(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.lost = 1
    assert run.end().events == ["end 77"]
    assert not list(tmp_path.iterdir())


def written(folder: Path, *lines: Any, end: str = "\n") -> None:
    text = "\n".join(each if isinstance(each, str) else json.dumps(each) for each in lines)
    (folder / record_name(HASH, 3)).write_text(text + end, encoding="utf-8")


def test_a_last_line_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    written(tmp_path, [3, 30, []], [4, 40, []], "[5, 5", end="")
    assert list(load_outages(tmp_path, HASH)) == [3, 4]
    assert load_outages(tmp_path, HASH + 1) == {}


@pytest.mark.parametrize(
    "step",
    [
        [0, 0, []],
        [(1 << 32) - 1, (1 << 63) - 1, []],
        [1, 2, [[0, "", 0, 0], [(1 << 29) - 1, "00" * 64, 1, 1]]],
    ],
)
def test_a_step_at_the_ends_of_what_is_allowed_is_read(tmp_path: Path, step: list[Any]) -> None:
    written(tmp_path, step)
    (found,) = load_outages(tmp_path, HASH).values()
    assert (found.number, found.time_us) == (step[0], step[1])
    assert [[f.can_id, f.data.hex(), f.is_fd, f.is_extended] for f in found.frames] == step[2]
    assert all(type(f.is_fd) is bool and type(f.is_extended) is bool for f in found.frames)


@pytest.mark.parametrize(
    ("step", "what"),
    [
        ([-1, 0, []], "step -1"),
        ([1 << 32, 0, []], "step 4294967296"),
        ([True, 0, []], "step True"),
        ([1.0, 0, []], r"step 1\.0"),
        ([1, -1, []], "time -1"),
        ([1, 1 << 63, []], "time 9223372036854775808"),
        ([1, 2.0, []], r"time 2\.0"),
        ([1, 2, [[-1, "", 0, 0]]], "identifier -1"),
        ([1, 2, [[1 << 29, "", 0, 0]]], "identifier 536870912"),
        ([1, 2, [[1.0, "", 0, 0]]], r"identifier 1\.0"),
        ([1, 2, [[1, "00" * 65, 0, 0]]], "65 bytes of data"),
        ([1, 2, [[1, "0", 0, 0]]], "not a step"),
        ([1, 2, 3], "not a step"),
        ([1, 2], "not a step"),
        ("nonsense", "not a step"),
        ("[" * 100_000, "not a step"),
    ],
)
def test_a_line_that_is_no_step_is_refused_by_its_number(
    tmp_path: Path, step: Any, what: str
) -> None:
    written(tmp_path, [0, 0, []], step)
    with pytest.raises(OutageError, match=rf"line 2: not a step: .*{what}|line 2: {what}"):
        load_outages(tmp_path, HASH)


def test_a_record_that_is_no_text_or_too_long_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / record_name(HASH, 3)
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(OutageError, match=path.name):
        load_outages(tmp_path, HASH)
    assert outage_record.RECORD_LIMIT_BYTES == 200_000_000
    written(tmp_path, [3, 30, []])
    monkeypatch.setattr(outage_record, "RECORD_LIMIT_BYTES", 5)
    with pytest.raises(OutageError, match=path.name):
        load_outages(tmp_path, HASH)
