"""A python-can message as the cores see it."""

from __future__ import annotations

import can

from meshpoint.dbc.frame import Frame


def frame_of(message: can.Message) -> Frame:
    """The frame that a data message carries."""
    return Frame(message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id)
