"""`meshpoint convert`: a log as time series for viewers, or a bus live."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.base.exits import Exit
from meshpoint.bridges.foxglove_sink import mcap_file
from meshpoint.bridges.live_view import live_view
from meshpoint.bridges.mf4_sink import mf4_file
from meshpoint.bridges.parquet_sink import parquet_file
from meshpoint.bridges.sample_clock import LiveTies, Ties, ties_of
from meshpoint.bridges.series import Sample, TimeSeries
from meshpoint.bridges.sink import Event, InOrder, Sink
from meshpoint.bridges.viewer_server import LOCALHOST
from meshpoint.bus import given_numbers
from meshpoint.bus.frames import frame_of
from meshpoint.bus.logs.files import log_files
from meshpoint.bus.logs.reader import LogError
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.cli import arguments
from meshpoint.logs.log_clock import Entry, Unpack
from meshpoint.logs.log_progress import read_in_sensor_time
from meshpoint.logs.story import Story
from meshpoint.results.output import beside, check_writable, complain, tell
from meshpoint.results.progress import Shown

FILES: Final = {".mcap": mcap_file, ".mf4": mf4_file, ".parquet": parquet_file}
"""What is written, by the file's ending."""
LIVE_PORT: Final = 8765
"""The one that viewers propose."""
MOST_PORT: Final = 65535
WAIT_S: Final = 0.05
BACK_S: Final = 1.0
SHOWN_EVERY: Final = 1000
"""Frames."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "convert",
        description="The signals of a log as time series in SI units: each at the time at which it "
        "was sampled, tooth edges one by one, estimated and true states (topic Compared; of the "
        "virtual rig alone), and a list of events. -o writes a file by its "
        "ending: .mcap for Foxglove, Lichtblick and PlotJuggler, .mf4 for MDF viewers, .parquet "
        "for pandas, DuckDB and the like. --live serves the same of a bus to viewers on this "
        "machine. .mcap and --live need meshpoint[mcap], .mf4 needs meshpoint[mf4].",
    )
    parser.add_argument(
        "log", type=Path, nargs="*", metavar="LOG", help=f"{arguments.LOGS_HELP}; none with --live"
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("-o", "--output", type=Path, metavar="FILE", help="the file to write")
    where.add_argument(
        "--live",
        type=given_numbers.whole(1, MOST_PORT),
        nargs="?",
        const=LIVE_PORT,
        metavar="PORT",
        help=f"serve a bus as a Foxglove WebSocket on localhost until Ctrl-C (port: {LIVE_PORT})",
    )
    parser.add_argument(
        "--origin",
        action="append",
        default=[],
        metavar="URL",
        help="with --live: web pages from there may read the bus as well, as "
        "https://app.foxglove.dev (default: pages of this machine alone)",
    )
    arguments.add_gearbox(parser)
    arguments.add_wire(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes the file, up to a defect in the log; or serves until Ctrl-C."""
    if namespace.live is not None:
        return _serve(namespace)
    if namespace.origin:
        raise CommandError("--origin without --live: only a bus is served to web pages")
    if not namespace.log:
        raise CommandError("-o without LOG: there is nothing to convert")
    path: Path = namespace.output
    if path.is_dir():
        raise CommandError(f"-o {path}: is a folder, allowed is a file")
    if path.suffix not in FILES:
        raise CommandError(f"-o {path}: ends in {path.suffix!r}, allowed are {', '.join(FILES)}")
    files, sheet = log_files(namespace.log), arguments.sheet_of(namespace)
    if path.exists() and any(path.samefile(file) for file in files):
        raise CommandError(f"-o {path}: is the log itself")
    check_writable(str(path))
    said, entries = read_in_sensor_time(namespace, files, sheet)
    try:
        with beside(path) as new:
            with FILES[path.suffix](new) as sink, Shown("converting", "frames", None) as shown:
                ties = ties_of(
                    _counted(entries(), shown), arguments.unpack_all_of(namespace, sheet)
                )
                writing = Writing(sink, arguments.unpack_all_of(namespace, sheet), ties)
                defect = writing.take_all(_counted(entries(), shown))
            if not writing.samples:
                raise CommandError(
                    f"{files[0]}: of {writing.frames:,} frames none is a message of "
                    f"{namespace.wire} (--profile): nothing was written"
                )
    except OSError as error:
        raise unwritten(path, error) from error
    if said:
        complain(f"meshpoint convert: {said}")
    if writing.went_back:
        complain("meshpoint convert: the log's time goes back: its parts lie over each other")
    writing.complain()
    tell(f"{path}: {writing.samples:,} samples, {writing.events:,} events")
    if defect is not None:
        complain(f"meshpoint convert: {defect}; what is written is all that stands before it")
        return Exit.BAD_INPUT
    return Exit.DONE


