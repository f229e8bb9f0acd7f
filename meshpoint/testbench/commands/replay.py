"""`meshpoint replay`: a recorded log through the same core."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rich.progress import Progress, SpinnerColumn, TextColumn

from meshpoint.bus.logs.files import log_files, read_logs
from meshpoint.bus.logs.limits import LogError
from meshpoint.controller.header import RunHeader
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ReferenceEngagement, ShiftOutcome
from meshpoint.dbc.node import Node
from meshpoint.testbench.commands import arguments
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.logs.counterfactual import Counterfactuals, counterfactual_table
from meshpoint.testbench.logs.replay import LogReplay, Session, Verification
from meshpoint.testbench.logs.replay_strategy import Chosen, header_for
from meshpoint.testbench.report.collect import MADE, ReportCollector
from meshpoint.testbench.report.run import Report, ReportRun
from meshpoint.testbench.report.write import aim_rad, check_report, report_provenance, write_report
from meshpoint.testbench.results.output import complain_of_strategy, console, rows_table, write_json
from meshpoint.testbench.results.rows import RowCollector, ShiftRow

TELL_FRAMES = 500
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
    parser.add_argument(
        "log",
        type=Path,
        nargs="+",
        metavar="LOG",
        help=".log (candump), .blf or .asc; several in order, or a folder of logs, are one bus",
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="compare every frame with the log: identical, differs at step n, or not verifiable",
    )
    parser.add_argument(
        "--strategy",
        type=arguments.strategy_name,
        metavar="NAME|FILE.py:CLASS",
        help="what another strategy would have commanded on the same frames: when it fires, and "
        "the phase it then expects, beside what was recorded; a log that a strategy of your own "
        "has made is repeated with that same file",
    )
    parser.add_argument("--header-dir", type=Path, metavar="DIR", help="where the run headers are")
    arguments.add_json(parser)
    arguments.add_report(parser)
    parser.set_defaults(run=run)


class _Log:
    """The log's frames; remembers the defect that ended it early."""

    def __init__(self, files: list[Path], rows: _Rows, tell: Callable[[int], None]) -> None:
        self._files = files
        self._rows = rows
        self._tell = tell
        self.defect: LogError | None = None
        self.frames = 0

    def __iter__(self) -> Iterator[Frame]:
        try:
            for _, frame in read_logs(self._files):
                self.frames += 1
                self._rows.logged(frame)
                if self.frames % TELL_FRAMES == 0:
                    self._tell(self.frames)
                yield frame
        except LogError as error:
            if not self.frames:
                raise
            self.defect = error


class _Rows:
    """Rows from the replayed controller's outcomes beside the logged truth; with another strategy
    beside the logged commands, since that truth came of those."""

    def __init__(self, for_report: bool = False, other: bool = False) -> None:
        self._for_report = for_report
        self.counterfactuals = Counterfactuals() if other else None
        self._logged = Receiver(*Node)
        self._made = Receiver(Node.BENCH)
        self._collector: RowCollector | None = None
        self._settings = self._logged_settings = ControllerSettings()
        """Of the replayed controller and of the recorded one, which name their strategies."""
        self._truth: list[ReferenceEngagement] = []
        self.report: ReportCollector | None = None
        self.header: RunHeader | None = None
        """Of the first session, which rows and report are made with."""

    def logged(self, frame: Frame) -> None:
        """A frame of the log: rows use the truth of it, a report all but the controller's."""
        message = self._logged.receive(frame).message
        if self.counterfactuals is not None:
            if isinstance(message, ShiftOutcome):
                self.counterfactuals.recorded(message, self._logged_settings)
        elif isinstance(message, ReferenceEngagement):
            self._truth.append(message)
        if self.report is not None and message is not None and not isinstance(message, MADE):
            self.report.take(message)

    def start(self, header: RunHeader, settings: ControllerSettings) -> None:
        """A session's data sheet is known, and the settings that it is replayed with."""
        self._logged_settings, self._settings = header.settings, settings
        if self.report is not None:
            self.report.restart()
        if self._collector is None:
            self.header = header
            self._collector = RowCollector(header.sheet, aim_rad(header), settings)
            if self._for_report:
                self.report = ReportCollector(header.sheet, aim_rad(header), settings)

    def made(self, frame: Frame) -> None:
        """A frame the replayed controller sent."""
        message = self._made.receive(frame).message
        if isinstance(message, ShiftOutcome) and self._collector is not None:
            for truth in self._truth:
                self._collector.take(truth)
            self._truth.clear()
            self._collector.take(message)
            if self.counterfactuals is not None:
                self.counterfactuals.made(message, self._settings)
        if self.report is not None and isinstance(message, MADE):
            self.report.take(message)

    @property
    def rows(self) -> list[ShiftRow]:
        """The shifts so far."""
        return self._collector.rows if self._collector else []


