"""Two nodes on one bus, and candump beside them: seen by other people's tools alone.

The bus is vcan0; `tests/controllers_emulated` puts the nodes on the two ends of another one.
"""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cantools.database
from patience import POLL_S, Patience, until

from meshpoint.bus.pace import PACED_NODES, PaceFile
from meshpoint.cli.main import main
from meshpoint.cli.table import build_parser
from meshpoint.controller.run.warm_up import warm_up as load_controller_kernels
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.node import run_rig  # noqa: F401 (as `rig` does once it runs)
from meshpoint.rig_sim.presets import warm_up as load_rig_kernels
from meshpoint.rig_sim.settings import Preset

for _name in ("up", "rig", "controller", "request", "replay"):
    build_parser(_name)  # loads the command, before anything is forked

ROOT = Path(__file__).resolve().parents[2]
DBC = cantools.database.load_file(ROOT / "dbc" / "meshpoint.dbc")
EMULATED = os.environ.get("WITH_VCAN") == "qemu"
SPEED = 0.1 if EMULATED else 1.0
"""Bus time over wall time: an emulated processor is some twenty times slower. Where that is too
fast for the machine, bus time waits for the nodes."""
PATIENCE_BUS_S = 20.0
"""A shift takes half a second of bus time."""
AGAIN_BUS_S = 0.5
"""A request on which the controller does not act by then is sent again."""
GAP_MS = "500" if EMULATED else "20"
"""Between two frames of other traffic, which goes by the wall clock: bus time waits for a node that
has too many to read."""
LOOK_S = 0.2 if EMULATED else POLL_S
"""Looking costs processor time, which the nodes want."""
load_controller_kernels(baselines=EMULATED)
load_rig_kernels(load_sheet("thesis"), Preset.THESIS)
"""Before anything is forked, too: to load numba and the kernels takes a node as long as all else
that it does in a test."""
VALVES = ("Brake", "SplitLow", "SplitHigh", "MainFirst", "MainSecond", "MainCrawl", "MainThird",
          "RangeLow", "RangeHigh")  # fmt: skip
IN_GEAR = 1
ENGAGED = 1
LATE_FAULTS = {1: "SpeedStale", 2: "PositionStale", 3: "ValveLinkLost"}
"""What the controller says of a shift when the other node's frames were late: not a failure of
either, and asked again."""
Values = dict[str, Any]
Accept = Callable[[Values], bool]


class Seen(NamedTuple):
    """One frame as candump wrote it."""

    can_id: int
    data: bytes
    dbc: cantools.database.Database = DBC

    @property
    def name(self) -> str:
        """As the DBC calls it."""
        return str(self.dbc.get_message_by_frame_id(self.can_id).name)

    @property
    def values(self) -> Values:
        """Decoded by cantools, in the DBC's units."""
        decoded: Values = self.dbc.get_message_by_frame_id(self.can_id).decode(
            self.data, decode_choices=False
        )
        return decoded


def parse(line: str, dbc: cantools.database.Database = DBC) -> Seen:
    """A line of `candump -L`: (time) vcan0 ID#data, or ID##<flags>data for CAN FD."""
    frame = line.split()[2]
    can_id, _, rest = frame.partition("#")
    data = rest[2:] if rest.startswith("#") else rest
    return Seen(int(can_id, 16), bytes.fromhex(data), dbc)


@dataclass(frozen=True)
class Contract:
    """What the frames of a profile mean. parts: how many frames some messages come in; the
    frames' names are the message's with 1, 2 and so on behind it."""

    dbc: cantools.database.Database = DBC
    parts: Mapping[str, int] = field(default_factory=dict)
    options: tuple[str, ...] = ("--fd",)
    """Of the nodes that speak it."""
    silent_channels: int = 0
    """Bits of the status's InvalidChannels that stay set, as the profile has no such messages."""

    def frames(self, name: str) -> list[str]:
        """The names of a message's frames, in order."""
        count = self.parts.get(name)
        return [name] if count is None else [f"{name}{part + 1}" for part in range(count)]

    def tag(self, frame: str) -> str:
        """What marks a frame's line."""
        return f" {self.dbc.get_message_by_name(frame).frame_id:08X}#"

    def parse(self, line: str) -> Seen:
        """A line of `candump -L`."""
        return parse(line, self.dbc)


@dataclass(frozen=True)
class Wire:
    """The devices of the two nodes, which may be the same. candump, `cansend` and other traffic are
    at the rig's end, so that what they see of the controller has been over the bus."""

    controller: str
    rig: str
    contract: Contract
    prepare: Callable[[], None]
    """Makes the devices as they should be, whatever a test before this one did to them."""

    def options(self, device: str) -> list[str]:
        """Of a node on one of them."""
        return ["-i", "socketcan", "-c", device, *self.contract.options]


