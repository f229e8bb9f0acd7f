"""A node's timers: what is due within a millisecond comes within it, on a machine that lets it."""

from __future__ import annotations

import asyncio
import sys
import time

import pytest

from meshpoint.bus.fine_timers import run

SHORT_S = 0.0003


@pytest.mark.skipif(sys.platform == "win32", reason="the loop of Windows has its own granularity")
def test_a_timer_of_a_third_of_a_millisecond_takes_no_millisecond() -> None:
    """The best of a hundred: whole milliseconds, rounded up, would make each take one or more."""

    async def sleeps_s() -> list[float]:
        taken = []
        for _ in range(100):
            begin = time.perf_counter()
            await asyncio.sleep(SHORT_S)
            taken.append(time.perf_counter() - begin)
        return taken

    assert SHORT_S <= min(run(sleeps_s())) < 0.0008


def test_it_returns_and_raises_what_the_coroutine_does() -> None:
    async def says(value: int) -> int:
        if value < 0:
            raise ValueError(value)
        return value

    assert run(says(3)) == 3
    with pytest.raises(ValueError, match="-1"):
        run(says(-1))
