"""Sensor time: 32-bit microseconds on the wire, unwrapped to integers that never wrap."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import EdgesInputRise

WRAP: Final = 1 << 32
HALF: Final = 1 << 31
LOW: Final = 0xFFFF
READ_CYCLE_US: Final = CODECS[EdgesInputRise.__name__].spec.cycle_time_us
"""From one read of the sensors to the next: no shorter tick sees more of them."""


def unwrap(stamp: int, near: int) -> int:
    """The time congruent to the 32-bit `stamp` that lies nearest to `near`."""
    return near + ((stamp - near + HALF) & (WRAP - 1)) - HALF


def chained_us(read_us: int, lows: Iterable[int]) -> list[int]:
    """Times of a wheel's edges, newest first, from the low 16 bits of each: the newest lies before
    the read, each other one before the one behind it (docs/wire.md)."""
    times, time_us = [], read_us
    for low in lows:
        time_us -= (time_us - low) & LOW
        times.append(time_us)
    return times


def wrap(time_us: int) -> int:
    """The low 32 bits of a time, as in frames."""
    return time_us & (WRAP - 1)
