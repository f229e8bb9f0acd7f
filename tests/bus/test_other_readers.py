"""Logs between us and everybody else's tools: the same frames, to the bit, both ways."""

from __future__ import annotations

import gzip
import random
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import can
import cantools
import pytest

from meshpoint.bus.light_can import mf4_module
from meshpoint.bus.logs.reader import FORMATS, LogError, read_log
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import ETC1, EdgesMainRise, ShiftResult, ValveCommand
from meshpoint.dbc.node import Node
from meshpoint.dbc.source import DBC_PATH

pytestmark = pytest.mark.check
EPOCH_S = 1_700_000_000.0
FD_FORMATS = [*FORMATS, ".mf4"]


def bus_frames(classic_alone: bool = False) -> list[tuple[float, Frame]]:
    """Frames of each length that there is, and messages of the DBC."""
    draw = random.Random(4)
    lengths = range(9) if classic_alone else (*range(9), 12, 16, 20, 24, 32, 48, 64)
    frames: list[Frame] = []
    for length in lengths:
        is_fd = not classic_alone and (length > 8 or draw.random() < 0.5)
        frames.append(Frame(draw.getrandbits(29), draw.randbytes(length), is_fd))
        frames.append(Frame(draw.getrandbits(11), draw.randbytes(length), is_fd, False))
    control = Transmitter(Node.TRANSMISSION_CONTROL)
    frames.append(control.encode(ETC1(output_shaft_speed_rad_s=100.0)))
    if not classic_alone:
        stamps = tuple(draw.getrandbits(16) for _ in range(27))
        edges = EdgesMainRise(read_time_us=4_294_000_000, timestamp_low_us=stamps)
        frames += [control.encode(ValveCommand()), Transmitter(Node.GEARBOX_IO).encode(edges)]
    return [(EPOCH_S + k * 0.25, frame) for k, frame in enumerate(frames)]


def ours(path: Path, frames: list[tuple[float, Frame]]) -> Path:
    with LogWriter(path, channel="can0") as log:
        for time_s, frame in frames:
            log.write(time_s, frame)
    return path


def theirs(path: Path, frames: list[tuple[float, Frame]], **options: object) -> Path:
    """The same by python-can's writer of the ending; MF4's is asammdf's."""
    writer = mf4_module().MF4Writer if path.suffix == ".mf4" else can.Logger
    with writer(path, **options) as log:
        for time_s, frame in frames:
            log.on_message_received(message_of(time_s, frame))
    return path


def message_of(time_s: float, frame: Frame) -> can.Message:
    return can.Message(
        timestamp=time_s,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        is_fd=frame.is_fd,
        data=frame.data,
        channel=0,
        is_rx=True,
    )


def as_frame(message: can.Message) -> Frame:
    return Frame(message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id)


@pytest.mark.parametrize("ending", [".log", ".blf"])
def test_a_small_packed_file_of_endless_content_is_refused_early(
    tmp_path: Path, ending: str
) -> None:
    """No log packs to a 200th; a gigabyte of one byte packs to a 1000th."""
    path = tmp_path / f"a{ending}.gz"
    with gzip.open(path, "wb") as packed:
        packed.write(b"(1.0) can0 123#00\n")
        for _ in range(64):
            packed.write((b" " * 1023 + b"\n") * 2**10)
    with pytest.raises(LogError, match=r"over 200 times what it is packed") as refused:
        list(read_log(path))
    assert refused.value.file == path
    assert int(re.findall(r"unpacked (\d+) bytes", str(refused.value))[0]) < 20 * 2**20


def test_a_packed_log_of_lines_needs_no_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = bus_frames()
    path = packed_log(ours(tmp_path / "a.log", frames))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    assert [frame for _, frame in read_log(path)] == [frame for _, frame in frames]


def test_a_packed_log_larger_than_what_is_left_of_the_disk_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = packed_log(ours(tmp_path / "a.blf", bus_frames()))
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage)
    with pytest.raises(LogError, match="no room to unpack it"):
        list(read_log(path))


@pytest.mark.parametrize("ending", FORMATS)
def test_python_can_reads_our_logs(tmp_path: Path, ending: str) -> None:
    frames = bus_frames()
    path = ours(tmp_path / f"a{ending}", frames)
    with can.LogReader(path) as log:
        read = [(message.timestamp, as_frame(message)) for message in log]
    assert [frame for _, frame in read] == [frame for _, frame in frames]
    first_s = read[0][0]
    for (theirs_s, _), (ours_s, _) in zip(read, frames, strict=True):
        assert theirs_s - first_s == pytest.approx(ours_s - EPOCH_S, abs=2e-6)


