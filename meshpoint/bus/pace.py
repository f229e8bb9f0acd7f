"""Bus time that waits for its nodes: several processes share one clock, and none is left behind.

A machine under load stops a process, or all of them, for tenths of a second, while a valve command
expires after 100 ms: on such a machine a live run shows the machine, not the gearbox. Here time is
kept in a file that all nodes read. A pacemaker moves it on with the wall clock, but never further
than every node has promised to look at it again, plus a millisecond. A node takes its promise back
while it works, so that a step of many milliseconds takes one of bus time. It promises nothing while
frames are on their way from or to it, as far as its bus can tell, nor, once it has heard others,
while it hears nobody: frames are waited for as well. A machine that keeps up runs in real time; one
that does not runs slower, and the nodes cannot tell.

One writer a word, so nothing needs a lock.
"""

from __future__ import annotations

import argparse
import os
import struct
import sys
import threading
import weakref
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter, sleep

from meshpoint.bus import given_numbers
from meshpoint.bus.slowness import times_slower
from meshpoint.bus.standard_error import lasting_error

PACED_NODES = ("rig", "controller", "bench")
HEARTBEAT_US = 2_000
"""How long, at speed 1, a node may go without looking at the clock."""
SLACK_US = 1_000
BUS_SILENCE_US = 14_000
"""How long a bus on which nodes speak every 10 ms may seem silent before time waits for frames."""
TICK_S = 0.0005
LONGEST_TICK_US = 2_000.0
"""Of bus time, at speed 1 and below. A pacemaker that was itself stopped goes on from where it was,
not from where it would be."""
GIVEN_UP_S = 1.0
"""A node that does not move for this long, by the pacemaker's time at speed 1 and above, is not
waited for any more. On a machine that computes slowly it is as much longer; so it is where bus time
is slower, which is for slower machines."""

_ABSENT = -1
_MARK = 0x6563_6170_2D70_6D31
_MARK_BYTES = struct.pack("=q", _MARK)
_LAYOUT = f"={1 + len(PACED_NODES)}qq"
_SIZE = struct.calcsize(_LAYOUT)


def tick_s(speed: float) -> float:
    """Wall seconds between two polls at the wall clock: half a millisecond of bus time."""
    return TICK_S / min(1.0, speed)


class PaceError(ValueError):
    """A file that is no pace file, or is none any more; the message names it."""


class PaceFile:
    """The shared words: bus time in microseconds, then one promise a node, then a mark.

    The file is read and written, not mapped: reading what another process has cut off is an error
    here, and would be a signal there that ends the process."""

    def __init__(self, path: Path) -> None:
        """Opens an existing file; OSError when there is none, PaceError when it is another."""
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        # Every clock of a node shares this file: it is closed with the last of them.
        weakref.finalize(self, os.close, self._descriptor)
        self._words()

    @staticmethod
    def create(path: Path) -> PaceFile:
        """A new file: time zero, no node there. It comes under its name when it is whole, so that
        a node which waits for the file never opens half of one."""
        started = path.with_name(f"{path.name}.{os.getpid()}")
        # What is there is left over, or a link put there so that we write to where it points.
        started.unlink(missing_ok=True)
        try:
            with started.open("xb") as file:
                file.write(struct.pack(_LAYOUT, 0, *[_ABSENT] * len(PACED_NODES), _MARK))
            started.replace(path)
        finally:
            started.unlink(missing_ok=True)
        return PaceFile(path)

    @property
    def now_us(self) -> int:
        """Bus time. PaceError where the file was cut off or replaced by something else."""
        return self._words()[0]

    def set_now(self, now_us: int) -> None:
        """For the pacemaker alone."""
        self._write(0, now_us)

    def promise(self, node: int, until_us: int) -> None:
        """Node number `node` will look at the clock again by then."""
        self._write(1 + node, until_us)

    def leave(self, node: int) -> None:
        """Nobody needs to wait for this node."""
        self._write(1 + node, _ABSENT)

    def promises_us(self) -> list[int | None]:
        """What each node has promised; None for one that is not there. PaceError as for
        `now_us`."""
        return [None if word == _ABSENT else word for word in self._words()[1:]]

    def _words(self) -> tuple[int, ...]:
        """Time and promises; read until two readings agree: another process may be writing."""
        before = b""
        while True:
            content = self._read()
            if len(content) != _SIZE:
                raise PaceError(f"{self._path}: {len(content)} bytes, a pace file has {_SIZE}")
            if not content.endswith(_MARK_BYTES):
                raise PaceError(f"{self._path}: is no pace file, or none any more")
            if content == before:
                words: tuple[int, ...] = struct.unpack(_LAYOUT, content)
                return words[:-1]
            before = content

    if hasattr(os, "pread"):

        def _read(self) -> bytes:
            return os.pread(self._descriptor, _SIZE + 1, 0)

        def _write(self, word: int, value: int) -> None:
            os.pwrite(self._descriptor, struct.pack("=q", value), 8 * word)

    else:

        def _read(self) -> bytes:
            os.lseek(self._descriptor, 0, os.SEEK_SET)
            return os.read(self._descriptor, _SIZE + 1)

        def _write(self, word: int, value: int) -> None:
            os.lseek(self._descriptor, 8 * word, os.SEEK_SET)
            os.write(self._descriptor, struct.pack("=q", value))