class Assembly:
    """A message's frames until the last one has come: one that was missed makes it void."""

    def __init__(self, contract: Contract, names: set[str]) -> None:
        self._contract = contract
        self._where = {
            contract.tag(frame): (name, number, frame == contract.frames(name)[-1])
            for name in names
            for number, frame in enumerate(contract.frames(name))
        }
        self._so_far: dict[str, tuple[int, Values]] = {}

    def take(self, line: str) -> tuple[str, Values] | None:
        """The message that this line makes complete, if it does."""
        where = next((where for tag, where in self._where.items() if tag in line), None)
        if where is None:
            return None
        name, number, is_last = where
        wanted, values = self._so_far.pop(name, (0, {}))
        if number not in (0, wanted):
            return None
        values = (values if number else {}) | self._contract.parse(line).values
        if is_last:
            return name, values
        self._so_far[name] = (number + 1, values)
        return None


class Candump:
    """`candump -L DEVICE` into a file, read while it grows."""

    def __init__(
        self, path: Path, wire: Wire, patience: Callable[[], Patience], say: Callable[[], str]
    ) -> None:
        self.path = path
        self._contract = wire.contract
        self._patience, self._say = patience, say
        self._file = path.open("wb")
        # -D: a device that goes down and up again does not end it. Line by line, to be read live.
        self._process = subprocess.Popen(
            ["stdbuf", "-oL", "candump", "-D", "-L", wire.rig], stdout=self._file
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

    def messages(self, names: set[str], what: str) -> Iterator[tuple[str, Values]]:
        """Every message of these names from the mark on, which moves on; waits for the next for as
        long as a test has patience."""
        patience, assembly = self._patience(), Assembly(self._contract, names)
        while True:
            self._take()
            while self._unread:
                message = assembly.take(self._unread.popleft())
                if message is not None:
                    yield message
            patience.check(what, self._say)
            time.sleep(LOOK_S)

    def wait(self, name: str, accept: Accept = lambda _values: True, what: str = "") -> Values:
        """The first message of this name, from the mark on, that is accepted."""
        for _, values in self.messages({name}, what or f"{name} as awaited"):
            if accept(values):
                return values
        raise AssertionError("there is no end of messages")

    def last(self, name: str) -> Values | None:
        """The newest message of this name so far."""
        assembly, newest = Assembly(self._contract, {name}), None
        for line in self.lines():
            message = assembly.take(line)
            newest = message[1] if message is not None else newest
        return newest

    def in_gear(self, gear: int) -> Values:
        """Waits until the controller reports the gear with all its channels valid."""
        return self.wait(
            "ControllerStatus",
            lambda status: (
                status["State"] == IN_GEAR
                and status["CurrentGear"] == gear
                and status["InvalidChannels"] == self._contract.silent_channels
            ),
            f"the controller in gear {gear}",
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
        self.name = name
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
        """Waits for its end; a hang is for pytest's time limit to find."""
        while (code := self.poll()) is None:
            time.sleep(LOOK_S)
        return code

    def signal(self, number: int) -> None:
        """Sends a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)


class Bench:
    """Rig in gear 14 and controller on bus time that waits for both, and candump."""

    def __init__(self, folder: Path, wire: Wire | None = None) -> None:
        self.folder = folder
        self.wire = wire = VCAN if wire is None else wire
        wire.prepare()
        pace = folder / "pace.time"
        self._pace = Command(folder, "up", "--pace-only", str(pace), "--speed", str(SPEED))
        until(lambda: self._pace.poll() is not None or pace.exists(), "a bus time")
        assert self._pace.poll() is None, self._pace.said
        self._time = PaceFile(pace)
        self.dump = Candump(folder / "candump.log", wire, self.patience, self.story)
        common = ["--gearbox", "thesis", "--pace", str(pace), "--speed", str(SPEED)]
        gear = ["--preset", "thesis", "--gear", "14", "--main-speed", "300"]
        self.rig = Command(folder, "rig", *gear, *common, *wire.options(wire.rig))
        # an emulated processor computes what is cheapest: the bus is under test here
        cheap = ["--estimator", "thesis", "--strategy", "speed_window"] if EMULATED else []
        headers = ["--header-dir", str(folder)]
        arguments = [*headers, *cheap, *common, *wire.options(wire.controller)]
        self.controller = Command(folder, "controller", "--arm", *arguments)
        self._wait_for_both()

    def _wait_for_both(self) -> None:
        """Bus time waits for no node that has not yet joined it, and loading one has taken four
        minutes on a busy machine: patience begins when both are there. A hang is for pytest's time
        limit to find."""
        joined = (PACED_NODES.index("rig"), PACED_NODES.index("controller"))
        while any(self._time.promises_us()[node] is None for node in joined):
            for node in (self.rig, self.controller):
                assert node.poll() is None, f"{node.name} ended with {node.poll()}{self.story()}"
            self.bus_s()  # fails where the pacemaker has ended
            time.sleep(LOOK_S)

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_error: object) -> None:
        self.stop()
        self.dump.stop()
        with suppress(subprocess.CalledProcessError):
            self.wire.prepare()

    @contextmanager
    def another_candump(self) -> Iterator[Candump]:
        """For a device that was made anew: the first candump hears the old one."""
        dump = Candump(self.folder / "again.log", self.wire, self.patience, self.story)
        try:
            yield dump
        finally:
            dump.stop()

    def bus_s(self) -> float:
        """Bus time; whoever waits for it learns when its pacemaker has ended."""
        assert self._pace.poll() is None, f"bus time has ended: {self._pace.said}"
        return self._time.now_us / 1e6

    def patience(self) -> Patience:
        """In bus time: it waits for nodes which the machine keeps from running."""
        return Patience(PATIENCE_BUS_S, self.bus_s)

    def story(self) -> str:
        """What the nodes said and where the controller stood last."""
        last = self.dump.last("ControllerStatus") or "none"
        said = "\n".join(f"{n.name} said: {n.said}" for n in (self.rig, self.controller))
        return f"\n{said}\nthe last status: {last}"

    def shift(self, gear: int, name: str = "ShiftOutcome", accept: Accept = bool) -> Values:
        """Asks for a gear by cansend, again where the request was lost or a node was late, and
        waits for a message of the shift. A shift that ends otherwise fails the test."""
        what, asked_s, acting = f"{name} of the shift to {gear}", -AGAIN_BUS_S, False
        for seen, values in self.dump.messages({name, "ShiftOutcome", "ControllerStatus"}, what):
            if seen == name and accept(values) and (name != "ShiftOutcome" or ended_well(values)):
                return values
            if seen == "ShiftOutcome":
                assert values["Fault"] in LATE_FAULTS or ended_well(values), (
                    f"{what}: it ended with {values}{self.story()}"
                )
                acting = False
            elif seen == "ControllerStatus":
                acting = values["TargetGear"] == gear
            if not acting and self.bus_s() - asked_s >= AGAIN_BUS_S:
                self.ask_by_cansend(gear)
                asked_s = self.bus_s()
        raise AssertionError("there is no end of messages")

    def ask_by_cansend(self, gear: int) -> None:
        """J1939 TC1 as any tool on the bus would send it."""
        message = self.wire.contract.dbc.get_message_by_name("TC1")
        most = {signal.name: signal.maximum for signal in message.signals}
        values = message.decode(message.encode(most, strict=False), decode_choices=False)
        data = message.encode(values | {"RequestedGear": gear}, strict=False)
        frame = f"{message.frame_id:08X}#{data.hex()}"
        subprocess.run(["cansend", self.wire.rig, frame], check=True)

    def wait_said(self, text: str, times: int = 1) -> None:
        """Waits until both nodes have said something so often."""
        until(
            lambda: all(node.said.count(text) >= times for node in (self.rig, self.controller)),
            f"{text!r}, {times} x from both nodes",
            patience=self.patience(),
            say=self.story,
            poll_s=LOOK_S,
        )

    def stop(self) -> list[int]:
        """Ends both nodes as a user would; their exit codes."""
        nodes = (self.controller, self.rig)
        for node in nodes:
            node.signal(signal.SIGTERM)
        codes = [node.wait() for node in nodes]
        self._pace.signal(signal.SIGTERM)
        self._pace.wait()
        return codes


def ended_well(outcome: Values) -> bool:
    """Whether a ShiftOutcome is one of a gear engaged."""
    return bool(outcome["Result"] == ENGAGED)


def meshpoint(folder: Path, *arguments: str) -> Command:
    """One command, to its end."""
    command = Command(folder, *arguments)
    command.wait()
    return command


def ip(*arguments: str) -> None:
    """`ip link ...`, as root."""
    subprocess.run(["ip", "link", *arguments], check=True)


def fresh_vcan0() -> None:
    """vcan0 there and up, whatever a test before this one did to it."""
    net = Path("/sys/class/net/vcan0")
    if not net.exists():
        ip("add", "dev", "vcan0", "type", "vcan")
        ip("set", "vcan0", "mtu", "72")
    if not int((net / "flags").read_text(), 16) & 1:
        ip("set", "vcan0", "up")


FD = Contract()
FALLING_EDGES = 0b1_0101_0100
"""Among the received messages in order of identifier: EEC1, then rising and falling edges of the
four shafts. The classic profile carries no falling ones."""
CLASSIC = Contract(
    cantools.database.load_file(ROOT / "dbc" / "classic" / "meshpoint_classic.dbc"),
    {"ControllerStatus": 7, "ShiftOutcome": 9},
    ("--profile", "classic"),
    FALLING_EDGES,
)
VCAN = Wire("vcan0", "vcan0", FD, fresh_vcan0)
CLASSIC_VCAN = Wire("vcan0", "vcan0", CLASSIC, fresh_vcan0)
