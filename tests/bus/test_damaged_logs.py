"""A log with a hole is never read as a shorter one without a word."""

from __future__ import annotations

import gc
import logging
import struct
import sys
from pathlib import Path

import can
import pytest
from log_mutations import mixed_log, silent_partial_reads

from meshpoint.bus.light_can import mf4_module
from meshpoint.bus.logs.files import read_logs
from meshpoint.bus.logs.reader import FORMATS, LogError, read_log
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.dbc.frame import Frame

SUITE_MUTATIONS = 60
"""1,000 a format by `python tests/bus/log_mutations.py 1000`."""
HEADER_BYTES = 144


def blf_in_containers(path: Path) -> list[int]:
    """A BLF log of three containers, of which this gives the offsets."""
    with LogWriter(path, flush_every_s=None) as log:
        for number in range(300):
            log.write(number * 1e-3, Frame(0x18FF0080, number.to_bytes(8, "big")))
            if number in (100, 200):
                log.flush()
    content, offsets = path.read_bytes(), [HEADER_BYTES]
    while (end := _behind(content, offsets[-1])) < len(content):
        offsets.append(end)
    assert len(offsets) == 3
    return offsets


def _behind(content: bytes, offset: int) -> int:
    (size,) = struct.unpack_from("<L", content, offset + 8)
    return int(offset + size + size % 4)


@pytest.mark.parametrize("ending", FORMATS)
def test_mutated_logs_are_never_read_in_part_in_silence(ending: str, tmp_path: Path) -> None:
    found = silent_partial_reads(ending, SUITE_MUTATIONS, 1, tmp_path)
    assert found["silent"] == 0
    assert found["reported"] > SUITE_MUTATIONS // 2


@pytest.mark.parametrize("container", [0, 1, 2])
@pytest.mark.parametrize(
    ("behind", "damage", "said"),
    [
        (0, bytes(16), "offset {at}: zeros where a container should begin"),
        (12, b"\x0b", "an object of type 11 where a container"),
    ],
)
def test_what_is_no_container_s_head_is_a_defect(
    container: int, behind: int, damage: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "hole.blf"
    head = blf_in_containers(path)[container]
    content, at = path.read_bytes(), head + behind
    path.write_bytes(content[:at] + damage + content[at + len(damage) :])
    with pytest.raises(LogError, match=said.format(at=head)):
        list(read_log(path))


def test_a_container_that_is_missing_as_a_whole_is_a_defect(tmp_path: Path) -> None:
    path = tmp_path / "missing.blf"
    _, begin, end = blf_in_containers(path)
    content = path.read_bytes()
    shorter = bytearray(content[:begin] + content[end:])
    struct.pack_into("<Q", shorter, 16, len(shorter))  # as if it had always been so long
    path.write_bytes(shorter)
    with pytest.raises(LogError, match="200 objects are left of 300"):
        list(read_log(path))


def test_a_blf_log_whose_header_was_not_completed_can_be_read_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "killed.blf"
    blf_in_containers(path)
    content = bytearray(path.read_bytes())
    struct.pack_into("<QQL", content, 16, HEADER_BYTES, HEADER_BYTES, 0)
    path.write_bytes(content)
    reader = read_log(path)
    assert len(list(reader)) == 300
    assert "interrupted" in reader.unfinished
    with pytest.raises(LogError, match="interrupted"):
        list(read_logs([path]))


@pytest.mark.parametrize("ending", FORMATS)
def test_a_completed_log_is_not_called_unfinished(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"whole{ending}"
    mixed_log(path, 60)
    reader = read_log(path)
    assert len(list(reader)) == 120
    assert (reader.error_frames, reader.remote_frames) == (2, 2)
    assert reader.unfinished == ""


def test_an_asc_log_without_its_end_can_be_read_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "cut.asc"
    mixed_log(path, 60)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-11]))
    reader = read_log(path)
    assert len(list(reader)) == 120 - 10
    assert "End TriggerBlock" in reader.unfinished


ASC_HEAD = "date Sam Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\n"
FD_TAIL = "102203 133 303000 e0006659 46500250 4b140250 20011736 2001040d"


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("3.098426 1  18EBFF00x  Rx   d 2 01 A0  Length = 273910 BitCount = 141 ID = 418119424x",
         Frame(0x18EBFF00, b"\x01\xa0", False)),
        ("0.1 2  100 TxRq d 0", Frame(0x100, b"", False, False)),
        (f"30.005021 CANFD   1 Rx        300            1 0 8  8 01 02 03 04 05 06 07 08 {FD_TAIL}",
         Frame(0x300, bytes(range(1, 9)), True, False)),
        (f"30.5 CANFD   2 Tx     1C4D80A7x  Engine::Dow 0 1 1  1 0A {FD_TAIL}",
         Frame(0x1C4D80A7, b"\x0a")),
        (f"30.5 CANFD   2 Tx     1C4D80A7x   0 1 0  0 {FD_TAIL}", Frame(0x1C4D80A7, b"")),
    ],
)  # fmt: skip
def test_frames_of_vector_tools_are_read(line: str, frame: Frame, tmp_path: Path) -> None:
    path = tmp_path / "vector.asc"
    path.write_text(f"{ASC_HEAD}{line}\n")
    ((_, read),) = read_log(path)
    assert read == frame


