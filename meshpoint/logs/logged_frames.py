"""The frames of a log in their order, with an account of them and of how far it could be read."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from meshpoint.bus.logs.files import read_logs
from meshpoint.bus.logs.reader import LogError
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox.reading import UnreadableError, open_regular
from meshpoint.logs.account import Account
from meshpoint.logs.log_clock import LogClock, LogClockFit, Unpack, clock_of

TELL_FRAMES: Final = 500
SAMPLE_BYTES: Final = 1 << 16
TEXT_LOGS: Final = (".log", ".asc")


class LoggedFrames:
    """Times in seconds and frames, once; remembers the defect that ended them early, and how the
    log's clock ran against the sensors'. A log of which nothing can be read raises LogError."""

    def __init__(
        self,
        files: list[Path],
        bus: str | None,
        tell: Callable[[int], None],
        stop: Callable[[], bool],
        *,
        in_sensor_time: bool = False,
        unpack: Callable[[], Unpack] | None = None,
    ) -> None:
        """bus: the one to read of several. tell: how many frames were read, now and then and at the
        end. stop: whether it shall end here, as Ctrl-C asks for. in_sensor_time: times are those of
        the sensors' clock, for which the log is read twice. unpack: as `clock_of` has it."""
        self._files = files
        self._bus = bus
        self._tell = tell
        self._stop = stop
        self._in_sensor_time = in_sensor_time
        self._unpack = unpack
        self.clock = LogClock([])
        """The log's clock against the sensors'; known at the end, in sensor time from the start."""
        self.buses: Counter[str] = Counter()
        """Frames of each bus."""
        self.account = Account()
        self.frames = 0
        self.defect: LogError | None = None
        self.interrupted = False

    def __iter__(self) -> Iterator[tuple[float, Frame]]:
        if self._in_sensor_time:
            with suppress(LogError):  # it is noted when the frames are read
                self.clock = clock_of(self._files, self._bus, self._unpack, self._stop)
            yield from self.clock.in_sensor_time(self._entries(), self._new_unpack())
            return
        fit = LogClockFit(self._new_unpack())
        for time_s, frame in self._entries():
            fit.take(time_s, frame)
            yield time_s, frame
        self.clock = fit.finish()

    def _new_unpack(self) -> Unpack | None:
        return None if self._unpack is None else self._unpack()

    def _entries(self) -> Iterator[tuple[float, Frame]]:
        """The log's own."""
        try:
            for time_s, frame in read_logs(self._files, self._bus, self.buses):
                self.account.take(time_s, frame)
                self.frames += 1
                yield time_s, frame
                if self.frames % TELL_FRAMES == 0:
                    self._tell(self.frames)
                    self.interrupted = self._stop()
                    if self.interrupted:
                        return
        except LogError as error:
            if not self.frames:
                raise
            self.defect = error
        self._tell(self.frames)

    def words(self) -> list[str]:
        """What is amiss with the frames and the clock of the log, a line each."""
        is_said = self._in_sensor_time or self.clock.differs
        return self.account.words() + ([self.clock.words] if is_said and self.clock.words else [])


def expected_frames(files: list[Path]) -> int | None:
    """About how many frames text logs hold, by the length of their first lines; None for others."""
    total = 0
    for path in files:
        if path.suffix.lower() not in TEXT_LOGS:
            return None
        try:
            with open_regular(path) as file:
                start = file.read(SAMPLE_BYTES)
                size = file.seek(0, os.SEEK_END)
        except (OSError, UnreadableError):
            return None
        lines = start.count(b"\n")
        total += size * lines // max(1, len(start))
    return total or None
