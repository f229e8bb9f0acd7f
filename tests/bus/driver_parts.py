"""Cores, a bus and a node in the background, for tests of a live node."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

import can
from patience import HANG_S, until_async

from meshpoint.bus.clock import Clock
from meshpoint.bus.core import Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.dbc.frame import Frame

PERIOD_US = 10_000
LAST = Frame(0x18FF0001, b"off")


class Metronome:
    """A core that sends the number of its step every 10 ms, and keeps what it receives."""

    def __init__(self, address: int = 1) -> None:
        self.address = address
        self.next_step_us = 0
        self.times_us: list[int] = []
        self.received: list[Frame] = []
        self.shut_down = 0

    def receive(self, frame: Frame) -> None:
        self.received.append(frame)

    def step(self, now_us: int) -> Step:
        assert not self.shut_down, "stepped after its end"
        self.times_us.append(now_us)
        self.next_step_us += PERIOD_US
        data = len(self.times_us).to_bytes(8, "big")
        return Step([Frame(0x18FF0000 | self.address, data)], [])

    def shutdown(self, now_us: int) -> Step:
        self.shut_down += 1
        return Step([LAST], ["valves off"])


class Counting(Metronome):
    """Says when it has made this many steps."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.steps = steps
        self.made = asyncio.Event()

    def step(self, now_us: int) -> Step:
        step = super().step(now_us)
        if len(self.times_us) == self.steps:
            self.made.set()
        return step


class Responder(Metronome):
    """Wants to be stepped at once when a frame comes, and answers it then; else sleeps."""

    def step(self, now_us: int) -> Step:
        self.times_us.append(now_us)
        self.next_step_us = now_us + 60_000_000
        answers = [Frame(0x18FF0002, frame.data) for frame in self.received]
        self.received.clear()
        return Step(answers, [])

    def receive(self, frame: Frame) -> None:
        self.received.append(frame)
        self.next_step_us = 0


class ScriptedBus(can.BusABC):
    """A bus without file descriptor, whose messages and errors a test decides."""

    def __init__(
        self, messages: tuple[can.Message, ...] = (), send_error: Exception | None = None
    ) -> None:
        self.messages = list(messages)
        self.send_error = send_error
        self.sent: list[can.Message] = []
        super().__init__(channel="scripted")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.messages:
            return self.messages.pop(0), True
        time.sleep(min(timeout or 0.0, 0.01))
        return None, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(msg)


class Run:
    """A node running in the background of a test."""

    def __init__(self, core: Any, open_bus: Callable[[], can.BusABC], **options: Any) -> None:
        self.core = core
        self.events: list[str] = []
        self.stop = asyncio.Event()
        self.statistics = NodeStatistics()
        self.task = asyncio.ensure_future(
            run_node(
                core,
                open_bus,
                options.pop("clock", None) or Clock(),
                on_event=self.events.append,
                stop=self.stop,
                name="node",
                statistics=self.statistics,
                **options,
            )
        )

    async def until(self, condition: Callable[[], object]) -> None:
        def holds() -> object:
            assert not self.task.done(), self.task
            return condition()

        await until_async(holds, "what the node should come to", say=lambda: self.events)

    async def end(self, limit_s: float | None = HANG_S) -> NodeStatistics:
        self.stop.set()
        return await asyncio.wait_for(self.task, limit_s)

    async def end_in_fake_time(self) -> NodeStatistics:
        """Without a limit: it would come at once while a thread closes the bus."""
        return await self.end(None)


def virtual(channel: str) -> can.BusABC:
    return can.Bus(channel=channel, interface="virtual", ignore_config=True)
