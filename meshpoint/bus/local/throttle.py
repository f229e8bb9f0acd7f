"""Who has to wait when a node sends faster than the others read: the one that floods the bus.

Without this, the frames of a flooding node pile up for all others until the hub throws them off.
"""

FAIR_BYTES_S = 1_000_000
"""What a node may always send: 12,000 frames of 64 bytes a second, over twice what fits on CAN FD
with 2 Mbit/s. More than that is passed on as long as nobody falls behind."""
BURST_BYTES = 256 * 1024
"""A node that was quiet may send so much at once."""
BEHIND_BYTES = 64 * 1024
"""With so much waiting for it a node is behind, and those that flood wait for it."""
CAUGHT_UP_BYTES = 16 * 1024
STALLED_S = 1.0
"""A node that has read nothing for so long is not waited for: what it leaves unread ends it."""
LOOK_S = 0.002
"""How often it is looked whether those that are behind have caught up."""


class Allowance:
    """What a sender has left of its fair share."""

    def __init__(self, now_s: float) -> None:
        self._left_bytes = float(BURST_BYTES)
        self._at_s = now_s

    def spend(self, sent_bytes: int, now_s: float) -> bool:
        """It has sent this; whether that is within its share."""
        earned = (now_s - self._at_s) * FAIR_BYTES_S
        left = min(self._left_bytes + earned, float(BURST_BYTES)) - sent_bytes
        # What it owes is bounded, so that after a flood it is soon heard like any other.
        self._left_bytes, self._at_s = max(left, -float(BURST_BYTES)), now_s
        return left >= 0.0


class ReaderProgress:
    """Whether a node reads what it is sent."""

    def __init__(self, now_s: float) -> None:
        self._passed_on = 0
        self._read = 0
        self._moved_s = now_s
        self._is_behind = False

    def sent(self, sent_bytes: int) -> None:
        """So much more has been put in its queue."""
        self._passed_on += sent_bytes

    def is_behind(self, waiting_bytes: int, now_s: float) -> bool:
        """Whether those that flood have to wait for it, with so much in its queue now."""
        read = self._passed_on - waiting_bytes
        if read != self._read or waiting_bytes <= CAUGHT_UP_BYTES:
            self._read, self._moved_s = read, now_s
        limit = CAUGHT_UP_BYTES if self._is_behind else BEHIND_BYTES
        self._is_behind = waiting_bytes > limit
        return self._is_behind and now_s - self._moved_s < STALLED_S
