"""`meshpoint replay`: a recorded log through the same core."""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)

from meshpoint.bus.logs.files import log_files, read_logs
from meshpoint.bus.logs.limits import LogError
from meshpoint.controller.header import RunHeader
from meshpoint.controller.settings import ESTIMATOR_NAMES, load_settings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import Message, ReferenceEngagement, ShiftOutcome, ShiftResult
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.testbench.commands import arguments, sensor_replay
from meshpoint.testbench.commands.interrupt import interruptible
from meshpoint.testbench.errors import CommandError
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.logs.account import Account
from meshpoint.testbench.logs.judged_rows import JudgedRow, commanded, judged_table, judged_words
from meshpoint.testbench.logs.open_loop import OpenLoop
from meshpoint.testbench.logs.replay import (
    LogReplay,
    NotVerifiableError,
    Session,
    Verification,
)
from meshpoint.testbench.logs.replay_strategy import Chosen, other_header, recorded_header
from meshpoint.testbench.report.collect import MADE, ReportCollector
from meshpoint.testbench.report.run import Report, ReportRun
from meshpoint.testbench.report.write import aim_rad, check_report, report_provenance, write_report
from meshpoint.testbench.results.output import (
    complain,
    complain_of_strategy,
    console,
    rows_table,
    write_json,
)
from meshpoint.testbench.results.rows import RowCollector, ShiftRow

TELL_FRAMES = 500
SAMPLE_BYTES = 1 << 16
TEXT_LOGS = (".log", ".asc")
EXIT_OF = {
    Verification.IDENTICAL: Exit.DONE,
    Verification.DIFFERS: Exit.FAILED,
    Verification.NOT_VERIFIABLE: Exit.NOT_VERIFIABLE,
}


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "replay",
        description="Feeds the frames of a log to the controller at the recorded steps and shows "
        "what it commands, shift by shift. The run header (header-*.json) is looked for beside "
        "the log.",
    )
    parser.add_argument(
        "log",
        type=Path,
        nargs="+",
        metavar="LOG",
        help=".log (candump), .blf, .asc, .trc, .csv or .mf4, each also .gz; several in order, or "
        "a folder of logs, are one bus",
    )
    parser.add_argument(
        "--jobs",
        type=arguments.whole(1, 1024),
        metavar="J",
        help="each LOG is a bus of its own, J of them at a time; the results do not depend on J",
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
        help="what another strategy decides on the same frames, each recorded shift by itself: "
        "when it fires, the phase it then expects, where it parts from what was recorded "
        "(docs/replay.md); a log that a strategy of your own has made is repeated with that same "
        "file",
    )
    parser.add_argument(
        "--settings",
        type=Path,
        metavar="FILE",
        help="what other settings decide (TOML); what the file leaves out is as recorded",
    )
    parser.add_argument(
        "--estimator",
        choices=sorted(ESTIMATOR_NAMES),
        help="what is decided by another estimator of the layshaft",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="what is decided by a controller that began the run with this calibration",
    )
    parser.add_argument(
        "--gearbox",
        metavar="NAME|FILE",
        help="what is decided by a controller that believes in this data sheet",
    )
    parser.add_argument("--header-dir", type=Path, metavar="DIR", help="where the run headers are")
    parser.add_argument(
        "--bus", metavar="NAME", help="of a log of several buses: can0, or its number"
    )
    sensor_replay.add_arguments(parser)
    arguments.add_json(parser)
    arguments.add_report(parser)
    parser.set_defaults(run=run)


class _Log:
    """The log's frames; remembers the defect that ended it early."""

    def __init__(
        self,
        files: list[Path],
        bus: str | None,
        rows: _Rows,
        tell: Callable[[int], None],
        stop: Callable[[], bool],
    ) -> None:
        """stop: whether it shall end here, as Ctrl-C asks for."""
        self._files = files
        self._bus = bus
        self.buses: Counter[str] = Counter()
        """Frames of each bus."""
        self._rows = rows
        self._tell = tell
        self.account = Account()
        self._stop = stop
        self.interrupted = False
        self.defect: LogError | None = None
        self.frames = 0

    def __iter__(self) -> Iterator[Frame]:
        try:
            for time_s, frame in read_logs(self._files, self._bus, self.buses):
                self.account.take(time_s, frame)
                self.frames += 1
                self._rows.logged(frame)
                if self.frames % TELL_FRAMES == 0:
                    self._tell(self.frames)
                    self.interrupted = self._stop()
                    if self.interrupted:
                        return
                yield frame
        except LogError as error:
            if not self.frames:
                raise
            self.defect = error


