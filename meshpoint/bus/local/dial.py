"""Connecting to a hub that is already there."""

import socket
import sys
import time

from meshpoint.bus.local import wire
from meshpoint.bus.local.channel import HubChannel, TcpChannel, UnixChannel
from meshpoint.bus.local.own_files import StrangerError, check_peer

_SEND_BUFFER_BYTES = 1024 * 1024


class NoHubError(OSError):
    """Nobody serves the channel."""


class NotAHubError(OSError):
    """Somebody serves the channel who is no meshpoint hub of this version."""


def dial(channel: HubChannel, timeout_s: float) -> socket.socket:
    """A non-blocking socket on which the hub has greeted: every frame sent by others from now on
    arrives here.

    Raises NoHubError, NotAHubError, StrangerError where another user serves it, or another OSError.
    """
    connection = _connect(channel, timeout_s)
    try:
        connection.sendall(wire.GREETING)
        _expect_greeting(connection, channel, time.monotonic() + timeout_s)
    except (BrokenPipeError, ConnectionResetError) as error:
        connection.close()
        raise NoHubError(f"{channel}: {error}") from error
    except BaseException:
        connection.close()
        raise
    connection.setblocking(False)
    return connection


def serves(channel: UnixChannel) -> bool:
    """Whether a process listens on the socket file of `channel`, without talking to it."""
    try:
        _connect(channel, timeout_s=1.0).close()
    except NoHubError:
        return False
    return True


def _connect(channel: HubChannel, timeout_s: float) -> socket.socket:
    try:
        if isinstance(channel, UnixChannel):
            connection = _connect_unix(channel, timeout_s)
        else:
            connection = _connect_tcp(channel, timeout_s)
    except (FileNotFoundError, ConnectionRefusedError, ConnectionResetError, TimeoutError) as error:
        raise NoHubError(f"{channel}: {error}") from error
    except StrangerError as error:
        raise StrangerError(f"{channel}: {error}") from error
    except OSError as error:
        raise OSError(error.errno, f"{channel}: {error.strerror}") from error
    # Frames wait here while the hub is not scheduled for a while.
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    return connection


def _connect_unix(channel: UnixChannel, timeout_s: float) -> socket.socket:
    if sys.platform == "win32":  # parse_channel lets no such channel through
        raise FileNotFoundError("this system has no unix sockets")
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(timeout_s)
        connection.connect(str(channel.path))
        check_peer(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _connect_tcp(channel: TcpChannel, timeout_s: float) -> socket.socket:
    connection = socket.create_connection((channel.host, channel.port), timeout_s)
    if connection.getsockname() == connection.getpeername():
        # TCP may connect a socket to itself where nobody listens.
        connection.close()
        raise ConnectionRefusedError("nobody listens")
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _expect_greeting(connection: socket.socket, channel: HubChannel, deadline: float) -> None:
    greeting = b""
    while len(greeting) < len(wire.GREETING):
        connection.settimeout(max(0.01, deadline - time.monotonic()))
        try:
            chunk = connection.recv(len(wire.GREETING) - len(greeting))
        except TimeoutError as error:
            raise NotAHubError(f"{channel}: no greeting from whoever listens there") from error
        if not chunk:
            # A hub that ends at this moment closes without a greeting; so does a stranger.
            raise NoHubError(f"{channel}: closed before greeting")
        greeting += chunk
        if not wire.GREETING.startswith(greeting):
            raise NotAHubError(
                f"{channel}: served by something that is no meshpoint hub of this version"
            )
