"""Controller and bench in this process, the rig in another: coordinated participants of SIL Kit."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Final

from meshpoint.base.errors import CommandError, RunError
from meshpoint.base.exits import Exit
from meshpoint.bench.bench_builder import virtual_bench
from meshpoint.bench.setup import Setup
from meshpoint.bench.shared_bus import NEVER_US, Elsewhere, SharedBus
from meshpoint.bench.simulate import rig_of
from meshpoint.bench.virtual_time import VirtualTime
from meshpoint.bridges.silkit_coordinated import Coordinated
from meshpoint.bus.core import Step
from meshpoint.bus.settle import settle
from meshpoint.bus.silkit.library import SilKitError, library

CONTROLLER: Final = "meshpoint controller"
RIG: Final = "meshpoint rig"
OURS: Final = frozenset((0, 2))
"""Controller and bench, by their places on the bench."""
END_S: Final = 10.0
"""How long the rig's process may take to end behind the simulation; then it is killed."""


class RigApart:
    """Runs `simulate`'s rig as a participant of its own."""

    def __init__(self, setup: Setup, registry: str) -> None:
        """CommandError where SIL Kit or its registry is not there."""
        self.bus = SharedBus()
        self._setup, self._registry = setup, registry
        try:
            self._controller = Coordinated(CONTROLLER, registry, self.bus, OURS)
        except SilKitError as error:
            raise CommandError(f"--silkit: {error}; `silkit-registry` starts a registry") from error

    def run(
        self, time: VirtualTime, until: Callable[[], bool], limit_us: int, end: Callable[[], Step]
    ) -> None:
        """As `VirtualTime.run`. RunError where the rig is lost, or anybody else sends."""
        with (
            _system_controller(self._registry) as starter,
            _rig_process(self._setup, self._registry, starter.pid) as (rig, said),
        ):

            def look() -> None:
                if rig.exitcode:
                    starter.terminate()  # has the others abort
                    why = _said(said, 0.0) or f"its process ended with exit code {rig.exitcode}"
                    raise SilKitError(f"participant {RIG} is lost: {why}")
                if starter.poll():
                    raise SilKitError("SIL Kit's system controller is lost")

            try:
                self._controller.run(time, until, limit_us, end, look)
            except SilKitError as error:
                raise RunError(f"--silkit: {error}") from error
            if not self._controller.is_over:
                why = _said(said, END_S) or "somebody else has ended the simulation"
                raise RunError(f"--silkit: {why}")


def _said(rig: Connection, timeout_s: float) -> str:
    """Why the rig's process has ended; empty where it said nothing."""
    with suppress(EOFError):
        if rig.poll(timeout_s):
            return str(rig.recv())
    return ""


def run_rig(setup: Setup, registry: str, starter: int, tell: Connection) -> None:
    """The rig's process, until the simulation ends. starter: the system controller's process, which
    ends with this one where the controller is lost. tell: takes the reason of a bad end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C means the command, which ends this one
    parent = multiprocessing.parent_process()

    def look() -> None:
        if parent is not None and wait([parent.sentinel], timeout=0):
            os.kill(starter, signal.SIGTERM)
            raise SilKitError(f"participant {CONTROLLER} is lost")

    bus = SharedBus()
    bench = virtual_bench(setup, Elsewhere(), rig_of(setup), Elsewhere(), shared=bus)
    settle()
    try:
        rig = Coordinated(RIG, registry, bus, frozenset((1,)))
        rig.run(bench.time, lambda: False, NEVER_US, lambda: Step([], []), look)
    except SilKitError as error:
        with suppress(BrokenPipeError):
            tell.send(str(error))
        sys.exit(Exit.FAILED)


@contextmanager
def _rig_process(
    setup: Setup, registry: str, starter: int
) -> Iterator[tuple[BaseProcess, Connection]]:
    context = multiprocessing.get_context("spawn")
    said, tell = context.Pipe(duplex=False)
    process = context.Process(target=run_rig, args=(setup, registry, starter, tell), daemon=True)
    process.start()
    tell.close()  # so that its end is seen here
    try:
        yield process, said
    finally:
        process.join(END_S)
        process.kill()
        process.join()


@contextmanager
def _system_controller(registry: str) -> Iterator[subprocess.Popen[bytes]]:
    """What has the participants begin together."""
    command = library("SilKit_py.tools").executable("sil-kit-system-controller")
    process = subprocess.Popen(  # noqa: S603 (of the package)
        [command, "--connect-uri", registry, "--log", "off", CONTROLLER, RIG],
        # A session of its own, for Ctrl-C.
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.wait()