@pytest.mark.parametrize(
    "line",
    [
        "0.000000 Start of measurement",
        "0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0",
        "1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%",
        "2.501000 1  J1939TP FEE3p 6 0 0 -   Rx   d 23 A0 0F A6",
        "2.5 SV: 3 0 1 ::Bus::Load = 12",
        "//0.000000 previous log file: logfile_errorframes.asc",
    ],
)
def test_known_events_that_are_no_frames_are_passed_over(line: str, tmp_path: Path) -> None:
    path = tmp_path / "vector.asc"
    path.write_text(f"{ASC_HEAD}{line}\n0.1 1 100 Rx d 0\n")
    assert len(list(read_log(path))) == 1


@pytest.mark.parametrize(
    "line",
    [
        "0.1 1 18FF0080x Rx d 8 01 02 03 04 05 06 07",
        "0.1 1 18FF0080x Rx d 8 01 02 03 04 05 06 07 8",
        "0.1 1 18FF0080x Rx d 8 01 02 03 04 05 06 07 08 09",
        "0.1 1 18FF0080x Rx r 8 01 02 03 04 05 06 07 08",
        "0.1 1 18FF0080x R d 8 01 02 03 04 05 06 07 08",
        "0.1 1 18FF00G0x Rx d 8 01 02 03 04 05 06 07 08",
        "0.1 x 18FF0080x Rx d 8 01 02 03 04 05 06 07 08",
        "0.1 1 18FF0080x Rx d 8 01 02 03 04\x0005 06 07 08",
        f"0.1 CANFE 1 Rx 300 1 0 8 8 01 02 03 04 05 06 07 08 {FD_TAIL}",
        f"0.1 CANFD 1 Rx 300 1 0 8 7 01 02 03 04 05 06 07 {FD_TAIL}",
        f"0.1 CANFD 1 Rx 300 1 0 f 64 01 02 03 04 05 06 07 08 {FD_TAIL}",
        "0.1 CANFD 1 Rx 300 1 0 8 8 01 02 03 04 05 06 07 08",
        "0.1 1 ErrorFrane",
        "base hox",
        "Begin",
        "End Trigger",
    ],
)
def test_a_damaged_asc_line_is_a_defect_and_no_missing_frame(line: str, tmp_path: Path) -> None:
    path = tmp_path / "damaged.asc"
    path.write_text(f"{ASC_HEAD}0.05 1 100 Rx d 0\n{line}\n0.2 1 100 Rx d 0\n")
    reader = read_log(path)
    with pytest.raises(LogError, match="line 4"):
        list(reader)
    assert reader.frames == 1


@pytest.mark.parametrize(
    "line",
    [
        "(1.0) can0 38FF0080#0102030405060708",  # a bit of an identifier made it an error frame
        "(1.0) can0 20000004#01020304",
        "(1.0) can0 18FF0080#R1020304",
        "(1.0) can0 18FF0080#R 0102",
    ],
)
def test_a_damaged_candump_line_is_no_error_and_no_remote_frame(line: str, tmp_path: Path) -> None:
    path = tmp_path / "damaged.log"
    path.write_text(f"{line}\n(2.0) can0 123#11\n")
    with pytest.raises(LogError, match="line 1"):
        list(read_log(path))


def test_of_a_damaged_mf4_its_defect_alone_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its reader would write tracebacks of its own, at once and as its remains are taken down."""
    path = tmp_path / "damaged.mf4"
    with mf4_module().MF4Writer(path) as writer:
        for number in range(300):
            message = can.Message(timestamp=1e-3 * number, arbitration_id=1, data=bytes(8))
            writer.on_message_received(message)
    whole, said = path.read_bytes(), list[str]()
    monkeypatch.setattr(sys, "unraisablehook", lambda left: said.append(repr(left)))
    monkeypatch.setattr(logging.getLogger("asammdf"), "handlers", [Said(said)])
    data = whole.index(b"##DZ") + 60  # packed; no other place, as asammdf may crash of those
    damaged = [whole[:length] for length in range(10, len(whole), len(whole) // 7)]
    damaged += [b"UnFinMF " + whole[8:]]
    damaged += [
        whole[:at] + bytes([whole[at] ^ 8]) + whole[at + 1 :] for at in (30, data, data + 90)
    ]
    defects = 0
    for content in damaged:
        path.write_bytes(content)
        try:
            list(read_log(path))
        except LogError as error:
            defects += 1
            assert "damaged.mf4" in str(error)
            assert "\n" not in str(error)
        gc.collect()
    assert defects >= 9
    assert said == []
    assert capsys.readouterr() == ("", "")


class Said(logging.Handler):
    """Keeps what a library says."""

    def __init__(self, said: list[str]) -> None:
        super().__init__()
        self._said = said

    def emit(self, record: logging.LogRecord) -> None:
        self._said.append(record.getMessage())
