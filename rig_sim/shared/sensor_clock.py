"""The sensor clock: what the capture timer and the valve drivers call time, in microseconds.

It starts at power-up and runs at the rate of the rig's own time, unless a fault makes it drift,
step or start anew. Then it is a line in pieces; the newest few are kept, for edges captured before.

Here it is whole and unwrapped; frames carry its low 32 bits, edges their low 16.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.kernels.structures import RecordArray
from meshpoint.rig_sim.shared.capture_records import PIECES, ClockPieces

PPM: Final = 1e-6


class SensorClock:
    """From microseconds since power-up to the clock, and back.

    `memory` is for `kernels.read_ring`.
    """

    def __init__(self, start_us: int) -> None:
        self.memory = RecordArray(ClockPieces(pieces=((0.0, start_us, 1.0),) * PIECES))
        self._since_us, self._base_us, self._rate = 0.0, start_us, 1.0

    def at(self, time_us: float) -> int:
        """What the clock shows at an instant, rounded down."""
        if time_us >= self._since_us:
            return self._base_us + math.floor((time_us - self._since_us) * self._rate)
        pieces = self.memory.record.pieces[:]
        found = pieces[0]
        for piece in pieces:
            if time_us >= piece.since_us:
                found = piece
        return found.base_us + math.floor((time_us - found.since_us) * found.rate)

    def when(self, clock_us: int) -> float:
        """The instant at which the clock, as it runs now, shows this."""
        return self._since_us + (clock_us - self._base_us) / self._rate

    def step(self, time_us: float, ahead_us: int) -> None:
        """It jumps, forwards or back."""
        self._piece(time_us, self.at(time_us) + ahead_us, self._rate)

    def drift(self, time_us: float, fast_ppm: float) -> None:
        """From now on it runs fast by this much, or slow."""
        self._piece(time_us, self.at(time_us), 1.0 + fast_ppm * PPM)

    def restart(self, time_us: float) -> None:
        """It starts anew at zero."""
        self._piece(time_us, 0, self._rate)

    def _piece(self, time_us: float, clock_us: int, rate: float) -> None:
        self._since_us, self._base_us, self._rate = time_us, clock_us, rate
        pieces = self.memory.record.pieces
        for i in range(PIECES - 1):
            pieces[i] = pieces[i + 1]
        newest = pieces[PIECES - 1]
        newest.since_us, newest.base_us, newest.rate = time_us, clock_us, rate
