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
from meshpoint.bus.local.own_files import open_own, others_may_write

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
        with contextlib.suppress(FileNotFoundError, ChannelError), _locked(channel):
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
        with _locked(channel):
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
def _locked(channel: UnixChannel) -> Iterator[None]:
    """Holds the lock of a channel, so that of several hubs starting at once one wins.

    The lock is on the folder itself: no file stays behind, and a killed holder frees it. Where
    others may write, and so lock the folder, it is on a file of ours, removed by who holds it."""
    folder = channel.path.parent
    if not others_may_write(folder):
        handle = os.open(folder, os.O_RDONLY)
        try:
            _wait_for_lock(handle, folder)
            yield
        finally:
            os.close(handle)
        return
    path = channel.path.with_name(channel.path.name + ".lock")
    while True:
        handle = open_own(path)
        try:
            _wait_for_lock(handle, path)
            if not _is_at(handle, path):
                continue  # who held it before has removed it
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
            return
        finally:
            os.close(handle)


def _wait_for_lock(handle: int, what: Path) -> None:
    deadline = time.monotonic() + _LOCK_WAIT_S
    while True:
        try:
            if sys.platform != "win32":
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            if time.monotonic() > deadline:
                raise ChannelError(f"{what} is locked by another process") from error
            time.sleep(0.005)
        else:
            return


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False
