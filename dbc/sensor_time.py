"""Sensor time: 32-bit microseconds on the wire, unwrapped to integers that never wrap."""

from __future__ import annotations

from typing import Final

WRAP: Final = 1 << 32
HALF: Final = 1 << 31


def unwrap(stamp: int, near: int) -> int:
    """The time congruent to the 32-bit `stamp` that lies nearest to `near`."""
    return near + ((stamp - near + HALF) & (WRAP - 1)) - HALF


def wrap(time_us: int) -> int:
    """The low 32 bits of a time, as in frames."""
    return time_us & (WRAP - 1)
