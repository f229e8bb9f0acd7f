"""The python-can interface `silkit`: a CAN network of SIL Kit, in wall time.

A participant that nobody coordinates: it joins and leaves when it likes, and hears what others
send, those of a coordinated run as well, at once."""

from __future__ import annotations

import itertools
import logging
import os
import queue
import socket
import time
from collections.abc import Callable
from typing import Any, Final
from urllib.parse import urlsplit

import can
from can.typechecking import CanFilters, Channel

from meshpoint.bus.silkit.library import (
    NETWORK,
    REGISTRY,
    Heard,
    SilKitError,
    library,
    wire_frame,
)
from meshpoint.bus.silkit.participant import Participant
from meshpoint.bus.simulated.messages import message_of, wire_frame_of

INTERFACE: Final = "silkit"
DEFAULT_PORT: Final = 8500
CONNECT_S: Final = 5.0
LOOK_S: Final = 0.1
"""How often a `recv` that waits looks whether the registry is still there."""
LAST_S: Final = 0.1
"""What was sent last is on its way for so long; a participant that leaves takes it along (2 ms were
too few here, 10 ms enough)."""

_log: Final = logging.getLogger("can.silkit")
_numbers: Final = itertools.count(1)

Arrived = queue.SimpleQueue[tuple[float, Heard]]
"""Wall times (s) and frames."""


class SilKitBus(can.BusABC):
    """A node on a CAN network of SIL Kit.

    Frames arrive at once, without a bus's timing and arbitration: SIL Kit's trivial simulation.
    Messages carry the wall time of their arrival. CAN FD is always on.

    channel: the network's name.
    registry: where SIL Kit's registry listens, `silkit://HOST:PORT`.
    participant: this node's name, of which there may be one; default: one of its own.

    Raises CanInitializationError where silkit-py is not installed or no registry is there.
    """

    def __init__(
        self,
        channel: Channel | None = None,
        can_filters: CanFilters | None = None,
        *,
        registry: str = REGISTRY,
        participant: str | None = None,
        receive_own_messages: bool = False,
        **kwargs: Any,
    ) -> None:
        self._registry: socket.socket | None = None
        self._participant: Participant | None = None
        if receive_own_messages:
            raise can.CanInitializationError(f"{INTERFACE}: receive_own_messages is not offered")
        network = NETWORK if channel is None else str(channel)
        name = participant or f"meshpoint-{os.getpid()}-{next(_numbers)}"
        self._arrived: Arrived = queue.SimpleQueue()
        self._left_out = 0
        self._sent_s = float("-inf")
        self._where = f"network {network}, registry {registry}"
        try:
            library()
            self._registry = _connection(registry)
            self._participant = Participant(name, registry, network, _put_into(self._arrived))
        except (OSError, ValueError) as error:
            raise can.CanInitializationError(
                f"{INTERFACE}: no registry at {registry}: {error}; `silkit-registry` starts one"
            ) from error
        except SilKitError as error:
            if self._registry is not None:
                self._registry.close()
                self._registry = None
            raise can.CanInitializationError(f"{INTERFACE}: {error}") from error
        self._network = network
        self._can_protocol = can.CanProtocol.CAN_FD
        self.channel_info = f"{INTERFACE} network {network}, participant {name}"
        super().__init__(channel=network, can_filters=can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002
        """Hands a frame to all others on the network; FD data are padded with zeros to a length
        that CAN FD has. It never waits.

        Raises CanOperationError where the registry is gone, ValueError for a frame that no CAN bus
        could carry; SIL Kit has no error frames."""
        if msg.is_error_frame:
            raise ValueError(f"{INTERFACE}: an error frame cannot be sent")
        frame = wire_frame_of(msg)
        participant = self._check()
        try:
            participant.send(frame)
        except RuntimeError as error:
            raise can.CanOperationError(f"{INTERFACE}: {self._where}: {error}") from error
        self._sent_s = time.monotonic()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = float("inf") if timeout is None else time.monotonic() + timeout
        while True:
            left_s = max(0.0, deadline - time.monotonic())
            try:
                time_s, frame = self._arrived.get(timeout=min(left_s, LOOK_S))
            except queue.Empty:
                self._check()
                if left_s <= LOOK_S:
                    return None, False
                continue
            try:
                return message_of(wire_frame(frame), time_s, self._network, is_own=False), False
            except ValueError as error:
                self._leave_out(frame.can_id, error)

    def _leave_out(self, can_id: int, error: ValueError) -> None:
        self._left_out += 1
        if self._left_out == 1:
            _log.warning(
                "%s: %s: frame 0x%X: %s; left out, as all of these", INTERFACE, self._where, can_id,
                error,
            )  # fmt: skip

    def _check(self) -> Participant:
        """CanOperationError where the bus is shut down or its registry gone."""
        if self._registry is None or self._participant is None:
            raise can.CanOperationError(f"{INTERFACE}: the bus is shut down")
        try:
            is_there = bool(self._registry.recv(1))
        except BlockingIOError:
            return self._participant
        except OSError:
            is_there = False
        if not is_there:
            raise can.CanOperationError(f"{INTERFACE}: {self._where}: lost the registry")
        return self._participant

    def shutdown(self) -> None:
        """Leaves the network, when what was sent last is on its way."""
        super().shutdown()
        if self._registry is not None:
            self._registry.close()
            self._registry = None
            time.sleep(max(0.0, self._sent_s + LAST_S - time.monotonic()))
        if self._participant is not None:
            self._participant.leave()
            self._participant = None


def _put_into(arrived: Arrived) -> Callable[[Heard], None]:
    """A handler that refers to no bus: one that is not shut down can still go."""

    def put(frame: Heard) -> None:
        arrived.put((time.time(), frame))

    return put


def _connection(registry: str) -> socket.socket:
    """A connection of our own to the registry: silkit-py says nothing of its end."""
    place = urlsplit(registry)
    address = place.hostname or "localhost", place.port or DEFAULT_PORT
    connection = socket.create_connection(address, CONNECT_S)
    connection.setblocking(False)
    return connection
