"""`meshpoint demo`: both nodes live, both strategies, one table, one picture, and the log checked
by bit-exact replay."""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can

from meshpoint.base.exits import Exit
from meshpoint.base.provenance import provenance
from meshpoint.base.version import product_version
from meshpoint.bench.bench import PlannedShift, plan_shifts
from meshpoint.bench.compiling import prepare
from meshpoint.bench.live import LiveResult, LiveRun, run_live, uses_virtual
from meshpoint.bench.simulate import LAYSHAFT_RAD_S
from meshpoint.bus.fine_timers import run as run_loop
from meshpoint.bus.local.register import register_interface
from meshpoint.bus.logs.reader import LogError, read_log
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.bus.profile import WireProfile
from meshpoint.cli import arguments
from meshpoint.controller.settings.header import new_header
from meshpoint.gearbox import GearboxSheet
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Session, Verification
from meshpoint.report.beliefs import Beliefs
from meshpoint.report.comparison import compare, comparison_table, explain, verdict
from meshpoint.report.plot import plot_shift
from meshpoint.results.output import (
    complain,
    console,
    folder_for,
    rows_table,
    write_json,
)
from meshpoint.results.progress import Shown
from meshpoint.results.rows import summarise
from meshpoint.rig_sim.settings import Preset, RigSettings
from meshpoint.run.demo_report import demo_run, write_demo_report

