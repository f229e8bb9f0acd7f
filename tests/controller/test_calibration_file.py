"""A calibration's file: when it is written, what is said of it, and what is put aside."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from calibration_example import SHEET, TEXT, example

from meshpoint.bus.core import Step
from meshpoint.controller.run import kept
from meshpoint.controller.run.kept import CalibrationWriter, load, save
from meshpoint.controller.run.node import CalibrationKeeper
from meshpoint.controller.settings.learned import Calibration


class Learner:
    """A core whose knowledge is set from outside."""

    next_step_us = 5

    def __init__(self) -> None:
        self.calibration_revision, self.got = (0, 0), list[Any]()

    def receive(self, frame: Any) -> None:
        self.got.append(frame)

    def step(self, now_us: int) -> Step:
        return Step([], [f"step {now_us}"])

    def shutdown(self, now_us: int) -> Step:
        return Step(["frame"], [f"end {now_us}"])  # type: ignore[list-item]

    def calibration(self, written: str) -> Any:
        return self.calibration_revision, written


def kept_by(answers: list[str | None]) -> tuple[Learner, CalibrationKeeper, list[Any]]:
    core, kept = Learner(), list[Any]()

    def keep(calibration: Any) -> str | None:
        kept.append(calibration)
        return answers.pop(0) if answers else None

    any_core: Any = core
    return core, CalibrationKeeper(any_core, keep, lambda now_us: f"at {now_us}"), kept


def test_a_calibration_is_kept_after_each_step_that_knows_more() -> None:
    core, keeper, kept = kept_by([None, "disk full"])
    assert keeper.step(1).events == ["step 1"]
    core.calibration_revision = (1, 0)
    assert keeper.step(2).events == ["step 2"]
    assert keeper.step(3).events == ["step 3"]
    core.calibration_revision = (1, 4)
    assert keeper.step(4).events == ["step 4", "disk full"]
    assert kept == [((1, 0), "at 2"), ((1, 4), "at 4")]


def test_at_the_end_a_calibration_is_kept_whatever_is_known() -> None:
    _, keeper, kept = kept_by(["disk full"])
    last = keeper.shutdown(9)
    assert (last.frames, last.events) == (["frame"], ["end 9", "disk full"])
    assert kept == [((0, 0), "at 9")]
    assert keeper.next_step_us == 5


def refused() -> Calibration:
    """One of another sheet, which the next start would refuse."""
    return replace(example(), provenance=replace(example().provenance, sheet_sha256="0" * 64))


def test_what_went_wrong_in_the_thread_is_said_at_the_end_at_the_latest(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    writer = CalibrationWriter(path, SHEET, threaded=True)
    line = writer(refused()) or writer.close()
    assert line is not None
    assert line.startswith("calibration not written: ")
    with pytest.raises(RuntimeError):
        writer(example())
    assert not path.exists()


def test_what_went_wrong_is_said_again_after_it_went_well(tmp_path: Path) -> None:
    writer = CalibrationWriter(tmp_path / "a.toml", SHEET, threaded=False)
    lines = [writer(each) for each in (refused(), refused(), example(), refused())]
    assert [line is not None for line in lines] == [True, False, False, True]
    assert writer.close() is None
    assert CalibrationWriter(tmp_path / "b.toml", SHEET, threaded=True).close() is None


@pytest.mark.parametrize(("shifts", "noun"), [(0, "shifts"), (1, "shift"), (2, "shifts")])
def test_a_start_says_over_how_many_shifts_was_learned(
    tmp_path: Path, shifts: int, noun: str
) -> None:
    path = tmp_path / "a.toml"
    save(path, replace(example(), provenance=replace(example().provenance, shifts=shifts)))
    found = load(path, SHEET)
    assert found.line == f"calibration {path}: learned over {shifts} {noun}"
    assert found.writable
    assert found.calibration is not None
    assert found.calibration.provenance.shifts == shifts


def test_why_a_file_cannot_be_put_aside_is_said_in_the_system_s_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "rename", denied)
    path = tmp_path / "a.toml"
    path.write_text("nonsense", encoding="utf-8")
    found = load(path, SHEET)
    assert not found.writable
    assert "cannot be put aside (Permission denied), so nothing will be written" in found.line


def test_a_file_is_on_the_disk_before_it_takes_its_place_and_then_its_place_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loss of power at any time leaves the old one or the new one."""
    path, seen, own = tmp_path / "a.toml", list[Any](), os.fsync
    path.write_text("old", encoding="utf-8")

    def noted(handle: int) -> None:
        new = tmp_path / ".a.toml.new"
        whole = new.read_text("utf-8") if new.exists() else None
        seen.append((whole == TEXT, path.read_text("utf-8") == "old"))
        own(handle)

    monkeypatch.setattr(kept, "os", SimpleNamespace(**(vars(os) | {"fsync": noted})))
    save(path, example())
    assert seen == [(True, True), (False, False)]
    assert path.read_text("utf-8") == TEXT


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_what_is_no_file_is_neither_moved_nor_written(tmp_path: Path) -> None:
    """A device that is named by mistake stays where it is."""
    path = tmp_path / "a.toml"
    os.mkfifo(path)
    loaded = load(path, SHEET)
    assert not loaded.writable
    assert "is a pipe" in loaded.line
    assert path.is_fifo()
