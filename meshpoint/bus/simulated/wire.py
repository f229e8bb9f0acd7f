"""A simulated bus in this process, in wall time: who is on it, and what each of them hears."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import can

from meshpoint.bus.simulated.confinement import ErrorState
from meshpoint.bus.simulated.core import CanBus, QueueOrder
from meshpoint.bus.simulated.error_frames import of_change, of_destroyed
from meshpoint.bus.simulated.events import (
    Attempt,
    BusEvent,
    Delivered,
    Destroyed,
    ErrorKind,
    Fault,
    StateChanged,
)
from meshpoint.bus.simulated.frame_bits import BitTiming, WireFrame
from meshpoint.bus.simulated.messages import message_of

Bus = tuple[BitTiming, QueueOrder]


class Port:
    """A node's receiving side: what it has heard and not yet taken."""

    def __init__(self, number: int, size: int, own: bool, errors: bool, restart_ns: int) -> None:
        self.number = number
        self.heard: deque[can.Message] = deque()
        self.lost = 0
        """Messages that found the receive queue full."""
        self.is_off = False
        self.size = size
        self.hears_own = own
        self.hears_errors = errors
        self.restart_ns = restart_ns

    def hear(self, message: can.Message) -> None:
        """One more; the newest is lost where the queue is full, as in a kernel."""
        if len(self.heard) < self.size:
            self.heard.append(message)
        else:
            self.lost += 1


class _Order:
    """That some attempts are to be destroyed: `of` a node, or of any."""

    def __init__(self, count: int, kind: ErrorKind, of: int | None, seen_by: int | None) -> None:
        self.count = count
        self.kind = kind
        self.of = of
        self.seen_by = seen_by


