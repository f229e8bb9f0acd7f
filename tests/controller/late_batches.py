"""What both crossing-time filters do with a batch of edges of before their state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from meshpoint.controller.estimation.crossing_layout import DONE, LATE, FilterMemory
from meshpoint.controller.records import Vector

EVERYTHING: Final = (
    "time_us", "x", "p", "restless", "nis", "log_variance", "held", "next",
)  # fmt: skip


def after(memory: FilterMemory, *fields: str) -> list[list[float]]:
    """These parts of a filter's memory; without any named, all that a batch may change."""
    return [memory.part(name).ravel().tolist() for name in fields or EVERYTHING]


def refuses_what_was_before_its_state(
    a_memory: Callable[[], FilterMemory],
    run: Callable[[FilterMemory, Vector], int],
    fine_rad: float,
) -> None:
    """`a_memory`: a filter at 1 ms; `fine_rad`: an angle to be expected at 5 ms."""
    for first_us, refused in ((999.0, True), (1000.0, False)):
        edges, fine = (
            np.array([[first_us, 5000.0], [7.0, fine_rad]]),
            np.array([[5000.0], [fine_rad]]),
        )
        for held in (0, 1):
            memory, other = a_memory(), a_memory()
            memory.held[0] = other.held[0] = held
            before = after(memory)
            answer = run(memory, edges)
            assert answer == (LATE if refused and held else DONE)
            if answer == LATE:
                assert after(memory) == before
            else:
                run(other, fine)
                assert after(memory) == after(other)
                assert memory.time_us[0] == 5000.0
