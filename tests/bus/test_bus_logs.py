"""Recorded buses: what was written can be read, and what cannot is reported in one kind of
error."""

import asyncio
import struct
import subprocess
import tempfile
import time
import tracemalloc
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import can
import pytest
from cut_logs import read_until_cut
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from patience import until, until_async

from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.local.wire import CLASSIC_LENGTHS, FD_LENGTHS
from meshpoint.bus.logs.reader import FORMATS, LogError, LogReader, read_log
from meshpoint.bus.logs.recorder import LogWriter, record_bus
from meshpoint.dbc.frame import Frame

NODE = str(Path(__file__).with_name("logging_node.py"))
EPOCH_S = 1_700_000_000.0

formats = pytest.mark.parametrize("ending", FORMATS)
examples = settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    is_fd, is_extended = draw(st.booleans()), draw(st.booleans())
    length = draw(st.sampled_from(sorted(FD_LENGTHS if is_fd else CLASSIC_LENGTHS)))
    return Frame(
        draw(st.integers(0, (1 << (29 if is_extended else 11)) - 1)),
        draw(st.binary(min_size=length, max_size=length)),
        is_fd,
        is_extended,
    )


timed_frames = st.lists(st.tuples(st.integers(0, 10**6), frames()), min_size=1, max_size=30)


def write(path: Path, content: list[tuple[float, Frame]]) -> None:
    with LogWriter(path) as log:
        for time_s, frame in content:
            log.write(time_s, frame)


def absolute(steps: list[tuple[int, Frame]], start_s: float) -> list[tuple[float, Frame]]:
    now_us = 0
    content = []
    for step_us, frame in steps:
        now_us += step_us
        content.append((start_s + now_us / 1e6, frame))
    return content


