"""What a live node counts."""

from dataclasses import dataclass, field

_EXACT_BITS = 4  # values below 16 us have a bucket each, above, buckets are 1/8 of the value wide


class Histogram:
    """Counts of non-negative integers, in buckets at most 1/8 of the value wide; bounded memory."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}  # by the largest value of the bucket
        self.total = 0
        self.maximum = 0

    def add(self, value: int) -> None:
        """Counts `value`; a negative one counts as 0."""
        value = max(0, value)
        shift = max(0, value.bit_length() - _EXACT_BITS)
        bucket = ((value >> shift) + 1 << shift) - 1
        self._counts[bucket] = self._counts.get(bucket, 0) + 1
        self.total += 1
        self.maximum = max(self.maximum, value)

    def quantile(self, fraction: float) -> int:
        """An upper bound, at most 1/8 too large, of the smallest value that `fraction` (0..1) of
        all values do not exceed; 0 without values."""
        seen = 0
        for bucket in sorted(self._counts):
            seen += self._counts[bucket]
            if seen >= fraction * self.total:
                return min(bucket, self.maximum)
        return 0


@dataclass
class NodeStatistics:
    """Counts of one run of a node."""

    steps: int = 0
    frames_received: int = 0  # handed to the core
    frames_sent: int = 0
    frames_refused: int = 0  # by the bus: transmit queue full, or no such frame on this device
    frames_discarded: int = 0  # stepped out while there was no bus
    own_address_frames: int = 0  # received with a source address of ours, not handed on
    remote_frames: int = 0  # not handed on
    error_frames: int = 0  # not handed on
    bus_offs: int = 0  # times that the CAN controller has left the bus; SocketCAN alone
    frames_lost: int = 0  # by the kernel, because the node did not read in time; SocketCAN alone
    outages: int = 0
    record_lines_lost: int = 0  # of what is kept beside the log: they could not be written
    lateness_us: Histogram = field(default_factory=Histogram)  # wall us from due time to step
