"""Records a bus to a log: candump text (`.log`), Vector's `.blf` or `.asc`."""

import asyncio
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, TextIO

import can

from meshpoint.bus.clock import US_PER_S, Clock, NodeClock
from meshpoint.bus.core import Step
from meshpoint.bus.driver import OnEvent, OpenBus, run_node
from meshpoint.bus.frames import message_of
from meshpoint.bus.local.closing import Closing
from meshpoint.bus.logs.bus_stamps import BusStamps
from meshpoint.bus.logs.reader import FORMATS, LogError
from meshpoint.dbc.frame import Frame

FLUSH_EVERY_S = 1.0
DEFAULT_CHANNEL = "vcan0"
# Names of devices; other channels (paths, addresses) would make no candump line.
_DEVICE_NAME = re.compile(r"[A-Za-z0-9_.-]{1,15}")

# A text log is flushed before its buffer is full, so always at the end of a line: what a killed
# process leaves can be read.
_BUFFER_BYTES = 1024 * 1024
_LONGEST_LINE_BYTES = 400
# A 64-byte CAN FD frame as a BLF object, 116 bytes, and the share of containers and compression.
_LONGEST_OBJECT_BYTES = 200
# What may still follow the frames: the last line of an ASC log, the header of a BLF container.
_END_BYTES = 256
_MAX_UNFLUSHED = _BUFFER_BYTES // _LONGEST_LINE_BYTES

_Writer = can.CanutilsLogWriter | can.ASCWriter | can.BLFWriter


class LogWriter(Closing):
    """Writes one log; its format is known by its ending (`meshpoint.bus.logs.reader.FORMATS`). A
    file that is there is replaced.

    channel: the name of the bus in the log.
    flush_every_s: flush when something is written so long after the last flush, so that a process
        that is killed leaves all but that; None: only by `flush` and `close`.
    by_frame_time: these seconds are those of the frames' own times, as a run in virtual time wants
        it: then what is in a `.log` or `.blf` depends on the frames alone.

    Raises LogError, here and on writing, when the file cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        channel: str = DEFAULT_CHANNEL,
        flush_every_s: float | None = FLUSH_EVERY_S,
        by_frame_time: bool = False,
    ) -> None:
        self.path = Path(path)
        self.frames = 0
        self._channel = channel
        self._flush_every_s = flush_every_s
        self._by_frame_time = by_frame_time
        self._flushed_at_s = None if by_frame_time else time.monotonic()
        self._flushed_bytes = 0
        self._unflushed = 0
        with self._errors():
            self._writer = self._open()
            # The head of the file, so that a process killed now leaves no part of one.
            self._writer.file.flush()

    def write(self, time_s: float, frame: Frame, received: bool = True) -> None:
        """Writes a frame; `received` is false for one that the recording node sent itself."""
        self.write_message(message_of(frame, time_s, received))

    def write_message(self, message: can.Message) -> None:
        """Writes a message of a bus, with its time stamp. Changes the name of its channel when
        that is not one of a device."""
        if not _DEVICE_NAME.fullmatch(str(message.channel)):
            message.channel = self._channel
        with self._errors():
            self._writer.on_message_received(message)
            self.frames += 1
            self._unflushed += 1
            if self._unflushed >= _MAX_UNFLUSHED and not isinstance(self._writer, can.BLFWriter):
                self._flush_text(self._writer)
            now_s = message.timestamp if self._by_frame_time else time.monotonic()
            if self._is_flush_due(now_s):
                self.flush()
                self._flushed_at_s = now_s

    def flush(self) -> None:
        """Brings everything written so far into the file, which is complete then."""
        if self._unflushed == 0:
            return
        with self._errors():
            if isinstance(self._writer, can.BLFWriter):
                self._reopen_blf(self._writer)
            else:
                self._flush_text(self._writer)
            self._flushed_bytes = self.path.stat().st_size
        if not self._by_frame_time:
            self._flushed_at_s = time.monotonic()

    def has_room(self, max_bytes: int) -> bool:
        """Whether one more frame surely leaves the log below `max_bytes`. Flushes where only the
        file can tell."""
        is_blf = isinstance(self._writer, can.BLFWriter)
        longest = _LONGEST_OBJECT_BYTES if is_blf else _LONGEST_LINE_BYTES
        if self._flushed_bytes + (self._unflushed + 1) * longest + _END_BYTES <= max_bytes:
            return True
        self.flush()
        return self._flushed_bytes + longest + _END_BYTES <= max_bytes

    def close(self) -> None:
        """Completes the log."""
        with self._errors():
            self._writer.stop()

    def _is_flush_due(self, now_s: float) -> bool:
        if self._flush_every_s is None:
            return False
        if self._flushed_at_s is None:
            self._flushed_at_s = now_s
        return now_s - self._flushed_at_s >= self._flush_every_s

    def _open(self) -> _Writer:
        match self.path.suffix.lower():
            case ".log":
                return can.CanutilsLogWriter(self._open_text(), channel=self._channel)
            case ".asc":
                return can.ASCWriter(self._open_text())
            case ".blf":
                return can.BLFWriter(self.path)
        cause = f"unknown ending {self.path.suffix!r}; known are {', '.join(FORMATS)}"
        raise LogError(self.path, "", cause)

    def _open_text(self) -> TextIO:
        return self.path.open("w", buffering=_BUFFER_BYTES, encoding="ascii", newline="\n")

    def _flush_text(self, writer: can.CanutilsLogWriter | can.ASCWriter) -> None:
        writer.file.flush()
        self._unflushed = 0

    def _reopen_blf(self, writer: can.BLFWriter) -> None:
        """python-can writes the last container and the header of a BLF log only when it ends it."""
        writer.stop()
        self._writer = can.BLFWriter(self.path, append=True)
        # python-can reads this back from the header, which holds no times before 1990.
        self._writer.start_timestamp = writer.start_timestamp
        self._unflushed = 0

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise LogError(self.path, "", error.strerror or str(error)) from error


class Log(Protocol):
    """What a recorder needs of a log: `LogWriter`, or `meshpoint.bus.logs.files.RotatingLog`."""

    def write_message(self, message: can.Message) -> None:
        """Writes a message of a bus."""

    def flush(self) -> None:
        """Brings everything written so far into the file."""


async def record_bus(
    open_bus: OpenBus,
    log: Log,
    *,
    on_event: OnEvent,
    stop: asyncio.Event,
    name: str = "recorder",
    bus_clock: NodeClock | None = None,
) -> None:
    """Writes every message of a bus to `log` until `stop` is set; the caller closes the log.

    bus_clock: of the nodes on the bus, by which the log is stamped; None: by the interface.

    A bus that goes away is reported and opened again, as for any node
    (`meshpoint.bus.driver.run_node`).
    """
    await run_node(
        _Flushing(log),
        open_bus,
        Clock(),
        on_event=on_event,
        stop=stop,
        name=name,
        on_message=BusStamps(bus_clock or Clock(), log.write_message),
    )


class _Flushing:
    """A core that flushes the log once a second, also when no more frames come."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self.next_step_us = 0

    def receive(self, frame: Frame) -> None:
        """Frames are written with the time of the bus, which a core does not see."""

    def step(self, now_us: int) -> Step:
        self._log.flush()
        self.next_step_us = now_us + round(FLUSH_EVERY_S * US_PER_S)
        return Step([], [])

    def shutdown(self, now_us: int) -> Step:
        return self.step(now_us)
