"""A third party on the bus that the commands meet on."""

from __future__ import annotations

import contextlib
import importlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
from acceptance_kit import ROOT
from acceptance_wire import Frame, Wire
from patience import Patience


def open_bus(channel: str) -> can.BusABC:
    """The product's bus by its python-can name, or by its class where it is not installed."""
    if "meshpoint" in can.VALID_INTERFACES:
        return can.Bus(interface="meshpoint", channel=channel)
    sys.path.insert(0, str(ROOT))
    plugin = importlib.import_module("meshpoint.bus.local.plugin")
    bus: can.BusABC = plugin.MeshpointBus(channel=channel)
    return bus


class Listener:
    """A third party on the bus: keeps every frame, and can send."""

    def __init__(self, channel: str, wire: Wire) -> None:
        self.wire = wire
        self.bus = open_bus(channel)
        self.frames: list[Frame] = []
        self.error: BaseException | None = None
        self._news = threading.Condition()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._stop.is_set():
            try:
                message = self.bus.recv(0.1)
            except (can.CanError, OSError, ValueError) as error:
                self.error = error
                return
            if message is None or message.is_error_frame or message.is_remote_frame:
                continue
            frame = Frame(
                time.monotonic(),
                message.arbitration_id,
                bytes(message.data),
                message.is_extended_id,
                message.is_fd,
            )
            with self._news:
                self.frames.append(frame)
                self._news.notify_all()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(2)
        with contextlib.suppress(can.CanError, OSError):
            self.bus.shutdown()

    def send(self, can_id: int, data: bytes, *, extended: bool = True, fd: bool = True) -> None:
        self.bus.send(
            can.Message(
                arbitration_id=can_id,
                data=data,
                is_extended_id=extended,
                is_fd=fd,
                bitrate_switch=fd,
            )
        )

    def position(self) -> int:
        """Where the next frame will be in `frames`."""
        return len(self.frames)

    def wait(
        self,
        name: str,
        condition: Callable[[dict[str, Any]], bool] = lambda values: True,
        *,
        since: int = 0,
    ) -> int:
        """Position of the first frame of `name` from `since` on for which the condition holds."""
        wanted = self.wire.ids[name]
        patience = Patience()
        position = since
        while True:
            with self._news:
                if position >= len(self.frames):
                    self._news.wait(0.05)
                count = len(self.frames)
            for index in range(position, count):
                frame = self.frames[index]
                if frame.can_id == wanted and condition(self.wire.decode(frame)):
                    return index
            position = max(position, count)
            patience.check(f"such a {name}", lambda: self._seen(wanted))

    def _seen(self, can_id: int) -> str:
        found = [frame for frame in self.frames if frame.can_id == can_id]
        last = self.wire.decode(found[-1]) if found else None
        return f"{len(self.frames)} frames seen, of these {len(found)}, the last: {last}"

    def of(self, name: str, since: int = 0, until: int | None = None) -> list[dict[str, Any]]:
        wanted = self.wire.ids[name]
        return [
            self.wire.decode(frame) for frame in self.frames[since:until] if frame.can_id == wanted
        ]

    def last(self, name: str) -> Frame:
        wanted = self.wire.ids[name]
        return next(frame for frame in reversed(self.frames) if frame.can_id == wanted)


def processes_naming(text: str) -> Iterator[tuple[int, str]]:
    """Processes whose command line holds `text` (a private channel of this test)."""
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            line = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if text in line:
                yield int(entry.parent.name), line
