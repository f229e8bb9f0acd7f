"""What a hub trusts in a folder where others may write: files of its own user, peers of its own
user, and root."""

from __future__ import annotations

import os
import socket
import stat
import struct
import sys
from pathlib import Path
from typing import Final

from meshpoint.bus.local.channel import ChannelError

_FLAGS: Final = (
    os.O_RDWR
    | os.O_CREAT
    | os.O_APPEND
    | getattr(os, "O_NOFOLLOW", 0)
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_CLOEXEC", 0)
)
_CREDENTIALS: Final = struct.Struct("3i")  # unix(7): process, user, group


class StrangerError(PermissionError):
    """At the other end of a unix socket is another user's process."""


def open_own(path: Path) -> int:
    """A descriptor of a file of this user that nobody else can open, made where it is missing;
    never of what a link points to. ChannelError for any other."""
    try:
        descriptor = os.open(path, _FLAGS, 0o600)
    except OSError as error:
        raise ChannelError(f"{path}: cannot be opened: {error.strerror or error}") from error
    found = os.fstat(descriptor)
    if sys.platform != "win32" and (
        not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077
    ):
        os.close(descriptor)
        raise ChannelError(
            f"{path} must be a file of this user that nobody else can open "
            f"(found mode {stat.filemode(found.st_mode)}, owner {found.st_uid})"
        )
    return descriptor


def others_may_write(folder: Path) -> bool:
    """Whether another user can put files into a folder, as into /tmp."""
    if sys.platform == "win32":
        return False
    found = folder.stat()
    return found.st_uid not in (os.getuid(), 0) or bool(found.st_mode & 0o022)


def check_peer(connection: socket.socket) -> None:
    """StrangerError where another user than this one or root is at the other end of a unix socket.
    Only Linux says who it is."""
    if sys.platform != "linux" or connection.family != socket.AF_UNIX:
        return
    option = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, user, _ = _CREDENTIALS.unpack(option)
    if user not in (os.getuid(), 0):
        raise StrangerError(
            f"a process of user {user} is there; allowed are this user, {os.getuid()}, and root"
        )
