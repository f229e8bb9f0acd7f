"""The classic profile in C: against cantools bit for bit, and against the rig's whole shifts."""

from __future__ import annotations

import ctypes
import json
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from e2e.p01 import e2e_p01_protect
from firmware_bench import VALVES, CommandBench, Order, command
from structures import CCommand, CEdgeRead, CFrame, CReport, CScan
from test_off import ENDS, go_through_all

from meshpoint.bench.firmware_classic import classic_options
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import simulate
from meshpoint.bus.classic.commands import OrderSender
from meshpoint.bus.classic.edges import EdgeReport, EdgeSender
from meshpoint.bus.profile import WireProfile
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.classic.codecs import CLASSIC_CODECS
from meshpoint.dbc.classic.source import CLASSIC_DBC
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.messages import ClutchAction, ClutchCommand, ValveAction
from meshpoint.firmware.board import Firmware
from meshpoint.firmware.build import BOTH_IMAGES, library
from meshpoint.firmware.native_board import NativeBoard
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
DATABASE = cantools.database.load_file(CLASSIC_DBC)
TEETH = {"OutputShaftSpeed": (6, SHEET.wheels.propeller.teeth),
         "InputShaftSpeed": (0, SHEET.wheels.input_.teeth)}  # fmt: skip
LAYSHAFT, MAIN = 2, 4
ON, ON_AT = ValveAction.ON_NOW, ValveAction.ON_AT
HALF = Fraction(1, 2)


@pytest.fixture
def board(folder: Path) -> NativeBoard:
    board = NativeBoard(library(folder, (*BOTH_IMAGES, *classic_options(SHEET))))
    board.power_on(sensor_us=0)
    return board


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(48))


class Wire:
    """What cantools packs and the library protects; keeps the counters."""

    def __init__(self) -> None:
        self.counters: dict[str, int] = {}

    def frame(self, name: str, **values: int) -> Frame:
        """The next frame of this message, of these steps of the wire."""
        message = DATABASE.get_message_by_name(name)
        spec = CLASSIC_CODECS[name].spec
        if not spec.is_protected:
            missing = {s.name: (1 << s.length) - 1 for s in message.signals}
            packed = message.encode(missing | values, scaling=False, strict=False, padding=True)
            return Frame(spec.can_id, bytes(packed), is_fd=False)
        counter = self.counters[name] = (self.counters.get(name, -1) + 1) % 15
        header = {"Crc": 0, "Counter": counter}
        data = bytearray(message.encode(header | values, scaling=False, strict=False))
        e2e_p01_protect(data, spec.protected_id, increment_counter=False)
        return Frame(spec.can_id, bytes(data), is_fd=False)


def half_up(value: Fraction) -> int:
    return (value + HALF).__floor__()


def speed(read: CEdgeRead, teeth: int) -> int:
    """Steps of 0.125 rpm over the newest edges of 15 ms, as docs/wire.md and the DBC have it."""
    stamps, span_us, count = list(read.stamps_us)[: read.valid_stamps], 0, 0
    for newer, older in pairwise(stamps):
        if span_us >= 15_000:
            break
        span_us, count = span_us + ((newer - older) & 0xFFFF), count + 1
    if read.sensor_fault or (not read.stopped and (read.long_interval or not span_us)):
        return 0xFFFF
    return 0 if read.stopped else half_up(Fraction(480_000_000 * count, span_us * teeth))


def drawn_read(rng: np.random.Generator, read_us: int, before: CEdgeRead | None) -> CEdgeRead:
    """A wheel that has gone on by some edges, its stamps some 100 to 3,000 us apart."""
    valid = int(rng.choice([0, 2, 3, 27, 27, 27, 27]))
    index = int(rng.integers(1 << 16)) if before is None else before.newest_index
    index = (index + int(rng.integers(20))) & 0xFFFF
    ages = rng.integers(int(rng.choice([150, 900])), 3_000, size=27).cumsum()
    stamps = [(read_us - int(age)) & 0xFFFF if k < valid else 0 for k, age in enumerate(ages)]
    flags = [bool(flag) for flag in rng.random(3) < 0.2]
    return CEdgeRead(read_us, index, valid, *flags, tuple(stamps))


