"""One strategy live: controller and rig on a real or local bus, the bench and the recorder beside.

The nodes are processes of their own; on python-can's `virtual` bus, which ends at the process, they
are tasks of this one.
"""

from __future__ import annotations

import argparse
import asyncio
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

import can

from meshpoint.base.errors import RunError
from meshpoint.base.provenance import gearbox_words
from meshpoint.bench.bench import BenchCore, PlannedShift
from meshpoint.bench.node_patience import (
    SHIFT_SILENCE_US,
    START_S,
    Heard,
    OwnTime,
    no_shift,
    not_started,
    taken,
)
from meshpoint.bench.pauses import pauses_of
from meshpoint.bus.clock import Clock, NodeClock
from meshpoint.bus.command_keys import CommandKeys
from meshpoint.bus.core import Core, Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.logs.bus_stamps import BusStamps
from meshpoint.bus.logs.recorder import LogWriter
from meshpoint.bus.options import IN_PROCESS
from meshpoint.bus.pace import PacedClock, PaceFile
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.signals import apart
from meshpoint.bus.slowness import times_slower
from meshpoint.controller.run import node as controller_node
from meshpoint.controller.run.node import run_controller
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.results.monitor import Monitor, RowMonitor
from meshpoint.rig_sim import node as rig_node
from meshpoint.rig_sim.node import run_rig
from meshpoint.rig_sim.settings import RigSettings

BENCH_ADDRESS = 0xF9
FLUSH_US = 1_000_000
POLL_S = 0.05
MOST_POLLS = 20.0
"""A slow machine waits at most this many times longer from poll to poll."""
END_S = 15.0
OF_ADDRESS = {
    **dict.fromkeys(rig_node.ADDRESSES, "rig"),
    **dict.fromkeys(controller_node.ADDRESSES, "controller"),
}
NODE_NAMES = ("rig", "controller")
"""In the order in which they are started."""
Nodes = dict[str, "asyncio.subprocess.Process | asyncio.Task[object]"]
"""Those that were started here, by name."""


@dataclass
class LiveRun:
    """What is needed to run one strategy live."""

    header: RunHeader
    rig: RigSettings
    plan: list[PlannedShift]
    log: Path
    open_bus: Callable[[], can.BusABC]
    speed: float
    in_process: bool
    paced: bool = True
    """Bus time waits for nodes that the machine keeps from running; else it is wall time."""
    start: Sequence[str] = NODE_NAMES
    """The nodes to start; the others are on the bus already."""
    node_arguments: Sequence[str] = ()
    """Bus, data-sheet and key arguments for the two processes."""
    controller_arguments: Sequence[str] = ()
    rig_arguments: Sequence[str] = ()
    """Files the rig's process reads; what they say is in `rig` as well."""
    keys: CommandKeys | None = None
    """By which commands are proven to be the controller's; those of `node_arguments`."""
    wire: WireProfile = WireProfile.FD
    """The frames on the bus."""
    on_row: Callable[[], None] = lambda: None
    on_event: Callable[[str], None] = lambda _line: None
    on_frame: Callable[[Frame], None] = lambda _frame: None

    @property
    def gearbox_words(self) -> str:
        """Which gearbox it is of, as titles say it."""
        rig = self.rig
        return gearbox_words(self.header.sheet, rig.preset, rig.profile, rig.as_built)


@dataclass
class LiveResult:
    """What the bus showed."""

    monitor: RowMonitor
    bench: BenchCore
    frames: int = 0
    heard: Heard = field(default_factory=Heard)
    pace: float = 1.0
    """Bus time over wall time while the plan ran."""
    problems: list[str] = field(default_factory=list)


class _Recorder:
    """A core that only listens: everything on the bus goes to rows and scores."""

    def __init__(self, result: LiveResult, log: LogWriter, run: LiveRun) -> None:
        self._result = result
        self._log = log
        self._unpack = unpacker(run)
        self._on_row, self._on_frame = run.on_row, run.on_frame
        self._rows = 0
        self.next_step_us = 0

    def receive(self, frame: Frame) -> None:
        """One frame in bus order."""
        self._result.frames += 1
        sender = OF_ADDRESS.get(frame.can_id & 0xFF)
        if sender is not None:
            self._result.heard.frames[sender] += 1
        for heard in self._unpack(frame):
            self._result.monitor.take(heard)
        self._on_frame(frame)

    def step(self, now_us: int) -> Step:
        """Brings the log to disk, and reports finished shifts."""
        self._log.flush()
        self.next_step_us = now_us + FLUSH_US
        rows = len(self._result.monitor.rows.rows)
        for _ in range(rows - self._rows):
            self._on_row()
        self._rows = rows
        return Step([], [])

    def shutdown(self, now_us: int) -> Step:
        """The last step."""
        return self.step(now_us)


def unpacker(run: LiveRun) -> Callable[[Frame], Iterable[Frame]]:
    """What makes frames of meshpoint.dbc of those on the bus, sensors and commands among them."""
    if run.wire is WireProfile.FD:
        return lambda frame: (frame,)
    from meshpoint.bus.classic.cores import listener_unpacker

    return listener_unpacker(run.header.sheet).take


