"""`meshpoint replay`: a recorded log through the same core."""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus import given_numbers
from meshpoint.bus.light_can import load_can
from meshpoint.bus.logs.files import log_files
from meshpoint.bus.logs.reader import LogError
from meshpoint.bus.profile import WireProfile
from meshpoint.cli import arguments
from meshpoint.cli.interrupt import interruptible
from meshpoint.controller.settings.header import RunHeader
from meshpoint.controller.settings.settings import ESTIMATOR_NAMES, load_settings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import load_sheet
from meshpoint.logs.consumed import NotVerifiableError
from meshpoint.logs.log_progress import (
    complain_of_interrupt,
    log_name,
    logged_frames,
)
from meshpoint.logs.logged_frames import LoggedFrames
from meshpoint.replays import gap_rate
from meshpoint.replays import replay_sensors as sensor_replay
from meshpoint.replays.chosen import Chosen, other_header, recorded_header
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.replay_page import write_replay_page
from meshpoint.replays.replay_record import replay_values
from meshpoint.replays.replay_rows import ReplayRows
from meshpoint.replays.session import Session, Verification
from meshpoint.report.judged_rows import judged_table, judged_words
from meshpoint.report.write import check_report
from meshpoint.results.output import (
    complain,
    complain_of_strategy,
    console,
    rows_table,
    write_json,
)

