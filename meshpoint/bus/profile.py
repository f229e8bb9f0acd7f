"""Which frames a bus carries: the two profiles of the wire contract."""

from __future__ import annotations

from enum import StrEnum


class WireProfile(StrEnum):
    """A profile of the wire contract."""

    FD = "fd"
    """CAN FD, 500 kbit/s and 2 Mbit/s: meshpoint.dbc."""
    CLASSIC = "classic"
    """Classic CAN, 500 kbit/s, frames of 8 bytes: meshpoint_classic.dbc."""
