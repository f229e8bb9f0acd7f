"""`meshpoint replay LOG --gap-rate`: would another controller have met the gap more often?"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus.logs.files import log_files
from meshpoint.bus.profile import WireProfile
from meshpoint.cli import arguments
from meshpoint.controller.settings.header import RunHeader
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.logs.consumed import NotVerifiableError
from meshpoint.logs.log_progress import complain_of_interrupt, logged_frames
from meshpoint.logs.logged_frames import LoggedFrames
from meshpoint.logs.sleeve_contacts import ShiftWatch
from meshpoint.replays.answer import Answer, of_another, of_judged
from meshpoint.replays.chosen import Chosen, other_header, recorded_header
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.replay_rows import ReplayRows
from meshpoint.results.output import console, write_json

STRATEGY: Final = "target_phase"
"""The other controller's, where none is named."""
NOT_OURS: Final = (
    "the log holds no run of our controller that can be repeated, so the state in which a shift "
    "was begun is unknown"
)


def run(namespace: argparse.Namespace, chosen: Chosen, stop: Callable[[], bool]) -> int:
    """How often the controller of a recorded bus met the gap, as the sleeves' positions show it,
    and how often the chosen one would have: reads the log once, and says both."""
    for name in ("sensors", "dbc", "map", "report", "jobs"):
        if getattr(namespace, name):
            raise CommandError(f"--{name}: not with --gap-rate, which says one sentence of one bus")
    files, sheet = log_files(namespace.log), arguments.sheet_of(namespace)
    unpack = arguments.unpacking_of(namespace, sheet)
    with logged_frames(files, namespace.bus, stop, unpack=unpack) as log:
        answer = _answer(namespace, chosen, files, log)
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


def _answer(
    namespace: argparse.Namespace, chosen: Chosen, files: list[Path], log: LoggedFrames
) -> Answer:
    name, sheet = str(chosen), arguments.sheet_of(namespace)
    open_loop = OpenLoop(lambda header: other_header(header, chosen), keeps_traces=False)
    rows = ReplayRows(False, open_loop, name)
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
    return of_another(sleeves.watch.shifts, str(chosen._replace(sheet=None)), why)


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