EXIT_OF = {
    Verification.IDENTICAL: Exit.DONE,
    Verification.IN_PARTS: Exit.NOT_VERIFIABLE,
    Verification.DIFFERS: Exit.FAILED,
    Verification.NOT_VERIFIABLE: Exit.NOT_VERIFIABLE,
}


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "replay",
        description="Feeds the frames of a log to the controller at the recorded steps and shows "
        "what it commands, shift by shift. The run header (header-*.json) is looked for beside "
        "the log. With --gap-rate it says how often the log's controller met the gap, and how "
        "often another one would have.",
    )
    arguments.add_logs(parser)
    parser.add_argument(
        "--jobs",
        type=given_numbers.whole(1, 1024),
        metavar="J",
        help="each LOG is a bus of its own, J of them at a time; the results do not depend on J",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--verify",
        action="store_true",
        help="compare every frame with the log: identical, differs at step n, or not verifiable",
    )
    what.add_argument(
        "--gap-rate",
        action="store_true",
        help="how often the log's controller, ours or not, met the gap, as the sleeves' positions "
        "show it, and how often another (--strategy, default: target_phase; --settings ...) would "
        "have: with a 95 %% interval, or not decidable and why. The log may be of `meshpoint "
        "controller --shadow --log FILE` (docs/replay.md)",
    )
    parser.add_argument(
        "--strategy",
        type=arguments.strategy_name,
        metavar="NAME|FILE.py:CLASS",
        help="what another strategy decides on the same frames, each recorded shift by itself: "
        "when it fires, the phase it then expects, when it first differs from what was recorded "
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
        help="what is decided by a controller that believes in this data sheet; of a log without a "
        "run header: its own data sheet",
    )
    arguments.add_wire(parser.add_argument_group("with --gap-rate"))
    parser.add_argument("--header-dir", type=Path, metavar="DIR", help="where the run headers are")
    parser.add_argument(
        "--bus", metavar="NAME", help="of a log of several buses: can0, or its number"
    )
    sensor_replay.add_arguments(parser)
    arguments.add_json(parser)
    arguments.add_report(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Replays, and verifies where asked; the first Ctrl-C ends it with what there is."""
    with interruptible() as stop:
        if namespace.gap_rate:
            namespace.strategy = namespace.strategy or gap_rate.STRATEGY
            return gap_rate.run(namespace, _asked(namespace), stop)
        if arguments.wire_of(namespace) is WireProfile.CLASSIC:
            raise CommandError(
                "--profile classic: for --gap-rate alone; else a log's profile is seen in it"
            )
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
    """Every log as a bus of its own, some at a time; reported in their order."""
    if namespace.report is not None:
        raise CommandError("--report draws one bus: not with --jobs")
    alone = [argparse.Namespace(**vars(namespace) | {"log": [path]}) for path in namespace.log]
    found: list[_One] = []
    if namespace.jobs == 1:
        found += [_alone(each, stop) for each in alone if not stop()]
    else:
        context = multiprocessing.get_context("spawn")
        jobs = min(namespace.jobs, len(alone))
        with ProcessPoolExecutor(jobs, mp_context=context, initializer=load_can) as pool:
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
    verify = namespace.verify
    asked = _asked(namespace)
    chosen = asked if asked.changes else None
    files = log_files(namespace.log)
    if not verify and sensor_replay.asked(namespace):
        return sensor_replay.run(namespace, files, "", stop)
    check_report(namespace.report)
    open_loop = None
    if chosen is not None and not verify:
        open_loop = OpenLoop(
            lambda header: other_header(header, chosen), keeps_traces=namespace.report is not None
        )
    rows = ReplayRows(namespace.report is not None, open_loop, str(chosen or ""))

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
        rows.beliefs.look if open_loop is None and namespace.report is not None else None,
    )
    with logged_frames(files, namespace.bus, stop) as log:
        sessions = replay.run(_fed(log, rows))
    tell_buses(out, log.buses, namespace.bus)
    of_another = not any(session.steps for session in sessions) and not refused
    if not verify and of_another:
        return _by_sensors(namespace, files, replay, stop)
    if log.defect is not None:
        _end_early(sessions[-1], f"then the log cannot be read: {log.defect}")
    if log.interrupted:
        _end_early(sessions[-1], f"then it was interrupted, after {log.frames} frames")
    _show(namespace, out, files, sessions, rows, log)
    if namespace.report is not None:
        write_replay_page(namespace, out, files, sessions, rows, log.interrupted)
    errors: Counter[str] = Counter()
    for session in sessions:
        errors += Counter(session.strategy_errors)
    complain_of_strategy(errors)
    values = replay_values(namespace, files, sessions, rows, events, log)
    if log.interrupted:
        complain_of_interrupt(log.frames)
        return Exit.INTERRUPTED, values
    if log.defect is not None and not verify:
        return _torn(namespace, log.defect), values
    return _exit_code(sessions, verify) or (Exit.FAILED if errors else Exit.DONE), values


def _torn(namespace: argparse.Namespace, defect: LogError) -> int:
    """Says on standard error where the log ends; with `--json -` all else that is said is there."""
    if namespace.json != "-":
        complain(f"the log cannot be read on: {defect}")
    return Exit.BAD_INPUT


def _by_sensors(
    namespace: argparse.Namespace, files: list[Path], replay: LogReplay, stop: Callable[[], bool]
) -> tuple[int, dict[str, Any]]:
    """A log without a run of ours: its sensors alone. CommandError for one of another profile."""
    if replay.is_classic:
        raise CommandError(str(replay.sessions[0].reason))
    return sensor_replay.run(namespace, files, str(replay.sessions[0]), stop)


def _asked(namespace: argparse.Namespace) -> Chosen:
    """What the other controller has otherwise. CommandError where a run shall be verified with
    something else than recorded it."""
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
    return chosen


def _fed(log: LoggedFrames, rows: ReplayRows) -> Iterator[Frame]:
    """Each frame, after the rows have had it."""
    for _, frame in log:
        rows.logged(frame)
        yield frame


def _end_early(session: Session, why: str) -> None:
    """A log that is not read to its end is verified as far as it goes, and says so."""
    if session.goes_on:
        session.verdict = Verification.NOT_VERIFIABLE
        session.step = session.steps
        session.reason = f"every step before it agrees; {why}"


def _exit_code(sessions: list[Session], verify: bool) -> int:
    if verify:
        codes = [EXIT_OF[session.verdict] for session in sessions]
        return max(codes, key=lambda code: (code is Exit.FAILED, code))
    broken = all(session.verdict is Verification.NOT_VERIFIABLE for session in sessions)
    return Exit.NOT_VERIFIABLE if broken else Exit.DONE


def _show(
    namespace: argparse.Namespace,
    out: Any,
    files: list[Path],
    sessions: list[Session],
    rows: ReplayRows,
    log: LoggedFrames,
) -> None:
    judged, asked = rows.judged if rows.open_loop else None, rows.asked
    of = "" if rows.header is None else f", sheet {rows.header.sheet.name}"
    if namespace.json != "-" and rows.rows:
        if judged is None:
            out.print(rows_table(f"{log_name(files)} as recorded{of}", rows.rows))
        else:
            out.print(judged_table(f"{log_name(files)} as {asked} decides it{of}", judged))
            out.print(judged_words(judged, asked))
    for number, session in enumerate(sessions, 1):
        if namespace.verify or session.verdict is not Verification.IDENTICAL:
            out.print(f"run {number} of {len(sessions)}: {session}")
        else:
            out.print(
                f"run {number} of {len(sessions)}: {session.steps} steps replayed"
                f"{session.intruders_text}"
            )
    for line in log.words():
        out.print(f"log: {line}")


def tell_buses(out: Any, buses: Counter[str], bus: str | None) -> None:
    """A log of several buses: which, and which of them was used."""
    if len(buses) > 1:
        each = ", ".join(f"{name} ({n} frames)" for name, n in sorted(buses.items()))
        used = "all are used as one (--bus picks one)" if bus is None else f"used is {bus}"
        out.print(f"buses in the log: {each}; {used}")
