"""The edge array against a plain reading of the wire contract, on edges with unbounded times."""

from __future__ import annotations

import ctypes
import random
from itertools import pairwise

import pytest
from firmware_bench import AT_REST, CommandBench
from structures import CEdgeChannel, CEdgeRead

from meshpoint.dbc.messages import EdgesInputFall, EdgesMainRise, GearboxSensors, SleevesAux
from meshpoint.firmware.board import Analogue
from meshpoint.firmware.native_board import NativeBoard

READ_US, LONG_US, STAMPS, WRAP = 10_000, 0xFFFF, 27, 1 << 32
HOUR_US = 3_600_000_000
GAPS_US = [150, 900, 2_000, 9_999, 10_000, 50_000, LONG_US, LONG_US + 1, 70_000, 3_000_000]


def expected(edges_us: list[int], on_us: int, now_us: int) -> tuple[object, ...]:
    """What docs/wire.md and the DBC want a frame to say, from all edges since power-on."""
    newest = edges_us[::-1][:STAMPS]
    gaps_us = [a - b for a, b in pairwise(newest)]
    stamps = [stamp & 0xFFFF for stamp in newest]
    stopped = now_us - (newest[0] if newest else on_us) > LONG_US
    return (len(edges_us) & 0xFFFF, len(newest), any(gap > LONG_US for gap in gaps_us), stopped,
            stamps + [0] * (STAMPS - len(stamps)))  # fmt: skip


def said(board: NativeBoard, channel: CEdgeChannel, now_us: int) -> tuple[object, ...]:
    read = CEdgeRead()
    board.code.edges_read(ctypes.byref(channel), now_us % WRAP, ctypes.byref(read))
    assert read.read_us == now_us % WRAP
    return (read.newest_index, read.valid_stamps, read.long_interval, read.stopped,
            list(read.stamps_us))  # fmt: skip


def test_reads_say_what_the_contract_wants_through_wraps_and_standstills(
    board: NativeBoard,
) -> None:
    rng = random.Random(3)
    for _ in range(40):
        now_us = on_us = rng.randrange(WRAP)
        channel, edges_us = CEdgeChannel(), []
        board.code.edges_power_on(ctypes.byref(channel), on_us % WRAP)
        next_us = now_us + rng.choice(GAPS_US)
        pace_us = rng.choice(GAPS_US)
        for _ in range(120):
            now_us += READ_US
            while next_us <= now_us:
                edges_us.append(next_us)
                board.code.edges_capture(ctypes.byref(channel), next_us % WRAP)
                next_us += pace_us if rng.random() < 0.9 else rng.choice(GAPS_US)
            assert said(board, channel, now_us) == expected(edges_us, on_us, now_us)


@pytest.mark.parametrize("edges", [0, 1, 30])
@pytest.mark.parametrize("stands_us", [WRAP - 30_000, WRAP, WRAP + 30_000, 3 * WRAP])
def test_a_standstill_as_long_as_the_clocks_range_is_no_short_one(
    board: NativeBoard, edges: int, stands_us: int
) -> None:
    on_us = WRAP - 5_000
    channel, at = CEdgeChannel(), None
    at = ctypes.byref(channel)
    board.code.edges_power_on(at, on_us)
    edges_us = [on_us + 1_000 * (place + 1) for place in range(edges)]
    for edge_us in edges_us:
        board.code.edges_capture(at, edge_us % WRAP)
    last_us = edges_us[-1] if edges_us else on_us
    now_us = last_us + stands_us
    for watched_us in range(last_us, now_us, HOUR_US):
        board.code.edges_watch(at, watched_us % WRAP)
    assert said(board, channel, now_us) == expected(edges_us, on_us, now_us)
    edges_us.append(now_us + 10)
    board.code.edges_capture(at, edges_us[-1] % WRAP)
    now_us += READ_US
    assert said(board, channel, now_us) == expected(edges_us, on_us, now_us)


def test_an_edge_after_the_read_waits_for_the_next_one(bench: CommandBench) -> None:
    now_us = bench.now_us
    bench.board.capture(1, [now_us - 5, now_us, now_us + 1])
    first = bench.read()["EdgesInputFall"]
    assert isinstance(first, EdgesInputFall)
    assert (first.newest_index, first.timestamp_low_us[0]) == (2, now_us & 0xFFFF)
    bench.wait(READ_US)
    assert bench.read()["EdgesInputFall"].newest_index == 3


def test_a_wheel_without_a_good_signal_says_so_and_the_others_go_on(bench: CommandBench) -> None:
    bench.memory.bad_wheels = 1 << 2
    bench.board.capture(0, [bench.now_us - 10])
    read = bench.read()
    faults = {name for name, message in read.items() if getattr(message, "sensor_fault", 0)}
    assert faults == {"EdgesMainRise", "EdgesMainFall"}
    assert read["EdgesInputRise"].newest_index == 1


def test_noise_on_a_wheel_says_so_and_the_others_go_on(bench: CommandBench) -> None:
    now_us = bench.now_us
    bench.board.capture(4, [now_us - 2_000 + 5 * place for place in range(300)])
    bench.board.capture(6, [now_us - 10])
    read = bench.read()
    assert isinstance(read["EdgesMainRise"], EdgesMainRise)
    assert read["EdgesMainRise"].sensor_fault
    assert not read["EdgesPropellerRise"].sensor_fault
    assert read["EdgesPropellerRise"].newest_index == 1


def test_a_sleeve_out_of_range_says_so_and_is_at_its_end(bench: CommandBench) -> None:
    samples = [[0] * 10, [0] * 10, [0] * 9 + [25_000], [-25_000] + [0] * 9]
    bench.board.take_sent()
    bench.board.read(Analogue(samples, AT_REST.slow, bad_sleeves=1))
    found = bench.sent()
    aux = found["SleevesAux"]
    assert isinstance(aux, SleevesAux)
    assert (found["SleevesMain"].sensor_fault, aux.sensor_fault) == (1, 3)
    assert aux.sleeve_splitter_m[9] == pytest.approx(0.02)
    assert aux.sleeve_range_m[0] == pytest.approx(-0.02)


def test_a_slow_sensor_out_of_range_is_at_its_end(bench: CommandBench) -> None:
    bench.board.take_sent()
    bench.board.read(Analogue(AT_REST.sleeves, (0, 65_535, 65_535, 65_535)))
    slow = bench.sent()["GearboxSensors"]
    assert isinstance(slow, GearboxSensors)
    assert (slow.oil_temperature_k, slow.clutch_position_fraction) == pytest.approx((473.15, 1.0))


def test_a_board_that_is_switched_on_again_has_empty_arrays(bench: CommandBench) -> None:
    bench.board.capture(0, [bench.now_us - 10])
    assert bench.read()["EdgesInputRise"].valid_stamps == 1
    bench.board.power_on(bench.now_us)
    read = bench.read()["EdgesInputRise"]
    assert (read.newest_index, read.valid_stamps) == (0, 0)
