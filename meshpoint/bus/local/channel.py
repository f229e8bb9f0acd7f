"""Where a hub is found: `unix:/path/to.sock` or `tcp:127.0.0.1:PORT`."""

import ipaddress
import os
import stat
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

DEFAULT_TCP_PORT = 29536

# sun_path of the smallest system (macOS 104, Linux 108), with its terminating zero
_MAX_UNIX_PATH_BYTES = 103

SYNTAX = "unix:/path/to.sock or tcp:127.0.0.1:PORT"


class ChannelError(ValueError):
    """A channel that does not name a place for a hub."""


class UnixChannel(NamedTuple):
    """A socket file, which the system lets only its owner open."""

    path: Path

    def __str__(self) -> str:
        return f"unix:{self.path}"


class TcpChannel(NamedTuple):
    """A TCP port. On a machine with several users, all of them can open it."""

    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"tcp:{host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether only processes of this machine reach it."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


HubChannel = UnixChannel | TcpChannel


def parse_channel(text: str) -> HubChannel:
    """The channel that `text` names; ChannelError says what is wrong with it."""
    kind, colon, rest = text.partition(":")
    if kind == "unix" and colon:
        return _parse_unix(text, rest)
    if kind == "tcp" and colon:
        return _parse_tcp(text, rest)
    raise ChannelError(f"channel {text!r} is not {SYNTAX}")


def default_channel() -> HubChannel:
    """The channel of this user, the same for all processes on this machine."""
    if sys.platform == "win32":
        return TcpChannel("127.0.0.1", DEFAULT_TCP_PORT)
    return UnixChannel(private_directory() / "default.sock")


def private_directory() -> Path:
    """This user's own directory for sockets and hub logs, made when missing.

    Raises ChannelError when somebody else could have put it there.
    """
    if sys.platform == "win32":
        directory = Path(tempfile.gettempdir()) / "meshpoint"
        directory.mkdir(exist_ok=True)
        return directory
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        directory = Path(runtime) / "meshpoint"
    else:
        directory = Path(tempfile.gettempdir()) / f"meshpoint-{os.getuid()}"
    directory.mkdir(mode=0o700, exist_ok=True)
    found = directory.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ChannelError(
            f"{directory} must be a directory of this user that nobody else can open "
            f"(found mode {stat.filemode(found.st_mode)}, owner {found.st_uid})"
        )
    return directory


def hub_log(channel: HubChannel) -> Path:
    """Where a hub in the background leaves its messages."""
    if isinstance(channel, UnixChannel):
        return channel.path.with_name(channel.path.name + ".log")
    return private_directory() / f"tcp-{channel.host.replace(':', '_')}-{channel.port}.log"


def _parse_unix(text: str, rest: str) -> UnixChannel:
    if sys.platform == "win32":
        raise ChannelError(
            f"channel {text!r}: this system has no unix sockets; use tcp:127.0.0.1:PORT"
        )
    if not rest:
        raise ChannelError(f"channel {text!r} names no path: {SYNTAX}")
    path = Path(rest).absolute()
    if len(os.fsencode(path)) > _MAX_UNIX_PATH_BYTES:
        raise ChannelError(
            f"channel {text!r}: the path has {len(os.fsencode(path))} bytes, "
            f"a socket's may have {_MAX_UNIX_PATH_BYTES}"
        )
    return UnixChannel(path)


def _parse_tcp(text: str, rest: str) -> TcpChannel:
    host, colon, port_text = rest.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not host or not (port_text.isascii() and port_text.isdigit()):
        raise ChannelError(f"channel {text!r} is not {SYNTAX}")
    port = int(port_text)
    if not 1 <= port <= 65535:
        raise ChannelError(f"channel {text!r}: port {port} is outside 1..65535")
    return TcpChannel(host, port)
