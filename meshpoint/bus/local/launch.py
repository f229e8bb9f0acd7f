"""Connecting to the hub of a channel, and starting one when nobody listens."""

import socket
import subprocess
import sys
import time
from pathlib import Path

from meshpoint.bus.local.channel import HubChannel
from meshpoint.bus.local.dial import NoHubError, dial
from meshpoint.bus.signals import apart

_RETRY_S = 0.01


class HubStartError(OSError):
    """No hub could be reached or started."""


def connect(channel: HubChannel, timeout_s: float, start: bool = True) -> socket.socket:
    """A greeted, non-blocking socket to the hub of `channel`, which is started if necessary.

    Safe when several processes do this at once: they end up at the same hub.

    Raises HubStartError when that fails or takes longer than `timeout_s` seconds, or an OSError
    of the connection (`meshpoint.bus.local.dial.dial`).
    """
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return dial(channel, timeout_s=max(_RETRY_S, deadline - time.monotonic()))
        except NoHubError as nobody:
            if not start:
                raise HubStartError(f"{channel}: no hub is running there") from nobody
            if time.monotonic() > deadline:
                raise HubStartError(f"{channel}: no hub within {timeout_s:g} s") from nobody
        # Again and again: the hub we found, or started, may end before we are connected.
        start_hub(channel, timeout_s)
        time.sleep(_RETRY_S)


def start_hub(channel: HubChannel, timeout_s: float) -> None:
    """Sees to it that a hub serves `channel`, one that outlives this process and its terminal.

    Raises HubStartError.
    """
    try:
        result = subprocess.run(  # noqa: S603 (our own module)
            [sys.executable, "-m", "meshpoint.bus.local.hub", str(channel), "--detach"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
            # Not here: it outlives this process and must not hold the folder.
            cwd=Path(sys.executable).anchor,
            timeout=timeout_s,
            check=False,
            **apart(),
        )
    except subprocess.TimeoutExpired as error:
        raise HubStartError(f"{channel}: no hub within {timeout_s:g} s") from error
    if result.returncode != 0:
        reason = result.stderr.strip().splitlines()[-1:] or [f"exit code {result.returncode}"]
        raise HubStartError(reason[0])