class _Rows:
    """Rows of the shifts: as recorded, from the repeated controller's outcomes and the logged
    truth; in open loop from the log alone, with the other strategy's decisions beside each."""

    def __init__(self, for_report: bool, open_loop: OpenLoop | None, asked: str) -> None:
        """asked: what the other controller is, in words."""
        self.asked = asked
        self._for_report = for_report
        self.open_loop = open_loop
        self._logged = Receiver(*Node)
        self._made = Receiver(Node.BENCH)
        self._collector: RowCollector | None = None
        self._truth: list[ReferenceEngagement] = []
        self._session = -1
        self._keys: list[tuple[int, int]] = []
        """Of each row in open loop: session and time of request."""
        self.report: ReportCollector | None = None
        self.header: RunHeader | None = None
        """Of the first session, which rows and report are made with."""

    def logged(self, frame: Frame) -> None:
        """A frame of the log: as recorded, rows use the truth of it and a report all but the
        controller's; in open loop both use all of it."""
        message = self._logged.receive(frame).message
        if message is None:
            return
        if self.open_loop is not None:
            self._take(message)
        elif isinstance(message, ReferenceEngagement):
            self._truth.append(message)
        if self.report is not None and (self.open_loop or not isinstance(message, MADE)):
            self.report.take(message)

    def start(self, header: RunHeader) -> None:
        """A session's data sheet is known, and the settings that it is repeated with."""
        self._session += 1
        if self.report is not None:
            self.report.restart()
        if self._collector is None:
            self.header = header
            self._collector = RowCollector(header.sheet, aim_rad(header), header.settings)
            if self._for_report:
                self.report = ReportCollector(header.sheet, aim_rad(header), header.settings)

    def made(self, frame: Frame) -> None:
        """A frame the repeated controller sent."""
        if self.open_loop is not None:
            return
        message = self._made.receive(frame).message
        if isinstance(message, ShiftOutcome):
            for truth in self._truth:
                self._take(truth)
            self._truth.clear()
            self._take(message)
        if self.report is not None and isinstance(message, MADE):
            self.report.take(message)

    def _take(self, message: Message) -> None:
        if self._collector is None:
            return
        self._collector.take(message)
        if isinstance(message, ShiftOutcome) and message.result is not ShiftResult.REFUSED:
            self._keys.append((self._session, message.request_time_us))

    @property
    def rows(self) -> list[ShiftRow]:
        """The shifts so far."""
        return self._collector.rows if self._collector else []

    @property
    def judged(self) -> list[JudgedRow]:
        """The same in open loop."""
        found = self.open_loop.judged if self.open_loop else {}
        return [
            JudgedRow(row, found.get(key)) for key, row in zip(self._keys, self.rows, strict=True)
        ]


def run(namespace: argparse.Namespace) -> int:
    """Replays, and verifies where asked; the first Ctrl-C ends it with what there is."""
    with interruptible() as stop:
        if namespace.jobs is not None:
            return _each(namespace, stop)
        code, values = _replay(namespace, stop)
    if namespace.json is not None:
        write_json(namespace.json, values)
    return code


class _One(NamedTuple):
    """What came of one log of several."""

    code: int
    values: dict[str, Any]
    text: str


def _each(namespace: argparse.Namespace, stop: Callable[[], bool]) -> int:
    """Every log as a bus of its own, some at a time; told in their order."""
    if namespace.report is not None:
        raise CommandError("--report draws one bus: not with --jobs")
    alone = [argparse.Namespace(**vars(namespace) | {"log": [path]}) for path in namespace.log]
    found: list[_One] = []
    if namespace.jobs == 1:
        found += [_alone(each, stop) for each in alone if not stop()]
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(namespace.jobs, len(alone)), mp_context=context) as pool:
            running = [pool.submit(_in_process, each) for each in alone]
            for future in running:
                if stop():
                    future.cancel()
                else:
                    found.append(future.result())
    for one in found:
        (sys.stderr if namespace.json == "-" else sys.stdout).write(one.text)
    interrupted = len(found) < len(alone) or any(one.values["interrupted"] for one in found)
    if namespace.json is not None:
        replays = [one.values for one in found]
        write_json(namespace.json, {"interrupted": interrupted, "replays": replays})
    if interrupted:
        return Exit.INTERRUPTED
    return max((one.code for one in found), key=lambda code: (code == Exit.FAILED, code))


def _in_process(namespace: argparse.Namespace) -> _One:
    """In a process of its own; Ctrl-C reaches it too."""
    with interruptible() as stop:
        return _alone(namespace, stop)


