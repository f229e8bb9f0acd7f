"""The hand-written codec against cantools and the DBC, bit for bit over random values."""

from __future__ import annotations

import ctypes
from typing import Any

import cantools
import numpy as np
import pytest
from structures import CEdgeRead, CFrame, COrder, CReport, CScan

from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.source import DBC_PATH
from meshpoint.firmware.native_board import NativeBoard

DATABASE = cantools.database.load_file(DBC_PATH)
EDGES = [message.name for message in DATABASE.messages if message.name.startswith("Edges")]
VALVES = [s.name.removesuffix("Energised")
          for s in DATABASE.get_message_by_name("ValveStatus").signals
          if s.name.endswith("Energised")]  # fmt: skip
TIMES = 200


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(48))


def expected(name: str, values: dict[str, Any]) -> bytes:
    """What cantools packs of these steps of the wire, the header empty."""
    message = DATABASE.get_message_by_name(name)
    return bytes(message.encode({"Crc": 0, "Counter": 0} | values, scaling=False, strict=False))


def packed(frame: CFrame, name: str) -> bytes:
    """The data of a frame, which is one of that message."""
    spec = CODECS[name].spec
    assert (frame.id, frame.length) == (spec.can_id, spec.length)
    assert (frame.is_extended, frame.is_fd) == (True, True)
    return bytes(frame.data)[: frame.length]


def bits(mask: int, suffix: str) -> dict[str, int]:
    return {f"{name}{suffix}": mask >> place & 1 for place, name in enumerate(VALVES)}


@pytest.mark.parametrize("channel", range(8))
def test_an_edge_frame(board: NativeBoard, rng: np.random.Generator, channel: int) -> None:
    frame = CFrame()
    for _ in range(TIMES):
        read_us, index, stamps = (
            int(rng.integers(1 << 32)), int(rng.integers(1 << 16)), rng.integers(1 << 16, size=27),
        )  # fmt: skip
        valid, flags = int(rng.integers(28)), [bool(flag) for flag in rng.integers(2, size=3)]
        read = CEdgeRead(read_us, index, valid, *flags, tuple(map(int, stamps)))
        board.code.frames_put_edges(ctypes.byref(frame), channel, ctypes.byref(read))
        values = {f"TimestampLow{place:02}": int(stamp) for place, stamp in enumerate(stamps)}
        values |= dict(zip(("LongInterval", "Stopped", "SensorFault"), flags, strict=True))
        values |= {"ReadTime": read_us, "NewestIndex": index, "ValidStamps": valid}
        assert packed(frame, EDGES[channel]) == expected(EDGES[channel], values)


@pytest.mark.parametrize("channel", range(8))
def test_an_edge_frame_that_is_heard(
    board: NativeBoard, rng: np.random.Generator, channel: int
) -> None:
    read, spec = CEdgeRead(), CODECS[EDGES[channel]].spec
    get = board.code.frames_get_edges
    get.restype = ctypes.c_bool
    for _ in range(TIMES):
        read_us, index, valid = (int(rng.integers(1 << bits)) for bits in (32, 16, 5))
        stamps = [int(each) for each in rng.integers(1 << 16, size=27)]
        values = {f"TimestampLow{place:02}": stamp for place, stamp in enumerate(stamps)}
        values |= {"ReadTime": read_us, "NewestIndex": index, "ValidStamps": valid}
        values |= {"LongInterval": 1, "Stopped": index & 1, "SensorFault": 1}
        frame = CFrame(spec.can_id, spec.length, True, True,
                       tuple(expected(EDGES[channel], values)))  # fmt: skip
        assert get(ctypes.byref(frame), ctypes.byref(read)) == (valid <= 27)
        assert (read.read_us, read.newest_index, read.valid_stamps, list(read.stamps_us)) == (
            read_us, index, valid, stamps,
        )  # fmt: skip


