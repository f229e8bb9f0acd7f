"""The messages of our wire contract as traffic: their longest frames and least intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from meshpoint.bus.simulated.frame_bits import (
    INTERMISSION_BITS,
    BitTiming,
    WireFrame,
    arbitration_key,
    longest,
)
from meshpoint.bus.simulated.response_time import Traffic
from meshpoint.dbc.node import Node
from meshpoint.dbc.schema import SCHEMA
from meshpoint.dbc.specs import MessageSpec

STEP_NS: Final = 10_000_000
"""An event message comes once a step of its sender at most."""
AT_ONCE: Final = {"ReferenceEngagement": 3}
"""Of an event message: how many of one step."""
PROBE_NS: Final = 1_000_000_000
"""The controller makes a step more once a second, to measure the delay of the bus."""
JITTER_NS: Final = 1_000_000
"""How late a node's step may be against its period."""
RIG_QUEUES: Final = {
    **{node: str(node) for node in Node},
    Node.ENGINE: str(Node.GEARBOX_IO),
    Node.REFERENCE: str(Node.GEARBOX_IO),
}
"""The rig plays gearbox, engine and reference, on one queue."""


def wire_frame(spec: MessageSpec) -> WireFrame:
    """A frame of the message, with zeros as data."""
    return WireFrame(spec.can_id, bytes(spec.length), spec.is_fd, bitrate_switch=spec.is_fd)


def contract_traffic(
    timing: BitTiming | None = None,
    queues: Mapping[Node, str] | None = None,
    jitter_ns: int = JITTER_NS,
) -> list[Traffic]:
    """All messages of the DBC by priority; `queues`: which nodes share one (none do)."""
    timing = timing or BitTiming()
    found = []
    for spec in SCHEMA.messages:
        frame = wire_frame(spec)
        bits_ns = longest(frame).duration_ns(timing) + INTERMISSION_BITS * timing.nominal_ns
        found.append(
            Traffic(
                spec.name,
                arbitration_key(frame),
                str(spec.sender) if queues is None else queues[spec.sender],
                bits_ns,
                spec.cycle_time_us * 1000 if spec.is_cyclic else STEP_NS,
                jitter_ns + (AT_ONCE.get(spec.name, 1) - 1) * STEP_NS,
                PROBE_NS if spec.sender is Node.TRANSMISSION_CONTROL else None,
            )
        )
    return sorted(found, key=lambda message: message.key)
