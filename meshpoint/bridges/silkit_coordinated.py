"""A coordinated participant of SIL Kit that runs some nodes of a shared bus, window by window.

SIL Kit's steps are the windows of `SharedBus`. In each, frames that nodes hand over go out on the
CAN network at once, for whoever listens; a message of topic `meshpoint/handed` before them says
when in the window that was, for which SIL Kit's CAN has no field. All of a step arrives before the
other participant's next one begins."""

from __future__ import annotations

import asyncio
import struct
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final

from meshpoint.bench.shared_bus import WINDOW_US, HandOver, SharedBus
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bus.core import Step
from meshpoint.bus.silkit.library import NETWORK, Heard, SilKitError, heard, join, library, send
from meshpoint.bus.silkit.library import wire_frame as wire_frame_of
from meshpoint.bus.simulated.frame_bits import WireFrame
from meshpoint.dbc.frame import Frame

TOPIC: Final = "meshpoint/handed"
HEAD: Final = struct.Struct("<QB")
"""Virtual time (us) and node; the identifiers of its frames follow, four bytes each."""
LOOK_S: Final = 0.1
ABORT_S: Final = 5.0
"""How long SIL Kit may take to end a simulation in which somebody is lost; without its system
controller it never does."""


class Announced:
    """What the others have handed over, from their messages and frames in order of arrival."""

    def __init__(self, network: str, own: frozenset[int]) -> None:
        """own: nodes of this participant, which hears its own messages."""
        self._network = network
        self._own = own
        self._messages: deque[bytes] = deque()
        self._frames: deque[Heard] = deque()

    def on_message(self, _subscriber: Any, event: Any) -> None:
        """A handler of the topic."""
        self._messages.append(event.data)

    def on_frame(self, _controller: Any, event: Any) -> None:
        """A handler of the network."""
        self._frames.append(heard(event))

    def before(self, now_us: int) -> list[HandOver]:
        """What was handed over before `now_us`. SilKitError for anything from another sender."""
        taken = []
        while self._messages:
            time_us, node, can_ids = unpack(self._messages[0])
            if time_us >= now_us:
                break
            self._messages.popleft()
            if node in self._own:
                continue
            taken.append(HandOver(time_us, node, [self._frame(can_id) for can_id in can_ids]))
        return taken

    def _frame(self, can_id: int) -> Frame:
        if not self._frames:
            raise SilKitError(f"network {self._network}: frame 0x{can_id:X} has not arrived")
        came = self._frames.popleft()
        if came.can_id != can_id:
            raise self._refusal(came, "neither controller nor rig has sent it")
        try:
            wired = wire_frame_of(came)
        except ValueError as error:
            raise self._refusal(came, str(error)) from error
        return Frame(wired.can_id, wired.data, wired.is_fd, wired.is_extended)

    def _refusal(self, came: Heard, why: str) -> SilKitError:
        return SilKitError(
            f"network {self._network}: frame 0x{came.can_id:X}: {why}; in a run that is the same "
            "to the byte others may only listen"
        )


def pack(handed: HandOver) -> bytes:
    """The message that goes before the frames."""
    ids = [frame.can_id for frame in handed.frames]
    return HEAD.pack(handed.time_us, handed.node) + struct.pack(f"<{len(ids)}I", *ids)


def unpack(message: bytes) -> tuple[int, int, tuple[int, ...]]:
    """Time (us), node and identifiers. SilKitError for what is no such message."""
    count, rest = divmod(len(message) - HEAD.size, 4)
    if count < 1 or rest:
        raise SilKitError(
            f"topic {TOPIC}: message of {len(message)} bytes, allowed are {HEAD.size} and 4 for "
            "each of its frames"
        )
    time_us, node = HEAD.unpack_from(message)
    return time_us, node, struct.unpack_from(f"<{count}I", message, HEAD.size)