def _counted(entries: Iterable[Entry], shown: Shown) -> Iterator[Entry]:
    """The same; a log is read twice, and both times count."""
    for number, entry in enumerate(entries, 1):
        if number % SHOWN_EVERY == 0:
            shown.advance(SHOWN_EVERY)
        yield entry


class Writing:
    """Frames to samples and events, and these to where they go. What was sampled before the first
    frame came is left out, and counted."""

    def __init__(self, sink: Sink, unpack: Unpack, ties: Ties) -> None:
        self._sink, self._unpack = sink, unpack
        self._series, self._story, self._order = TimeSeries(ties), Story(), InOrder()
        self._begun_s: float | None = None
        self._newest_s = 0.0
        self.frames = self.samples = self.events = 0
        self.went_back = False
        """The time of a frame was long before that of another that stands before it."""

    def take_all(self, entries: Iterable[Entry]) -> LogError | None:
        """A whole log; the defect that ended it early. LogError where it begins with one."""
        try:
            for time_s, frame in entries:
                self.take(time_s, frame)
        except LogError as error:
            if self._begun_s is None:
                raise
            return error
        finally:
            for sample in self._series.rest():
                self._order.add(sample)
            self._give(self._order.rest())
        return None

    def take(self, time_s: float, frame: Any) -> None:
        """A frame of the bus."""
        if self._begun_s is None:
            self._begun_s = self._newest_s = time_s
        self.frames += 1
        self.went_back |= time_s < self._newest_s - BACK_S
        self._newest_s = max(self._newest_s, time_s)
        found = tuple(self._unpack(frame))
        if not found and frame.is_fd:  # the classic profile has none
            self._series.left_out.unknown(frame.can_id)
        for inner in found:
            for sample in self._series.take(time_s, inner):
                if sample.time_s >= self._begun_s:  # MCAP has no time before a log's zero
                    self._order.add(sample)
                else:
                    self._series.left_out.early += 1
            for line in self._story.receive(time_s, inner):
                self._order.add(Event(self._begun_s + line.at_s, line.who, line.words))
        self._give(self._order.until(time_s))

    def complain(self) -> None:
        """Says what is not in the file, or not in its place."""
        for line in self._series.left_out.words():
            complain(f"meshpoint convert: {line}")

    def _give(self, found: Iterable[Sample | Event]) -> None:
        for one in found:
            if isinstance(one, Event):
                self._sink.event(one)
                self.events += 1
            else:
                self._sink.sample(one)
                self.samples += 1


def _serve(namespace: argparse.Namespace) -> int:
    if namespace.log:
        raise CommandError("--live with LOG: it serves a bus; of a log -o writes a file")
    unpack = arguments.unpack_all_of(namespace, arguments.sheet_of(namespace))
    with live_view(namespace.live, namespace.origin) as sink, open_bus_from(namespace) as bus:
        tell(f"{bus.channel_info}: ws://{LOCALHOST}:{namespace.live} until Ctrl-C")
        writing, begun_s = Writing(sink, unpack, LiveTies()), time.time() - time.monotonic()
        try:
            while True:
                message = bus.recv(WAIT_S)
                if message is None or message.is_error_frame or message.is_remote_frame:
                    continue
                writing.take(begun_s + time.monotonic(), frame_of(message))
        except KeyboardInterrupt:
            writing.complain()
            return Exit.DONE  # the way to end it