@pytest.mark.parametrize("ending", FD_FORMATS)
@pytest.mark.parametrize("packed", [False, True])
def test_we_read_the_logs_of_others(tmp_path: Path, ending: str, packed: bool) -> None:
    frames = bus_frames()
    path = theirs(tmp_path / f"a{ending}", frames)
    if packed:
        path = packed_log(path)
    read = list(read_log(path))
    assert [frame for _, frame in read] == [frame for _, frame in frames]
    for (read_s, _), (time_s, _) in zip(read, frames, strict=True):
        begin_s = read[0][0] if ending == ".asc" else EPOCH_S
        assert read_s - begin_s == pytest.approx(time_s - EPOCH_S, abs=2e-6)


def packed_log(path: Path) -> Path:
    to = path.with_name(path.name + ".gz")
    to.write_bytes(gzip.compress(path.read_bytes()))
    return to


@pytest.mark.parametrize("ending", [".trc", ".csv"])
def test_classic_frames_of_formats_that_have_no_others(tmp_path: Path, ending: str) -> None:
    frames = bus_frames(classic_alone=True)
    path = theirs(tmp_path / f"a{ending}", frames)
    assert [frame for _, frame in read_log(path)] == [frame for _, frame in frames]
    assert [frame for _, frame in read_log(packed_log(path))] == [frame for _, frame in frames]


def test_a_writer_that_lost_can_fd_is_refused_with_the_reason(tmp_path: Path) -> None:
    """python-can's csv writer makes frames of 64 bytes of unknown kind."""
    path = theirs(tmp_path / "a.csv", bus_frames())
    with pytest.raises(LogError, match="lost which frames are CAN FD") as refused:
        list(read_log(path))
    assert refused.value.position.startswith("line ")
    long = tmp_path / "a.trc"
    data = " ".join(["00"] * 64)
    long.write_text(TRC_21 + f"      6      1400.000 DT 1 18FF1480 Rx -  15    {data}\n")
    with pytest.raises(LogError, match="line 10: a classic frame of 64 bytes"):
        list(read_log(long))


def test_python_can_s_trc_writer_leaves_frames_out_and_that_is_said(tmp_path: Path) -> None:
    frames = bus_frames()
    reader = read_log(theirs(tmp_path / "a.trc", frames))
    assert [frame for _, frame in reader] == [f for _, f in frames if not f.is_fd]
    assert "leaves CAN FD frames out" in reader.unfinished


@pytest.mark.device
def test_can_utils_read_our_logs_and_we_read_theirs(tmp_path: Path) -> None:
    """can-utils' log2asc on our candump log, and asc2log on the ASC that it makes."""
    if shutil.which("log2asc") is None or shutil.which("asc2log") is None:
        pytest.skip("can-utils are not installed")
    frames = bus_frames()
    log = ours(tmp_path / "a.log", frames)
    asc, again = tmp_path / "a.asc", tmp_path / "b.log"
    subprocess.run(["log2asc", "-I", log, "-O", asc, "can0"], check=True)
    assert [frame for _, frame in read_log(asc)] == [frame for _, frame in frames]
    subprocess.run(["asc2log", "-I", asc, "-O", again], check=True)
    assert [frame for _, frame in read_log(again)] == [frame for _, frame in frames]


TRC_21 = """\
;$FILEVERSION=2.1
;$STARTTIME=45261.25
;$COLUMNS=N,O,T,B,I,d,R,L,D
;   Message   Time    Type ID     Rx/Tx
      1      1059.900 DT 1      0300 Rx -  7    00 00 00 00 04 00 00
      2      1283.231 FB 2 18FF1480 Rx -  9    01 02 03 04 05 06 07 08 09 0A 0B 0C
      3      1283.400 ST 1          Rx -  4    00 00 00 00
      4      1284.231 ER 1          Rx -  5    00 00 00 00 00
      5      1323.201 RR 1 18EFC034 Rx -  8
"""


def test_a_trc_of_a_peak_adapter(tmp_path: Path) -> None:
    """The example of PEAK's description of the format, with CAN FD, a status, an error frame."""
    path = tmp_path / "a.trc"
    path.write_text(TRC_21)
    reader = read_log(path)
    classic, fd = list(reader)
    assert classic[1] == Frame(0x300, bytes.fromhex("00000000040000"), False, False)
    assert fd[1] == Frame(0x18FF1480, bytes(range(1, 13)))
    assert fd[0] - classic[0] == pytest.approx(0.223331)
    assert classic[0] == pytest.approx((45261.25 - 25569) * 86400 + 1.0599)
    assert (reader.error_frames, reader.remote_frames) == (1, 1)
    assert reader.buses.frames == {"1": 1, "2": 1}
    assert [frame for _, frame in read_log(path, bus="2")] == [fd[1]]


