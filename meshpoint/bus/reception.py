"""Two ways to learn that frames have arrived: by the event loop, or by a thread.

The event loop watches buses with a file descriptor. All others (python-can's `virtual`, most
vendors') get a thread, because their `recv` has to be waited in. python-can's own Notifier is not
used: it takes one frame a callback, and errors do not reach the caller.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

import can

from meshpoint.bus.local.plugin import MeshpointBus

# A babbling node may fill the queue as fast as we empty it; steps must come in between.
MAX_BATCH = 4096
_THREAD_WAIT_S = 0.05


class Batch(NamedTuple):
    """Messages in the order of arrival, and what went wrong behind the last."""

    messages: list[can.Message]
    error: Exception | None


class Reception(Protocol):
    """Receives from one bus."""

    def take(self) -> Batch:
        """All that has arrived by now; never waits."""

    @property
    def awaits_frames(self) -> bool:
        """Whether frames are known to be on their way, from or to this node."""

    async def stop(self) -> None:
        """Leaves the bus alone. `on_ready` is not called any more."""


def receive_from(bus: can.BusABC, on_ready: Callable[[], None]) -> Reception:
    """Begins receiving from `bus`; `on_ready` is called in the running loop when frames wait."""
    loop = asyncio.get_running_loop()
    try:
        descriptor = bus.fileno()
        if descriptor >= 0:
            loop.add_reader(descriptor, on_ready)
            return _DescriptorReception(bus, descriptor, loop)
    except NotImplementedError:
        pass  # a bus without file descriptor, or a loop that cannot watch one (Windows)
    return _ThreadReception(bus, loop, on_ready)


class _DescriptorReception:
    def __init__(self, bus: can.BusABC, descriptor: int, loop: asyncio.AbstractEventLoop) -> None:
        self._bus = bus
        self._descriptor = descriptor
        self._loop = loop

    def take(self) -> Batch:
        messages: list[can.Message] = []
        try:
            if isinstance(self._bus, MeshpointBus):
                return Batch(self._bus.drain(), None)
            while len(messages) < MAX_BATCH:
                message = self._bus.recv(0.0)
                if message is None:
                    break
                messages.append(message)
        except (can.CanError, OSError) as error:
            return Batch(messages, error)
        return Batch(messages, None)

    @property
    def awaits_frames(self) -> bool:
        return isinstance(self._bus, MeshpointBus) and self._bus.has_frames_on_their_way

    async def stop(self) -> None:
        self._loop.remove_reader(self._descriptor)


class _ThreadReception:
    def __init__(
        self, bus: can.BusABC, loop: asyncio.AbstractEventLoop, on_ready: Callable[[], None]
    ) -> None:
        self._bus = bus
        self._loop = loop
        self._on_ready = on_ready
        self._arrived: deque[can.Message] = deque()
        self._error: Exception | None = None
        self._announced = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="can-reader", daemon=True)
        self._thread.start()

    def take(self) -> Batch:
        # Cleared first: a message that arrives from here on is announced again.
        self._announced = False
        error, self._error = self._error, None
        messages = [self._arrived.popleft() for _ in range(min(len(self._arrived), MAX_BATCH))]
        if self._arrived:
            self._announce()
        return Batch(messages, error)

    @property
    def awaits_frames(self) -> bool:
        return bool(self._arrived)

    async def stop(self) -> None:
        self._ending.set()
        await asyncio.to_thread(self._thread.join)

    def _receive(self) -> None:
        while not self._ending.is_set():
            try:
                message = self._bus.recv(_THREAD_WAIT_S)
            except Exception as error:  # noqa: BLE001 (a vendor's driver may raise anything)
                self._error = error
                self._announce()
                return
            if message is not None:
                self._arrived.append(message)
                self._announce()

    def _announce(self) -> None:
        if not self._announced and not self._ending.is_set():
            self._announced = True
            self._loop.call_soon_threadsafe(self._on_ready)