@cache
def log_content(ending: str, count: int) -> bytes:
    """Made once: an ASC log holds the time when it was made."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / f"some{ending}"
        with LogWriter(path, flush_every_s=None) as log:
            for number in range(count):
                data = number.to_bytes(4, "big") * (2 + 14 * (number % 2))
                log.write(EPOCH_S + number * 1e-3, Frame(0x18FF0001, data))
        return path.read_bytes()


def some_log(ending: str, directory: Path, count: int = 3000) -> Path:
    path = directory / f"some{ending}"
    path.write_bytes(log_content(ending, count))
    return path


@formats
@given(timed_frames)
@examples
def test_frames_and_times_are_read_as_they_were_written(
    ending: str, tmp_path: Path, steps: list[tuple[int, Frame]]
) -> None:
    path = tmp_path / f"log{ending}"
    content = absolute(steps, EPOCH_S)
    write(path, content)
    reader = read_log(path)
    result = list(reader)
    assert [frame for _, frame in result] == [frame for _, frame in content]
    assert reader.frames == len(content)
    origin_s = content[0][0] if ending == ".asc" else 0.0
    for (written_s, _), (read_s, _) in zip(content, result, strict=True):
        assert read_s == pytest.approx(written_s - origin_s, abs=1.5e-6)


@formats
def test_python_can_reads_the_same_from_our_log(ending: str, tmp_path: Path) -> None:
    path = some_log(ending, tmp_path)
    with can.LogReader(path) as reader:
        theirs = [
            (message.timestamp, message.arbitration_id, bytes(message.data), message.is_fd)
            for message in reader
        ]
    ours = [(time_s, frame.can_id, frame.data, frame.is_fd) for time_s, frame in read_log(path)]
    assert ours == theirs


@formats
def test_error_and_remote_frames_are_left_out_and_counted(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"log{ending}"
    with LogWriter(path, flush_every_s=None) as log:
        for _ in range(3):
            log.write(EPOCH_S, Frame(1, b"data"))
            log.write_message(can.Message(timestamp=EPOCH_S, is_error_frame=True))
            log.write_message(can.Message(timestamp=EPOCH_S, is_remote_frame=True, dlc=0))
            log.write_message(can.Message(timestamp=EPOCH_S, arbitration_id=2, is_fd=True))
    reader = read_log(path)
    assert [frame.can_id for _, frame in reader] == [1, 2] * 3
    assert (reader.frames, reader.error_frames, reader.remote_frames) == (6, 3, 3)


def test_candump_error_frames_of_every_class_are_no_data_frames(tmp_path: Path) -> None:
    path = tmp_path / "candump.log"
    path.write_text(
        "(1436509052.249713) vcan0 20000004#0000000000000000\n"
        "(1436509052.449847) can1 044#2A366C2BBA\n"
        "(1436509052.650004) can1 044#R4 R\n"
        "(1436509052.850131) can1 18FEF100##3AABBCCDD T\n"
    )
    reader = read_log(path)
    assert list(reader) == [
        (1436509052.449847, Frame(0x44, bytes.fromhex("2A366C2BBA"), False, False)),
        (1436509052.850131, Frame(0x18FEF100, bytes.fromhex("AABBCCDD"))),
    ]
    assert (reader.error_frames, reader.remote_frames) == (1, 1)


BLF_HEADER = struct.pack("<4sLBBBBBBBBQQLL8H8H", b"LOGG", 144, *(0,) * 28).ljust(144, b"\0")


def blf_container(method: int, content: bytes, reported: int) -> bytes:
    size = 32 + len(content)
    head = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, size, 10, method, reported)
    return head + content + bytes(size % 4)


def test_the_frame_objects_of_vector_tools_are_read_as_python_can_reads_them(
    tmp_path: Path,
) -> None:
    data = bytes(range(1, 31))  # the logger has left out two zeros at the end
    fd64 = struct.pack("<BBBBLLLLLLLHBBL", 1, 13, 32, 0, 0x98FF0001, 0, 0x3000, *(0,) * 8)
    size = 32 + len(fd64) + len(data)
    frame = struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, size, 101, 1, 0, 0, 250_000)
    frame += fd64 + data + bytes(size % 4)
    marker = struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, 36, 96, 2, 0, 0, 0) + b"text"
    content = marker + frame * 3
    cut = len(content) // 2  # in the middle of an object
    path = tmp_path / "vector.blf"
    path.write_bytes(
        BLF_HEADER
        + blf_container(0, content[:cut], cut)
        + blf_container(2, zlib.compress(content[cut:]), len(content) - cut)
    )
    with can.LogReader(path) as reader:
        theirs = [(message.timestamp, bytes(message.data)) for message in reader]
    ours = list(read_log(path))
    assert [(time_s, frame.data) for time_s, frame in ours] == theirs
    assert ours == [(2.5, Frame(0x18FF0001, data + bytes(2)))] * 3


def test_a_killed_process_leaves_a_log_that_can_be_read_to_its_end(
    tmp_path: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    paths = [tmp_path / f"killed{ending}" for ending in FORMATS]
    process = start(NODE, "0", *map(str, paths))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    for path in paths:
        until(lambda path=path: path.stat().st_size >= 5000, f"{path}, flushed while it is written")
    process.kill()
    process.wait()
    for path in paths:
        content = read_until_cut(read_log(path))
        numbers = [int.from_bytes(frame.data[:4], "big") for _, frame in content]
        assert len(numbers) > 20
        assert numbers == list(range(len(numbers)))


def test_the_file_depends_on_the_frames_alone_when_flushed_by_hand(tmp_path: Path) -> None:
    for ending in (".log", ".blf"):
        written = []
        for name in ("one", "two"):
            path = tmp_path / f"{name}{ending}"
            with LogWriter(path, flush_every_s=None) as log:
                for number in range(5000):
                    log.write(number * 1e-4, Frame(number, bytes(8)))
            written.append(path.read_bytes())
            time.sleep(0.01)
        assert written[0] == written[1]


@formats
@given(st.data())
@examples
def test_a_damaged_log_is_frames_and_perhaps_a_log_error_and_nothing_else(
    ending: str, tmp_path: Path, data: st.DataObject
) -> None:
    path = some_log(ending, tmp_path, 40)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(content) - 1))
        junk = data.draw(st.binary(max_size=8))
        content[place : place + data.draw(st.integers(0, 8))] = junk
        assume(content)
    path.write_bytes(content)
    try:
        for time_s, frame in read_log(path):
            assert time_s == time_s
            assert len(frame.data) <= 64
    except LogError as error:
        assert error.file == path
        assert error.cause


@pytest.mark.parametrize("ending", [".log", ".asc"])
@given(st.integers(1, 200))
@examples
def test_a_text_log_cut_inside_a_line_gives_its_whole_lines_then_an_error(
    ending: str, tmp_path: Path, cut: int
) -> None:
    path = some_log(ending, tmp_path, 40)
    content = path.read_bytes()[:-cut]
    assume(not content.endswith(b"\n"))
    path.write_bytes(content)
    reader = read_log(path)
    with pytest.raises(LogError, match="ends inside this line") as caught:
        list(reader)
    assert reader.frames >= 35
    assert caught.value.position == f"line {content.count(bytes([10])) + 1}"


@given(st.floats(0.0, 0.999))
@examples
def test_a_blf_log_cut_anywhere_is_an_error(tmp_path: Path, part: float) -> None:
    path = some_log(".blf", tmp_path, 200)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * part)])
    with pytest.raises(LogError):
        list(read_log(path))


@pytest.mark.parametrize("reported", [64_000_000, 1000])
def test_a_blf_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, reported: int) -> None:
    path = tmp_path / "bomb.blf"
    path.write_bytes(BLF_HEADER + blf_container(2, zlib.compress(bytes(64_000_000), 1), reported))
    tracemalloc.start()
    with pytest.raises(LogError, match="offset 144"):
        list(read_log(path))
    assert tracemalloc.get_traced_memory()[1] < 40_000_000
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.log", b"", "is empty"),
        ("empty.blf", b"", "is empty"),
        ("blank.log", b"\n\n", "holds no frames"),
        ("silent.asc", b"date Sat Sep 30 15:06:13.191 2017\nbase hex\n", "holds no frames"),
        ("image.log", b"\x89PNG\r\n\x1a\n\x00", "line 1: not text: byte 0x89"),
        ("prose.asc", b"It was a dark and stormy night.\n", "line 1: no ASC line"),
        ("prose.blf", b"It was a dark and stormy night." * 9, "not a BLF log"),
        ("table.csv", b"a,b\n", "line 1: not python-can's csv"),
        ("long.log", b"x" * 100_000, "line 1: longer than 4096"),
        ("odd.log", b"(1.0) can0 123#112\n", "line 1: odd number"),
        ("nine.log", b"(1.0) can0 123#112233445566778899\n", "a classic frame has 0..8"),
        ("ten.log", b"(1.0) can0 123##0" + b"11" * 10 + b"\n", "a CAN FD frame has 0..8, 12"),
        ("wide.log", b"(1.0) can0 FFF#11\n", "identifier 0xFFF is outside 0..0x7FF"),
    ],
)
def test_what_is_no_log_is_refused_with_file_place_and_cause(
    name: str, content: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        list(read_log(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)


def test_files_that_cannot_be_opened_or_are_too_large_are_log_errors(tmp_path: Path) -> None:
    for reader in (
        read_log(tmp_path / "missing.log"),
        read_log(tmp_path),
        LogReader(some_log(".log", tmp_path), max_bytes=1000),
    ):
        with pytest.raises(LogError, match=r"No such file|directory|the limit is 1000"):
            list(reader)
    for path in (tmp_path / "no" / "directory.log", tmp_path / "log.csv", tmp_path):
        with pytest.raises(LogError, match=r"No such file|ending"):
            LogWriter(path)


@pytest.mark.asyncio
async def test_a_recorder_writes_all_frames_of_the_bus_in_its_order(
    common_channel: str, join: Callable[..., MeshpointBus], tmp_path: Path
) -> None:
    path = tmp_path / "bus.log"
    sender = join()
    stop = asyncio.Event()
    listening: list[MeshpointBus] = []

    def open_bus() -> MeshpointBus:
        listening.append(MeshpointBus(common_channel))
        return listening[-1]

    with LogWriter(path) as log:
        recording = asyncio.ensure_future(record_bus(open_bus, log, on_event=print, stop=stop))
        await until_async(lambda: listening, "the recorder on the bus")
        began_s = time.time_ns() // 1000 / 1e6
        for number in range(1000):
            sender.send(can.Message(arbitration_id=number, data=bytes(64), is_fd=True))
        await until_async(lambda: log.frames == 1000, "every frame", say=lambda: log.frames)
        await until_async(
            lambda: path.read_bytes().count(b"\n") == 1000, "the file, while it is being written"
        )
        stop.set()
        await recording
    content = list(read_log(path))
    assert [frame.can_id for _, frame in content] == list(range(1000))
    assert began_s <= content[0][0] <= content[-1][0] <= time.time()
    assert "unix:" not in path.read_text()