def edges(wire: Wire, name: str, sender: EdgeSender, read: CEdgeRead) -> list[Frame]:
    """The rig's own choice of edges, packed by cantools."""
    report = EdgeReport(
        read.read_us, read.newest_index, read.valid_stamps, bool(read.long_interval),
        bool(read.stopped), bool(read.sensor_fault), tuple(read.stamps_us),
    )  # fmt: skip
    return [
        wire.frame(name, NewestIndex=message.newest_index,
                   **{f"TimestampLow{k:02}": low
                      for k, low in enumerate(message.timestamp_low_us)})
        for message in sender.cut(report)
    ]  # fmt: skip


def test_a_read_with_its_edges_speeds_and_slow_sensors(
    board: NativeBoard, rng: np.random.Generator
) -> None:
    wire, reads = Wire(), [None] * 8
    wheels = {name: EdgeSender(CLASSIC_CODECS[name].message_type)
              for name in ("EdgesLayshaft", "EdgesMain")}  # fmt: skip
    for number in range(1, 401):
        read_us = int(rng.integers(1 << 32))
        reads = [drawn_read(rng, read_us, before) for before in reads]
        supply, oil = int(rng.integers(1 << 16)), int(rng.integers(4_000, 30_001))
        scan = CScan((0,) * 4, 0, supply, oil, 0, 0)
        board.code.frames_send_reads((CEdgeRead * 8)(*reads), read_us, ctypes.byref(scan))
        lay, main_shaft = reads[LAYSHAFT], reads[MAIN]
        of = [edges(wire, name, wheels[name], read)
              for name, read in (("EdgesLayshaft", lay), ("EdgesMain", main_shaft))]  # fmt: skip
        expected = [
            wire.frame(
                "SensorRead", ReadTime=read_us, LayshaftIndex=wheels["EdgesLayshaft"].index & 0xFF,
                MainIndex=wheels["EdgesMain"].index & 0xFF,
                LayshaftStopped=lay.stopped, MainStopped=main_shaft.stopped,
                LayshaftSensorFault=lay.sensor_fault, MainSensorFault=main_shaft.sensor_fault,
            ),
            *of[0], *of[1],
        ]  # fmt: skip
        if number % 5 == 0:
            speeds = {name: speed(reads[k], teeth) for name, (k, teeth) in TEETH.items()}
            expected.append(wire.frame("ETC1", **speeds))
        if number % 10 == 0:
            expected.append(wire.frame("SlowSensors", SupplyPressure=supply, OilTemperature=oil))
        assert board.take_sent() == expected


def test_state_and_sleeves(board: NativeBoard, rng: np.random.Generator) -> None:
    wire = Wire()
    suffixes = [f"{name.title().replace('_', '')}" for name in VALVES]
    for number in range(1, 301):
        brake, clutch = int(rng.choice([65_500, 1 << 16])), int(rng.integers(10_001))
        brake = int(rng.integers(brake - 65_500, brake))
        faults, positions = int(rng.integers(16)), rng.integers(-20_000, 20_001, size=(10, 4))
        scans = (CScan * 10)(*(CScan(tuple(map(int, row)), brake, 0, 4_000, clutch, 0)
                               for row in positions))  # fmt: skip
        energised, pending, refused, expired = map(int, rng.integers(512, size=4))
        report = CReport(int(rng.integers(1 << 32)), energised, pending, refused, expired)
        board.code.frames_send_reads((CEdgeRead * 8)(), 0, scans)
        board.take_sent()
        board.code.frames_send_valves(ctypes.byref(report))
        board.code.frames_send_sleeves(0, scans, faults)
        read = (number - 1) % 15
        flags = {f"{name}{what}": mask >> place & 1
                 for what, mask in (("Energised", energised), ("Pending", pending))
                 for place, name in enumerate(suffixes)}  # fmt: skip
        at = {
            f"{name}{k:02}": half_up(Fraction(int(positions[5 * k, sleeve]), 10))
            for sleeve, name in enumerate(
                ("SleeveFirstSecond", "SleeveCrawlThird", "SleeveSplitter", "SleeveRange")
            )
            for k in (0, 1)
        }
        expected = [
            wire.frame(
                "GearboxState", Read=read, BrakePressure=min(half_up(Fraction(brake, 16)), 4095),
                ClutchPosition=half_up(Fraction(clutch, 10)), RefusedCount=refused & 15,
                ExpiredCount=expired & 15, **flags,
            )
        ]  # fmt: skip
        for place, name in enumerate(("SleevesMainShort", "SleevesAuxShort")[: 2 - number % 2]):
            signals = DATABASE.get_message_by_name(name).signals
            samples = {s.name: at[s.name] for s in signals if s.name in at}
            fault = faults >> 2 * place & 3
            expected.append(wire.frame(name, Read=read & 3, SensorFault=fault, **samples))
        assert board.take_sent() == expected


