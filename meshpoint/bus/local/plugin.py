"""The python-can interface `meshpoint`: a bus through the local hub."""

import select
import socket
import struct
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import can
from can.typechecking import AutoDetectedConfig, CanFilters, Channel

from meshpoint.bus.local import wire
from meshpoint.bus.local.channel import (
    ChannelError,
    TcpChannel,
    default_channel,
    hub_log,
    parse_channel,
)
from meshpoint.bus.local.launch import connect
from meshpoint.bus.local.wire import Flag

_TELLS_WAITING = sys.platform == "linux"
if _TELLS_WAITING:
    from fcntl import ioctl
    from termios import FIONREAD, TIOCOUTQ  # the latter: what its reader has not read (unix(7))

CONNECT_TIMEOUT_S = 30.0
_COUNT = struct.Struct("=i")
_READ_BYTES = 64 * 1024
_READS_PER_DRAIN = 4
_MAX_UNSENT_BYTES = 1024 * 1024
_GOODBYE_TIMEOUT_S = 5.0

# Plain integers: arithmetic on IntFlag members would cost more than all the rest of a frame.
_EXTENDED = Flag.EXTENDED.value
_FD = Flag.FD.value
_BITRATE_SWITCH = Flag.BITRATE_SWITCH.value
_ERROR_STATE = Flag.ERROR_STATE.value
_REMOTE = Flag.REMOTE.value
_ERROR = Flag.ERROR.value