def _alone(namespace: argparse.Namespace, stop: Callable[[], bool]) -> _One:
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        try:
            code, values = _replay(argparse.Namespace(**vars(namespace) | {"json": None}), stop)
        except LogError as error:
            # One that cannot be read hides none of the others.
            code, values = Exit.BAD_INPUT, {"error": str(error), "interrupted": False}
            text.write(f"{error}\n")
    return _One(int(code), {"log": str(namespace.log[0])} | values, text.getvalue())


def _replay(namespace: argparse.Namespace, stop: Callable[[], bool]) -> tuple[int, dict[str, Any]]:
    """One bus: exit code, and what `--json` has of it."""
    chosen, verify = _chosen(namespace), namespace.verify
    files = log_files(namespace.log)
    if not verify and sensor_replay.asked(namespace):
        return sensor_replay.run(namespace, files, "")
    check_report(namespace.report)
    open_loop = None
    if chosen is not None and not verify:
        open_loop = OpenLoop(
            lambda header: other_header(header, chosen), keeps_traces=namespace.report is not None
        )
    rows = _Rows(namespace.report is not None, open_loop, str(chosen or ""))

    refused: list[NotVerifiableError] = []

    def change(header: RunHeader) -> RunHeader:
        try:
            changed = recorded_header(header, chosen, verify)
        except NotVerifiableError as error:
            refused.append(error)  # a run of ours, but not to be repeated
            raise
        rows.start(changed)
        return changed

    out = console(namespace.json)
    events: list[tuple[int, str]] = []
    replay = LogReplay(
        namespace.header_dir or files[0].parent,
        verify,
        change,
        rows.made,
        lambda time_us, line: events.append((time_us, line)),
        open_loop,
    )
    log, sessions = _replayed(replay, files, namespace.bus, rows, stop)
    tell_buses(out, log.buses, namespace.bus)
    of_another = not any(session.steps for session in sessions) and not refused
    if not verify and namespace.report is None and of_another:
        return sensor_replay.run(namespace, files, str(sessions[0]))
    if log.defect is not None:
        _end_early(sessions[-1], f"then the log cannot be read: {log.defect}")
    if log.interrupted:
        _end_early(sessions[-1], f"then it was interrupted, after {log.frames} frames")
    _show(namespace, out, files, sessions, rows, log.account)
    if namespace.report is not None:
        _report(namespace, out, files, sessions, rows, log.interrupted)
    errors: Counter[str] = Counter()
    for session in sessions:
        errors += Counter(session.strategy_errors)
    complain_of_strategy(errors)
    values = _values(namespace, files, sessions, rows, events, log)
    if log.interrupted:
        complain(f"interrupted: what is told ends after {log.frames} frames of the log")
        return Exit.INTERRUPTED, values
    if log.defect is not None and not verify:
        return Exit.BAD_INPUT, values
    return _exit_code(sessions, verify) or (Exit.FAILED if errors else Exit.DONE), values


def _chosen(namespace: argparse.Namespace) -> Chosen | None:
    """What the other controller has otherwise; None where none is asked about. CommandError where a
    run shall be verified with something else than recorded it."""
    name, gearbox = namespace.strategy, namespace.gearbox
    chosen = Chosen(
        name,
        None if name is None else arguments.strategy_file(name),
        namespace.settings,
        namespace.estimator,
        namespace.calibration,
        None if gearbox is None else load_sheet(gearbox),
    )
    if namespace.verify and chosen._replace(name=None, file=None).changes:
        raise CommandError("--verify compares with the log: no other settings can be asked about")
    if chosen.settings is not None:
        load_settings(chosen.settings)
    return chosen if chosen.changes else None


def _replayed(
    replay: LogReplay,
    files: list[Path],
    bus: str | None,
    rows: _Rows,
    stop: Callable[[], bool],
) -> tuple[_Log, list[Session]]:
    """The whole log through it, with progress told."""
    with Progress(
        SpinnerColumn(),
        TextColumn("replaying"),
        BarColumn(),
        TextColumn("{task.completed} frames"),
        TimeRemainingColumn(),
        console=console("-"),
        transient=True,
    ) as progress:
        task = progress.add_task("frames", total=expected_frames(files))
        log = _Log(files, bus, rows, lambda frames: progress.update(task, completed=frames), stop)
        return log, replay.run(log)


def expected_frames(files: list[Path]) -> int | None:
    """About how many frames text logs hold, by the length of their first lines; None for others."""
    total = 0
    for path in files:
        if path.suffix.lower() not in TEXT_LOGS:
            return None
        try:
            with path.open("rb") as file:
                start = file.read(SAMPLE_BYTES)
                size = file.seek(0, os.SEEK_END)
        except OSError:
            return None
        lines = start.count(b"\n")
        total += size * lines // max(1, len(start))
    return total or None