class _LeftWaiting(ThreadPoolExecutor):
    """Threads that nobody waits for: one in SIL Kit may never come back."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = Future[Any]()
        threading.Thread(target=lambda: future.set_result(fn(*args, **kwargs)), daemon=True).start()
        return future


class Coordinated:
    """One participant, from when it joins to the end of the simulation."""

    def __init__(self, name: str, registry: str, bus: SharedBus, own: frozenset[int]) -> None:
        """own: the nodes it runs, by their places on the bench.

        SilKitError where it cannot join."""
        silkit = library()
        self._bus = bus
        self._participant = join(name, registry)
        self._lifecycle = self._participant.create_lifecycle_service(
            silkit.LifecycleConfiguration(silkit.OperationMode.Coordinated)
        )
        self._can = self._participant.create_can_controller("can", NETWORK)
        self._announced = Announced(NETWORK, own)
        self._can.add_frame_handler(self._announced.on_frame)
        topic = silkit.PubSubSpec(TOPIC, silkit.media_type_data())
        self._publisher = self._participant.create_data_publisher("handed", topic)
        self._subscriber = self._participant.create_data_subscriber(
            "others", topic, self._announced.on_message
        )
        self._error: Exception | None = None
        self.is_over = False
        """Whether what it was to run until has come."""

    def run(
        self,
        time: VirtualTime,
        until: Callable[[], bool],
        limit_us: int,
        end: Callable[[], Step],
        look: Callable[[], None],
    ) -> None:
        """Runs `time` with the others' until `until()` says so, or until `limit_us`; or until one
        of the others ends the simulation.

        end: makes the last frames. look: called every 0.1 s of wall time; raises what should end
        the simulation, which must then end for this participant, too."""

        def step(now_ns: int, _duration_ns: int) -> None:
            # What a handler raises SIL Kit drops.
            try:
                self._window(now_ns // 1000, time, until, limit_us, end)
            except Exception as error:  # noqa: BLE001
                self._fail(error, end)

        self._lifecycle.set_communication_ready_handler(self._can.start)
        time_sync = self._lifecycle.create_time_sync_service()
        time_sync.set_simulation_step_handler(step, WINDOW_US * 1000)
        asyncio.run(self._until_ended(end, look))
        if self._error is not None:
            raise self._error

    async def _until_ended(self, end: Callable[[], Step], look: Callable[[], None]) -> None:
        asyncio.get_running_loop().set_default_executor(_LeftWaiting())
        ended = asyncio.ensure_future(self._lifecycle.start_lifecycle())
        while not ended.done():
            await asyncio.wait([ended], timeout=LOOK_S)
            try:
                look()
            except Exception as error:  # noqa: BLE001 (whatever has happened to the others)
                self._fail(error, end)
                await asyncio.wait([ended], timeout=ABORT_S)
                return

    def _window(
        self, now_us: int, time: VirtualTime, until: Callable[[], bool], limit_us: int,
        end: Callable[[], Step],
    ) -> None:  # fmt: skip
        handed = self._announced.before(now_us)
        if self.is_over:
            # As much of the last window as there was.
            last_us = time.now_us
            self._bus.begin(last_us + 1, [each for each in handed if each.time_us <= last_us])
            self._send_last(end)
            self._lifecycle.stop("all is done")
            return
        self._bus.begin(now_us, handed)
        window_end_us = min(now_us + WINDOW_US - 1, limit_us)
        self.is_over = time.run(until, window_end_us) or window_end_us == limit_us
        for own in self._bus.handed():
            self._publisher.publish(pack(own))
            self._send(own.frames)

    def _fail(self, error: Exception, end: Callable[[], Step]) -> None:
        if self._error is None:
            self._error = error
            try:
                self._send_last(end)
            finally:
                self._lifecycle.stop(str(error))

    def _send_last(self, end: Callable[[], Step]) -> None:
        """Valves off, for whoever listens: nobody of the run takes them."""
        self._send(end().frames)

    def _send(self, frames: list[Frame]) -> None:
        for can_id, data, is_fd, is_extended in frames:
            send(self._can, WireFrame(can_id, data, is_fd, is_extended, bitrate_switch=is_fd))
