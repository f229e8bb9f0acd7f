"""The live driver: runs any core on a python-can bus, in asyncio.

It decides nothing. It reads the clock once a turn, hands over all frames that have arrived, steps
the core when a step is due, and sends what the step returns.
"""

import asyncio
import errno
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import can

from meshpoint.bus.clock import NodeClock
from meshpoint.bus.core import Core
from meshpoint.bus.frames import frame_of, message_of
from meshpoint.bus.kernel_drops import lost_frames
from meshpoint.bus.local.plugin import MeshpointBus
from meshpoint.bus.reception import Reception, receive_from
from meshpoint.bus.records import Records
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import ADDRESS_CLAIM, group_of

RECONNECT_S = 0.5
_REPORT_EVERY_S = 1.0

_LAST_SEND_TIMEOUT_S = 0.2

# The transmit queue is full (the first three), or the device cannot send such a frame at all.
_REFUSALS = {errno.ENOBUFS, errno.EAGAIN, errno.EWOULDBLOCK, errno.EINVAL}
# How python-can reports a full socketcan queue when it is not asked to wait: without a code.
_QUEUE_FULL_TEXT = "Transmit buffer full"
# The kernel's error frames, alone of all interfaces': linux/can/error.h.
_SOCKETCAN = "SocketcanBus"
_BUS_OFF = 0x040
_RESTARTED = 0x100
# Buses that return own frames as if received, so that one's own address there means nothing.
_ECHOING = {"UdpMulticastBus"}

OpenBus = Callable[[], can.BusABC]
OnEvent = Callable[[str], None]
OnMessage = Callable[[can.Message], None]
OnFrame = Callable[[Frame], None]


async def run_node(
    core: Core,
    open_bus: OpenBus,
    clock: NodeClock,
    *,
    on_event: OnEvent,
    stop: asyncio.Event,
    name: str,
    own_addresses: frozenset[int] = frozenset(),
    statistics: NodeStatistics | None = None,
    on_message: OnMessage | None = None,
    on_own: OnFrame | None = None,
    records: Records | None = None,
) -> NodeStatistics:
    """Runs `core` until `stop` is set, then sends its last frames and closes the bus.

    A bus that goes away is reported and opened again, tried every half second. Meanwhile the core
    is stepped at its times, and what it sends is discarded, never sent late.

    open_bus: called in a thread. What it raises at the first call is raised from here.
    on_event: gets the core's events and the driver's own, as lines that begin with `name`.
    own_addresses: source addresses (the last byte of a 29-bit identifier) of this node. Frames
        that carry one are not handed to the core: several interfaces return one's own frames, and
        not all mark them (python-can issue 1274).
    on_own: gets those frames.
    statistics: counted in here, so that it can be read meanwhile; also returned.
    on_message: gets every message as it came, before the core does: error frames, own ones, all.
    records: written when a step's frames are sent, and closed at the end.
    """
    node = _Node(
        core,
        open_bus,
        clock,
        on_event,
        name,
        own_addresses,
        statistics or NodeStatistics(),
        on_message,
        on_own,
        records,
    )
    await node.run(stop)
    return node.statistics


