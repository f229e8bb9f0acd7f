"""What is kept of a link outage, step by step, and which records of one are read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from meshpoint.bus.core import Step
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
        self.kept = OutageRecord(self.core, folder, HASH, lambda: self.lost)
        self.lines: list[str] = []

    def steps(self, count: int, lost: int = 0) -> None:
        """So many steps; before each of them so many frames were lost."""
        for _ in range(count):
            self.lost += lost
            number = self.kept._number
            step = self.kept.step(10_000 * number)
            assert step.events[0] == f"step {10_000 * number}"
            self.lines += step.events[1:]

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
    assert run.lines == [f"outage: what its steps were made of is kept in {name}"]
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
    run.kept.shutdown(5)
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
    step = run.kept.shutdown(77)
    assert [line.split(":")[0] for line in step.events] == ["end 77", "outage"]
    assert run.numbers == [0, 1, 2, 3]
    assert run.kept._file is None


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    run = Run(tmp_path / "none")
    run.steps(2)
    run.steps(1, lost=1)
    assert [line.split(":")[0] for line in run.lines] == ["outage not recorded"]
    assert run.kept._file is None


def test_a_disk_that_is_full_ends_the_record(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.steps(3)
    run.steps(1, lost=1)

    class Full:
        def write(self, _text: str) -> None:
            raise OSError(28, "no space")

        def close(self) -> None:
            closed.append(True)

    closed: list[bool] = []
    own, run.kept._file = run.kept._file, Full()  # type: ignore[assignment]
    assert own is not None
    own.close()
    run.steps(5)
    assert closed == [True]
    assert run.kept._file is None


def test_two_seconds_before_an_outage_and_two_hours_of_it_are_kept(tmp_path: Path) -> None:
    """A step is 10 ms. What is longer is not kept to its end, nor is another one behind it."""
    run = Run(tmp_path)
    run.steps(1)
    assert run.kept._newest.maxlen == 2 * 100
    run.steps(1, lost=1)
    assert run.kept._newest.maxlen == 2 * 100
    run.kept._written = 2 * 3600 * 100 - 2
    run.steps(1, lost=1)
    assert run.kept._file is not None
    run.steps(1, lost=1)
    assert run.kept._file is None
    run.steps(2, lost=1)
    assert run.numbers == [0, 1, 2, 3]


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
    assert run.kept.shutdown(5).events == ["end 5"]
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