def heard(board: NativeBoard, frame: Frame) -> CCommand:
    """What the codec makes of a frame."""
    found = CCommand()
    data = frame.data.ljust(64, b"\0")
    taken = CFrame(frame.can_id, len(frame.data), frame.is_extended, frame.is_fd, tuple(data))
    board.code.frames_hear(ctypes.byref(taken), 0, ctypes.byref(found))
    return found


def test_orders(board: NativeBoard, rng: np.random.Generator) -> None:
    wire = Wire()
    names = [f"{name.title().replace('_', '')}Action" for name in VALVES]
    for number in range(300):
        actions, times_us = rng.integers(4, size=9), rng.integers(1 << 32, size=9)
        clutch, timed = int(rng.integers(4)), [v for v in range(9) if actions[v] >= 2]
        for valve in timed[1:]:
            time_us = int(times_us[valve])
            heard(board, wire.frame("ValveTime", Order=number % 15, Valve=valve, Time=time_us))
        orders = dict(zip(names, map(int, actions), strict=True))
        first_us = int(times_us[timed[0]]) if timed else 0
        found = heard(board, wire.frame("ValveOrders", Clutch=clutch, FirstTime=first_us, **orders))
        assert found.has_orders == (number >= 2)
        if found.has_orders:
            assert [order.action for order in found.orders] == list(actions)
            assert [found.orders[v].time_us for v in timed] == [int(times_us[v]) for v in timed]
            assert (found.has_clutch, found.close_clutch) == (clutch in (1, 2), clutch == 2)


class ClassicBench(CommandBench):
    """A board on a classic bus."""

    def __init__(self, board: NativeBoard) -> None:
        self._orders = OrderSender()
        super().__init__(board)

    def frames(self, clutch: ClutchAction | None = None, **orders: Order) -> list[Frame]:
        """ValveTime as often as it takes, and ValveOrders."""
        made = None if clutch is None else ClutchCommand(action=clutch)
        return self._orders.valves(command(orders), made)

    def valve_frame(self, **orders: Order) -> Frame:
        return self.frames(**orders)[-1]

    def command(self, **orders: Order) -> None:
        for frame in self.frames(**orders):
            self.board.receive(frame)


@pytest.fixture
def bench(board: NativeBoard) -> ClassicBench:
    return ClassicBench(board)


def test_every_valve_is_off_within_101_ms_in_random_moments(bench: ClassicBench) -> None:
    go_through_all(bench, ENDS, 800)


