"""`LiveBench`: the same bench with controller and rig as processes on a CAN bus."""

from __future__ import annotations

import argparse
import asyncio
import os
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Self

import can

from meshpoint.api.bench import rig_settings
from meshpoint.api.choices import PathLike, load_settings, setup_of
from meshpoint.api.watching import DEFAULT_TIMEOUT_S, ShiftError, Watching
from meshpoint.base.errors import RunError
from meshpoint.bench.bench import PATIENCE_US
from meshpoint.bench.live import NODE_NAMES, LiveRun, LiveSession, live_session
from meshpoint.bus.fine_timers import run as run_loop
from meshpoint.bus.options import IN_PROCESS, add_bus_arguments, open_bus_from
from meshpoint.bus.slowness import times_slower
from meshpoint.dbc.frame import Frame
from meshpoint.results.output import folder_for
from meshpoint.rig_sim.settings import DEFAULT_PRESET, DEFAULT_PROFILE

POLL_S: Final = 0.02
MOST_POLL_S: Final = 1.0
SHIFT_LIMIT_US: Final = 6 * PATIENCE_US
"""The operator is patient for so long in each of its stages."""


class LiveBench(Watching):
    """Controller and rig as two processes on a bus; time goes on by itself.

    Without `interface` and `channel` they meet on a local bus that nobody else can see. Where both
    are started here, bus time waits for whichever the machine keeps from running.

    interface, channel, bus_arguments: the bus, as in python-can; `bus_arguments` are further words
        of its command line, as ["-b", "500000"].
    in_process: run the nodes in this process, beside each other, as on a bus that ends at the
        process (`virtual`) they always are.
    start: the nodes to start, of `rig` and `controller`; the others are on the bus already, as
        hardware is. Then bus time is wall time. Without a rig there is no truth: `contact` is None.
    speed: run this many times as fast as the wall clock; slower where a machine cannot keep up.
    log: the file that the bus is recorded to; without it, one that is deleted at the end.
    node_arguments, controller_arguments, rig_arguments: further words of the command lines of both
        nodes, or of one (`meshpoint rig -h`).

    The others are those of `Bench`; settings, as_built and faults are names or files here.
    RunError where a node does not start, or ends by itself.
    """

    def __init__(
        self,
        *,
        interface: str | None = None,
        channel: str | None = None,
        bus_arguments: Sequence[str] = (),
        in_process: bool = False,
        start: Sequence[str] = NODE_NAMES,
        speed: float = 1.0,
        gearbox: PathLike | None = None,
        preset: str = DEFAULT_PRESET,
        seed: int = 1,
        as_built: PathLike = DEFAULT_PROFILE,
        faults: PathLike | None = None,
        strategy: str | None = None,
        estimator: str | None = None,
        settings: PathLike | None = None,
        gear: int = 8,
        log: PathLike | None = None,
        node_arguments: Sequence[str] = (),
        controller_arguments: Sequence[str] = (),
        rig_arguments: Sequence[str] = (),
    ) -> None:
        unknown = set(start) - set(NODE_NAMES)
        if unknown:
            raise ValueError(f"start = {sorted(unknown)}, allowed are {', '.join(NODE_NAMES)}")
        chosen = load_settings(settings, strategy=strategy, estimator=estimator)
        setup = setup_of(gearbox, preset, seed, as_built, faults or (), chosen)
        super().__init__(setup, gear)
        self._folder = tempfile.TemporaryDirectory(prefix="meshpoint-")
        self.log = Path(self._folder.name) / "run.log" if log is None else Path(log)
        """Where the bus is recorded."""
        header = setup.header
        header.save(folder_for(self.log.parent))
        bus = [*_bus(interface, channel, Path(self._folder.name)), *bus_arguments]
        self._run = LiveRun(
            header=header,
            rig=rig_settings(setup, gear),
            plan=[],
            log=self.log,
            open_bus=_opener(bus),
            speed=speed,
            in_process=in_process or interface in IN_PROCESS,
            paced=set(start) == set(NODE_NAMES),
            start=tuple(start),
            node_arguments=[
                *bus,
                "--gearbox",
                str(gearbox or setup.preset.sheet_name),
                *node_arguments,
            ],
            controller_arguments=[
                "--arm",
                *_given(settings=settings, strategy=strategy, estimator=estimator),
                *controller_arguments,
            ],
            rig_arguments=[*_given(as_built=as_built, faults=faults), *rig_arguments],
            on_event=lambda line: self.said.append(line),
            on_frame=self._see,
        )
        self.said: list[str] = []
        """What recorder and operator have said: a bus that was lost, a shift that is stuck."""
        self._session: LiveSession | None = None
        # To look costs processor time, which on a slow machine the nodes want.
        self._poll_s = min(MOST_POLL_S, POLL_S * times_slower())
        self._orders: list[Callable[[], None]] = []
        self._failure: BaseException | None = None
        self._ready, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._live, name="meshpoint-bench", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._session is None:
            self.close()
            self._raise_failure()

    @property
    def now_s(self) -> float:
        """Bus time, s."""
        return self._now_us() / 1e6

    def run_for(self, seconds: float) -> None:
        """Waits for so much bus time."""
        self._wait(lambda: False, round(seconds * 1e6))

    def run_until(
        self, condition: Callable[[Self], object], timeout_s: float = DEFAULT_TIMEOUT_S
    ) -> float:
        """Waits until `condition(bench)` is true, which is asked every 20 ms (less often on a
        slow machine).

        Returns bus time, s. TimeoutError after `timeout_s` of bus time."""
        if not self._wait(lambda: bool(condition(self)), round(timeout_s * 1e6)):
            raise TimeoutError(f"not so within {timeout_s:g} s of bus time")
        return self.now_s

    def close(self) -> None:
        """Ends the nodes that were started here, all valves off, and completes the log."""
        self._ending.set()
        self._thread.join()
        self._folder.cleanup()

    def _complete_log(self) -> Path:
        done, session = threading.Event(), self._session
        if session is not None and self._thread.is_alive():
            self._orders += [session.log.flush, done.set]
            while not done.wait(self._poll_s) and self._thread.is_alive():
                pass
        return self.log

    # -------------------------------------------------- the thread of the bus ----

    def _live(self) -> None:
        try:
            run_loop(self._main())
        except BaseException as error:  # noqa: BLE001 (raised again where the caller waits)
            self._failure = error
        finally:
            self._ready.set()

    async def _main(self) -> None:
        async with live_session(self._run, self._operator, self._monitor) as session:
            self._session = session
            self._ready.set()
            while not self._ending.is_set():
                await asyncio.sleep(self._poll_s)
                session.check()
                while self._orders:
                    self._orders.pop(0)()

    def _see(self, frame: Frame) -> None:
        self._latest[frame.can_id] = frame  # the session has the monitor take it

    # --------------------------------------------------- the caller's thread ----

    def _now_us(self) -> int:
        if self._session is None or self._ending.is_set():
            raise RuntimeError("this bench is closed")
        return self._session.now_us

    def _order(self, order: Callable[[], None]) -> None:
        self._raise_failure()
        self._orders.append(order)

    def _wait(self, until: Callable[[], bool], limit_us: int) -> bool:
        end_us = self._now_us() + limit_us
        while not until():
            self._raise_failure()
            if self._now_us() > end_us:
                return False
            time.sleep(self._poll_s)
        return True

    def _until_done(self) -> None:
        if not self._wait(lambda: self.shift_is_over, SHIFT_LIMIT_US):
            raise ShiftError(self._why_no_row(len(self._planned) - 1))

    def _raise_failure(self) -> None:
        if isinstance(self._failure, Exception):
            raise self._failure
        if self._failure is not None:
            raise RunError(f"the bench's thread has ended: {self._failure!r}")


def _bus(interface: str | None, channel: str | None, private: Path) -> list[str]:
    """python-can's words for it, or those of a local bus that nobody else can see."""
    if interface is None and channel is None:
        if os.name == "posix":
            return ["-i", "meshpoint", "-c", f"unix:{private / 'bus.sock'}"]
        return ["-i", "meshpoint", "-c", f"tcp:127.0.0.1:{20_000 + os.getpid() % 20_000}"]
    words = [] if interface is None else ["-i", interface]
    return words if channel is None else [*words, "-c", channel]


def _opener(words: Sequence[str]) -> Callable[[], can.BusABC]:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    chosen = parser.parse_args(list(words))
    return lambda: open_bus_from(chosen)


def _given(**values: PathLike | None) -> list[str]:
    """These as words of a command line, where they are given."""
    words: list[str] = []
    for name, value in values.items():
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    return words
