"""`meshpoint watch`: the state of a bus, or of a log as it goes on, in the terminal."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import can
from rich.console import Console
from rich.live import Live
from rich.text import Text

from meshpoint.base.exits import Exit
from meshpoint.bus import given_numbers
from meshpoint.bus.frames import frame_of
from meshpoint.bus.logs.files import log_files
from meshpoint.bus.options import add_bus_arguments, bus_config, open_bus_from
from meshpoint.cli import arguments
from meshpoint.logs.log_clock import Entry, Unpack
from meshpoint.logs.log_progress import read_in_sensor_time
from meshpoint.logs.panel import HEIGHT, Panel
from meshpoint.results.output import WordsConsole, complain

PICTURES_HZ: Final = 12.0


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "watch",
        description="Gear, speeds, the tooth against the gap, valves, sleeves, air, each message's "
        "rate and its age in ms (red: not to be relied on), the last shifts and what happened, in "
        "80 x 24 characters. It only listens: nothing is sent. With LOG it plays the log; "
        "`--speed 0` draws its end at once. Without a terminal it draws the last picture alone.",
    )
    parser.add_argument(
        "log",
        type=Path,
        nargs="*",
        metavar="LOG",
        help=f"{arguments.LOGS_HELP}; none: a live bus",
    )
    parser.add_argument(
        "--speed",
        type=given_numbers.number(0.0, 1e6),
        default=1.0,
        metavar="X",
        help="a log's time against the wall clock; 0.02 is slow motion, 0 as fast as it can be "
        "read (default: 1)",
    )
    parser.add_argument(
        "--for",
        dest="for_s",
        type=given_numbers.seconds,
        metavar="S",
        help="end after this many wall seconds (default: Ctrl-C, or the log's end)",
    )
    arguments.add_gearbox(parser)
    arguments.add_wire(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Draws until the end, or Ctrl-C."""
    out = WordsConsole()
    title = namespace.log[0].name if namespace.log else _bus_name(namespace)
    sheet = arguments.sheet_of(namespace)
    panel = Panel(sheet, title)
    if namespace.log:
        said, entries = read_in_sensor_time(namespace, log_files(namespace.log), sheet)
        if said:
            complain(f"meshpoint watch: {said}")
        unpack = arguments.unpack_all_of(namespace, sheet)
        pictures = _of_log(panel, namespace.speed, unpack, entries())
    else:
        pictures = _of_bus(panel, namespace, arguments.unpack_all_of(namespace, sheet))
    end_s = None if namespace.for_s is None else time.monotonic() + namespace.for_s
    try:
        if out.is_terminal:
            _play(panel, pictures, out, end_s)
        else:
            _last(pictures, end_s)
    except KeyboardInterrupt:
        pass  # the way to end it
    for line in panel.lines():
        out.print(line, soft_wrap=True)
    return Exit.DONE


def _bus_name(namespace: argparse.Namespace) -> str:
    config = bus_config(namespace)
    return f"{config.get('interface', '')} {config.get('channel') or 'local bus'}".strip()


def _play(panel: Panel, pictures: Iterator[None], out: Console, end_s: float | None) -> None:
    with Live(console=out, screen=True, auto_refresh=False) as live:
        for _ in pictures:
            lines = panel.lines()[: max(1, min(HEIGHT, out.height))]
            live.update(Text("\n").join(lines), refresh=True)
            if end_s is not None and time.monotonic() >= end_s:
                return


def _last(pictures: Iterator[None], end_s: float | None) -> None:
    for _ in pictures:
        if end_s is not None and time.monotonic() >= end_s:
            return


def _of_bus(panel: Panel, namespace: argparse.Namespace, unpack: Unpack) -> Iterator[None]:
    """Takes what comes; gives way whenever it is time for a picture."""
    with open_bus_from(namespace) as bus:
        while True:
            due_s = time.monotonic() + 1 / PICTURES_HZ
            heard = False
            while (left_s := due_s - time.monotonic()) > 0.0:
                heard |= _take(panel, bus.recv(left_s), unpack)
            if not heard:
                panel.heard.idle(time.monotonic())
            yield


def _take(panel: Panel, message: can.Message | None, unpack: Unpack) -> bool:
    if message is None or message.is_error_frame or message.is_remote_frame:
        return False
    now_s = time.monotonic()
    for frame in unpack(frame_of(message)):
        panel.receive(now_s, frame)
    return True


def _of_log(panel: Panel, speed: float, unpack: Unpack, entries: Iterable[Entry]) -> Iterator[None]:
    """The log's frames at their times; the time between pictures is wall time."""
    begin_s: float | None = None
    started_s = drawn_s = time.monotonic()
    for time_s, frame in entries:
        begin_s = time_s if begin_s is None else begin_s
        if speed > 0.0:
            due_s = started_s + (time_s - begin_s) / speed
            while (now_s := time.monotonic()) < due_s:
                if now_s - drawn_s >= 1 / PICTURES_HZ:
                    drawn_s = now_s
                    yield
                time.sleep(min(due_s - now_s, 1 / PICTURES_HZ))
        for inner in unpack(frame):
            panel.receive(time_s, inner)
        if time.monotonic() - drawn_s >= 1 / PICTURES_HZ:
            drawn_s = time.monotonic()
            yield
    yield
