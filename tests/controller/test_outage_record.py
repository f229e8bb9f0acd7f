"""What is kept of a link outage: two seconds before it, all of it and one after, step by step."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from meshpoint.bus import outage_record
from meshpoint.bus.core import Step
from meshpoint.bus.outage_record import (
    OutageError,
    OutageRecord,
    StepInput,
    load_outages,
    record_name,
)
from meshpoint.bus.records import Records
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

    def steps(self, count: int, lost: int = 0) -> Run:
        """This many steps; before each of them this many frames were lost."""
        for _ in range(count):
            self.lost += lost
            self.lines += self.kept.step(10_000 * self._number).events[1:]
            self.unwritten += self.records.write()
            self._number += 1
        return self

    def end(self) -> Step:
        """The core's end, and what the driver does then."""
        step = self.kept.shutdown(77)
        self.unwritten += self.records.close()
        return step

    @property
    def numbers(self) -> list[int]:
        return list(load_outages(self.folder, HASH))


@pytest.mark.parametrize(("before", "lost", "first"), [(5, 150, 0), (250, 30, 50), (1, 1, 0)])
def test_an_outage_is_kept_with_two_seconds_before_and_one_after(
    before: int, lost: int, first: int, tmp_path: Path
) -> None:
    """A step is 10 ms. The record is named by its first step and said once."""
    run = Run(tmp_path).steps(before).steps(lost, lost=1).steps(300)
    assert run.numbers == list(range(first, before + lost - 1 + 100))
    name = f"outage-00000000000000ab-{first}.jsonl"
    assert run.lines == [f"outage: what its steps were made of goes to {name}"]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_second_outage_has_a_record_of_its_own_also_after_one_too_long_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert outage_record.MOST_STEPS == 2 * 3600 * 100, "two hours"
    monkeypatch.setattr(outage_record, "MOST_STEPS", 250)
    run = Run(tmp_path).steps(200).steps(500, lost=1)
    assert run.numbers == list(range(250))
    run.steps(101).steps(1, lost=1).steps(200)
    assert len(run.lines) == len(list(tmp_path.iterdir())) == 2
    assert run.numbers[250:] == list(range(801 - 200, 801 + 50))


def test_frames_are_kept_with_the_step_that_consumed_them_and_handed_on(tmp_path: Path) -> None:
    """A step writes nothing itself: the driver has it written, once the frames are on their way."""
    run, other = Run(tmp_path), Frame(0x1FFFFFFF, bytes(64), False, False)
    for frame in (PLAIN, other):
        run.kept.receive(frame)
    run.steps(2)
    run.kept.receive(other)
    run.lost = 1
    run.kept.step(20_000)
    assert not list(tmp_path.iterdir())
    run.end()
    assert (run.core.got, run.kept.next_step_us) == ([PLAIN, other, other], 7)
    assert load_outages(tmp_path, HASH) == {
        0: StepInput(0, 0, [PLAIN, other]),
        1: StepInput(1, 10_000, []),
        2: StepInput(2, 20_000, [other]),
    }


@pytest.mark.parametrize(("steps", "kept"), [(4, [0, 1, 2, 3]), (0, [])])
def test_the_end_of_a_run_closes_its_record_and_notices_a_last_loss(
    steps: int, kept: list[int], tmp_path: Path
) -> None:
    run = Run(tmp_path).steps(steps)
    run.lost = 1
    said = [line.split(":")[0] for line in run.end().events]
    assert said == ["end 77", *["outage"] * bool(kept)]
    assert run.numbers == kept


def test_a_folder_that_cannot_be_written_to_is_named_once_and_all_lines_are_counted(
    tmp_path: Path,
) -> None:
    run = Run(tmp_path / "none").steps(2).steps(3, lost=1)
    run.end()
    assert len(run.unwritten) == 1
    assert f"{tmp_path / 'none'}" in run.unwritten[0]
    assert run.records.lost_lines == 5


def test_what_a_record_would_be_written_to_is_a_file_of_its_own(tmp_path: Path) -> None:
    """Neither a pipe, which would be waited for, nor what somebody's link points to."""
    other = tmp_path / "other"
    other.write_text("untouched", encoding="utf-8")
    (tmp_path / record_name(HASH, 0)).symlink_to(other)
    os.mkfifo(tmp_path / record_name(HASH, 5))
    run = Run(tmp_path).steps(2).steps(1, lost=1)
    run.records.put(record_name(HASH, 5), "line")
    run.end()
    assert other.read_text(encoding="utf-8") == "untouched"
    assert run.records.lost_lines == 4


STEP = '[1, 2, [[0, "", 0, 0], [536870911, "' + "00" * 64 + '", 1, 1]]]'


@pytest.mark.parametrize("line", ["[0, 0, []]", "[4294967295, 9223372036854775807, []]", STEP])
def test_a_step_at_the_ends_of_what_is_allowed_is_read_and_a_line_cut_off_is_left_out(
    line: str, tmp_path: Path
) -> None:
    (tmp_path / record_name(HASH, 3)).write_text(line + "\n[5, 5", encoding="utf-8")
    assert len(load_outages(tmp_path, HASH)) == 1


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("[4294967296, 0, []]", "step 4294967296"),
        ("[1.0, 0, []]", r"step 1\.0"),
        ("[1, -1, []]", "time -1"),
        ("[1, 9223372036854775808, []]", "time 9223372036854775808"),
        ('[1, 2, [[-1, "", 0, 0]]]', "identifier -1"),
        ('[1, 2, [[1.0, "", 0, 0]]]', r"identifier 1\.0"),
        ('[1, 2, [[1, "' + "00" * 65 + '", 0, 0]]]', "65 bytes of data"),
        ("[1, 2, 3]", "not iterable"),
        ("[1, 2]", ""),
        ('[1, "2", []]', ""),
        ("nonsense", ""),
        ('[1, 2, [[1, "zz", true, true]]]', ""),
        ('[1, 2, [[536870912, "", true, true]]]', "identifier 536870912"),
        ("[true, 2, []]", ""),
        ("[" * 5_000, ""),
    ],
)
def test_a_line_that_is_no_step_is_refused_by_its_number(
    line: str, what: str, tmp_path: Path
) -> None:
    path = tmp_path / record_name(HASH, 3)
    path.write_text("[0, 0, []]\n" + line + "\n", encoding="utf-8")
    with pytest.raises(OutageError, match=f"line 2: not a step: .*{what}"):
        load_outages(tmp_path, HASH)


def test_a_record_that_is_no_text_or_too_long_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / record_name(HASH, 3)
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(OutageError, match=path.name):
        load_outages(tmp_path, HASH)
    assert outage_record.RECORD_LIMIT_BYTES == 200_000_000
    path.write_text("[3, 30, []]\n", encoding="utf-8")
    monkeypatch.setattr(outage_record, "RECORD_LIMIT_BYTES", 5)
    with pytest.raises(OutageError, match=path.name):
        load_outages(tmp_path, HASH)