class _Node:
    def __init__(
        self,
        core: Core,
        open_bus: OpenBus,
        clock: NodeClock,
        on_event: OnEvent,
        name: str,
        own_addresses: frozenset[int],
        statistics: NodeStatistics,
        on_message: OnMessage | None,
        on_own: OnFrame | None,
        records: Records | None,
    ) -> None:
        self.statistics = statistics
        self._core = core
        self._open_bus = open_bus
        self._clock = clock
        self._on_event = on_event
        self._name = name
        self._own_addresses = own_addresses
        self._on_message = on_message
        self._on_own = on_own
        self._records = records
        self._loop = asyncio.get_running_loop()
        self._bus: can.BusABC | None = None
        self._reception: Reception | None = None
        self._reopening: asyncio.Task[None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._timer_due_us = 0
        self._stepping = True
        self._ending = asyncio.Event()
        self._failure: asyncio.Future[None] = self._loop.create_future()
        self._lost_at_s: float | None = None  # until the next bus has carried a frame
        self._refusal = ""  # the last one, in words
        self._refusals_reported = (float("-inf"), 0)  # when, and how many
        self._bus_off_reported_at_s = float("-inf")
        self._lost_before = 0  # of this bus; counted
        self._loss_reported = (float("-inf"), 0)  # when, and how many

    async def run(self, stop: asyncio.Event) -> None:
        self._attach(await asyncio.to_thread(self._open_bus))
        stopped = asyncio.ensure_future(stop.wait())
        try:
            self._turn()
            ends: list[asyncio.Future[Any]] = [stopped, self._failure]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            stopped.cancel()
            self._clock.leave()
            await self._end()
        if self._failure.done():
            self._failure.result()

    def _turn(self) -> None:
        if not self._stepping:
            return
        try:
            self._receive_and_step()
        # Raised again by run(): from a callback it would only be logged.
        except Exception as error:  # noqa: BLE001
            self._stepping = False
            self._failure.set_exception(error)

    def _receive_and_step(self) -> None:
        now_us = self._clock.now_us()
        self._clock.begins(now_us)
        self._receive()
        due_us = self._core.next_step_us
        if now_us >= due_us:
            step = self._core.step(now_us)
            self.statistics.steps += 1
            if self._timer_due_us <= now_us:  # not one that a frame asked for
                late_s = self._clock.wall_s(now_us - self._timer_due_us)
                self.statistics.lateness_us.add(round(late_s * 1e6))
            self._report(step.events)
            self._send(step.frames)
            self._tell_refusals()
            if self._records is not None:
                self._report(self._records.write())
        self._set_timer(now_us)
        if self._reception is None or not self._reception.awaits_frames:
            self._clock.here()

    def _set_timer(self, now_us: int) -> None:
        # A step that is asked for at once is due now, however long ago its time may be.
        due_us = max(now_us, self._core.next_step_us)
        if self._timer is not None:
            if due_us == self._timer_due_us:
                return
            self._timer.cancel()
        self._timer_due_us = due_us
        self._timer = self._loop.call_later(self._clock.delay_s(due_us), self._on_timer)

    def _on_timer(self) -> None:
        self._timer = None
        self._turn()

    def _receive(self) -> None:
        if self._reception is None:
            return
        messages, error = self._reception.take()
        for message in messages:
            self._accept(message)
        self._count_lost()
        if error is not None:
            self._lose_bus(error)

    def _count_lost(self) -> None:
        """Frames that the kernel could not deliver: reported at once, then once a second."""
        if self._bus is None:
            return
        counts, lost = self.statistics, lost_frames(self._bus)
        counts.frames_lost += lost - self._lost_before
        self._lost_before = lost
        now_s, (reported_s, reported) = self._loop.time(), self._loss_reported
        if counts.frames_lost > reported and now_s - reported_s >= _REPORT_EVERY_S:
            self._loss_reported = (now_s, counts.frames_lost)
            self._say(
                f"{counts.frames_lost - reported} frames lost in the kernel ({counts.frames_lost} "
                "so far): bus or machine overloaded, they came faster than this node reads"
            )

    def _accept(self, message: can.Message) -> None:
        counts = self.statistics
        self._bus_works()
        if self._on_message is not None:
            self._on_message(message)
        if message.is_error_frame:
            self._accept_error(message.arbitration_id)
        elif message.is_remote_frame:
            counts.remote_frames += 1
            if counts.remote_frames == 1:
                self._say(
                    f"remote frames on the bus, the first 0x{message.arbitration_id:X}: ignored"
                )
        elif self._is_own(message):
            counts.own_address_frames += 1
            if self._on_own is not None:
                self._on_own(frame_of(message))
            if counts.own_address_frames == 1 and type(self._bus).__name__ not in _ECHOING:
                self._say(
                    f"frame 0x{message.arbitration_id:X} on the bus has our own source address: "
                    "another node sends as we do; ignored, as all of these"
                )
        else:
            counts.frames_received += 1
            self._clock.heard()
            self._core.receive(frame_of(message))

    def _accept_error(self, error_class: int) -> None:
        counts = self.statistics
        counts.error_frames += 1
        is_kernels = type(self._bus).__name__ == _SOCKETCAN
        if is_kernels and error_class & _BUS_OFF:
            counts.bus_offs += 1
            self._tell_bus_off()
        elif is_kernels and error_class & _RESTARTED:
            self._say(f"CAN controller restarted after bus-off ({counts.bus_offs} so far)")
        elif counts.error_frames == 1:
            self._say(f"error frames on the bus, the first of class 0x{error_class:X}")

    def _tell_bus_off(self) -> None:
        """At once, then once a second: one that restarts may go bus-off ten times a second."""
        now_s = self._loop.time()
        if now_s - self._bus_off_reported_at_s < _REPORT_EVERY_S:
            return
        self._bus_off_reported_at_s = now_s
        self._say(
            f"CAN controller is bus-off ({self.statistics.bus_offs} so far): after "
            "too many errors it has left the bus, nothing is sent or heard until it restarts. "
            "With restart-ms 0 it never does by itself: `ip -details link show` says so, "
            "`ip link set DEVICE type can restart` or DEVICE down and up brings it back"
        )

    def _is_own(self, message: can.Message) -> bool:
        """Under a source address of ours. Claims of the address are heard all the same: whose it
        is must be settled."""
        if not message.is_extended_id or message.arbitration_id & 0xFF not in self._own_addresses:
            return False
        return group_of(message.arbitration_id) != ADDRESS_CLAIM

    def _send(self, frames: list[Frame], timeout_s: float = 0.0) -> None:
        if isinstance(self._bus, MeshpointBus):
            self._send_part(frames, timeout_s)
        else:
            for frame in frames:
                self._send_part([frame], timeout_s)

    def _send_part(self, frames: list[Frame], timeout_s: float) -> None:
        """What the bus takes or refuses in one call."""
        counts = self.statistics
        if self._bus is None or not frames:
            counts.frames_discarded += len(frames)
            return
        messages = [message_of(frame) for frame in frames]
        try:
            if isinstance(self._bus, MeshpointBus):
                self._bus.send_together(messages, timeout_s)
            else:
                self._bus.send(messages[0], timeout_s)
        except (can.CanError, OSError) as error:
            if not _only_this_frame(error):
                counts.frames_discarded += len(frames)
                self._lose_bus(error)
                return
            counts.frames_refused += len(frames)
            self._refuse(frames[0], error)
        else:
            counts.frames_sent += len(frames)
            self._bus_works()

    def _refuse(self, frame: Frame, error: Exception) -> None:
        hint = ""
        if _error_number(error) == errno.EINVAL:
            hint = "; is this a classic CAN device, or CAN FD not switched on?"
        self._refusal = f"frame 0x{frame.can_id:X} not sent: {error}{hint}"
        self._tell_refusals()

    def _tell_refusals(self, *, last: bool = False) -> None:
        """At once, then once a second, and what is left at the end: none goes untold."""
        now_s, refused = self._loop.time(), self.statistics.frames_refused
        reported_s, reported = self._refusals_reported
        if refused == reported or (now_s - reported_s < _REPORT_EVERY_S and not last):
            return
        self._refusals_reported = (now_s, refused)
        self._say(f"{self._refusal} ({refused - reported} frames refused, {refused} so far)")

    def _attach(self, bus: can.BusABC) -> None:
        self._reception = receive_from(bus, self._turn)
        self._bus = bus
        self._lost_before = lost_frames(bus)

    def _bus_works(self) -> None:
        """A frame has gone through. Only that proves a reopened bus: a link that is down opens."""
        if self._lost_at_s is not None:
            self._say(f"bus is back after {self._loop.time() - self._lost_at_s:.1f} s")
            self._lost_at_s = None

    def _lose_bus(self, error: Exception) -> None:
        bus, reception = self._bus, self._reception
        if bus is None or reception is None:
            return
        self._bus = self._reception = None
        if self._lost_at_s is None:
            self.statistics.outages += 1
            self._lost_at_s = self._loop.time()
            self._say(f"bus lost: {error}; trying again every {RECONNECT_S:g} s")
        self._reopening = self._loop.create_task(self._reopen(bus, reception))

    async def _reopen(self, lost: can.BusABC, reception: Reception) -> None:
        """Opens anew instead of using the same bus again, so that nothing stale is in a queue."""
        await _close(lost, reception)
        complaint = ""
        while not await self._ends_within(RECONNECT_S):
            try:
                self._attach(await asyncio.to_thread(self._open_bus))
            except Exception as error:  # noqa: BLE001 (a vendor's driver may raise anything)
                if str(error) != complaint:
                    complaint = str(error)
                    self._say(f"bus still away: {complaint}")
            else:
                return

    async def _ends_within(self, seconds: float) -> bool:
        try:
            await asyncio.wait_for(self._ending.wait(), seconds)
        except TimeoutError:
            return False
        return True

    async def _end(self) -> None:
        """Last frames, whatever the reason of the end; then closes everything."""
        self._ending.set()
        if self._reopening is not None:
            await self._reopening
        self._stepping = False
        if self._timer is not None:
            self._timer.cancel()
        try:
            step = self._core.shutdown(self._clock.now_us())
            self._report(step.events)
            self._send(step.frames, timeout_s=_LAST_SEND_TIMEOUT_S)
            self._tell_refusals(last=True)
        finally:
            if self._records is not None:
                self._report(self._records.close())
                self.statistics.record_lines_lost = self._records.lost_lines
            bus, reception = self._bus, self._reception
            self._bus = self._reception = None
            if bus is not None and reception is not None:
                await _close(bus, reception)

    def _report(self, events: Iterable[str]) -> None:
        for event in events:
            self._say(event)

    def _say(self, event: str) -> None:
        self._on_event(f"{self._name}: {event}")


async def _close(bus: can.BusABC, reception: Reception) -> None:
    await reception.stop()
    with suppress(can.CanError, OSError):  # a broken bus may fail to close properly
        await asyncio.to_thread(bus.shutdown)


def _only_this_frame(error: Exception) -> bool:
    """Whether the bus refused a frame but goes on working."""
    if isinstance(error, can.CanTimeoutError) or str(error).startswith(_QUEUE_FULL_TEXT):
        return True
    return _error_number(error) in _REFUSALS


def _error_number(error: Exception) -> int | None:
    """The operating system's error number, wherever the interface has put it."""
    if isinstance(error, OSError):
        return error.errno
    if isinstance(error, can.CanError) and error.error_code is not None:
        return error.error_code
    return error.__cause__.errno if isinstance(error.__cause__, OSError) else None
