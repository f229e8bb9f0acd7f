"""Two nodes on vcan0, and candump beside them: seen by other people's tools alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cantools.database

ROOT = Path(__file__).resolve().parents[2]
DBC = cantools.database.load_file(ROOT / "dbc" / "meshpoint.dbc")
EMULATED = os.environ.get("WITH_VCAN") == "qemu"
SPEED = "0.05" if EMULATED else "1"
"""Bus time over wall time: an emulated processor is some twenty times slower."""
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
        self._position = 0

    def lines(self) -> list[str]:
        """All complete lines so far."""
        text = self.path.read_text()
        return text[: text.rfind("\n") + 1].splitlines()

    def mark(self) -> None:
        """What comes from now on counts for `wait`."""
        self._position = len(self.lines())

    def wait(self, name: str, accept: Callable[[Values], bool] = lambda _values: True) -> Values:
        """The first message of this name, from the mark on, that is accepted; the mark moves on."""
        can_id = DBC.get_message_by_name(name).frame_id
        tag = f" {can_id:08X}#"
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            lines = self.lines()
            for number in range(self._position, len(lines)):
                if tag in lines[number]:
                    values = parse(lines[number]).values
                    if accept(values):
                        self._position = number + 1
                        return values
            self._position = max(self._position, len(lines))
            time.sleep(0.2)
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


class Nodes:
    """Rig in gear 14 and controller, on bus time that waits for both."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        pace = folder / "pace"
        self._pace = self._start("pace", str(pace), "--speed", SPEED)
        while not pace.exists():
            time.sleep(0.1)
        common = ["--pace", str(pace), "--speed", SPEED, *BUS]
        gear = ["--gear", "14", "--main-speed", "300"]
        self.rig = self._start("rig", *gear, *common)
        self.controller = self._start("controller", "--header-dir", str(folder), *common)

    def _start(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.err").open("wb") as said:
            return subprocess.Popen(
                [sys.executable, "-m", "testbench", name, *arguments], cwd=ROOT, stderr=said
            )

    def said(self, name: str) -> str:
        """What a node has written on standard error."""
        return (self.folder / f"{name}.err").read_text()

    def wait_said(self, name: str, text: str, times: int = 1) -> None:
        """Waits until a node has said something so often."""
        end_s = time.monotonic() + PATIENCE_S
        while self.said(name).count(text) < times:
            assert time.monotonic() < end_s, f"{name} did not say {text!r}: {self.said(name)}"
            time.sleep(0.2)

    def stop(self) -> list[int]:
        """Ends both nodes as a user would; their exit codes."""
        nodes = (self.controller, self.rig)
        for node in nodes:
            if node.poll() is None:
                node.send_signal(signal.SIGTERM)
        codes = [node.wait(PATIENCE_S) for node in nodes]
        self._pace.send_signal(signal.SIGTERM)
        self._pace.wait(PATIENCE_S)
        return codes


def meshpoint(*arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """One command, to its end."""
    return subprocess.run(
        [sys.executable, "-m", "testbench", *arguments],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S, **more,
    )  # fmt: skip


def ip(*arguments: str) -> None:
    """`ip link ...`, as root."""
    subprocess.run(["ip", "link", *arguments], check=True)
