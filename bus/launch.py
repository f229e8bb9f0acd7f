"""Connecting to the hub of a channel, and starting one when nobody listens."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

from bus.channel import HubChannel, UnixChannel, private_directory
from bus.dial import NoHubError, dial

_RETRY_S = 0.01
_SOURCE_ROOT = Path(__file__).resolve().parent.parent

# Hubs started here, kept so that those which have ended are reaped.
_started: list[subprocess.Popen[bytes]] = []


class HubStartError(OSError):
    """No hub could be reached or started."""


def connect(channel: HubChannel, timeout_s: float, start: bool = True) -> socket.socket:
    """A greeted, non-blocking socket to the hub of `channel`, which is started if necessary.

    Safe when several processes do this at once: they end up at the same hub.

    Raises HubStartError when that fails or takes longer than `timeout_s` seconds, or an OSError
    of the connection (`bus.dial.dial`).
    """
    deadline = time.monotonic() + timeout_s
    hub: subprocess.Popen[bytes] | None = None
    while True:
        try:
            return dial(channel, timeout_s=max(0.1, deadline - time.monotonic()))
        except NoHubError as nobody:
            if not start:
                raise HubStartError(f"{channel}: no hub is running there") from nobody
            if time.monotonic() > deadline:
                raise HubStartError(f"{channel}: no hub within {timeout_s:g} s") from nobody
        if hub is None or hub.poll() == 0:
            # 0: it found another hub serving, or ended between its start and our call.
            hub = start_hub(channel)
        elif hub.returncode is not None:
            raise HubStartError(
                f"{channel}: the hub could not start: {_last_line(hub_log(channel))}"
            )
        time.sleep(_RETRY_S)


def start_hub(channel: HubChannel) -> "subprocess.Popen[bytes]":
    """Starts a hub that outlives this process and its terminal; its messages go to `hub_log`."""
    _started[:] = [hub for hub in _started if hub.poll() is None]
    paths = [str(_SOURCE_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    flags = 0
    if sys.platform == "win32":
        flags = subprocess.DETACHED_PROCESS | subprocess.CREATE_NEW_PROCESS_GROUP
    log = hub_log(channel)
    log.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with log.open("ab") as messages:
        hub = subprocess.Popen(
            [sys.executable, "-m", "bus.hub", str(channel)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            # Not ours: whoever waits for the end of our stderr would wait for the hub's end.
            stderr=messages,
            cwd=_SOURCE_ROOT.anchor,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,
            creationflags=flags,
        )
    _started.append(hub)
    return hub


def hub_log(channel: HubChannel) -> Path:
    """Where a hub started by a node leaves its messages."""
    if isinstance(channel, UnixChannel):
        return channel.path.with_name(channel.path.name + ".log")
    return private_directory() / f"tcp-{channel.host.replace(':', '_')}-{channel.port}.log"


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return lines[-1] if lines else f"see {log}"
