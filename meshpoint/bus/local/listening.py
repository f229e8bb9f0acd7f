"""Where a hub listens: taking a channel, so that of several hubs one gets it, and leaving it."""

import contextlib
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from meshpoint.bus.local.channel import ChannelError, HubChannel, TcpChannel, UnixChannel, hub_log
from meshpoint.bus.local.dial import dial, serves

if sys.platform != "win32":
    import fcntl

_LISTEN_BACKLOG = 1024
_LOCK_WAIT_S = 5.0


class HubRunningError(Exception):
    """Another hub serves this channel already."""


def listen(channel: HubChannel, allow_remote: bool = False) -> socket.socket:
    """The listening socket of a hub.

    Raises HubRunningError when a hub serves the channel already, ChannelError or another OSError
    when it cannot be served.
    """
    if isinstance(channel, UnixChannel):
        return _listen_unix(channel)
    if not channel.is_local and not allow_remote:
        raise ChannelError(f"{channel} is open to other machines: needs --allow-remote")
    return _listen_tcp(channel)


def clean_up(channel: HubChannel) -> None:
    """Removes our files: an empty log, and the socket unless another hub has taken its place."""
    log = hub_log(channel)
    # FileNotFoundError: there is no log, or somebody has removed the whole directory.
    with contextlib.suppress(FileNotFoundError):
        if log.stat().st_size == 0:
            log.unlink()
    if isinstance(channel, UnixChannel):
        with contextlib.suppress(FileNotFoundError), _locked(channel.path.parent):
            if not serves(channel):
                channel.path.unlink()


def _listen_tcp(channel: TcpChannel) -> socket.socket:
    family = socket.AF_INET6 if ":" in channel.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        if sys.platform == "win32":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:  # lets a port be bound again at once; a port somebody listens on stays refused
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((channel.host, channel.port))
        listener.listen(_LISTEN_BACKLOG)
    except OSError as error:
        listener.close()
        # Whoever else has the port: a hub is what we want, anything else is an error.
        try:
            dial(channel, timeout_s=1.0).close()
        except OSError as refused:
            raise ChannelError(f"{channel}: {error}; {refused}") from error
        raise HubRunningError from error
    return listener


def _listen_unix(channel: UnixChannel) -> socket.socket:
    if sys.platform == "win32":  # parse_channel lets no unix channel through
        raise ChannelError(f"{channel}: this system has no unix sockets")
    path = channel.path
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _locked(path.parent):
            if serves(channel):
                raise HubRunningError  # noqa: TRY301
            # A socket without a listener was left by a hub that was killed.
            if path.is_socket():
                path.unlink()
            mask = os.umask(0o177)
            try:
                listener.bind(str(path))
            finally:
                os.umask(mask)
            listener.listen(_LISTEN_BACKLOG)
    except BaseException:
        listener.close()
        raise
    return listener


@contextlib.contextmanager
def _locked(directory: Path) -> Iterator[None]:
    """Holds the lock of `directory`, so that of several hubs starting at once one wins.

    The lock is on the directory itself: no file stays behind, and a killed holder frees it.
    """
    handle = os.open(directory, os.O_RDONLY)
    try:
        deadline = time.monotonic() + _LOCK_WAIT_S
        while True:
            try:
                if sys.platform != "win32":
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:
                if time.monotonic() > deadline:
                    raise ChannelError(f"{directory} is locked by another process") from error
                time.sleep(0.005)
        yield
    finally:
        os.close(handle)