AIMING_STRATEGY = "target_phase"
DEMO_STRATEGIES = ("speed_window", AIMING_STRATEGY)
SINCE = "MESHPOINT_SINCE"
"""`make demo` says here when its set-up began, in seconds since 1970."""
BUS_ARGUMENTS = (
    ("interface", "-i"), ("channel", "-c"), ("bitrate", "-b"), ("data_bitrate", "--data-bitrate"),
    ("config", "--config"),
)  # fmt: skip


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "demo",
        description="Starts controller and rig as two processes on a bus of their own (or on the "
        "one given), asks for upshifts with the speed window of today and with phase control, "
        "prints one row a shift, and checks its own log by bit-exact replay. -i virtual runs all "
        "in one process.",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="default: out/demo"
    )
    arguments.add_shifts(parser, default=10, least=1)
    arguments.add_rig(parser)
    arguments.add_gearbox(parser, has_preset=True)
    arguments.add_controller(parser, strategy=False)
    arguments.add_keys(parser)
    arguments.add_wire(parser)
    arguments.add_speed(parser)
    parser.add_argument(
        "--wall-clock",
        action="store_true",
        help="run by the wall clock, also where this machine cannot keep up; by default bus time "
        "waits for the nodes",
    )
    arguments.add_json(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Runs both strategies one after the other, on the same seed."""
    out = console(namespace.json)
    sheet = arguments.sheet_of(namespace)
    rig = _rig(namespace, sheet)
    if arguments.wire_of(namespace) is WireProfile.CLASSIC:
        from meshpoint.bus.classic.traffic import load_words

        out.print(load_words(sheet))
    folder_for(namespace.out)
    begun_s = float(os.environ.get(SINCE, time.time()))
    prepare(thesis=rig.preset is Preset.THESIS)
    results: dict[str, LiveResult] = {}
    sessions: dict[str, Session] = {}
    lives: dict[str, LiveRun] = {}
    beliefs: dict[str, Beliefs] = {}
    with tempfile.TemporaryDirectory(prefix="meshpoint-") as private:
        for strategy in reversed(DEMO_STRATEGIES):  # the one that has the picture first
            live = lives[strategy] = _live_run(namespace, rig, strategy, Path(private))
            result = results[strategy] = _with_progress(namespace, strategy, live)
            out.print(rows_table(f"{strategy}, {live.gearbox_words}", result.monitor.rows.rows))
            if strategy == AIMING_STRATEGY:
                out.print(_picture(namespace.out, live, begun_s))
            out.print()
            beliefs[strategy] = Beliefs()
            sessions[strategy] = _verify(live.log, beliefs[strategy])
    lives, results, sessions = _ordered(lives), _ordered(results), _ordered(sessions)
    rows = {name: result.monitor.rows.rows for name, result in results.items()}
    groups, better = compare(rows), verdict(rows)
    out.print(comparison_table(groups, live.gearbox_words))
    for line in (*explain(groups, sheet), better):
        out.print(line)
    report = namespace.out / "report.html"
    write_demo_report(report, lives, results, sessions, beliefs)
    values = {
        "shifts": [
            row.to_json() for result in results.values() for row in result.monitor.rows.rows
        ],
        "strategies": {
            name: {
                "shifts": [row.to_json() for row in result.monitor.rows.rows],
                "summary": summarise(name, result.monitor.rows.rows).to_json(),
                "estimation": result.monitor.scores(),
                "frames": result.frames,
                "verification": {
                    "verdict": sessions[name].verdict.value,
                    "steps": sessions[name].steps,
                    "reason": sessions[name].reason,
                },
                "bus_time_over_wall_time": round(result.pace, 3),
                "problems": result.problems,
            }
            for name, result in results.items()
        },
        "comparison": [group.to_json() for group in groups],
        "verdict": better,
        "gap_over_pitch": sheet.dog.backlash_share,
        "provenance": provenance(sheet, namespace.seed, namespace.preset, rig.profile),
    }
    write_json(str(namespace.out / "run.json"), values)
    if namespace.json is not None:
        write_json(namespace.json, values)
    pace = min(result.pace for result in results.values())
    if pace < 0.95 * namespace.speed:
        out.print(f"bus time ran at {pace:.2f} x wall time, where this machine could not keep up")
    for name, session in sessions.items():
        out.print(f"log {_log_path(namespace.out, name)}: replay is {session}")
    out.print(f"report {report}")
    return _exit_code(results, sessions)


def _log_path(folder: Path, strategy: str) -> Path:
    return folder / f"{strategy}.log"


def _plan(namespace: argparse.Namespace, sheet: GearboxSheet) -> list[PlannedShift]:
    pairs = arguments.pairs_of(namespace, sheet, Preset(namespace.preset))
    return plan_shifts(sheet, list(pairs), namespace.shifts, LAYSHAFT_RAD_S)


def _rig(namespace: argparse.Namespace, sheet: GearboxSheet) -> RigSettings:
    first, built = _plan(namespace, sheet)[0], arguments.as_built_of(namespace)
    return RigSettings(
        preset=Preset(namespace.preset),
        seed=namespace.seed,
        start_gear=first.from_,
        main_speed_rpm=first.main_rpm,
        profile=built.profile,
        as_built=built.fixed,
        faults=arguments.faults_of(namespace),
    )


def _live_run(
    namespace: argparse.Namespace, rig: RigSettings, strategy: str, private: Path
) -> LiveRun:
    sheet = arguments.sheet_of(namespace)
    wire, settings = arguments.wire_of(namespace), arguments.settings_of(namespace, strategy)
    header = new_header(product_version(), sheet, settings)
    header.save(namespace.out)
    in_process = uses_virtual(namespace)
    bus = _bus_arguments(namespace, strategy, private)
    # The demo brings its own rig, so its controller is armed on any bus.
    controller = ["--arm", "--strategy", strategy, *_given(namespace, "settings", "estimator")]
    return LiveRun(
        header=header,
        rig=rig,
        plan=_plan(namespace, sheet),
        log=_log_path(namespace.out, strategy),
        open_bus=_opener(bus),
        speed=namespace.speed,
        in_process=in_process,
        paced=not namespace.wall_clock,
        node_arguments=[
            *bus,
            "--gearbox",
            arguments.gearbox_of(namespace),
            *_given(namespace, "keys"),
        ],
        keys=arguments.keys_of(namespace),
        wire=wire,
        controller_arguments=controller,
        rig_arguments=_given(namespace, "as_built", "faults"),
    )


def _given(namespace: argparse.Namespace, *names: str) -> list[str]:
    """These arguments as they were given, for a node's own command line."""
    chosen = []
    for name in names:
        value = getattr(namespace, name)
        if value is not None:
            chosen += [f"--{name.replace('_', '-')}", str(value)]
    return chosen


def _bus_arguments(namespace: argparse.Namespace, strategy: str, private: Path) -> list[str]:
    """The bus as given, or a fresh one of this run that nobody else can see."""
    given = []
    for name, option in BUS_ARGUMENTS:
        if name in namespace:
            given += [option, str(getattr(namespace, name))]
    if given:
        return given
    if os.name == "posix":
        return ["-i", "meshpoint", "-c", f"unix:{private / strategy}.sock"]
    port = 20_000 + os.getpid() % 20_000 + DEMO_STRATEGIES.index(strategy)
    return ["-i", "meshpoint", "-c", f"tcp:127.0.0.1:{port}"]


def _opener(bus: list[str]) -> Callable[[], can.BusABC]:
    register_interface()
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    chosen = parser.parse_args(bus)
    return lambda: open_bus_from(chosen)


def _with_progress(namespace: argparse.Namespace, strategy: str, live: LiveRun) -> LiveResult:
    with Shown(strategy, "shifts", namespace.shifts) as shown:
        live.on_row = shown.advance
        live.on_event = lambda line: _complain(line)
        return run_loop(run_live(live))


def _complain(line: str) -> None:
    """Only what goes wrong is worth a line here; the shifts have their table."""
    if "bus" in line or "refused" in line or "stuck" in line:
        complain(line)


def _verify(log: Path, beliefs: Beliefs) -> Session:
    replay = LogReplay(log.parent, verify=True, on_step=beliefs.look)
    try:
        return replay.run(frame for _, frame in read_log(log))[0]
    except LogError as error:
        return Session(verdict=Verification.NOT_VERIFIABLE, reason=str(error))


def _ordered(by_strategy: dict[str, Any]) -> dict[str, Any]:
    return {name: by_strategy[name] for name in DEMO_STRATEGIES}


def _picture(folder: Path, live: LiveRun, begun_s: float) -> str:
    """Draws the first aimed shift; says where, and how long that took from the beginning."""
    shifts = demo_run(live).shifts
    aimed = [shift for shift in shifts if shift.row.reference == "known" and shift.row.contact]
    if not shifts:
        return "no shift to draw"
    path = folder / "shift.png"
    plot_shift(path, (aimed or shifts)[0], live.header.sheet, live.gearbox_words)
    setup = ", set-up included" if SINCE in os.environ else ""
    return f"picture {path}: {time.time() - begun_s:.0f} s after the start{setup}"


def _exit_code(results: dict[str, LiveResult], sessions: dict[str, Session]) -> int:
    if any(result.bench.gave_up for result in results.values()):
        return Exit.FAILED
    if any(session.verdict is Verification.DIFFERS for session in sessions.values()):
        return Exit.FAILED
    if any(session.verdict is not Verification.IDENTICAL for session in sessions.values()):
        return Exit.NOT_VERIFIABLE
    return Exit.DONE