def test_the_slow_sensors(board: NativeBoard, rng: np.random.Generator) -> None:
    frame = CFrame()
    for _ in range(TIMES):
        time_us, slow = (
            int(rng.integers(1 << 32)),
            [
                int(rng.integers(low, high + 1))
                for low, high in ((0, 0xFFFF), (0, 0xFFFF), (4_000, 30_000), (0, 10_000))
            ],
        )
        scan = CScan((0,) * 4, *slow, 0)
        board.code.frames_put_gearbox_sensors(ctypes.byref(frame), time_us, ctypes.byref(scan))
        values = {
            "SampleTime": time_us, "BrakePressure": slow[0], "SupplyPressure": slow[1],
            "OilTemperature": slow[2], "ClutchPosition": slow[3],
        }  # fmt: skip
        assert packed(frame, "GearboxSensors") == expected("GearboxSensors", values)


@pytest.mark.parametrize(
    ("name", "first", "signals"),
    [("SleevesMain", 0, ("SleeveFirstSecond", "SleeveCrawlThird")),
     ("SleevesAux", 2, ("SleeveSplitter", "SleeveRange"))],
)  # fmt: skip
def test_the_sleeves(
    board: NativeBoard, rng: np.random.Generator, name: str, first: int, signals: tuple[str, str]
) -> None:
    frame = CFrame()
    for _ in range(TIMES):
        time_us, faults = int(rng.integers(1 << 32)), int(rng.integers(4))
        samples = rng.integers(-20_000, 20_001, size=(10, 4))
        scans = (CScan * 10)(*(CScan(tuple(map(int, row))) for row in samples))
        board.code.frames_put_sleeves(ctypes.byref(frame), time_us, scans, first, faults)
        values = {
            f"{signal}{place:02}": int(samples[place, first + sleeve])
            for sleeve, signal in enumerate(signals)
            for place in range(10)
        }
        values |= {"SampleTime": time_us, "SensorFault": faults}
        assert packed(frame, name) == expected(name, values)


def test_valve_status(board: NativeBoard, rng: np.random.Generator) -> None:
    frame = CFrame()
    for _ in range(TIMES):
        time_us, energised, pending = (
            int(rng.integers(1 << 32)),
            *map(int, rng.integers(512, size=2)),
        )
        counts = [int(each) for each in rng.integers(1 << 16, size=2)]
        report = CReport(time_us, energised, pending, *counts)
        board.code.frames_put_valve_status(ctypes.byref(frame), ctypes.byref(report))
        values = bits(energised, "Energised") | bits(pending, "Pending")
        values |= {"SampleTime": time_us, "RefusedCount": counts[0], "ExpiredCount": counts[1]}
        assert packed(frame, "ValveStatus") == expected("ValveStatus", values)


def test_a_valve_command(board: NativeBoard, rng: np.random.Generator) -> None:
    orders = (COrder * 9)()
    for _ in range(TIMES):
        actions, times_us = rng.integers(4, size=9), rng.integers(1 << 32, size=9)
        values = {f"{name}Action": int(a) for name, a in zip(VALVES, actions, strict=True)}
        values |= {f"{name}Time": int(t) for name, t in zip(VALVES, times_us, strict=True)}
        frame = CFrame(data=tuple(expected("ValveCommand", values).ljust(64, b"\0")))
        board.code.frames_get_valve_command(ctypes.byref(frame), orders)
        assert [(order.action, order.time_us) for order in orders] == list(
            zip(map(int, actions), map(int, times_us), strict=True)
        )


@pytest.mark.parametrize(
    ("action", "is_one", "closes"),
    [(0, True, False), (1, True, True), (2, False, False), (255, False, False)],
)
def test_a_clutch_command(board: NativeBoard, action: int, is_one: bool, closes: bool) -> None:
    frame = CFrame(data=tuple(expected("ClutchCommand", {"Action": action}).ljust(64, b"\0")))
    close = ctypes.c_bool()
    board.code.frames_get_clutch_command.restype = ctypes.c_bool
    found = board.code.frames_get_clutch_command(ctypes.byref(frame), ctypes.byref(close))
    assert (found, close.value and found) == (is_one, closes)


def test_data_ids_are_those_of_the_dbc(board: NativeBoard) -> None:
    board.code.frames_data_id.restype = ctypes.c_uint16
    for codec in CODECS.values():
        if codec.spec.name in {*EDGES, "GearboxSensors", "SleevesMain", "SleevesAux",
                               "ValveStatus", "ValveCommand", "ClutchCommand"}:  # fmt: skip
            assert board.code.frames_data_id(codec.spec.can_id) == codec.spec.data_id
