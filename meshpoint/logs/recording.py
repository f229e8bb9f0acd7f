"""`--log`: the log of a run, with the run header beside it so that the log can be replayed."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import can

from meshpoint.base.errors import CommandError, RunError
from meshpoint.bus.clock import NodeClock
from meshpoint.bus.driver import OpenBus
from meshpoint.bus.logs.files import RotatingLog, open_log
from meshpoint.bus.logs.reader import LogError
from meshpoint.bus.logs.recorder import LogWriter, record_bus
from meshpoint.controller.settings.header import RunHeader
from meshpoint.results.output import folder_for

LAST_FRAMES_S = 0.1
"""What the nodes send when they end belongs to the log."""


def start_log(
    namespace: argparse.Namespace,
    header: RunHeader | None,
    *,
    channel: str,
    by_frame_time: bool = False,
) -> LogWriter | RotatingLog | None:
    """The log that --log and --log-size ask for; LogError or CommandError where it cannot be."""
    target: str | None = namespace.log
    if target is None:
        if namespace.log_size is not None:
            raise CommandError("--log-size without --log: there is no log to divide")
        return None
    folder_for(log_folder(target))
    log = open_log(
        target, channel=channel, max_bytes=namespace.log_size, by_frame_time=by_frame_time
    )
    if header is not None:
        save_header(header, log.path.parent)
    return log


def save_header(header: RunHeader, folder: Path) -> None:
    """Writes the run header; CommandError where it cannot be: nothing has been started yet."""
    try:
        header.save(folder_for(folder))
    except OSError as error:
        raise CommandError(
            f"run header in {folder}: cannot be written: {error.strerror or error}"
        ) from error


def log_folder(target: str) -> Path:
    """Where a log of this --log is, and its run header."""
    path = Path(target)
    return path if target.endswith(("/", "\\")) or path.is_dir() else path.parent


def written(log: LogWriter | RotatingLog) -> str:
    """The file or files of a log, in words."""
    if isinstance(log, LogWriter) or len(log.paths) == 1:
        return str(log.path if isinstance(log, LogWriter) else log.paths[0])
    return f"{log.paths[0]} ... {log.paths[-1].name}, {len(log.paths)} files"


@asynccontextmanager
async def recording(
    log: LogWriter | RotatingLog | None,
    open_bus: OpenBus,
    on_event: Callable[[str], None],
    bus_clock: NodeClock,
) -> AsyncIterator[None]:
    """Records the bus while the block runs, with a connection of its own that is there before the
    block begins, stamped by the nodes' clock. A log that cannot be written any more is reported,
    and the block goes on; at its end RunError says that the log is not whole."""
    if log is None:
        yield
        return
    loop, opened, stop = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()

    def open_and_tell() -> can.BusABC:
        bus = open_bus()
        loop.call_soon_threadsafe(opened.set)
        return bus

    async def record() -> str:
        """What ended it; empty: it was asked to stop, and the log is whole."""
        try:
            with log:
                await record_bus(
                    open_and_tell, log, on_event=on_event, stop=stop, bus_clock=bus_clock
                )
        except LogError as error:
            on_event(f"recorder: the log has ended, the node goes on: {error}")
            return str(error)
        return ""

    task = asyncio.create_task(record())
    waiting = asyncio.create_task(opened.wait())
    await asyncio.wait((task, waiting), return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
    try:
        if task.done():
            task.result()
        yield
        await asyncio.sleep(LAST_FRAMES_S)
    finally:
        stop.set()
        fault = await task
    if fault:
        raise RunError(f"error: the log ended before the run did: {fault}")
