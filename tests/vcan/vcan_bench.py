"""Two nodes on vcan0, and candump beside them: seen by other people's tools alone."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cantools.database

from meshpoint.testbench.cli import build_parser, main

build_parser()  # loads all commands, before anything is forked

ROOT = Path(__file__).resolve().parents[2]
DBC = cantools.database.load_file(ROOT / "dbc" / "meshpoint.dbc")
EMULATED = os.environ.get("WITH_VCAN") == "qemu"
SPEED = "0.05" if EMULATED else "1"
"""Bus time over wall time: an emulated processor is some twenty times slower."""
POLL_S = 0.5 if EMULATED else 0.1
PATIENCE_S = 400.0 if EMULATED else 60.0
BUS = ["-i", "socketcan", "-c", "vcan0", "--fd"]
VALVES = ("Brake", "SplitLow", "SplitHigh", "MainFirst", "MainSecond", "MainCrawl", "MainThird",
          "RangeLow", "RangeHigh")  # fmt: skip
IN_GEAR = 1
Values = dict[str, Any]


class Seen(NamedTuple):
    """One frame as candump wrote it."""

    can_id: int
    data: bytes

    @property
    def values(self) -> Values:
        """Decoded by cantools, in the DBC's units."""
        decoded: Values = DBC.get_message_by_frame_id(self.can_id).decode(
            self.data, decode_choices=False
        )
        return decoded


def parse(line: str) -> Seen:
    """A line of `candump -L`: (time) vcan0 ID#data, or ID##<flags>data for CAN FD."""
    frame = line.split()[2]
    can_id, _, rest = frame.partition("#")
    data = rest[2:] if rest.startswith("#") else rest
    return Seen(int(can_id, 16), bytes.fromhex(data))


class Candump:
    """`candump -L vcan0` into a file, read while it grows."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("wb")
        # -D: a device that goes down and up again does not end it. Line by line, to be read live.
        self._process = subprocess.Popen(
            ["stdbuf", "-oL", "candump", "-D", "-L", "vcan0"], stdout=self._file
        )
        self._read = path.open()
        self._unread: deque[str] = deque()
        self._rest = ""

    def lines(self) -> list[str]:
        """All complete lines so far."""
        text = self.path.read_text()
        return text[: text.rfind("\n") + 1].splitlines()

    def _take(self) -> None:
        """Reads on: the file grows by hundreds of lines a second, so never from the start."""
        *lines, self._rest = (self._rest + self._read.read()).split("\n")
        self._unread.extend(lines)

    def mark(self) -> None:
        """What comes from now on counts for `wait`."""
        self._take()
        self._unread.clear()

    def wait(self, name: str, accept: Callable[[Values], bool] = lambda _values: True) -> Values:
        """The first message of this name, from the mark on, that is accepted; the mark moves on."""
        can_id = DBC.get_message_by_name(name).frame_id
        tag = f" {can_id:08X}#"
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            self._take()
            while self._unread:
                line = self._unread.popleft()
                if tag in line:
                    values = parse(line).values
                    if accept(values):
                        return values
            time.sleep(POLL_S)
        raise AssertionError(f"no {name} as awaited within {PATIENCE_S:.0f} s")

    def in_gear(self, gear: int) -> Values:
        """Waits until the controller reports the gear with all its channels valid."""
        return self.wait(
            "ControllerStatus",
            lambda status: (
                status["State"] == IN_GEAR
                and status["CurrentGear"] == gear
                and status["InvalidChannels"] == 0
            ),
        )

    def stop(self) -> None:
        """Ends candump; the file stays."""
        self._process.terminate()
        self._process.wait()
        self._file.close()
        self._read.close()


class Command:
    """One meshpoint command in a process of its own.

    Forked from this one, which has loaded the product already: on an emulated processor loading it
    takes most of a minute, each time."""

    def __init__(self, folder: Path, name: str, *arguments: str) -> None:
        self._said = folder / f"{name}.err"
        self._printed = folder / f"{name}.out"
        self.pid = os.fork()
        if self.pid == 0:
            os._exit(self._run([name, *arguments]))
        self.returncode: int | None = None

    def _run(self, arguments: list[str]) -> int:
        try:
            for path, stream in ((self._printed, 1), (self._said, 2)):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), stream)
            # pytest's own capture has put others in their place.
            sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), line_buffering=True)
            sys.stderr = io.TextIOWrapper(io.FileIO(2, "w", closefd=False), line_buffering=True)
            code = main(arguments)
            sys.stdout.flush()
            sys.stderr.flush()
        except BaseException:  # noqa: BLE001 (a child must end here, however it went)
            traceback.print_exc()
            return 99
        return int(code)

    @property
    def said(self) -> str:
        """Its standard error so far."""
        return self._said.read_text() if self._said.exists() else ""

    @property
    def printed(self) -> str:
        """Its standard output so far."""
        return self._printed.read_text() if self._printed.exists() else ""

    def poll(self) -> int | None:
        """Its exit code, negative for a signal; None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self) -> int:
        """Waits for its end."""
        end_s = time.monotonic() + PATIENCE_S
        while (code := self.poll()) is None:
            assert time.monotonic() < end_s, f"still running: {self.said}"
            time.sleep(POLL_S)
        return code

    def signal(self, number: int) -> None:
        """Sends a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)


class Nodes:
    """Rig in gear 14 and controller, on bus time that waits for both."""

    def __init__(self, folder: Path) -> None:
        pace = folder / "pace.time"
        self._pace = Command(folder, "pace", str(pace), "--speed", SPEED)
        while not pace.exists():
            assert self._pace.poll() is None, self._pace.said
            time.sleep(POLL_S)
        common = ["--pace", str(pace), "--speed", SPEED, *BUS]
        # kernels are not compiled in the emulated machine: the truck's take it too long there
        gear = ["--preset", "thesis", "--gear", "14", "--main-speed", "300"]
        self.rig = Command(folder, "rig", *gear, *common)
        # nor are the controller's: there the bus is under test, with what is cheapest to compute
        cheap = ["--estimator", "thesis", "--strategy", "speed_window"] if EMULATED else []
        headers = ["--header-dir", str(folder)]
        self.controller = Command(folder, "controller", "--arm", *headers, *cheap, *common)

    def wait_said(self, node: Command, text: str, times: int = 1) -> None:
        """Waits until a node has said something so often."""
        end_s = time.monotonic() + PATIENCE_S
        while node.said.count(text) < times:
            assert time.monotonic() < end_s, f"{text!r} was not said: {node.said}"
            time.sleep(POLL_S)

    def stop(self) -> list[int]:
        """Ends both nodes as a user would; their exit codes."""
        nodes = (self.controller, self.rig)
        for node in nodes:
            node.signal(signal.SIGTERM)
        codes = [node.wait() for node in nodes]
        self._pace.signal(signal.SIGTERM)
        self._pace.wait()
        return codes


def meshpoint(folder: Path, *arguments: str) -> Command:
    """One command, to its end."""
    command = Command(folder, *arguments)
    command.wait()
    return command


def ip(*arguments: str) -> None:
    """`ip link ...`, as root."""
    subprocess.run(["ip", "link", *arguments], check=True)
