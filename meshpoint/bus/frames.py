"""A python-can message as the cores see it, and back."""

from __future__ import annotations

import can

from meshpoint.dbc.frame import Frame


def frame_of(message: can.Message) -> Frame:
    """The frame that a data message carries."""
    return Frame(message.arbitration_id, bytes(message.data), message.is_fd, message.is_extended_id)


def message_of(frame: Frame, time_s: float = 0.0, received: bool = False) -> can.Message:
    """The message that carries a frame, an FD frame at the data phase's bit rate."""
    return can.Message(
        timestamp=time_s,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        data=frame.data,
        is_fd=frame.is_fd,
        bitrate_switch=frame.is_fd,
        is_rx=received,
    )
