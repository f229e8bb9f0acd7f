"""A capture as a log of our bus: its edges in the edge frames of one shaft, one read each 10 ms."""

from __future__ import annotations

from typing import Final

from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.dbc.edges import EDGES
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.node import Node
from meshpoint.logs.capture_files import Capture
from meshpoint.logs.captures import READ_US, read_frame
from meshpoint.units import SECOND_US

FIRST_READ_US: Final = 1 << 20
"""Sensor time of the first read: frames want a past."""


def write_capture(log: LogWriter, capture: Capture, shaft: str) -> int:
    """Writes both polarities' frames of a shaft; returns how many. Edges keep their distances; the
    first one comes at the first read. LogError where the log cannot be written."""
    transmitter = Transmitter(Node.GEARBOX_IO)
    first_us = int(min([*capture.rise_us[:1], *capture.fall_us[:1]]))
    last_us = int(max([*capture.rise_us[-1:], *capture.fall_us[-1:]]))
    moved_us = FIRST_READ_US - first_us
    edges = [
        (message, [t + moved_us for t in edges_us.tolist()])
        for message, edges_us in zip(EDGES[shaft], (capture.rise_us, capture.fall_us), strict=True)
    ]
    reads = range(FIRST_READ_US, last_us + moved_us + 2 * READ_US, READ_US)
    for read_us in reads:
        for message, edges_us in edges:
            frame = read_frame(edges_us, read_us)
            values = frame._asdict()
            # The running number of the newest edge; there is none before the first.
            values["newest_index"] = (frame.newest_index - 1) & 0xFFFF if frame.valid_stamps else 0
            log.write(read_us / SECOND_US, transmitter.encode(message(**values)))
    return 2 * len(reads)
