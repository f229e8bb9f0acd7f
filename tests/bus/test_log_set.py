"""Logs of several files: parts by size, names by date, read in order as one bus."""

from __future__ import annotations

import random
import re
import subprocess
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import can
import pytest
from cut_logs import read_until_cut
from patience import until

from meshpoint.bus.logs.files import (
    MIN_PART_BYTES,
    RotatingLog,
    dated_log,
    log_files,
    open_log,
    part_path,
    parts_of,
    read_logs,
)
from meshpoint.bus.logs.reader import FORMATS, LogError, read_log
from meshpoint.bus.logs.recorder import FLUSH_EVERY_S, LogWriter
from meshpoint.dbc.frame import Frame

pytestmark = pytest.mark.check
NODE = str(Path(__file__).with_name("logging_node.py"))
EPOCH_S = 1_700_000_000.0
FIELD_NAME = re.compile(r"candump-\d{4}-\d\d-\d\d_\d{6}\.log")
"""As `candump -l` names its logs."""
FRAMES = 3000

formats = pytest.mark.parametrize("ending", FORMATS)


def frame(number: int) -> Frame:
    """Numbered; the rest cannot be compressed."""
    return Frame(0x18FF0001, number.to_bytes(4, "big") + random.Random(number).randbytes(60))


def numbers(files: list[Path]) -> list[int]:
    return [int.from_bytes(one.data[:4], "big") for _, one in read_logs(files)]


def write_parts(path: Path, max_bytes: int, count: int = FRAMES) -> list[Path]:
    with RotatingLog(path, max_bytes, channel="vcan0", flush_every_s=None) as log:
        for number in range(count):
            log.write(EPOCH_S + number / 2000, frame(number))
    assert log.frames == count
    return log.paths


@formats
@pytest.mark.parametrize("max_bytes", [MIN_PART_BYTES, 140_000])
def test_no_part_is_larger_than_asked_and_none_much_smaller(
    ending: str, max_bytes: int, tmp_path: Path
) -> None:
    parts = write_parts(tmp_path / f"run{ending}", max_bytes)
    sizes = [part.stat().st_size for part in parts]
    assert len(parts) >= 2
    assert max(sizes) <= max_bytes
    assert min(sizes[:-1]) > 0.95 * max_bytes
    assert [part.name for part in parts[:2]] == [f"run_001{ending}", f"run_002{ending}"]


@formats
def test_parts_read_in_order_are_the_frames_of_one_log(ending: str, tmp_path: Path) -> None:
    parts = write_parts(tmp_path / f"run{ending}", MIN_PART_BYTES)
    assert numbers(parts) == list(range(FRAMES))
    assert log_files([tmp_path]) == parts_of(tmp_path / f"run{ending}") == parts


@formats
def test_every_part_is_a_log_for_other_tools(ending: str, tmp_path: Path) -> None:
    for part in write_parts(tmp_path / f"run{ending}", MIN_PART_BYTES):
        with can.LogReader(part) as reader:
            theirs = [bytes(message.data) for message in reader]
        assert theirs == [one.data for _, one in read_log(part)]