def _on_wire(run: LiveRun, bench: Core) -> Core:
    """The bench as it is on this bus."""
    if run.wire is WireProfile.FD:
        return bench
    from meshpoint.bus.classic.cores import ClassicBenchCore

    return ClassicBenchCore(bench)


@dataclass
class LiveSession:
    """Both nodes at work on a bus, a bench that makes its plan, and the recorder."""

    run: LiveRun
    result: LiveResult
    log: LogWriter
    clocks: _Clocks
    _tasks: Sequence[asyncio.Task[object]]
    _nodes: Nodes

    @property
    def now_us(self) -> int:
        """Bus time."""
        return self.clocks.now_us()

    def check(self) -> None:
        """Raises what ended recorder or bench; RunError where a node or bus time has ended."""
        for task in self._tasks:
            _check(task)
        _check_nodes(self._nodes)
        self.clocks.check()


async def run_live(run: LiveRun) -> LiveResult:
    """Runs the plan; ends the nodes with their valves off. RunError when they do not."""
    pauses = pauses_of(run.header.sheet, run.rig.profile, run.rig.preset)
    bench = BenchCore(run.plan, pauses)
    async with live_session(run, bench) as session:
        await _until_done(session)
    return session.result


@asynccontextmanager
async def live_session(
    run: LiveRun, bench: BenchCore, monitor: RowMonitor | None = None
) -> AsyncIterator[LiveSession]:
    """Starts the nodes, waits until they are heard, and has the bench begin; at the end all nodes
    have ended, with their valves off. RunError when they do not start."""
    result = LiveResult(monitor or Monitor(run.header.sheet, run.header.settings), bench)
    stop_listening, stop_bench, stop_nodes = asyncio.Event(), asyncio.Event(), asyncio.Event()

    def report(line: str) -> None:
        result.problems.append(line)
        run.on_event(line)

    with (
        LogWriter(run.log, channel="meshpoint", flush_every_s=None) as log,
        _clocks(run) as clocks,
    ):
        recorder = asyncio.create_task(
            run_node(
                _Recorder(result, log, run), run.open_bus, Clock(),
                on_event=report, stop=stop_listening, name="recorder",
                on_message=BusStamps(clocks.of("bench"), log.write_message),
            )
        )  # fmt: skip
        # The log begins before the nodes do, so that their first steps are in it.
        await asyncio.sleep(2 * POLL_S)
        nodes = await _start_nodes(run, clocks, stop_nodes)
        try:
            await _until_heard(result, recorder, nodes, clocks)
        except BaseException:
            await _end_nodes(nodes, stop_nodes)
            stop_listening.set()
            await recorder
            raise
        begun_us, begun_s = clocks.bench.now_us(), perf_counter()
        task = asyncio.create_task(
            run_node(
                _on_wire(run, bench), run.open_bus, clocks.bench, on_event=report,
                stop=stop_bench, name="bench", own_addresses=frozenset({BENCH_ADDRESS}),
            )
        )  # fmt: skip
        try:
            yield LiveSession(run, result, log, clocks, [recorder, task], nodes)
        finally:
            result.pace = (clocks.bench.now_us() - begun_us) / 1e6 / (perf_counter() - begun_s)
            stop_bench.set()
            await _end_nodes(nodes, stop_nodes)
            await asyncio.sleep(2 * POLL_S)
            stop_listening.set()
            await asyncio.gather(recorder, task)


class _Clocks:
    """The clocks of one run: shared bus time, or one wall clock each."""

    def __init__(self, run: LiveRun, pace_path: Path | None) -> None:
        self.pace_path = pace_path
        self._speed = run.speed
        self._file = None if pace_path is None else PaceFile(pace_path)
        self.bench = self.of("bench")
        self.pacemaker: subprocess.Popen[bytes] | None = None

    def now_us(self) -> int:
        """Bus time, for whoever watches from another thread."""
        return self.bench.now_us() if self._file is None else self._file.now_us

    def check(self) -> None:
        """RunError where bus time does not go on any more."""
        if self.pacemaker is not None and self.pacemaker.poll() is not None:
            raise RunError(f"the pacemaker ended with exit code {self.pacemaker.returncode}")

    def of(self, name: str) -> NodeClock:
        """The clock of a node of this process."""
        if self._file is None:
            return Clock(self._speed)
        return PacedClock(self._file, name, self._speed)


@contextmanager
def _clocks(run: LiveRun) -> Iterator[_Clocks]:
    """The clocks, with a pacemaker running beside where bus time is shared."""
    if not run.paced:
        yield _Clocks(run, None)
        return
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as folder:
        path = Path(folder) / "pace"
        PaceFile.create(path)
        command = [sys.executable, "-m", "meshpoint.bus.pace", str(path), "--speed", str(run.speed)]
        # It ends with its standard input, which leaving the block closes.
        with subprocess.Popen(command, stdin=subprocess.PIPE, **apart()) as pacemaker:  # noqa: S603 (ours)
            clocks = _Clocks(run, path)
            clocks.pacemaker = pacemaker
            yield clocks


