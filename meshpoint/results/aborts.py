"""How often a shift's sleeve was stopped short of the teeth, in words."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.messages import ShiftOutcome
from meshpoint.units import MM

TIMES: Final = ("never", "once", "twice")


def halt_mm(outcome: ShiftOutcome) -> float | None:
    """Where the sleeve stood after the last abort, in mm from neutral, negative towards first and
    crawl; None without an abort."""
    return outcome.halt_position_m / MM if outcome.aborts else None


def aborts_words(aborts: int, stood_mm: float | None) -> str:
    """`never`, `once, stood at 3.4 mm`, or of several where it stood last."""
    times = TIMES[aborts] if aborts < len(TIMES) else f"{aborts} times"
    if stood_mm is None:
        return times
    return f"{times}, {'stood' if aborts == 1 else 'last stood'} at {abs(stood_mm):.1f} mm"
