"""An event loop whose time is not the wall's: it goes on when nothing is left to do, at once.

Timers come exactly when they are due, in whatever time the machine takes for them, so that a test
can count steps and seconds. For cores on a bus that needs no thread (`QuietBus`).
"""

from __future__ import annotations

import asyncio
import selectors
import socket
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import can

T = TypeVar("T")


class _LeapingSelector(selectors.SelectSelector):
    """Instead of waiting for a timer, makes it that time. Without timers it waits for threads."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout is None:
            return super().select()
        ready = super().select(0.0)
        if not ready:
            self.now_s += max(0.0, timeout)
        return ready


class FakeTimeLoop(asyncio.SelectorEventLoop):
    """Begins at 0 s."""

    def __init__(self) -> None:
        self._leaping = _LeapingSelector()
        super().__init__(self._leaping)

    def time(self) -> float:
        return self._leaping.now_s

    def time_ns(self) -> int:
        return round(self._leaping.now_s * 1e9)


def run_in_fake_time(main: Callable[[FakeTimeLoop], Coroutine[Any, Any, T]]) -> T:
    """Runs `main(loop)` to its end in a loop of its own."""
    with asyncio.Runner(loop_factory=FakeTimeLoop) as runner:
        loop = runner.get_loop()
        assert isinstance(loop, FakeTimeLoop)
        return runner.run(main(loop))


class QuietBus(can.BusABC):
    """Keeps what is sent, or refuses it; nothing arrives. It has a descriptor that is never ready,
    so that the driver needs no thread to read it."""

    def __init__(self, send_error: Exception | None = None) -> None:
        self._ends = socket.socketpair()
        self.send_error = send_error
        self.sent: list[can.Message] = []
        super().__init__(channel="quiet")

    def fileno(self) -> int:
        return self._ends[0].fileno()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return None, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(msg)

    def shutdown(self) -> None:
        super().shutdown()
        for end in self._ends:
            end.close()