def test_part_1000_comes_behind_part_999(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    wanted = [part_path(path, number) for number in (1, 2, 10, 999, 1000)]
    for part in reversed(wanted):
        part.write_text("(1.0) can0 123#11\n")
    (tmp_path / "header-0123.json").write_text("{}")
    (tmp_path / "run_1.txt").write_text("")
    assert [part.name for part in wanted[-2:]] == ["run_999.log", "run_1000.log"]
    assert log_files([tmp_path]) == wanted


def test_parts_of_an_earlier_log_are_not_replaced(tmp_path: Path) -> None:
    """The ones beyond the new end would be read as its own."""
    first = write_parts(tmp_path / "run.log", MIN_PART_BYTES, 1000)
    before = [part.read_bytes() for part in first]
    with pytest.raises(LogError, match=r"run_001\.log: is there already"):
        RotatingLog(tmp_path / "run.log", MIN_PART_BYTES, channel="vcan0")
    assert [part.read_bytes() for part in first] == before


def test_in_a_folder_a_log_is_named_as_candump_names_it(tmp_path: Path) -> None:
    before = datetime.now().astimezone().replace(microsecond=0)
    with open_log(f"{tmp_path}/", channel="vcan0") as log:
        log.write(EPOCH_S, frame(0))
    (path,) = tmp_path.iterdir()
    assert path == log.path
    assert FIELD_NAME.fullmatch(path.name)
    named = datetime.strptime(path.name, "candump-%Y-%m-%d_%H%M%S.log").astimezone()
    assert before <= named <= datetime.now().astimezone()


@pytest.mark.parametrize("in_parts", [False, True])
def test_processes_that_start_in_one_second_get_names_of_their_own(
    in_parts: bool, tmp_path: Path
) -> None:
    now, names = datetime(2025, 11, 21, 3, 12, 45, tzinfo=UTC), []
    threads = [
        threading.Thread(target=lambda: names.append(dated_log(tmp_path, now, in_parts)))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(names)) == 8
    assert min(names).name == "candump-2025-11-21_031245.log"


def test_a_defect_in_a_part_ends_the_set(tmp_path: Path) -> None:
    """What follows a hole would not fit to what came before."""
    parts = write_parts(tmp_path / "run.log", MIN_PART_BYTES, 2000)
    parts[1].write_bytes(parts[1].read_bytes()[:-5])
    read: list[int] = []
    with pytest.raises(LogError, match="ends inside this line") as caught:
        for _, one in read_logs(parts):
            read.append(int.from_bytes(one.data[:4], "big"))
    assert caught.value.file == parts[1]
    assert read == list(range(len(read)))


@formats
def test_only_the_last_of_several_may_hold_nothing(ending: str, tmp_path: Path) -> None:
    """As a process leaves it that is killed just after it has begun a part."""
    parts = write_parts(tmp_path / f"run{ending}", MIN_PART_BYTES, 1500)
    began = LogWriter(part_path(tmp_path / f"run{ending}", len(parts) + 1))
    more = log_files([tmp_path])
    assert more == [*parts, began.path]
    assert numbers(more) == list(range(1500))
    with pytest.raises(LogError, match=r"is empty|holds no frames"):
        numbers([began.path])
    with pytest.raises(LogError, match=r"is empty|holds no frames"):
        numbers([began.path, *parts])
    began.close()


def test_a_folder_without_logs_says_so(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("none")
    with pytest.raises(LogError, match=r"folder without a log.*\.blf"):
        log_files([tmp_path])


@pytest.mark.parametrize("ending", [".log", ".blf"])
def test_flushed_by_frame_time_a_log_depends_on_its_frames_alone(
    ending: str, tmp_path: Path
) -> None:
    """And holds all but the last second of them at any time."""
    contents = []
    for name in ("one", "two"):
        path = tmp_path / f"{name}{ending}"
        log = LogWriter(path, by_frame_time=True)
        for number in range(5000):
            log.write(number / 500, frame(number))
        assert len(list(read_log(path))) > 5000 - 2 * 500
        log.close()
        contents.append(path.read_bytes())
        time.sleep(0.01)
    assert contents[0] == contents[1]


def numbers_until_cut(files: list[Path]) -> list[int]:
    """The frames' numbers; the last part need not be complete."""
    last = read_until_cut(read_logs(files[-1:]))
    whole = numbers(files[:-1]) if len(files) > 1 else []
    return whole + [int.from_bytes(one.data[:4], "big") for _, one in last]


@formats
@pytest.mark.parametrize("max_bytes", [None, MIN_PART_BYTES])
def test_a_log_holds_all_but_its_last_second_at_any_time(
    ending: str, max_bytes: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a process that is killed leaves. The clock is the test's own."""
    now_s = 1000.0
    monkeypatch.setattr("meshpoint.bus.logs.recorder.time.monotonic", lambda: now_s)
    path = tmp_path / f"run{ending}"
    log = LogWriter(path) if max_bytes is None else RotatingLog(path, max_bytes, channel="vcan0")
    for number in range(2000):
        log.write(EPOCH_S + now_s, frame(number))
        if number % 130 == 129 and number > 200:
            found = numbers_until_cut(log_files([tmp_path]))
            assert found == list(range(len(found)))
            assert number - len(found) < round(FLUSH_EVERY_S / 0.005)
        now_s += 0.005
    log.close()


@pytest.mark.long
def test_killed_they_leave_parts_that_can_be_read_to_their_end(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    folders = {ending: tmp_path / ending[1:] for ending in FORMATS}
    for folder in folders.values():
        folder.mkdir()
    paths = [str(folder / f"killed{ending}") for ending, folder in folders.items()]
    process = start(NODE, str(MIN_PART_BYTES), *paths)
    until(lambda: all(len(list(f.iterdir())) >= 3 for f in folders.values()), "three parts each")
    process.kill()
    process.wait()
    for folder in folders.values():
        files = log_files([folder])
        found = numbers_until_cut(files)
        assert found == list(range(len(found)))
        assert len(files) >= 3