def _end_early(session: Session, why: str) -> None:
    """A log that is not read to its end is verified as far as it goes, and says so."""
    if session.verdict is Verification.IDENTICAL:
        session.verdict = Verification.NOT_VERIFIABLE
        session.step = session.steps
        session.reason = f"every step before it agrees; {why}"


def _exit_code(sessions: list[Session], verify: bool) -> int:
    codes = [EXIT_OF[session.verdict] for session in sessions]
    if verify:
        return max(codes, key=lambda code: (code is Exit.FAILED, code))
    broken = all(code is Exit.NOT_VERIFIABLE for code in codes)
    return Exit.NOT_VERIFIABLE if broken else Exit.DONE


def _values(
    namespace: argparse.Namespace,
    files: list[Path],
    sessions: list[Session],
    rows: _Rows,
    events: list[tuple[int, str]],
    log: _Log,
) -> dict[str, Any]:
    """What `--json` has."""
    judged = rows.judged if rows.open_loop else None
    shifts = (
        [row.to_json() for row in rows.rows]
        if judged is None
        else [row.to_json(rows.asked) for row in judged]
    )
    values: dict[str, Any] = {
        "log": str(namespace.log[0]),
        "logs": [str(path) for path in files],
        "mode": "as recorded" if judged is None else "open loop",
        "sessions": [_session_json(session) for session in sessions],
        "account": log.account.to_json(),
        "interrupted": log.interrupted,
        "shifts": shifts,
        "events": [{"time_us": time_us, "event": line} for time_us, line in events],
    }
    if rows.open_loop is not None:
        values["commanded"] = [commanded(row) for row in shifts]
        values["unfinished_shifts"] = rows.open_loop.unfinished
    return values


def _show(
    namespace: argparse.Namespace,
    out: Any,
    files: list[Path],
    sessions: list[Session],
    rows: _Rows,
    account: Account,
) -> None:
    judged, asked = rows.judged if rows.open_loop else None, rows.asked
    if namespace.json != "-" and rows.rows:
        if judged is None:
            out.print(rows_table(f"{_name(files)} as recorded", rows.rows))
        else:
            out.print(judged_table(f"{_name(files)} as {asked} decides it", judged))
            out.print(judged_words(judged, asked), markup=False)
    for number, session in enumerate(sessions, 1):
        if namespace.verify or session.verdict is not Verification.IDENTICAL:
            out.print(f"run {number} of {len(sessions)}: {session}", markup=False)
        else:
            out.print(
                f"run {number} of {len(sessions)}: {session.steps} steps replayed"
                f"{session.intruders_text}"
            )
    for line in account.words():
        out.print(f"log: {line}", markup=False)


def _report(
    namespace: argparse.Namespace,
    out: Any,
    files: list[Path],
    sessions: list[Session],
    rows: _Rows,
    interrupted: bool,
) -> None:
    """The page; without a run header there is no data sheet to draw anything by."""
    header = rows.header
    if header is None or rows.report is None:
        out.print("no report: no run of this log could be repeated")
        return
    name, shifts = header.settings.strategy_name, rows.report.finish()
    notes = [f"run {n} of {len(sessions)}: {session}" for n, session in enumerate(sessions, 1)]
    if not namespace.verify:
        notes = []
    if interrupted:
        notes.append("Interrupted: what came later in the log is not in here.")
    subtitle = (
        "A recorded bus through the same controller, as recorded; sensors, valves and truth are "
        "those of the log."
    )
    if rows.open_loop is not None:
        judged = rows.judged
        shifts = [replace(s, replayed=j.judged) for s, j in zip(shifts, judged, strict=True)]
        subtitle = (
            f"A recorded bus, and what {rows.asked} decides on the same frames: each shift "
            "judged from the state in which it was begun. Outcomes are the log's; the other "
            "strategy has none."
        )
        notes.append(judged_words(judged, rows.asked))
    report = Report(
        title=f"meshpoint replay: {_name(files)}",
        subtitle=subtitle,
        sheet=header.sheet,
        runs=[ReportRun(name, shifts, notes)],
        asked=rows.asked if rows.open_loop else None,
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


def tell_buses(out: Any, buses: Counter[str], bus: str | None) -> None:
    """A log of several buses: which, and which of them was used."""
    if len(buses) > 1:
        each = ", ".join(f"{name} ({n} frames)" for name, n in sorted(buses.items()))
        used = "all are used as one (--bus picks one)" if bus is None else f"used is {bus}"
        out.print(f"buses in the log: {each}; {used}", markup=False)


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
        "intruders": {f"{can_id:08X}": n for can_id, n in sorted(session.intruders.items())},
    }
