"""`meshpoint simulate`: shifts in virtual time."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.console import Console

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bench.adapter import AdapterProfile
from meshpoint.bench.adapter_profiles import PROFILES, unfit
from meshpoint.bench.compiling import prepare_once
from meshpoint.bench.setup import Setup
from meshpoint.bench.simulate import Apart, Result, simulate
from meshpoint.bus import given_numbers
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.silkit.library import REGISTRY
from meshpoint.bus.simulated.core import QueueOrder
from meshpoint.cli import arguments
from meshpoint.cli.interrupt import interruptible
from meshpoint.controller.run.kept import CalibrationWriter, Keep
from meshpoint.controller.settings.learned import Calibration
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.logs.recording import start_log, written
from meshpoint.report.beliefs import Beliefs
from meshpoint.report.collect import ReportCollector
from meshpoint.report.comparison import compare, comparison_table, explain
from meshpoint.report.run import Report, ReportRun
from meshpoint.report.write import (
    aim_rad,
    check_report,
    estimator_notes,
    report_provenance,
    write_report,
)
from meshpoint.results.junit import write_junit, write_text
from meshpoint.results.limits import (
    MEANINGS,
    Limit,
    LimitResult,
    judge,
    markdown,
    parse_limit,
)
from meshpoint.results.monitor import Monitor, RowMonitor
from meshpoint.results.output import (
    complain,
    complain_of_strategy,
    console,
    rows_table,
    shown,
    write_json,
)
from meshpoint.results.progress import Shown
from meshpoint.results.rows import ShiftRow, summarise
from meshpoint.rig_sim.settings import Preset
from meshpoint.run.firmware_argument import add_firmware, firmware_of

LOG_CHANNEL = "virtual"
LEAST_LOAD = 0.1


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "simulate",
        description="Runs controller, rig and bench in one process on a virtual bus, as fast as "
        "it goes. The same seed gives the same bytes.",
    )
    arguments.add_rig(parser)
    arguments.add_truck(parser)
    arguments.add_gearbox(parser, has_preset=True)
    arguments.add_controller(parser)
    arguments.add_calibration(parser)
    arguments.add_shifts(parser, default=20, least=1)
    arguments.add_keys(parser)
    arguments.add_wire(parser)
    _add_bus(parser)
    parser.add_argument(
        "--silkit",
        nargs="?",
        const=REGISTRY,
        metavar="REGISTRY",
        help="controller and rig as two processes, coordinated participants of Vector SIL Kit: "
        f"same frames, to the byte; a registry has to listen there (default: {REGISTRY}); needs "
        "meshpoint[silkit] (docs/silkit.md)",
    )
    add_firmware(parser)
    arguments.add_log(parser)
    arguments.add_json(parser)
    arguments.add_report(parser)
    parser.add_argument(
        "--score-estimators",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="compare the three layshaft estimators with the encoder on this run's edges, which "
        "takes a quarter longer (default: where --json or --report shows it)",
    )
    _add_limits(parser)
    parser.set_defaults(run=run)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    """--fail-if, --junit and --markdown."""
    parser.add_argument(
        "--fail-if",
        type=_limit,
        action="append",
        default=[],
        metavar='"FIGURE < LIMIT"',
        help='exit code 1 where a figure of the run is so, as "first_contact_gap < 0.95", or '
        f'"... < 95%%"; may be repeated; figures: {", ".join(MEANINGS)} (docs/ci.md)',
    )
    parser.add_argument(
        "--junit", type=Path, metavar="FILE", help="the result as JUnit XML, for a CI server"
    )
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="figures and shifts as Markdown, for people"
    )


def _limit(text: str) -> Limit:
    try:
        return parse_limit(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _add_bus(parser: argparse.ArgumentParser) -> None:
    """--bus-load and --bus-queue."""
    parser.add_argument(
        "--bus-load",
        type=given_numbers.number(LEAST_LOAD, 1.0),
        metavar="X",
        help="share of the bus that is taken, 0.1 to 1: frames of exact length, arbitration, and "
        "other nodes' frames, drawn from the seed, up to this load (default: our own frames alone, "
        "of average length)",
    )
    parser.add_argument(
        "--bus-queue",
        choices=tuple(order.value for order in QueueOrder),
        default=QueueOrder.FIFO.value,
        help="with --bus-load: a node's waiting frames leave fifo, in the order given, as from a "
        "SocketCAN interface; or by priority, for which worst responses have the least bounds, but "
        "frames of two steps may be mixed, which --verify does not take (default: %(default)s)",
    )
    parser.add_argument(
        "--adapter",
        choices=tuple(PROFILES),
        help="what lies between controller and bus: delays, bundles, pauses, queues and clocks as "
        "they are reported of adapters (docs/bench.md); one through which our messages do not fit "
        "is refused with the reason (default: nothing)",
    )


def _adapter(namespace: argparse.Namespace, sheet: GearboxSheet) -> AdapterProfile | None:
    """The profile that is asked for; CommandError where our messages do not fit through it."""
    if namespace.adapter is None:
        return None
    profile = PROFILES[namespace.adapter]
    is_classic = arguments.wire_of(namespace) is WireProfile.CLASSIC
    why = unfit(profile, sheet if is_classic else None)
    if why is not None:
        raise CommandError(f"--adapter {profile.name} cannot work: {why}")
    return profile


def _apart(namespace: argparse.Namespace, setup: Setup) -> Apart | None:
    """What runs the rig in another process, where --silkit asks for it."""
    if namespace.silkit is None:
        return None
    if setup.bus_load is not None:
        raise CommandError("--silkit: other nodes' frames (--bus-load) are not on its bus")
    if setup.firmware is not None:
        raise CommandError("--silkit: the rig's process there has no --firmware")
    from meshpoint.bridges.silkit_rig_apart import RigApart

    return RigApart(setup, namespace.silkit)


def _is_scored(namespace: argparse.Namespace) -> bool:
    """Whether the estimators are compared: as asked, else where that is shown."""
    asked: bool | None = namespace.score_estimators
    is_shown = namespace.json is not None or namespace.report is not None
    return is_shown if asked is None else asked


def run(namespace: argparse.Namespace) -> int:
    """Runs it."""
    sheet, preset = arguments.sheet_of(namespace), Preset(namespace.preset)
    calibration, writer = arguments.calibration_of(namespace, sheet, threaded=False, tell=complain)
    unwritten: list[str] = []
    setup = _setup(namespace, sheet, preset, calibration)
    apart = _apart(namespace, setup)
    out = console(namespace.json)
    check_report(namespace.report)
    is_scored = _is_scored(namespace)
    # After all that may be wrong.
    prepare_once(thesis=preset is Preset.THESIS, baselines=is_scored)
    collector, beliefs = None, Beliefs()
    if namespace.report is not None:
        collector = ReportCollector(setup.sheet, aim_rad(setup.header), setup.settings, beliefs)
    with ExitStack() as stack:
        log = start_log(namespace, setup.header, channel=LOG_CHANNEL, by_frame_time=True)
        if log is not None:
            stack.enter_context(log)
        progress = stack.enter_context(Shown("simulating", "shifts", setup.shifts))

        def on_frame(time_us: int, frame: Frame) -> None:
            if log is not None:
                log.write(time_us / 1e6, frame)
            if collector is not None:
                collector.receive(frame)

        def on_row(_row: ShiftRow) -> None:
            progress.advance()

        stop = stack.enter_context(interruptible())
        result = simulate(
            setup,
            on_frame if namespace.log or namespace.report else None,
            on_row,
            monitor=(Monitor if is_scored else RowMonitor)(setup.sheet, setup.settings),
            keep=_keep(writer, unwritten),
            stop=stop,
            record=None if log is None else log.path.parent,
            apart=apart,
            on_step=None if collector is None else beliefs.look,
        )
    if collector is not None:
        write_report(namespace.report, _report(setup, result, collector))
    judged = judge(
        namespace.fail_if,
        summarise(setup.settings.strategy_name, result.rows),
        result.rows,
    )
    _write_results(namespace, setup, result, judged)
    if log is not None:
        out.print(f"log {written(log)}")
    if namespace.json != "-":
        _show(out, setup, result)
    unwritten += map(_complained, result.unwritten)
    complain_of_strategy(result.strategy_errors)
    for each in judged:
        (complain if each.failed else out.print)(each.words)
    if result.interrupted:
        complain(f"interrupted: {len(result.rows)} of {setup.shifts} shifts are in the results")
        return Exit.INTERRUPTED
    failed = result.stuck or unwritten or result.strategy_errors
    return Exit.FAILED if failed or any(each.failed for each in judged) else Exit.DONE


def _setup(
    namespace: argparse.Namespace,
    sheet: GearboxSheet,
    preset: Preset,
    calibration: Calibration | None,
) -> Setup:
    """The run asked for."""
    built, settings = arguments.as_built_of(namespace), arguments.settings_of(namespace)
    wire = arguments.wire_of(namespace)
    if wire is WireProfile.CLASSIC and namespace.bus_load is not None:
        raise CommandError("--bus-load: other nodes' frames are drawn for --profile fd alone")
    faults = arguments.faults_of(namespace)
    return Setup(
        sheet=sheet,
        settings=settings,
        wire=wire,
        preset=preset,
        seed=namespace.seed,
        shifts=namespace.shifts,
        pairs=arguments.pairs_of(namespace, sheet, preset),
        profile=built.profile,
        as_built=built.fixed,
        faults=faults,
        truck_nodes=namespace.truck_nodes,
        calibration=calibration,
        keys=arguments.keys_of(namespace),
        bus_load=namespace.bus_load,
        adapter=_adapter(namespace, sheet),
        bus_queue=QueueOrder(namespace.bus_queue),
        firmware=firmware_of(namespace),
    )


def _write_results(
    namespace: argparse.Namespace, setup: Setup, result: Result, judged: list[LimitResult]
) -> None:
    """--json, --junit and --markdown."""
    name = setup.settings.strategy_name
    if namespace.json is not None:
        limits = {"gates": [each.to_json() for each in judged]} if judged else {}
        write_json(namespace.json, result.to_json(name) | limits)
    summary = summarise(name, result.rows)
    if namespace.junit is not None:
        stuck = [f"shift {number + 1} had no outcome" for number in result.stuck]
        if result.interrupted:
            stuck.append(f"interrupted after {len(result.rows)} of {setup.shifts} shifts")
        cases = [("every shift came to an outcome", "; ".join(stuck))]
        cases += [(f"not {each.limit}", each.words if each.failed else "") for each in judged]
        said = f"{len(result.rows)} shifts, {name}, seed {setup.seed}, {setup.gearbox_words}"
        write_junit(namespace.junit, "simulate", cases, said)
    if namespace.markdown is not None:
        title = f"meshpoint simulate: {name}, seed {setup.seed}, {setup.gearbox_words}"
        write_text(namespace.markdown, markdown(title, summary, result.rows, judged))


def _show(out: Console, setup: Setup, result: Result) -> None:
    """Rows, summary and estimators as people read them."""
    name = setup.settings.strategy_name
    out.print(rows_table(f"{shown(name)}, seed {setup.seed}, {setup.gearbox_words}", result.rows))
    out.print()
    groups = compare({name: result.rows})
    out.print(comparison_table(groups, setup.gearbox_words))
    for line in explain(groups, setup.sheet):
        out.print(line)
    for line in estimator_notes(name, result.estimation):
        out.print(line)
    if not result.estimation:
        out.print("Estimators were not compared with the encoder: --score-estimators.")
    if setup.wire is WireProfile.CLASSIC:
        from meshpoint.bus.classic.traffic import load_words

        out.print(f"bus taken for {result.bus_load:.1%} of the time; {load_words(setup.sheet)}")


def _keep(writer: CalibrationWriter | None, unwritten: list[str]) -> Keep | None:
    """Writes, and says where that failed."""
    if writer is None:
        return None

    def keep(learned: Calibration) -> str | None:
        line = writer(learned)
        if line is not None:
            unwritten.append(_complained(line))
        return line

    return keep


def _complained(line: str) -> str:
    complain(line)
    return line


def _report(setup: Setup, result: Result, collector: ReportCollector) -> Report:
    name = setup.settings.strategy_name
    notes = estimator_notes(name, result.estimation)
    return Report(
        title=f"meshpoint simulate: {setup.shifts} shifts, {name}",
        subtitle="Simulated in virtual time by the rig's preset "
        f"{setup.preset.value}, {setup.gearbox_words}.",
        sheet=setup.sheet,
        runs=[ReportRun(name, collector.finish(), notes)],
        provenance=report_provenance(
            setup.sheet, seed=setup.seed, preset=setup.preset.value, profile=setup.profile,
            **{"run header": f"{setup.header.run_hash:016x}"},
        ),
    )  # fmt: skip