class MeshpointBus(can.BusABC):
    """A node on a local bus: every frame reaches all other nodes in one order, and none is lost.

    Messages carry the hub's time stamp. CAN FD is always on; bit rates have no meaning here.
    No complete frame is ever held back outside the socket, so `fileno()` is readable exactly as
    long as frames wait.

    channel: `unix:/path/to.sock` or `tcp:127.0.0.1:PORT`; default: this user's own bus.
    start_hub: start a hub when nobody listens on the channel.
    allow_remote: connect to a TCP address that is not on this machine.
    connect_timeout_s: how long to wait for the hub.

    Raises CanInitializationError when there is no hub to connect to, ValueError when `channel`
    names none.
    """

    def __init__(
        self,
        channel: Channel | None = None,
        can_filters: CanFilters | None = None,
        *,
        start_hub: bool = True,
        allow_remote: bool = False,
        receive_own_messages: bool = False,
        connect_timeout_s: float = CONNECT_TIMEOUT_S,
        **kwargs: Any,
    ) -> None:
        if receive_own_messages:
            raise can.CanInitializationError("meshpoint: receive_own_messages is not offered")
        self._unreceived = b""  # the start of a record that has not arrived completely
        self._unsent = bytearray()
        # A thread that receives also sends what is left to send.
        self._send_lock = threading.Lock()
        self._lost = False
        try:
            place = default_channel() if channel is None else parse_channel(str(channel))
            if isinstance(place, TcpChannel) and not place.is_local:
                if not allow_remote:
                    raise ChannelError(f"{place} is on another machine: needs allow_remote=True")
                start_hub = False
            self._hub_log = hub_log(place)
            self._socket = connect(place, connect_timeout_s, start_hub)
        except OSError as error:
            raise can.CanInitializationError(f"meshpoint: {error}") from error
        self._can_protocol = can.CanProtocol.CAN_FD
        self._place = str(place)
        self.channel_info = f"meshpoint channel {place}"
        super().__init__(channel=self._place, can_filters=can_filters, **kwargs)

    def fileno(self) -> int:
        """The socket, for `select` and event loops."""
        return self._socket.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hands the frame to the hub.

        timeout: seconds to wait while the hub does not read, None for ever. What cannot go out in
            time waits in a buffer of 1 MiB for the next `send`, `recv` or `drain`.

        Raises CanTimeoutError when that buffer is full (the frame is not sent then),
        CanOperationError when the hub is gone, ValueError for a frame no CAN bus could carry.
        """
        self._send(_pack(msg), timeout)

    def send_together(self, messages: Sequence[can.Message], timeout: float | None = None) -> None:
        """As `send`, in this order, with one system call for all: they cost more than the rest of
        a frame. Either all are sent or, where the buffer has no place for them, none."""
        self._send(b"".join([_pack(message) for message in messages]), timeout)

    def drain(self) -> list[can.Message]:
        """All messages that have arrived (up to 256 KiB of them), in few reads; never waits.

        Raises CanOperationError when the hub is gone and no message is left.
        """
        self._flush_between()
        messages: list[can.Message] = []
        for _ in range(_READS_PER_DRAIN):
            try:
                chunk = self._read(_READ_BYTES)
            except can.CanOperationError:
                if messages:
                    return messages  # the next call raises
                raise
            messages += self._take_messages(chunk)
            if len(chunk) < _READ_BYTES:
                break
        return messages

    @property
    def has_frames_on_their_way(self) -> bool:
        """Whether the hub has not yet read all that this node has sent, or this node not all that
        the hub has passed on. Where the system cannot tell (not Linux): what this node has not
        sent yet."""
        if self._unsent or self._lost or not _TELLS_WAITING:
            return bool(self._unsent)
        return any(_waiting_bytes(self._socket, queue) for queue in (FIONREAD, TIOCOUTQ))

    def shutdown(self) -> None:
        """Sends what is left to send, as far as the hub takes it soon, and closes."""
        if self._is_shutdown:
            return
        super().shutdown()
        if not self._lost:
            self._say_goodbye()
        self._lost = True
        self._socket.close()

    def _send(self, records: bytes, timeout: float | None) -> None:
        with self._send_lock:
            if len(self._unsent) + len(records) > _MAX_UNSENT_BYTES:
                self._flush(timeout)
                if len(self._unsent) + len(records) > _MAX_UNSENT_BYTES:
                    raise can.CanTimeoutError(f"meshpoint: {self._place}: the hub takes no frames")
            self._unsent += records
            self._flush(timeout)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        """Also called alone, by a client elsewhere (Jumpstarter's), whose numbers are floats."""
        self._filters = filters and [
            each | {"can_id": int(each["can_id"]), "can_mask": int(each["can_mask"])}
            for each in filters
        ]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            self._flush_between()
            # Only to the end of this record: a frame read ahead would not make fileno() readable.
            chunk = self._read(wire.missing_bytes(self._unreceived))
            if chunk:
                messages = self._take_messages(chunk)
                if messages:
                    return messages[0], True
            elif not self._wait(deadline):
                return None, True

    def _read(self, size: int) -> bytes:
        """Up to `size` bytes, none when none have arrived."""
        if self._lost:
            raise can.CanOperationError(f"meshpoint: {self._place}: not connected any more")
        try:
            chunk = self._socket.recv(size)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            raise self._broken(str(error)) from error
        if not chunk:
            raise self._broken("connection closed")
        return chunk

    def _take_messages(self, chunk: bytes) -> list[can.Message]:
        """The messages which `chunk` completes, as far as the filters let them through."""
        buffer = self._unreceived + chunk
        messages = []
        behind = 0
        try:
            for record, end in wire.records(buffer):
                messages.append(_unpack(record, self._place))
                behind = end
        except wire.WireError as error:
            raise self._broken(str(error)) from error
        self._unreceived = buffer[behind:]
        if self._filters is not None:
            messages = [message for message in messages if self._matches_filters(message)]
        return messages

    def _flush(self, timeout: float | None) -> None:
        """Sends what waits, until nothing is left or the hub has not taken it for `timeout` s."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while self._unsent:
            if self._lost:
                raise can.CanOperationError(f"meshpoint: {self._place}: not connected any more")
            try:
                sent = self._socket.send(self._unsent)
            except (BlockingIOError, InterruptedError):
                if not self._wait(deadline, to_send=True):
                    return
                continue
            except OSError as error:
                raise self._broken(str(error)) from error
            del self._unsent[:sent]

    def _flush_between(self) -> None:
        """Sends what waits without waiting, unless another thread does so just now."""
        if self._unsent and self._send_lock.acquire(blocking=False):
            try:
                self._flush(timeout=0.0)
            finally:
                self._send_lock.release()

    def _wait(self, deadline: float | None, to_send: bool = False) -> bool:
        """Waits until the socket can be read (or sent on); whether there is still time."""
        seconds = None
        if deadline is not None:
            seconds = deadline - time.monotonic()
            if seconds <= 0.0:
                return False
        # While frames wait to go out, a reader looks after them, too.
        wants_to_send = to_send or bool(self._unsent)
        try:
            _wait_for(self._socket, not to_send, wants_to_send, seconds)
        except (OSError, ValueError) as error:  # closed meanwhile by another thread
            raise self._broken(str(error)) from error
        return True

    def _say_goodbye(self) -> None:
        """Makes sure that the hub has taken all we sent: closing a socket on which frames wait to
        be read may discard what is under way in the other direction."""
        deadline = time.monotonic() + _GOODBYE_TIMEOUT_S
        try:
            with self._send_lock:
                self._flush(_GOODBYE_TIMEOUT_S)
            self._socket.shutdown(socket.SHUT_WR)
            while True:
                if not self._read(_READ_BYTES) and not self._wait(deadline):
                    return
        except (can.CanOperationError, OSError):
            return  # it closed the connection, as it should

    def _broken(self, cause: str) -> can.CanOperationError:
        self._lost = True
        return can.CanOperationError(
            f"meshpoint: {self._place}: lost the hub: {cause} "
            f"(one in the background leaves its reasons in {self._hub_log})"
        )

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": "meshpoint", "channel": str(default_channel())}]


def _waiting_bytes(sock: socket.socket, queue: int) -> int:
    (count,) = _COUNT.unpack(ioctl(sock, queue, bytes(_COUNT.size)))
    return int(count)


def _wait_for(sock: socket.socket, read: bool, write: bool, seconds: float | None) -> None:
    if sys.platform != "win32":  # select() cannot watch file descriptors above 1023 there
        events = (select.POLLIN if read else 0) | (select.POLLOUT if write else 0)
        poller = select.poll()
        poller.register(sock, events)
        poller.poll(None if seconds is None else seconds * 1000.0)
    else:
        select.select([sock] if read else [], [sock] if write else [], [], seconds)


def _pack(message: can.Message) -> bytes:
    flags = (
        (_EXTENDED if message.is_extended_id else 0)
        | (_FD if message.is_fd else 0)
        | (_BITRATE_SWITCH if message.bitrate_switch else 0)
        | (_ERROR_STATE if message.error_state_indicator else 0)
        | (_REMOTE if message.is_remote_frame else 0)
        | (_ERROR if message.is_error_frame else 0)
    )
    return wire.pack(flags, message.arbitration_id, message.data, message.dlc)


def _unpack(record: wire.WireRecord, channel: str) -> can.Message:
    flags, length, can_id, time_us, data = record
    return can.Message(
        timestamp=time_us * 1e-6,
        arbitration_id=can_id,
        is_extended_id=bool(flags & _EXTENDED),
        is_remote_frame=bool(flags & _REMOTE),
        is_error_frame=bool(flags & _ERROR),
        channel=channel,
        dlc=length,
        data=data,
        is_fd=bool(flags & _FD),
        bitrate_switch=bool(flags & _BITRATE_SWITCH),
        error_state_indicator=bool(flags & _ERROR_STATE),
    )
