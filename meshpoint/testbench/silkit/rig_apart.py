"""Controller and bench in this process, the rig in another: coordinated participants of SIL Kit."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Final

from meshpoint.bus.core import Step
from meshpoint.bus.settle import settle
from meshpoint.bus.silkit.library import SilKitError, library
from meshpoint.testbench.errors import CommandError, RunError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.loop.bench_builder import virtual_bench
from meshpoint.testbench.loop.setup import Setup
from meshpoint.testbench.loop.shared_bus import NEVER_US, Elsewhere, SharedBus
from meshpoint.testbench.loop.simulate import rig_of
from meshpoint.testbench.loop.virtual_time import VirtualTime
from meshpoint.testbench.silkit.coordinated import Coordinated

CONTROLLER: Final = "meshpoint controller"
RIG: Final = "meshpoint rig"


class RigApart:
    """Runs `simulate`'s rig as a participant of its own."""

    def __init__(self, setup: Setup, registry: str) -> None:
        """CommandError where SIL Kit or its registry is not there."""
        self.bus = SharedBus()
        self._setup, self._registry = setup, registry
        try:
            self._controller = Coordinated(CONTROLLER, registry, self.bus, frozenset((0, 2)))
        except SilKitError as error:
            raise CommandError(f"--silkit: {error}; `silkit-registry` starts a registry") from error

    def run(
        self, time: VirtualTime, until: Callable[[], bool], limit_us: int, end: Callable[[], Step]
    ) -> None:
        """As `VirtualTime.run`. RunError where the rig is lost, or anybody else sends."""
        with _system_controller(self._registry) as starter, _worker(starter.pid) as pool:
            rig = pool.submit(run_rig, self._setup, self._registry)

            def look() -> None:
                if rig.done():
                    starter.terminate()  # has all participants abort
                    _check(rig)
                    raise RunError(f"--silkit: {RIG} has ended before {CONTROLLER}")
                if starter.poll() is not None:
                    raise RunError("--silkit: SIL Kit's system controller has ended by itself")

            try:
                self._controller.run(time, until, limit_us, end, look)
            except SilKitError as error:
                raise RunError(f"--silkit: {error}") from error
            _check(rig)
            if not self._controller.is_over:
                raise RunError("--silkit: somebody else has ended the simulation")


def _check(rig: Future[None]) -> None:
    """RunError for what has ended the rig."""
    try:
        rig.result()
    except (SilKitError, BrokenExecutor) as error:
        raise RunError(f"--silkit: participant {RIG} is lost: {error}") from error


def run_rig(setup: Setup, registry: str) -> None:
    """The rig's process, until the simulation ends."""
    bus = SharedBus()
    bench = virtual_bench(setup, Elsewhere(), rig_of(setup), Elsewhere(), shared=bus)
    settle()
    rig = Coordinated(RIG, registry, bus, frozenset((1,)))
    rig.run(bench.time, lambda: False, NEVER_US, lambda: Step([], []), lambda: None)


@contextmanager
def _system_controller(registry: str) -> Iterator[subprocess.Popen[bytes]]:
    """What starts the participants together."""
    command = [library("SilKit_py.tools").executable("sil-kit-system-controller")]
    # A session of its own: Ctrl-C means the command, which ends this one.
    process = subprocess.Popen(  # noqa: S603 (of the package)
        [*command, "--connect-uri", registry, "--log", "off", CONTROLLER, RIG],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _worker(starter: int) -> Iterator[ProcessPoolExecutor]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, initializer=_follow, initargs=(starter,)) as pool:
        yield pool


def _follow(starter: int) -> None:
    """Runs in the rig's process as it starts: it ends with its parent, and so does `starter`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_the_parent() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            wait([parent.sentinel])
            os.kill(starter, signal.SIGTERM)
            os._exit(Exit.FAILED)

    threading.Thread(target=end_with_the_parent, daemon=True).start()
