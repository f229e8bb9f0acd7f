"""The interval of a rate. scipy's `binomtest` has it for whole numbers alone; shifts of one gearbox
go together and count as a broken number of independent ones."""

from __future__ import annotations

import math
from typing import Final

Z_95: Final = 1.959964


def wilson(hits: float, trials: float) -> tuple[float, float]:
    """95 % interval of a rate (Wilson 1927): meaningful at 0, at 1 and for few trials."""
    if trials <= 0:
        return 0.0, 1.0
    rate, z2 = hits / trials, Z_95 * Z_95
    middle = (rate + z2 / (2 * trials)) / (1 + z2 / trials)
    half = Z_95 / (1 + z2 / trials)
    half *= math.sqrt(rate * (1 - rate) / trials + z2 / (4 * trials * trials))
    return max(0.0, middle - half), min(1.0, middle + half)