def run(namespace: argparse.Namespace) -> int:
    """Replays, and verifies where asked."""
    other = namespace.strategy
    chosen = None if other is None else Chosen(other, arguments.strategy_file(other))
    files = log_files(namespace.log)
    check_report(namespace.report)
    rows = _Rows(namespace.report is not None, other is not None)

    def change(header: RunHeader) -> RunHeader:
        changed = header_for(header, chosen, namespace.verify)
        rows.start(header, changed.settings)
        return changed

    out = console(namespace.json)
    events: list[tuple[int, str]] = []
    replay = LogReplay(
        namespace.header_dir or files[0].parent,
        namespace.verify,
        change,
        rows.made,
        lambda time_us, line: events.append((time_us, line)),
    )
    with Progress(
        SpinnerColumn(),
        TextColumn("replaying {task.completed} frames"),
        console=console("-"),
        transient=True,
    ) as progress:
        task = progress.add_task("frames", total=None)
        log = _Log(files, rows, lambda frames: progress.update(task, completed=frames))
        sessions = replay.run(log)
    if log.defect is not None:
        _end_early(sessions[-1], log.defect)
    _show(namespace, out, files, sessions, rows, events)
    if namespace.report is not None:
        _report(namespace, out, files, sessions, rows)
    errors: Counter[str] = Counter()
    for session in sessions:
        errors += Counter(session.strategy_errors)
    complain_of_strategy(errors)
    return _exit_code(sessions, namespace.verify) or (Exit.FAILED if errors else Exit.DONE)


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
    files: list[Path],
    sessions: list[Session],
    rows: _Rows,
    events: list[tuple[int, str]],
) -> None:
    pairs = rows.counterfactuals.pairs() if rows.counterfactuals else None
    if namespace.json is not None:
        values = {
            "log": str(namespace.log[0]),
            "logs": [str(path) for path in files],
            "sessions": [_session_json(session) for session in sessions],
            "shifts": [row.to_json() for row in rows.rows],
            "events": [{"time_us": time_us, "event": line} for time_us, line in events],
        }
        if pairs is not None:
            values["commanded"] = [pair.to_json() for pair in pairs]
        write_json(namespace.json, values)
    if namespace.json != "-" and rows.rows:
        title = f"{_name(files)} as {namespace.strategy or 'recorded'} commands it"
        if pairs is None:
            out.print(rows_table(title, rows.rows))
        else:
            out.print(counterfactual_table(title, pairs))
    for number, session in enumerate(sessions, 1):
        if namespace.verify or session.verdict is not Verification.IDENTICAL:
            out.print(f"run {number} of {len(sessions)}: {session}", markup=False)
        else:
            out.print(f"run {number} of {len(sessions)}: {session.steps} steps replayed")


def _report(
    namespace: argparse.Namespace,
    out: Any,
    files: list[Path],
    sessions: list[Session],
    rows: _Rows,
) -> None:
    """The page; without a run header there is no data sheet to draw anything by."""
    header = rows.header
    if header is None or rows.report is None:
        out.print("no report: no run of this log could be repeated")
        return
    name = namespace.strategy or header.settings.strategy_name
    notes = [f"run {n} of {len(sessions)}: {session}" for n, session in enumerate(sessions, 1)]
    what = "as recorded" if namespace.strategy is None else f"as {namespace.strategy} commands it"
    report = Report(
        title=f"meshpoint replay: {_name(files)}",
        subtitle=f"A recorded bus through the same controller, {what}; sensors, valves and truth "
        "are those of the log.",
        sheet=header.sheet,
        runs=[ReportRun(name, rows.report.finish(), notes if namespace.verify else [])],
        provenance=report_provenance(
            header.sheet,
            seed=None,
            preset=None,
            **{
                "log": ", ".join(path.name for path in files),
                "recorded with version": header.version,
                "run headers": ", ".join(f"{session.run_hash:016x}" for session in sessions),
            },
        ),
    )
    write_report(namespace.report, report)


def _name(files: list[Path]) -> str:
    more = f" and {len(files) - 1} more" if len(files) > 1 else ""
    return f"{files[0].name}{more}"


def _session_json(session: Session) -> dict[str, Any]:
    return {
        "verdict": session.verdict.value,
        "step": session.step,
        "reason": session.reason,
        "steps": session.steps,
        "frames": session.frames,
        "run_hash": f"{session.run_hash:016x}",
    }
