"""`meshpoint report LOG`: would another controller have met the gap more often?"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from meshpoint.bus.logs.files import log_files
from meshpoint.bus.profile import WireProfile
from meshpoint.controller.header import RunHeader
from meshpoint.controller.settings import load_settings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.rig_sim.settings import DEFAULT_PRESET
from meshpoint.testbench.commands import arguments
from meshpoint.testbench.commands.interrupt import interruptible
from meshpoint.testbench.commands.log_progress import complain_of_interrupt, logged_frames
from meshpoint.testbench.commands.replay_rows import ReplayRows
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.logs.consumed import NotVerifiableError
from meshpoint.testbench.logs.logged_frames import LoggedFrames
from meshpoint.testbench.logs.replay import LogReplay
from meshpoint.testbench.logs.sleeve_contacts import ShiftWatch
from meshpoint.testbench.open_loop.answer import Answer, of_another, of_judged
from meshpoint.testbench.open_loop.chosen import Chosen, other_header, recorded_header
from meshpoint.testbench.open_loop.open_loop import OpenLoop
from meshpoint.testbench.results.output import console, write_json

NOT_OURS = (
    "the log holds no run of our controller that can be repeated, so the state in which a shift "
    "was begun is unknown"
)


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "report",
        description="How often the controller of a recorded bus met the gap, as the sleeves' "
        "positions show it, and how often another strategy would have, worked out for each shift "
        "with an interval; or that it cannot be decided, and why. The bus may have been recorded "
        "by `meshpoint controller --shadow --log FILE`. docs/replay.md says what is worked out.",
    )
    parser.add_argument("log", type=Path, nargs="+", metavar="LOG", help=arguments.LOGS_HELP)
    parser.add_argument(
        "--strategy",
        type=arguments.strategy_name,
        default="target_phase",
        metavar="NAME|FILE.py:CLASS",
        help="the other strategy (default: target_phase)",
    )
    parser.add_argument(
        "--settings", type=Path, metavar="FILE", help="the other controller's settings, TOML"
    )
    parser.add_argument(
        "--gearbox",
        default=DEFAULT_PRESET.sheet_name,
        metavar="NAME|FILE",
        help="data sheet, where no run header says it (default: %(default)s)",
    )
    parser.add_argument("--header-dir", type=Path, metavar="DIR", help="where the run headers are")
    arguments.add_wire(parser)
    parser.add_argument("--bus", metavar="NAME", help="of a log of several buses: can0")
    arguments.add_json(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Reads the log once, and says both."""
    files = log_files(namespace.log)
    if namespace.settings is not None:
        load_settings(namespace.settings)
    unpack = arguments.unpacking_of(namespace, load_sheet(namespace.gearbox))
    with (
        interruptible() as stop,
        logged_frames(files, namespace.bus, stop, unpack=unpack) as log,
    ):
        answer = _answer(namespace, files, log)
    out = console(namespace.json)
    out.print(answer.sentence, soft_wrap=True)
    for line in log.words():
        out.print(f"log: {line}", soft_wrap=True)
    if log.defect is not None:
        out.print(f"the log cannot be read on: {log.defect}", soft_wrap=True)
    if namespace.json is not None:
        values = {
            "logs": [str(path) for path in files],
            "interrupted": log.interrupted,
            "account": log.account.to_json(),
            "log_clock": log.clock.to_json(),
        }
        write_json(namespace.json, values | answer.to_json())
    if log.interrupted:
        complain_of_interrupt(log.frames)
        return Exit.INTERRUPTED
    return Exit.DONE if log.defect is None else Exit.BAD_INPUT


def _answer(namespace: argparse.Namespace, files: list[Path], log: LoggedFrames) -> Answer:
    name = namespace.strategy
    chosen = Chosen(name, arguments.strategy_file(name), namespace.settings)
    open_loop = OpenLoop(lambda header: other_header(header, chosen), keeps_traces=False)
    rows = ReplayRows(False, open_loop, name)
    sheet = load_sheet(namespace.gearbox)
    sleeves, unpack = _Sleeves(sheet), arguments.unpack_all_of(namespace, sheet)
    refused: list[str] = []

    def change(header: RunHeader) -> RunHeader:
        try:
            changed = recorded_header(header, None, verify=False)
        except NotVerifiableError as error:
            refused.append(str(error))
            raise
        rows.start(changed)
        sleeves.use(changed.sheet)
        return changed

    folder = namespace.header_dir or files[0].parent
    replay = LogReplay(folder, verify=False, change=change, on_output=rows.made, onlooker=open_loop)

    def fed() -> Iterator[Frame]:
        for _, frame in log:
            rows.logged(frame)
            for inner in unpack(frame):
                sleeves.take(inner)
            yield frame

    sessions = replay.run(fed())
    if replay.is_classic and arguments.wire_of(namespace) is WireProfile.FD:
        raise CommandError("the log is of the classic profile: --profile classic and --gearbox")
    if any(session.steps for session in sessions):
        return of_judged(rows.judged, sleeves.watch.shifts, name)
    why = refused[0] if refused else f"{NOT_OURS} ({sessions[0].reason})"
    return of_another(sleeves.watch.shifts, name, why)


class _Sleeves:
    """The sleeves' contacts, by the data sheet of the run header where there is one."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._receiver = Receiver(*Node)
        self.watch = ShiftWatch(sheet)

    def use(self, sheet: GearboxSheet) -> None:
        """The header's, which comes with the first step, before any shift."""
        if sheet != self._sheet:
            self._sheet = sheet
            shifts = self.watch.shifts
            self.watch = ShiftWatch(sheet)
            self.watch.shifts += shifts

    def take(self, frame: Frame) -> None:
        """A frame of the log, in its order."""
        message = self._receiver.receive(frame).message
        if message is not None:
            self.watch.take(message)