class PacedClock:
    """A node's view of the shared bus time; the same use as `meshpoint.bus.clock.Clock`."""

    def __init__(self, file: PaceFile, name: str, speed: float = 1.0) -> None:
        """name: one of PACED_NODES."""
        self.speed = speed
        self._file = file
        self._node = PACED_NODES.index(name)
        self._heartbeat_us = int(HEARTBEAT_US * max(1.0, speed))
        self._heard_us: int | None = None
        self._promised_us = self._looked_us = 0
        self._now_us = 0
        self._is_broken = False

    def now_us(self) -> int:
        """Bus time in microseconds. PaceError, once, where the file is none any more: the node
        ends then, and its last step is at the last time there was."""
        if not self._is_broken:
            try:
                self._now_us = self._file.now_us
            except PaceError:
                self._is_broken = True
                raise
        return self._now_us

    def heard(self) -> None:
        """A frame of another node has arrived."""
        self._heard_us = self.now_us()

    def begins(self, now_us: int) -> None:
        """The node has begun to work at this bus time: until it has done, it takes back what it
        has promised beyond."""
        self._looked_us = now_us
        self._file.promise(self._node, min(now_us, self._promised_us))

    def here(self) -> None:
        """The node has done all that was due when it began: what fell due since, it has not seen,
        so it promises by then. Where others have spoken and none does now, it promises nothing
        further, until the pacemaker has given up and time has gone on."""
        now_us = self.now_us()
        if self._heard_us is not None:
            if now_us > self._promised_us + self._heartbeat_us + SLACK_US * max(1.0, self.speed):
                self._heard_us = None  # given up: there is nobody to wait for
            elif now_us - self._heard_us > BUS_SILENCE_US * max(1.0, self.speed):
                return
        self._promised_us = self._looked_us + self._heartbeat_us
        self._file.promise(self._node, self._promised_us)

    def leave(self) -> None:
        """The node ends."""
        if not self._is_broken:
            self._file.leave(self._node)

    def delay_s(self, until_us: int) -> float:
        """Wall seconds after which to look again: at `until_us`, or a heartbeat after it began
        to work."""
        now_us = self.now_us()
        if until_us <= now_us:
            return 0.0
        left_us = min(until_us, self._looked_us + self._heartbeat_us) - now_us
        return max(tick_s(self.speed), self.wall_s(left_us))

    def wall_s(self, clock_us: int) -> float:
        """Wall seconds that a span of bus time takes on a machine that keeps up."""
        return clock_us / (self.speed * 1e6)


class Pacemaker:
    """Decides how far bus time goes. Pure: the wall clock comes in as spans."""

    def __init__(self, speed: float, slower: float = 1.0) -> None:
        self.now_us = 0.0
        self._speed = speed
        self._given_up_us = GIVEN_UP_S * 1e6 * max(1.0 / min(1.0, speed), slower)
        self._seen: list[int | None] = [None] * len(PACED_NODES)
        self._still_us = [0.0] * len(PACED_NODES)

    def advance(self, elapsed_us: float, promises_us: Iterable[int | None]) -> int:
        """The bus time after `elapsed_us` of wall time, given what the nodes have promised."""
        elapsed_us = min(elapsed_us, LONGEST_TICK_US / min(1.0, self._speed))
        until_us = self.now_us + elapsed_us * self._speed
        for node, promise_us in enumerate(promises_us):
            moved = promise_us != self._seen[node]
            self._seen[node] = promise_us
            self._still_us[node] = 0.0 if moved else self._still_us[node] + elapsed_us
            if promise_us is not None and self._still_us[node] < self._given_up_us:
                until_us = min(until_us, promise_us + SLACK_US * max(1.0, self._speed))
        self.now_us = max(self.now_us, until_us)
        return int(self.now_us)


def keep_pace(path: Path, speed: float, ending: threading.Event) -> str:
    """Moves the time of the file on until `ending` is set, and returns what ended it before that:
    a file that is none any more. Empty: nothing did."""
    file = PaceFile(path)
    pacemaker = Pacemaker(speed, times_slower())
    before_s = perf_counter()
    while not ending.is_set():
        sleep(tick_s(speed))
        now_s = perf_counter()
        try:
            promises_us = file.promises_us()
        except PaceError as error:
            return str(error)
        file.set_now(pacemaker.advance((now_s - before_s) * 1e6, promises_us))
        before_s = now_s
    return ""


def main(arguments: list[str] | None = None) -> int:
    """`python -m meshpoint.bus.pace FILE --speed X`: keeps pace until standard input ends, as it
    does when the process that started this one is gone, however it went."""
    parser = argparse.ArgumentParser(description="Keeps the bus time of a paced run.")
    parser.add_argument("file", type=Path)
    parser.add_argument("--speed", type=given_numbers.speed, default=1.0)
    chosen = parser.parse_args(arguments)
    ending, faults = threading.Event(), [""]

    def keep() -> None:
        faults[0] = keep_pace(chosen.file, chosen.speed, ending)
        if faults[0]:
            sys.stderr.write(f"pace: {faults[0]}\n")

    keeper = threading.Thread(target=keep)
    keeper.start()
    sys.stdin.buffer.read()
    ending.set()
    keeper.join()
    return 1 if faults[0] else 0


if __name__ == "__main__":
    with lasting_error():
        code = main()
    raise SystemExit(code)