async def _start_nodes(run: LiveRun, clocks: _Clocks, stop: asyncio.Event) -> Nodes:
    if run.in_process:
        tasks = {
            "rig": lambda: run_rig(
                run.header.sheet, run.rig, run.open_bus, clocks.of("rig"),
                on_event=run.on_event, stop=stop, keys=run.keys, wire=run.wire,
            ),
            "controller": lambda: run_controller(
                run.header, run.open_bus, clocks.of("controller"),
                on_event=run.on_event, stop=stop, keys=run.keys, wire=run.wire,
                record=run.log.parent if run.wire is WireProfile.CLASSIC else None,
            ),
        }  # fmt: skip
        return {
            name: asyncio.create_task(tasks[name]()) for name in NODE_NAMES if name in run.start
        }
    pace = [] if clocks.pace_path is None else ["--pace", str(clocks.pace_path)]
    wire = ["--profile", run.wire.value]
    is_classic = run.wire is WireProfile.CLASSIC
    record = ["--header-dir", str(run.log.parent)] if is_classic else []
    common = [
        *run.node_arguments, *wire, "--speed", str(run.speed), *pace, "--quiet", "--until-eof",
    ]  # fmt: skip
    commands = {
        "rig": [
            "rig", "--seed", str(run.rig.seed), "--gear", str(run.rig.start_gear),
            "--main-speed", str(run.rig.main_speed_rpm), "--preset", run.rig.preset.value,
            *run.rig_arguments, *common,
        ],
        "controller": ["controller", *run.controller_arguments, *record, *common],
    }  # fmt: skip
    return {name: await _spawn(commands[name]) for name in NODE_NAMES if name in run.start}


async def _spawn(arguments: Sequence[str]) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "meshpoint", *arguments, stdin=asyncio.subprocess.PIPE, **apart()
    )


async def _until_heard(
    result: LiveResult, recorder: asyncio.Task[object], nodes: Nodes, clocks: _Clocks
) -> None:
    """Waits until both nodes are on the bus; each is given a time to run, however long that takes
    on this machine."""
    own = {name: OwnTime() for name in NODE_NAMES}
    slow = times_slower()
    limit_s, poll_s = START_S * slow, POLL_S * min(slow, MOST_POLLS)
    while result.monitor.status is None or result.heard.missing():
        before_s = perf_counter()
        await asyncio.sleep(poll_s)
        _check(recorder)
        _check_nodes(nodes)
        clocks.check()
        for name, time in own.items():
            node = nodes.get(name)
            process = None if node is None or isinstance(node, asyncio.Task) else node.pid
            passed_s = min(perf_counter() - before_s, 2 * poll_s)
            time.look(None if process is None else taken(process), passed_s)
        missing = result.heard.missing()
        late = [name for name, time in own.items() if time.seconds > limit_s]
        if late and set(late) & set(missing or late):
            slow_s = START_S * times_slower()
            if slow_s <= limit_s:
                raise RunError(not_started(missing or late, limit_s))
            limit_s = slow_s  # it has become slower meanwhile


def _check(task: asyncio.Task[object]) -> None:
    """Raises what ended a task."""
    if task.done():
        task.result()


def _check_nodes(nodes: Nodes) -> None:
    for name, node in nodes.items():
        if isinstance(node, asyncio.Task):
            _check(node)
        elif node.returncode is not None:
            raise RunError(f"{name} ended by itself with exit code {node.returncode}")


async def _until_done(session: LiveSession) -> None:
    """Waits for the bench; gives up when a node has died or nothing happens any more."""
    result, clock = session.result, session.clocks.bench
    seen, since_us = 0, clock.now_us()
    while not result.bench.done:
        await asyncio.sleep(POLL_S)
        session.check()
        now_us, rows = clock.now_us(), len(result.monitor.rows.rows)
        result.heard.look(now_us)
        if rows != seen:
            seen, since_us = rows, now_us
        if now_us - since_us > SHIFT_SILENCE_US:
            raise RunError(no_shift(result.heard.silent(now_us), session.run.paced))


async def _end_nodes(nodes: Nodes, stop: asyncio.Event) -> None:
    stop.set()
    limit_s = END_S * times_slower()
    for node in nodes.values():
        if isinstance(node, asyncio.Task):
            continue
        if node.returncode is None:
            with suppress(ProcessLookupError):
                node.terminate()
    for node in nodes.values():
        if isinstance(node, asyncio.Task):
            await asyncio.wait([node], timeout=limit_s)
            continue
        try:
            await asyncio.wait_for(node.wait(), limit_s)
        except TimeoutError:
            # It may have ended between the time-out and here.
            with suppress(ProcessLookupError):
                node.kill()
            await node.wait()


def uses_virtual(namespace: argparse.Namespace) -> bool:
    """Whether the bus asked for ends at the process."""
    return getattr(namespace, "interface", None) in IN_PROCESS
