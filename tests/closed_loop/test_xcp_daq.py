"""What pyxcp measures of a controller is what the controller's frames held."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pyxcp.daq_stim import DaqList, DaqRecorder
from pyxcp.recorder.converter import convert_xmraw
from xcp_master import master

from meshpoint.bridges.a2l_module import figures
from meshpoint.dbc.specs import SignalSpec
from meshpoint.xcp.memory import (
    FIGURE_BYTES,
    MEASURED_ADDRESS,
    MEASURED_BYTES,
    MESSAGE_BYTES,
    MESSAGES,
    SENT_BYTES,
    SLEEVES,
    MeasuredMemory,
    StepFacts,
)

BOTH = pytest.mark.parametrize("fd", [True, False], ids=["can_fd", "can"])
REFERENCE, WORKING = 0, 1
CONTROLLER, MASTER = 1, 2
STEP, SHIFT_END = 0, 1


TYPES = {(8, False): "U8", (8, True): "I8", (16, False): "U16", (16, True): "I16",
         (32, False): "U32", (32, True): "I32"}  # fmt: skip
HEADER_BITS = 24
"""CRC and counter of a protected frame."""


def measurable(name: str) -> list[tuple[str, int, SignalSpec]]:
    """Signals of a message that fill whole bytes: name, address, layout."""
    ((number, spec),) = ((i, each) for i, each in enumerate(MESSAGES) if each.name == name)
    start = MEASURED_ADDRESS + MESSAGE_BYTES * number
    return [
        (f"{name}.{signal.name}", start + signal.start_bit // 8, signal)
        for signal in spec.signals
        if (signal.bits, signal.signed) in TYPES and signal.start_bit >= HEADER_BITS
    ]


def daq_list(name: str, event: int, most: int) -> DaqList:
    rows = [
        (row, address, 0, TYPES[signal.bits, signal.signed])
        for row, address, signal in measurable(name)[:most]
    ]
    return DaqList(name, event, False, True, rows)


def raw(signal: SignalSpec, data: bytes) -> int:
    first, size = signal.start_bit // 8, signal.bits // 8
    return int.from_bytes(data[first : first + size], "little", signed=signal.signed)


@BOTH
def test_a_recorded_shift_holds_what_the_frames_held(fd: bool, tmp_path: Path) -> None:
    """pyxcp records, and writes an MF4 of it: every sample is the frame's of the same step, bit for
    bit, at sensor time."""
    named = {"ControllerEstimates": STEP, "ControllerStatus": STEP, "ShiftOutcome": SHIFT_END}
    most = 99 if fd else 4  # what a bus of 8 bytes has room for
    lists = [daq_list(name, event, most) for name, event in named.items()]
    recorder = DaqRecorder(lists, str(tmp_path / "shift"))
    with master(fd=fd, policy=recorder, requests=[]) as (one, loop, cable):
        one.connect()
        recorder.setup()
        recorder.start()
        loop.operator.ask(10, loop.time.now_us + 800_000)
        cable.until(lambda: bool(loop.outcomes))
        cable.pass_time(100_000)
        recorder.stop()
        one.disconnect()
    assert len(loop.outcomes) == 1
    convert_xmraw("mdf", str(tmp_path / "shift.xmraw"), str(tmp_path / "shift.mf4"))
    from asammdf import MDF  # with pandas a second: not where tests are collected

    with MDF(tmp_path / "shift.mf4") as recorded:
        for name in named:
            sent = [
                frame.data
                for _, frame in loop.frames
                if frame.can_id == next(m.can_id for m in MESSAGES if m.name == name)
            ]
            for row, _, signal in measurable(name)[:most]:
                samples = [int(each) for each in recorded.get(row).samples]
                held = [raw(signal, data) for data in sent]
                assert is_within(samples, held), row
                assert len(samples) > 100 or name == "ShiftOutcome"
        stamps = recorded.get("ControllerStatus.StepNumber").timestamps
        steps = recorded.get("ControllerStatus.StepNumber").samples
        ticks = {round((b - a) / (m - n), 6) for a, b, n, m in zip(
            stamps[:-1], stamps[1:], steps[:-1].astype(int), steps[1:].astype(int), strict=True
        )}  # fmt: skip
        assert max(ticks) <= 0.0101


def is_within(few: list[int], many: list[int]) -> bool:
    """Whether the samples stand in the frames as a whole, one after another."""
    return any(few == many[i : i + len(few)] for i in range(len(many) - len(few) + 1))


def test_sleeve_guard_and_learned_figures_are_measured() -> None:
    with master(shifts=2, requests=[]) as (one, loop, cable):
        one.connect()
        cable.until(lambda: len(loop.outcomes) > 1, 20_000_000)
        cable.pass_time(100_000)
        names = [name for name, _, _ in figures()]
        one.setMta(MEASURED_ADDRESS + SENT_BYTES)
        content = one.fetch(FIGURE_BYTES * len(names))
        values = dict(zip(names, struct.unpack(f"<{len(names)}f", content), strict=True))
        kept = loop.core.calibration("")
        assert kept.brake is not None
        assert values["learned.brake.gain"] == pytest.approx(kept.brake.gain, rel=1e-6)
        assert values["learned.brake.drag_nm"] == pytest.approx(kept.brake.drag_nm, rel=1e-6)
        assert math.isnan(values["learned.sleeves.crawl.delay_ms"])
        assert abs(values["sleeve.first_second_mm"]) < 13.0
        assert values["guard.row"] == 0.0


def place_of(name: str) -> int:
    """Where a figure stands behind the messages, in bytes."""
    return SENT_BYTES + FIGURE_BYTES * [each for each, _, _ in figures()].index(name)


def test_of_the_learned_figures_only_what_is_read_is_worked_out() -> None:
    """Each step, as a list that is measured asks for it; all of them take 1.1 ms."""
    asked: list[str] = []

    class Learned:
        def __getattr__(self, group: str) -> Any:
            asked.append(group)
            return SimpleNamespace(gain=1.25, drag_nm=-3.0)

    memory = MeasuredMemory()
    memory.take([], StepFacts((0.001,) * len(SLEEVES), 7, Learned))
    assert struct.unpack("<f", memory.read(place_of("guard.row"), 4)) == (7.0,)
    assert asked == []
    assert struct.unpack("<f", memory.read(place_of("learned.brake.gain"), 4)) == (1.25,)
    assert asked == ["brake"]


def test_any_part_of_the_bytes_is_that_of_the_whole() -> None:
    with master(shifts=1, requests=[]) as (one, loop, cable):
        one.connect()
        cable.until(lambda: bool(loop.outcomes), 20_000_000)
        cable.pass_time(100_000)
        one.setMta(MEASURED_ADDRESS)
        whole = one.fetch(MEASURED_BYTES)
        for start, length in (
            (0, 5),
            (SENT_BYTES - 3, 9),
            (SENT_BYTES + 2, 7),
            (MEASURED_BYTES - 5, 5),
        ):
            one.setMta(MEASURED_ADDRESS + start)
            part = one.fetch(length)
            if start >= SENT_BYTES:  # the messages are those of a later step
                assert part == whole[start : start + length]
            assert len(part) == length
