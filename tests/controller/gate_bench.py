"""An edge gate on wheels whose every edge is set by hand.

A tooth takes a millisecond: a microsecond is a thousandth of a pitch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshpoint.controller.records import Integers
from meshpoint.controller.sensing.gate_kernels import gate_edges
from meshpoint.controller.sensing.gate_layout import (
    COUNTING,
    GateMemory,
    new_gate,
    teeth_of,
)

PITCH_RAD = 2.0 * math.pi / 45
NOW = 1_000_000
"""The time of the last edge with a tooth; times below are told from it on (us)."""
WHOLE = teeth_of(45, ())
LEAST = math.sqrt(6.0 * 300.0 / PITCH_RAD) * 1e-6
"""A wheel at this speed, pitches/us, stops within three pitches at 300 rad/s2: 8.8 ms a pitch."""


def sought(duty: float = 0.5, widest: int = 1, pitch_rad: float = PITCH_RAD) -> GateMemory:
    return new_gate(pitch_rad, duty, 300.0, 300.0, widest)


def cruising(**fields: float) -> GateMemory:
    """A whole wheel whose rising edge of tooth 100 has just come."""
    gate = sought()
    values = {
        "mode": COUNTING, "time_us": NOW, "tooth": 100, "falling": 0, "at": 0.0, "lag": 0.0,
        "rate_per_us": 1e-3, "duty": 0.5, "scatter": 0.002, "found_us": 1,
    }  # fmt: skip
    for name, value in (values | fields).items():
        gate.part(name)[0] = value
    gate.last[:] = 100, 99
    gate.part("last_us")[:] = NOW, NOW - 500
    gate.part("interval_us")[:] = 1000.0, 1000.0
    return gate


class Fed(NamedTuple):
    """What the gate made of edges."""

    times: list[int]
    teeth: list[int]
    falling: list[int]
    angles: list[float]
    """In pitches."""
    extra: list[int]
    used: tuple[int, int]


def feed(
    gate: GateMemory, rises: list[int], falls: list[int] | None = None, teeth: Integers = WHOLE,
    first: int = 500,
) -> Fed:  # fmt: skip
    """Edges at these times; the sensor's own numbers begin with `first`."""
    falls = falls or []
    rows = [
        np.array([range(first, first + len(own)), [NOW + each for each in own]], dtype=np.int64)
        for own in (rises, falls)
    ]
    rows = [each if each.shape[1] else np.zeros((2, 1), np.int64) for each in rows]
    gate.given[:] = len(rises), len(falls)
    room = len(rises) + len(falls)
    edges, numbers = np.zeros((2, room)), np.zeros((3, room), np.int64)
    before = gate.extra.item()
    n = gate_edges(gate.flat, teeth, rows[0], rows[1], edges, numbers)
    extra = numbers[2, : gate.extra.item() - before] - NOW
    pitch_rad = gate.part("pitch_rad").item()
    return Fed((edges[0, :n] - NOW).astype(int).tolist(), numbers[0, :n].tolist(),
               numbers[1, :n].tolist(), (edges[1, :n] / pitch_rad).tolist(), extra.tolist(),
               (gate.used.item(0), gate.used.item(1)))  # fmt: skip


def value(gate: GateMemory, name: str) -> float:
    return float(gate.part(name)[0])


def mode(gate: GateMemory) -> int:
    return int(gate.mode[0])


def health(gate: GateMemory) -> tuple[int, int, int, int, int]:
    """Extra, missed, doubts, lost, stops."""
    extra, missed, doubts, lost, stops = (
        int(value(gate, name)) for name in ("extra", "missed", "doubts", "lost", "stops")
    )
    return extra, missed, doubts, lost, stops
