"""What the acceptance tests share: running the commands, and reading the wire with other tools.

Nothing here imports the product. Commands run as processes; frames are read by python-can, decoded
by cantools with the DBC as it lies in the repository, and checked by autosar-e2e.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import can
import cantools.database
from e2e import p05
from patience import HANG_S, Patience

ROOT = Path(__file__).resolve().parents[2]
DBC_FILE = ROOT / "dbc" / "meshpoint.dbc"
THESIS_SHEET = ROOT / "meshpoint" / "gearbox" / "sheets" / "thesis.toml"
COMMAND = (sys.executable, "-m", "meshpoint")

# The thesis's sheet: 48 dog teeth, backlash a fifth of the pitch.
PITCH_DEG = 7.5
HALF_BACKLASH_DEG = 0.75
EXPIRY_US = 100_000
US_WRAP = 1 << 32

MAIN_GEAR_OF = {13: 1, 14: 1} | {gear: 2 + (gear - 1) % 6 // 2 for gear in range(1, 13)}


STRATEGIES = ("speed_window", "target_phase")
FIRST_SEEDS = (1, 2, 3)
OTHER_SEEDS = (101, 202, 303)
SHIFTS = 60


def words(text: str) -> list[str]:
    return text.split()


# ---------------------------------------------------------------------------------- processes


class Outcome(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def text(self) -> str:
        return f"exit code {self.code}\n--- stdout\n{self.out}\n--- stderr\n{self.err}"

    @property
    def json(self) -> Any:
        return strict_json(self.out)


def strict_json(text: str) -> Any:
    """JSON as RFC 8259 has it: NaN and Infinity are no JSON."""

    def refuse(token: str) -> None:
        raise ValueError(f"{token} is not JSON")

    return json.loads(text, parse_constant=refuse)


def environment(**more: str) -> dict[str, str]:
    """The environment of a command: the repository importable, no CAN settings of this user."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("CAN_")}
    kept["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), kept.get("PYTHONPATH", "")]))
    kept["PYTHONUNBUFFERED"] = "1"
    kept["COLUMNS"] = "200"
    kept.pop("NO_COLOR", None)
    return kept | more


def start(*arguments: object, cwd: Path, **more: str) -> subprocess.Popen[str]:
    """A command running in a process group of its own, its output in pipes."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=cwd,
        env=environment(**more),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def kill_group(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.communicate(timeout=HANG_S)


class PreparedCommands:
    """Processes that have the product imported and fork one more for each command."""

    def __init__(self) -> None:
        self._idle: queue.SimpleQueue[subprocess.Popen[str]] = queue.SimpleQueue()
        self.all: list[subprocess.Popen[str]] = []

    def _take(self) -> subprocess.Popen[str]:
        with contextlib.suppress(queue.Empty):
            return self._idle.get_nowait()
        process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("prepared_command.py"))],
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.all.append(process)
        return process

    def run(self, arguments: Sequence[str], cwd: Path, scratch: Path, timeout_s: float) -> Outcome:
        out, err = scratch / "out", scratch / "err"
        request = {
            "arguments": arguments,
            "cwd": str(cwd),
            "out": str(out),
            "err": str(err),
            "timeout_s": timeout_s,
        }
        process = self._take()
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        assert answer, "the product cannot be imported"
        self._idle.put(process)
        code = json.loads(answer)
        assert code is not None, f"{arguments} did not end within {timeout_s:g} s"
        return Outcome(code, out.read_text(errors="replace"), err.read_text(errors="replace"))

    def close(self) -> None:
        for process in self.all:
            process.kill()
            process.communicate()


PREPARED = PreparedCommands()


def run(*arguments: object, cwd: Path | None = None, timeout_s: float = HANG_S) -> Outcome:
    """Run a command to its end; a command that does not end in time fails the test."""
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as scratch:
        folder = Path(scratch)
        if hasattr(os, "fork"):
            work = folder / "work"
            work.mkdir()
            return PREPARED.run([*map(str, arguments)], cwd or work, folder, timeout_s)
        return run_whole(*arguments, cwd=cwd or folder, timeout_s=timeout_s)


def run_whole(*arguments: object, cwd: Path, timeout_s: float = HANG_S) -> Outcome:
    """The same by a fresh interpreter."""
    process = start(*arguments, cwd=cwd)
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        kill_group(process)
        raise AssertionError(f"{arguments} did not end within {timeout_s:g} s") from None
    return Outcome(process.returncode, out, err)


def run_many(commands: Sequence[Sequence[object]]) -> list[Outcome]:
    """Run commands, two at a time."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        return list(pool.map(lambda command: run(*command), commands))


def assert_ended_well(outcome: Outcome) -> None:
    assert outcome.code == 0, outcome.text
    assert "Traceback" not in outcome.err + outcome.out, outcome.text


def assert_refused(outcome: Outcome, *named: str) -> None:
    """Exit code 2, no traceback, and one error line that names each of `named`.

    argparse prints its usage first; the error itself is the last line.
    """
    assert "Traceback" not in outcome.err + outcome.out, outcome.text
    assert outcome.code == 2, outcome.text
    lines = [line for line in outcome.err.splitlines() if line.strip()]
    assert lines, f"refused without a word\n{outcome.text}"
    start_of_usage = lines[0].startswith("usage:")
    assert start_of_usage or len(lines) == 1, f"more than one line\n{outcome.text}"
    for name in named:
        assert name.lower() in lines[-1].lower(), f"{name!r} is not named\n{outcome.text}"


# --------------------------------------------------------------------------------------- wire


class Frame(NamedTuple):
    """One frame as another tool sees it."""

    time_s: float
    can_id: int
    data: bytes
    is_extended: bool
    is_fd: bool


class Wire:
    """The DBC through cantools, and the end-to-end header through autosar-e2e."""

    def __init__(self, path: Path = DBC_FILE) -> None:
        database = cantools.database.load_file(str(path))
        self.messages = {message.frame_id: message for message in database.messages}
        self.ids = {message.name: message.frame_id for message in database.messages}

    def message(self, name: str) -> Any:
        return self.messages[self.ids[name]]

    def name(self, can_id: int) -> str | None:
        return self.messages[can_id].name if can_id in self.messages else None

    def sender(self, can_id: int) -> str:
        return str(self.messages[can_id].senders[0])

    def data_id(self, can_id: int) -> int | None:
        """The end-to-end data identifier, None for messages that carry none (J1939)."""
        attributes = self.messages[can_id].dbc.attributes
        if "E2EProfile" not in attributes or attributes["E2EProfile"].value in (0, "None"):
            return None
        return int(attributes["E2EDataId"].value)

    def decode(self, frame: Frame) -> dict[str, Any]:
        return dict(
            self.messages[frame.can_id].decode(frame.data, decode_choices=False, allow_excess=False)
        )

    def crc_holds(self, frame: Frame) -> bool:
        data_id = self.data_id(frame.can_id)
        assert data_id is not None
        return bool(p05.e2e_p05_check(frame.data, data_id))

    def protect(self, can_id: int, data: bytes) -> bytes:
        """The payload with its counter kept and its CRC made to fit."""
        data_id = self.data_id(can_id)
        if data_id is None:
            return data
        protected = bytearray(data)
        p05.e2e_p05_protect(protected, data_id, increment_counter=False)
        return bytes(protected)

    def encode(self, name: str, counter: int, **signals: float) -> bytes:
        """A payload of `name`, all signals zero but the given ones, valid end to end."""
        message = self.message(name)
        values = {signal.name: 0 for signal in message.signals} | signals
        if self.data_id(message.frame_id) is not None:
            values["Counter"] = counter % 256
        data = message.encode(values, strict=False)
        return self.protect(message.frame_id, data)


def us_between(early: int, late: int) -> int:
    """Signed difference of two times of the 32-bit sensor clock."""
    return (late - early + US_WRAP // 2) % US_WRAP - US_WRAP // 2


# --------------------------------------------------------------------------------------- logs

CANDUMP_LINE = re.compile(
    r"^\((?P<time>\d+\.\d{6})\) (?P<channel>\S+) (?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
    r"(?P<mark>##[0-9A-Fa-f]|#)(?P<data>(?:[0-9A-Fa-f]{2})*)(?P<direction> [RT])?$"
)


def read_log(path: Path) -> list[Frame]:
    """The log as python-can reads it."""
    with can.LogReader(str(path)) as reader:
        return [
            Frame(
                message.timestamp,
                message.arbitration_id,
                bytes(message.data),
                message.is_extended_id,
                message.is_fd,
            )
            for message in reader
        ]


class Recorded(NamedTuple):
    """One `simulate` run: its output, its log, and the log's frames."""

    outcome: Outcome
    log: Path
    frames: list[Frame]

    @property
    def report(self) -> dict[str, Any]:
        report: dict[str, Any] = self.outcome.json
        return report


class LogLine(NamedTuple):
    """One line of a candump log, taken apart so that it can be tampered with."""

    prefix: str
    can_id: int
    mark: str
    data: bytes
    suffix: str

    @classmethod
    def parse(cls, line: str) -> LogLine:
        match = CANDUMP_LINE.match(line)
        assert match, f"no candump line: {line!r}"
        return cls(
            line[: match.start("mark")],
            int(match["id"], 16),
            match["mark"],
            bytes.fromhex(match["data"]),
            line[match.end("data") :],
        )

    @property
    def text(self) -> str:
        return f"{self.prefix}{self.mark}{self.data.hex().upper()}{self.suffix}"

    @property
    def time_s(self) -> float:
        return float(self.prefix[1 : self.prefix.index(")")])


def read_lines(log: Path) -> list[LogLine]:
    return [LogLine.parse(line) for line in log.read_text().splitlines()]


def write_lines(log: Path, lines: Sequence[LogLine]) -> None:
    log.write_text("".join(line.text + "\n" for line in lines))


def copy_run(log: Path, to: Path) -> Path:
    """The log and everything saved beside it, copied to a folder of its own."""
    shutil.copytree(log.parent, to)
    return to / log.name


def verdict_of(outcome: Outcome) -> str:
    """What `replay --verify` said: identical, differs N, not verifiable, error."""
    text = (outcome.out + outcome.err).lower()
    assert "traceback" not in text, outcome.text
    if outcome.code == 2:
        return "error"
    differs = re.search(r"differs at step (\d+)", text)
    said = [
        *([f"differs {differs[1]}"] if differs else []),
        *(["not verifiable"] if "not verifiable" in text else []),
        *(["identical"] if "identical" in text else []),
    ]
    assert len(said) == 1, f"not one verdict but {said}\n{outcome.text}"
    return said[0]


# ---------------------------------------------------------------------------------------- bus


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
