"""What the analogue inputs read as: each step of the wire, the ends of the range, broken wires."""

from __future__ import annotations

import ctypes

import pytest
from structures import CScan

from meshpoint.firmware.native_board import NativeBoard

FULL = 4095 * 16
SLEEVES = range(4)
BRAKE, SUPPLY, OIL, CLUTCH = range(4, 8)
RANGES = [(-20_000, 40_000)] * 4 + [(0, 50_000)] * 2 + [(4_000, 26_000), (0, 10_000)]
"""In steps of the wire: at 10 % of full scale, and from there to 90 % (docs/bench.md)."""


def scan(board: NativeBoard, readings: list[int]) -> CScan:
    found = CScan()
    board.code.transmitters_scale((ctypes.c_uint16 * 8)(*readings), ctypes.byref(found))
    return found


def values(found: CScan) -> list[int]:
    return [*found.sleeve_um, found.brake_20pa, found.supply_20pa, found.oil_centidegree,
            found.clutch_basispoint]  # fmt: skip


def reading(share: float) -> int:
    """Of full scale, as the converter has it."""
    return round(FULL * share)


def test_each_value_of_the_wire_is_read_to_its_step(board: NativeBoard) -> None:
    for part in range(5_001):
        wanted = [low + span * part // 5_000 for low, span in RANGES]
        shares = [(value - low) / span for value, (low, span) in zip(wanted, RANGES, strict=True)]
        found = scan(board, [reading(0.1 + 0.8 * share) for share in shares])
        assert values(found) == wanted
        assert found.bad_sleeves == 0


def test_no_two_readings_are_out_of_order(board: NativeBoard) -> None:
    before = values(scan(board, [0] * 8))
    for step in range(1, FULL, 13):
        now = values(scan(board, [step] * 8))
        assert all(a <= b for a, b in zip(before, now, strict=True)), step
        before = now


@pytest.mark.parametrize("share", [0.0, 0.02, 0.049, 0.951, 1.0])
@pytest.mark.parametrize("sleeve", SLEEVES)
def test_a_sleeve_whose_wire_is_broken_or_shorted_says_so(
    board: NativeBoard, sleeve: int, share: float
) -> None:
    readings = [reading(0.5)] * 8
    readings[sleeve] = reading(share)
    assert scan(board, readings).bad_sleeves == 1 << sleeve


@pytest.mark.parametrize("channel", [BRAKE, SUPPLY, OIL, CLUTCH])
def test_below_its_range_a_transmitter_reads_as_its_least_value(
    board: NativeBoard, channel: int
) -> None:
    readings = [reading(0.5)] * 8
    readings[channel] = 0
    found = scan(board, readings)
    assert values(found)[channel] == RANGES[channel][0]
    assert found.bad_sleeves == 0
