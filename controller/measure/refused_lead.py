"""More lead for activations, after the valve side has refused one because it came late.

On a machine that is late, or a bus that is full, the least delay seen of a read is too large as
well, so the sensor clock is thought to be further behind than it is. A refusal is the proof: until
some time without one, activations are sent a tick earlier, and after another refusal two.
"""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.messages import ValveStatus

MOST_TICKS: Final = 3
KEPT_US: Final = 10_000_000
"""So long after a refusal."""


class RefusedLead:
    """Counts refusals, by the valve side's own count."""

    def __init__(self, tick_us: int) -> None:
        self._tick_us = tick_us
        self._refused: int | None = None
        self._refused_us = 0
        self.more_us = 0
        """How much earlier activations are to be sent."""

    def take(self, status: ValveStatus | None, now_us: int) -> bool:
        """The newest status of the valves; returns whether it shows a refusal since the one
        before."""
        if self.more_us and now_us - self._refused_us > KEPT_US:
            self.more_us = 0
        if status is None:
            return False
        before, self._refused = self._refused, status.refused_count
        if before in (None, self._refused):
            return False
        self._refused_us = now_us
        self.more_us = min(self.more_us + self._tick_us, MOST_TICKS * self._tick_us)
        return True
