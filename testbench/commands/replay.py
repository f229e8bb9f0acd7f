"""`meshpoint replay`: a recorded log through the same core."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bus.logs import LogError, read_log
from controller.header import RunHeader
from controller.settings import STRATEGY_NAMES
from dbc.frame import Frame
from dbc.link import Receiver
from dbc.messages import ReferenceEngagement, ShiftOutcome
from dbc.node import Node
from gearbox import GearboxSheet
from testbench import arguments
from testbench.exits import Exit
from testbench.output import console, rows_table, write_json
from testbench.replay import LogReplay, Session, Verification
from testbench.rows import RowCollector, ShiftRow

EXIT_OF = {
    Verification.IDENTICAL: Exit.DONE,
    Verification.DIFFERS: Exit.FAILED,
    Verification.NOT_VERIFIABLE: Exit.NOT_VERIFIABLE,
}


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "replay",
        help="a recorded log through the same controller",
        description="Feeds the frames of a log to the controller at the recorded steps and shows "
        "what it commands, shift by shift. The run header (header-*.json) is looked for beside "
        "the log.",
    )
    parser.add_argument("log", type=Path, metavar="LOG", help=".log (candump), .blf or .asc")
    parser.add_argument(
        "--verify",
        action="store_true",
        help="compare every frame with the log: identical, differs at step n, or not verifiable",
    )
    parser.add_argument(
        "--strategy",
        choices=tuple(STRATEGY_NAMES),
        help="what another strategy would have commanded on the same frames",
    )
    parser.add_argument("--header-dir", type=Path, metavar="DIR", help="where the run headers are")
    arguments.add_json(parser)
    parser.set_defaults(run=run)


class _Log:
    """The log's frames; remembers the defect that ended it early."""

    def __init__(self, path: Path, rows: _Rows) -> None:
        self._path = path
        self._rows = rows
        self.defect: LogError | None = None
        self.frames = 0

    def __iter__(self) -> Iterator[Frame]:
        try:
            for _, frame in read_log(self._path):
                self.frames += 1
                self._rows.logged(frame)
                yield frame
        except LogError as error:
            if not self.frames:
                raise
            self.defect = error


class _Rows:
    """Rows from the replayed controller's outcomes beside the logged truth."""

    def __init__(self) -> None:
        self._logged = Receiver(*Node)
        self._made = Receiver(Node.BENCH)
        self._collector: RowCollector | None = None
        self._truth: list[ReferenceEngagement] = []

    def logged(self, frame: Frame) -> None:
        """A frame of the log: of these only the truth is used."""
        message = self._logged.receive(frame).message
        if isinstance(message, ReferenceEngagement):
            self._truth.append(message)

    def start(self, sheet: GearboxSheet) -> None:
        """A session's data sheet is known."""
        if self._collector is None:
            self._collector = RowCollector(sheet)

    def made(self, frame: Frame) -> None:
        """A frame the replayed controller sent."""
        message = self._made.receive(frame).message
        if isinstance(message, ShiftOutcome) and self._collector is not None:
            for truth in self._truth:
                self._collector.take(truth)
            self._truth.clear()
            self._collector.take(message)

    @property
    def rows(self) -> list[ShiftRow]:
        """The shifts so far."""
        return self._collector.rows if self._collector else []


def run(namespace: argparse.Namespace) -> int:
    """Replays, and verifies where asked."""
    other = namespace.strategy
    rows = _Rows()

    def change(header: RunHeader) -> RunHeader:
        rows.start(header.sheet)
        if other is None:
            return header
        return dataclasses.replace(
            header, settings=dataclasses.replace(header.settings, strategy_name=other)
        )

    out = console(namespace.json)
    events: list[tuple[int, str]] = []
    verify = namespace.verify and other is None
    replay = LogReplay(
        namespace.header_dir or namespace.log.parent,
        verify,
        change,
        rows.made,
        lambda time_us, line: events.append((time_us, line)),
    )
    log = _Log(namespace.log, rows)
    sessions = replay.run(log)
    if log.defect is not None:
        _end_early(sessions[-1], log.defect)
    _show(namespace, out, sessions, rows.rows, events)
    return _exit_code(sessions, namespace.verify)


def _end_early(session: Session, defect: LogError) -> None:
    """A log that stops being readable is verified as far as it goes, and says so."""
    if session.verdict is Verification.IDENTICAL:
        session.verdict = Verification.NOT_VERIFIABLE
        session.step = session.steps
        session.reason = f"every step before it agrees; then the log cannot be read: {defect}"


def _exit_code(sessions: list[Session], verify: bool) -> int:
    codes = [EXIT_OF[session.verdict] for session in sessions]
    if verify:
        return max(codes, key=lambda code: (code is Exit.FAILED, code))
    broken = all(code is Exit.NOT_VERIFIABLE for code in codes)
    return Exit.NOT_VERIFIABLE if broken else Exit.DONE


def _show(
    namespace: argparse.Namespace,
    out: Any,
    sessions: list[Session],
    rows: list[ShiftRow],
    events: list[tuple[int, str]],
) -> None:
    if namespace.json is not None:
        write_json(
            namespace.json,
            {
                "log": str(namespace.log),
                "sessions": [_session_json(session) for session in sessions],
                "shifts": [row.to_json() for row in rows],
                "events": [{"time_us": time_us, "event": line} for time_us, line in events],
            },
        )
    if namespace.json != "-" and rows:
        title = f"{namespace.log.name} as {namespace.strategy or 'recorded'} commands it"
        out.print(rows_table(title, rows))
    for number, session in enumerate(sessions, 1):
        if namespace.verify or session.verdict is not Verification.IDENTICAL:
            out.print(f"run {number} of {len(sessions)}: {session}", markup=False)
        else:
            out.print(f"run {number} of {len(sessions)}: {session.steps} steps replayed")


def _session_json(session: Session) -> dict[str, Any]:
    return {
        "verdict": session.verdict.value,
        "step": session.step,
        "reason": session.reason,
        "steps": session.steps,
        "frames": session.frames,
        "run_hash": f"{session.run_hash:016x}",
    }
