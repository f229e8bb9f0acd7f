"""Frames of a bus that has to be waited for in a thread: none stays behind without a word."""

from __future__ import annotations

import asyncio
import queue
import sys
import threading
from types import FrameType
from typing import Any

import can
import pytest
from patience import HANG_S

from meshpoint.bus.reception import receive_from


class QueueBus:
    """A bus without a file descriptor. Says when its reader has come back for more."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[can.Message] = queue.SimpleQueue()
        self.idle = threading.Event()

    def fileno(self) -> int:
        raise NotImplementedError

    def recv(self, timeout: float) -> can.Message | None:
        if self._waiting.empty():
            self.idle.set()
        try:
            return self._waiting.get(timeout=timeout)
        except queue.Empty:
            return None

    def arrive(self, number: int) -> None:
        """A frame comes in, and its reader has done all that it does about it."""
        self.idle.clear()
        self._waiting.put(can.Message(arbitration_id=number))
        assert self.idle.wait(HANG_S)


class ArrivesAtLine:
    """Lets a frame arrive at each line of a function in turn, one line a call."""

    def __init__(self, bus: QueueBus, function: Any) -> None:
        self._bus, self._code = bus, function.__code__
        self._left = 0
        self.sent = 0
        self.is_past_the_end = False

    def before(self, line: int) -> None:
        """From now on: before the line with this number of the next call."""
        self._left, self.is_past_the_end = line, True
        sys.settrace(self._called)

    def _called(self, frame: FrameType, event: str, _: Any) -> Any:
        return self._line if frame.f_code is self._code else None

    def _line(self, frame: FrameType, event: str, _: Any) -> Any:
        if event in ("line", "return"):
            self._left -= 1
            if self._left < 0:
                sys.settrace(None)
                frame.f_trace = None
                self.is_past_the_end = False
                self.sent += 1
                self._bus.arrive(self.sent)
                return None
        return self._line


@pytest.mark.asyncio
async def test_a_frame_that_arrives_at_any_line_of_taking_others_is_told_of() -> None:
    bus, reported = QueueBus(), asyncio.Event()
    reception = receive_from(bus, reported.set)  # type: ignore[arg-type]
    arrives = ArrivesAtLine(bus, type(reception).take)
    taken, line = 0, 0
    while not arrives.is_past_the_end:
        bus.arrive(0)
        await asyncio.sleep(0)
        assert reported.is_set()
        arrives.before(line)
        while reported.is_set():
            reported.clear()
            taken += len(reception.take().messages)
            sys.settrace(None)
            await asyncio.sleep(0)
        line += 1
        assert taken == line + arrives.sent
    assert line > 4
    await reception.stop()
