"""A node's timers: what is due within a millisecond comes within it, on a machine that lets it."""

from __future__ import annotations

import asyncio
import select
import selectors
import sys

import pytest

from meshpoint.bus.fine_timers import run

SHORT_S = 0.0003


@pytest.mark.skipif(sys.platform == "win32", reason="the loop of Windows has its own granularity")
def test_a_timer_of_a_third_of_a_millisecond_waits_for_no_whole_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the operating system is asked to wait: epoll takes whole milliseconds, rounded up."""
    asked_s: list[float] = []

    def recorded(read: object, write: object, both: object, timeout: float | None = None) -> object:
        if timeout:
            asked_s.append(timeout)
        return select.select(read, write, both, timeout)  # type: ignore[call-overload]

    monkeypatch.setattr(selectors.SelectSelector, "_select", staticmethod(recorded))
    run(asyncio.sleep(SHORT_S))
    assert asked_s, "the loop did not wait by select"
    assert 0.0 < max(asked_s) <= SHORT_S


def test_it_returns_and_raises_what_the_coroutine_does() -> None:
    async def says(value: int) -> int:
        if value < 0:
            raise ValueError(value)
        return value

    assert run(says(3)) == 3
    with pytest.raises(ValueError, match="-1"):
        run(says(-1))