@pytest.mark.parametrize("ending", FD_FORMATS)
def test_a_log_of_two_buses(tmp_path: Path, ending: str) -> None:
    frames = bus_frames()[::2]
    path = tmp_path / f"a{ending}"
    writer = mf4_module().MF4Writer if ending == ".mf4" else can.Logger
    with writer(path) as log:
        for time_s, frame in frames:
            for bus in (0, 1):
                message = message_of(time_s, frame._replace(can_id=frame.can_id ^ bus))
                message.channel = bus if ending != ".log" else f"can{bus}"
                log.on_message_received(message)
    reader = read_log(path)
    assert len(list(reader)) == 2 * len(frames)
    assert list(reader.buses.frames.values()) == [len(frames)] * 2
    name = min(reader.buses.frames)
    assert [frame for _, frame in read_log(path, bus=name)] == [frame for _, frame in frames]
    with pytest.raises(LogError, match="no frame of bus 'can7'"):
        list(read_log(path, bus="can7"))


def test_a_packed_log_that_is_cut_off_gives_all_before_that(tmp_path: Path) -> None:
    frames = bus_frames() * 200
    path = packed_log(ours(tmp_path / "a.log", frames))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    read = []
    with pytest.raises(LogError, match="cut off"):
        for entry in read_log(path):
            read.append(entry[1])
    assert 1000 < len(read) < len(frames)
    assert read == [frame for _, frame in frames[: len(read)]]


def test_what_is_no_gzip_file_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.log.gz"
    path.write_bytes(b"(1.0) can0 123#00\n")
    with pytest.raises(LogError, match="not a gzip file"):
        list(read_log(path))


@pytest.mark.parametrize("ending", FORMATS)
def test_cantools_decodes_our_logs_as_we_do(tmp_path: Path, ending: str) -> None:
    """Each signal of each message: cantools by our DBC, ours by the codec made of it."""
    database = cantools.database.load_file(DBC_PATH, strict=False)
    path = ours(tmp_path / f"a{ending}", bus_frames())
    compared = 0
    with can.LogReader(path) as log:
        for message in log:
            if not message.is_extended_id:
                continue
            for codec in CODECS.values():
                if codec.spec.can_id == message.arbitration_id:
                    values = database.decode_message(
                        message.arbitration_id, message.data, decode_choices=False
                    )
                    # J1939 fills bits without a meaning with ones.
                    again = database.encode_message(
                        message.arbitration_id,
                        values,
                        strict=False,
                        padding=codec.spec.data_id is None,
                    )
                    assert bytes(again) == bytes(message.data)
                    decoded = codec.decode(bytes(message.data))
                    assert decoded is not None
                    if isinstance(decoded, EdgesMainRise):
                        assert values["ReadTime"] == decoded.read_time_us
                        names = [f"TimestampLow{k:02}" for k in range(27)]
                        assert tuple(values[n] for n in names) == decoded.timestamp_low_us
                    compared += 1
    assert compared == 3


def test_asammdf_finds_our_signals_in_an_mf4_of_our_log(tmp_path: Path) -> None:
    """Our log written on as MF4 by python-can, then read by asammdf with our DBC, and by us."""
    from asammdf import MDF  # with pandas a second: not where tests are collected

    frames = bus_frames()
    log = ours(tmp_path / "a.blf", frames)
    path = theirs(tmp_path / "a.mf4", list(read_log(log)))
    assert [frame for _, frame in read_log(path)] == [frame for _, frame in frames]
    with MDF(path) as mdf:
        extracted = mdf.extract_bus_logging({"CAN": [(DBC_PATH, 0)]})
        stamps = extracted.get("ReadTime").samples
        speed = extracted.get("OutputShaftSpeed").samples
    assert stamps.tolist() == [4_294_000_000]
    etc1 = CODECS["ETC1"].decode(frames[-3][1].data)
    assert etc1 is not None
    assert etc1.output_shaft_speed_rad_s is not None
    rpm = etc1.output_shaft_speed_rad_s * 30.0 / 3.141592653589793
    assert speed.tolist() == [pytest.approx(rpm)]


def test_an_mf4_is_read_though_python_can_was_loaded_without_asammdf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = bus_frames()
    path = theirs(tmp_path / "a.mf4", frames)
    monkeypatch.setattr(can.io.mf4, "asammdf", None)
    assert [frame for _, frame in read_log(path)] == [frame for _, frame in frames]


def test_results_have_names_in_both(tmp_path: Path) -> None:
    """A value table of the DBC by cantools and by us."""
    database = cantools.database.load_file(DBC_PATH, strict=False)
    signal = database.get_message_by_name("ShiftOutcome").get_signal_by_name("Result")
    assert signal.choices is not None
    named = {value: str(name).upper() for value, name in signal.choices.items()}
    assert {r.value: r.name.replace("_", "") for r in ShiftResult} == {
        value: name.replace("_", "") for value, name in named.items()
    }