def of_no_counter(orders: Frame) -> Frame:
    """Counters go from 0 to 14."""
    data = bytearray(orders.data)
    data[1] |= 15
    e2e_p01_protect(data, CLASSIC_CODECS["ValveOrders"].spec.protected_id, increment_counter=False)
    return orders._replace(data=bytes(data))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda times, orders: [orders],
        lambda times, orders: [times[0]._replace(data=times[0].data[:-1] + b"\x55"), orders],
        lambda times, orders: [*times, orders._replace(data=orders.data[:-1] + b"\x55")],
        lambda times, orders: [*times, orders._replace(data=orders.data + b"\0")],
        lambda times, orders: [*times, orders._replace(is_fd=True)],
        lambda times, orders: [*times, orders._replace(is_extended=False)],
        lambda times, orders: [*times, orders._replace(can_id=orders.can_id + 1)],
        lambda times, orders: [*times, of_no_counter(orders)],
    ],
    ids=["time lost", "time damaged", "CRC", "long", "FD", "11 bits", "other", "counter 15"],
)
def test_orders_that_are_not_whole_do_nothing_and_renew_nothing(
    bench: ClassicBench, spoil: Any
) -> None:
    bench.command(brake=ON)
    bench.wait(40_000)
    due_us = bench.now_us + 1_000
    *times, orders = bench.frames(main_first=(ON_AT, due_us), range_low=(ON_AT, due_us))
    for frame in spoil(times, orders):
        bench.board.receive(frame)
    bench.wait(59_999)
    assert bench.driven == {"brake"}
    bench.wait(1)
    assert bench.driven == set()


def test_orders_that_are_sent_again_and_again_are_those_of_a_sender_that_is_broken(
    bench: ClassicBench,
) -> None:
    due_us = bench.now_us + 1_000
    *times, orders = bench.frames(main_first=(ON_AT, due_us), range_low=(ON_AT, due_us))
    for frame in (*times, orders, orders, orders, orders):
        bench.board.receive(frame)
    bench.wait(1_000)
    assert bench.driven == {"main_first", "range_low"}
    bench.command(brake=ON)
    assert bench.driven == {"main_first", "range_low"}


def test_a_time_of_earlier_orders_is_of_no_use(bench: ClassicBench) -> None:
    """Fifteen orders later they have the same counter."""
    due_us = bench.now_us + 20_000
    times, _ = bench.frames(main_first=(ON_AT, due_us), range_low=(ON_AT, due_us))
    bench.board.receive(times)
    for _ in range(14):
        bench.command(brake=ON)
    bench.board.receive(bench.frames(main_first=(ON_AT, due_us), range_low=(ON_AT, due_us))[-1])
    bench.wait(20_000)
    assert bench.driven == {"brake"}


def test_the_clutch_does_as_ordered_and_opens_100_ms_after_the_last_order(
    bench: ClassicBench,
) -> None:
    for clutch in (ClutchAction.CLOSE, None):
        for frame in bench.frames(clutch, brake=ON):
            bench.board.receive(frame)
        assert bench.memory.is_clutch_closed
        bench.wait(45_000)
    bench.command(brake=ON)
    bench.wait(9_999)
    assert bench.memory.is_clutch_closed
    bench.wait(1)
    assert not bench.memory.is_clutch_closed
    assert bench.driven == {"brake"}


def bus(setup: Setup) -> list[tuple[int, Frame]]:
    """Every frame of a run, and when it was through."""
    seen: list[tuple[int, Frame]] = []
    simulate(setup, lambda time_us, frame: seen.append((time_us, frame)))
    return seen


def test_every_frame_on_a_classic_bus_is_the_same_with_the_firmware_and_without(
    board: NativeBoard,
) -> None:
    alone = Setup(SHEET, ControllerSettings(), seed=2, shifts=1, wire=WireProfile.CLASSIC)
    assert bus(replace(alone, firmware=Firmware.NATIVE)) == bus(alone)


def test_simulate_makes_shifts_with_the_firmware_on_a_classic_bus(
    board: NativeBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--shifts", "1", "--json", "-", "--firmware", "native", "--profile", "classic")
    assert main(["simulate", *options]) == 0
    (row,) = json.loads(capsys.readouterr().out)["shifts"]
    assert (row["result"], row["fault"]) == ("engaged", "none")
