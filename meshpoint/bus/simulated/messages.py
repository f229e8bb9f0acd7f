"""A python-can message as a frame on the wire, and back."""

from __future__ import annotations

import can

from meshpoint.bus.simulated.frame_bits import WireFrame, check_frame, fd_length


def wire_frame_of(message: can.Message) -> WireFrame:
    """The frame that a message asks for; FD data are padded with zeros to a length that CAN FD has.

    ValueError for one that no CAN bus could carry."""
    data = bytes(message.data)
    if message.is_fd and len(data) <= 64:
        data = data.ljust(fd_length(len(data)), b"\0")
    frame = WireFrame(
        message.arbitration_id,
        b"" if message.is_remote_frame else data,
        message.is_fd,
        message.is_extended_id,
        message.is_fd and message.bitrate_switch,
        message.is_remote_frame,
        message.is_fd and message.error_state_indicator,
        message.dlc if message.is_remote_frame else None,
    )
    check_frame(frame)
    return frame


def message_of(frame: WireFrame, time_s: float, channel: str, is_own: bool) -> can.Message:
    """The message of a frame that was on the wire at a time (s)."""
    return can.Message(
        timestamp=time_s,
        arbitration_id=frame.can_id,
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
        is_fd=frame.is_fd,
        bitrate_switch=frame.is_fd and frame.bitrate_switch,
        error_state_indicator=frame.is_fd and frame.error_state,
        is_rx=not is_own,
        channel=channel,
        dlc=frame.dlc if frame.is_remote else len(frame.data),
        data=None if frame.is_remote else frame.data,
    )
