"""A CAN frame as the pure cores see it."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """One CAN frame; it carries no time, because what a frame says about time is inside it.

    `can_id` has 29 bits, or 11 when `is_extended` is false; `data` is the payload without padding.
    """

    can_id: int
    data: bytes
    is_fd: bool = True
    is_extended: bool = True
