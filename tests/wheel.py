"""A sensor wheel with known edges and the frames that a capture unit makes of them."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from meshpoint.dbc.messages import EdgesMainFall, EdgesMainRise
from meshpoint.dbc.sensor_time import wrap

STAMPS = 27
LONG_US = 65_535
READ_US = 10_000


@dataclass(frozen=True)
class Wheel:
    """Rising edge k of the wheel, k = first, first + 1, ..., comes at rise_us[k - first]; its
    falling edge at fall_us[k - first], before the next rising one. Unwrapped sensor time."""

    first: int
    rise_us: Sequence[int]
    fall_us: Sequence[int]
    fall_number_ahead: int = 0
    """The capture unit's falling edges may be numbered ahead: it woke between two edges."""

    def rise(self, read_us: int) -> EdgesMainRise:
        return EdgesMainRise(**capture(self.rise_us, self.first, read_us))

    def fall(self, read_us: int) -> EdgesMainFall:
        return EdgesMainFall(**capture(self.fall_us, self.first + self.fall_number_ahead, read_us))

    def angle_of(self, duty_share: float) -> dict[int, float]:
        """Angle in pitches of every edge by its time."""
        angles = {t: float(self.first + i) for i, t in enumerate(self.rise_us)}
        return angles | {t: self.first + i + duty_share for i, t in enumerate(self.fall_us)}


def capture(edges_us: Sequence[int], first: int, read_us: int) -> dict[str, object]:
    """The capture array of thesis figure 2.2 at a read: what the DBC says its fields hold."""
    seen = bisect_right(edges_us, read_us)
    times = list(edges_us[max(0, seen - STAMPS) : seen])[::-1]
    gaps = [late - early for late, early in itertools.pairwise(times)]
    low = [t & 0xFFFF for t in times]
    return {
        "read_time_us": wrap(read_us),
        "newest_index": (first + seen - 1) & 0xFFFF,
        "valid_stamps": len(times),
        "long_interval": any(gap > LONG_US for gap in gaps),
        "stopped": bool(times) and read_us - times[0] > LONG_US,
        "timestamp_low_us": tuple(low + [0] * (STAMPS - len(low))),
    }