class Wire:
    """One channel. Everything is done under `changed`; nobody's thread but the callers' runs.

    A silent node is on it that acknowledges, so that a node alone can send as on python-can's
    `virtual`."""

    def __init__(self, name: str, timing: BitTiming, order: QueueOrder) -> None:
        self.name = name
        self.form: Final = (timing, order)
        self.changed = threading.Condition()
        self.ports: dict[int, Port] = {}
        self._orders: list[_Order] = []
        self._restarts: list[tuple[int, int]] = []
        self._leaving: set[int] = set()
        self._began_ns = time.monotonic_ns()
        self._epoch_ns = time.time_ns() - self._began_ns
        self._bus = CanBus(1, timing, order=order, disturb=self._disturb, restarts=False)

    def now_ns(self) -> int:
        """Bus time."""
        return time.monotonic_ns() - self._began_ns

    def join(self, queue_length: int, port: Callable[[int], Port]) -> Port:
        """A new node; `port` makes its receiving side from its number."""
        with self.changed:
            self._advance()
            number = self._bus.add_node(self.now_ns(), queue_length)
            self.ports[number] = port(number)
            return self.ports[number]

    def leave(self, port: Port) -> bool:
        """The node hears nothing more, and is gone when what it handed over is sent; whether it
        was the last."""
        with self.changed:
            self._advance()
            del self.ports[port.number]
            self._leaving.add(port.number)
            self._restarts = [entry for entry in self._restarts if entry[1] != port.number]
            self.changed.notify_all()
            return not self.ports

    def send(self, port: Port, frame: WireFrame, timeout_s: float | None) -> bool | None:
        """Whether the frame is in the queue, after waiting for a place; None: bus-off."""
        deadline_ns = None if timeout_s is None else self.now_ns() + int(timeout_s * 1e9)
        with self.changed:
            while True:
                self._advance()
                now_ns = self.now_ns()
                if self._bus.state(port.number) is ErrorState.BUS_OFF:
                    return None
                if self._bus.send(port.number, frame, now_ns):
                    self.changed.notify_all()
                    return True
                if deadline_ns is not None and now_ns >= deadline_ns:
                    return False
                self._wait(deadline_ns)

    def receive(self, port: Port, timeout_s: float | None) -> can.Message | None:
        """The next message, after waiting for one; None where none came."""
        deadline_ns = None if timeout_s is None else self.now_ns() + int(timeout_s * 1e9)
        with self.changed:
            while True:
                self._advance()
                if port.heard:
                    return port.heard.popleft()
                if deadline_ns is not None and self.now_ns() >= deadline_ns:
                    return None
                self._wait(deadline_ns)

    def destroy(self, count: int, kind: ErrorKind, of: int | None, seen_by: int | None) -> None:
        """The next attempts go wrong: those of a node, or of any."""
        with self.changed:
            self._advance()
            self._orders.append(_Order(count, kind, of, seen_by))

    def bus_off(self, port: Port) -> None:
        """The node has failed too often."""
        with self.changed:
            self._advance()
            self._bus.force_bus_off(port.number, self.now_ns())
            self._advance()
            self.changed.notify_all()

    def restart(self, port: Port) -> None:
        """The node begins its way back from bus-off."""
        with self.changed:
            self._advance()
            self._bus.restart(port.number, self.now_ns())
            self.changed.notify_all()

    def state(self, port: Port) -> tuple[ErrorState, int, int]:
        """A node's error state and its two error counters."""
        with self.changed:
            self._advance()
            return self._bus.state(port.number), *self._bus.counters(port.number)

    def _wait(self, deadline_ns: int | None) -> None:
        """Until something happens on the bus, somebody changes it, or the deadline."""
        next_ns = min([self._bus.next_ns, *(at_ns for at_ns, _ in self._restarts)])
        if deadline_ns is not None:
            next_ns = min(next_ns, deadline_ns)
        seconds = (next_ns - self.now_ns()) / 1e9
        self.changed.wait(None if seconds == float("inf") else max(seconds, 0.0))

    def _advance(self) -> None:
        now_ns = self.now_ns()
        while self._restarts and self._restarts[0][0] <= now_ns:
            at_ns, number = self._restarts.pop(0)
            self._tell(self._bus.run_to(at_ns))
            self._bus.restart(number, at_ns)
        self._tell(self._bus.run_to(now_ns))
        for number in [n for n in self._leaving if not self._bus.waiting(n)]:
            self._leaving.remove(number)
            self._bus.remove_node(number)

    def _tell(self, events: list[BusEvent]) -> None:
        for event in events:
            if isinstance(event, Delivered):
                self._deliver(event)
            elif isinstance(event, Destroyed):
                self._report(event)
            elif isinstance(event, StateChanged):
                self._change(event)
        if events:
            self.changed.notify_all()

    def _deliver(self, event: Delivered) -> None:
        for port in self.ports.values():
            is_own = port.number in event.senders
            hears = port.hears_own if is_own else port.number != event.missed_by
            if hears and not port.is_off:
                port.hear(self._message(event, is_own))

    def _message(self, event: Delivered, is_own: bool) -> can.Message:
        time_s = (self._epoch_ns + self._began_ns + event.time_ns) / 1e9
        return message_of(event.frame, time_s, self.name, is_own)

    def _report(self, event: Destroyed) -> None:
        for port in self.ports.values():
            if port.hears_errors and not port.is_off:
                message = of_destroyed(event, port.number)
                self._hear_error(port, message, event.time_ns)

    def _change(self, event: StateChanged) -> None:
        port = self.ports.get(event.node)
        if port is None:
            return
        was_off, port.is_off = port.is_off, event.state is ErrorState.BUS_OFF
        if port.is_off and port.restart_ns:
            self._restarts.append((event.time_ns + port.restart_ns, port.number))
            self._restarts.sort()
        if port.hears_errors:
            self._hear_error(port, of_change(event, was_off), event.time_ns)

    def _hear_error(self, port: Port, message: can.Message, time_ns: int) -> None:
        message.timestamp = (self._epoch_ns + self._began_ns + time_ns) / 1e9
        message.channel = self.name
        port.hear(message)

    def _disturb(self, attempt: Attempt) -> Fault | None:
        for order in self._orders:
            if order.of is None or order.of in attempt.senders:
                order.count -= 1
                if order.count == 0:
                    self._orders.remove(order)
                seen_by = None if order.seen_by in attempt.senders else order.seen_by
                if seen_by is not None and seen_by not in self.ports:
                    seen_by = None
                return Fault(order.kind, seen_by=seen_by)
        return None


_wires: dict[str, Wire] = {}
_wires_lock: Final = threading.Lock()


def open_port(
    name: str, form: Bus, queue_length: int, port: Callable[[int], Port]
) -> tuple[Wire, Port]:
    """Joins the channel of this name in this process, or makes it.

    ValueError where it is there with other bit rates or queues."""
    with _wires_lock:
        wire = _wires.get(name)
        if wire is None:
            wire = _wires[name] = Wire(name, *form)
        if wire.form != form:
            raise ValueError(
                f"channel {name} is open with {_said(wire.form)}, asked for is {_said(form)}"
            )
        return wire, wire.join(queue_length, port)


def _said(form: Bus) -> str:
    timing, order = form
    bitrates = (1_000_000_000 // bit_ns for bit_ns in (timing.nominal_ns, timing.data_ns))
    return "bitrate {}, data_bitrate {}, queue {}".format(*bitrates, order.value)


def close_port(wire: Wire, port: Port) -> None:
    """Leaves; a channel that nobody is on any more is gone."""
    with _wires_lock:
        if wire.leave(port):
            del _wires[wire.name]


def open_channels() -> list[str]:
    """The channels that somebody of this process is on."""
    with _wires_lock:
        return list(_wires)
