"""`meshpoint controller` and `meshpoint rig`: the two nodes on a bus, until asked to stop."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can

from meshpoint.base.errors import CommandError, RunError
from meshpoint.base.exits import Exit
from meshpoint.base.provenance import gearbox_words
from meshpoint.base.version import product_version
from meshpoint.bus import given_numbers
from meshpoint.bus.core import Core
from meshpoint.bus.fine_timers import run as run_loop
from meshpoint.bus.options import (
    add_bus_arguments,
    bus_config,
    controller_address,
    listen_only_words,
    open_bus_from,
)
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.signals import stop_at_end_of_input, stop_on_signals
from meshpoint.bus.statistics import NodeStatistics
from meshpoint.cli import arguments
from meshpoint.cli.pace import add_pace, clock_of
from meshpoint.controller.settings.header import RunHeader, XcpAccess, new_header
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.logs.recording import log_folder, recording, save_header, start_log
from meshpoint.results.output import complain
from meshpoint.rig_sim.settings import MAX_MAIN_SPEED_RPM, Preset, RigSettings
from meshpoint.rig_sim.truck.stand import STAND
from meshpoint.run.firmware_argument import add_firmware, firmware_of
from meshpoint.run.free_bus import check_no_rig

if TYPE_CHECKING:
    from meshpoint.xcp.node import XcpCore


def add_parser(commands: Any) -> None:
    """Both commands' arguments."""
    controller: argparse.ArgumentParser = commands.add_parser(
        "controller",
        description="Reads tooth timestamps, estimates, predicts, and fires where its outputs are "
        "armed (--arm; docs/guard.md). SIGINT or SIGTERM ends it with all valves off: exit code 0, "
        "or 1 where something it was to keep or say could not be written.",
    )
    arguments.add_gearbox(controller)
    arguments.add_controller(controller)
    arguments.add_arming(controller)
    arguments.add_xcp(controller)
    arguments.add_calibration(controller)
    add_header_dir(controller)
    controller.add_argument(
        "--diagnosis",
        action="store_true",
        help="what a garage's tool expects of a node: claims its J1939 address, reports trouble "
        "codes (DM1), clears them (DM3, DM11), and answers UDS over ISO-TP (docs/diagnosis.md)",
    )
    controller.add_argument(
        "--shadow",
        action="store_true",
        help="computes, logs and says what it would have done beside what the production "
        "controller does, and sends nothing at all on the bus; listen-only where the adapter can "
        "(docs/bench.md)",
    )
    _add_common(controller)
    controller.set_defaults(run=run_controller_command)
    rig: argparse.ArgumentParser = commands.add_parser(
        "rig",
        description="Plays gearbox, sensors and engine. SIGINT or SIGTERM ends it with all "
        "valves off: exit code 0, or 1 where its log or its words could not be written.",
    )
    arguments.add_rig(rig)
    arguments.add_truck(rig)
    add_firmware(rig)
    arguments.add_gearbox(rig, has_preset=True)
    speed = add_rig_start(rig)
    speed.add_argument(
        "--stand",
        action="store_true",
        help="nothing turns: the engine rests until TSC1 asks for a speed, and the output is free, "
        "as on a stand; for `meshpoint commission` (docs/bench.md). What --as-built FILE fixes "
        "holds",
    )
    rig.add_argument(
        "--describe",
        action="store_true",
        help="print data sheet, as-built values of the seed and every fault, and end",
    )
    _add_common(rig)
    rig.set_defaults(run=run_rig_command)


def add_header_dir(parser: arguments.Arguments) -> None:
    """--header-dir."""
    parser.add_argument(
        "--header-dir",
        type=Path,
        metavar="DIR",
        help="save the run header here, and what the log cannot hold (the steps of a link outage; "
        "with --profile classic all steps); replay wants both beside the log",
    )


def add_rig_start(parser: arguments.Arguments) -> arguments.Arguments:
    """--gear and --main-speed; the group of which only one may be given."""
    parser.add_argument(
        "--gear",
        type=given_numbers.whole(1, len(DRIVE_GEARS)),
        default=8,
        metavar="N",
        help="the gear it stands in at the start (default: 8)",
    )
    speed = parser.add_mutually_exclusive_group()
    speed.add_argument(
        "--main-speed",
        type=given_numbers.number(0.0, MAX_MAIN_SPEED_RPM),
        default=RigSettings().main_speed_rpm,
        metavar="RPM",
        help="main shaft speed at the start (default: %(default)g)",
    )
    return speed


def _add_common(parser: argparse.ArgumentParser) -> None:
    arguments.add_keys(parser)
    arguments.add_wire(parser)
    add_pace(parser)
    arguments.add_log(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="no lines about what happens")
    # For whoever starts the node: it ends well also where that process is killed.
    parser.add_argument("--until-eof", action="store_true", help=argparse.SUPPRESS)
    add_bus_arguments(parser)


def run_controller_command(namespace: argparse.Namespace) -> int:
    """Runs the controller until a signal."""
    from meshpoint.controller.run.node import OtherControllerError, run_controller

    if namespace.shadow:
        return run_shadow(namespace)
    sheet, settings = arguments.sheet_of(namespace), arguments.settings_of(namespace)
    calibration, writer = arguments.calibration_of(namespace, sheet, threaded=True, tell=complain)
    armed, keys = arguments.armed_of(namespace), arguments.keys_of(namespace)
    wire = _wire_of(namespace, sheet)
    xcp = arguments.xcp_of(namespace)
    header = new_header(product_version(), sheet, settings, calibration, armed, xcp)
    if namespace.header_dir is not None:
        save_header(header, namespace.header_dir)

    async def run() -> NodeStatistics:
        stop = asyncio.Event()
        with _stop(namespace, stop):
            async with _recording(namespace, header):
                return await run_controller(
                    header,
                    _opener(namespace, f"sheet {sheet.name}, run header {header.run_hash:016x}"),
                    clock_of(namespace, namespace.command),
                    on_event=_printer(namespace),
                    stop=stop,
                    keep=writer,
                    around=_xcp_slave(xcp),
                    keys=keys,
                    diagnosis=namespace.diagnosis,
                    record=_record_folder(namespace, wire),
                    wire=wire,
                    address=controller_address(namespace),
                )

    try:
        lost = run_loop(run()).record_lines_lost
    except OtherControllerError as error:
        if writer is not None:
            writer.close()
        raise RunError(str(error)) from None
    if lost:
        complain(f"meshpoint controller: {lost} lines of its records could not be written")
    unwritten = writer.close() if writer is not None else None
    if unwritten is not None:
        complain(unwritten)
    return Exit.FAILED if lost or unwritten is not None else Exit.DONE


def _xcp_slave(access: XcpAccess) -> type[XcpCore] | None:
    """What makes a controller an XCP slave; None, and nothing of it is loaded, where a master may
    do nothing."""
    if access is XcpAccess.OFF:
        return None
    from meshpoint.xcp.node import XcpCore

    return XcpCore


def _record_folder(namespace: argparse.Namespace, wire: WireProfile) -> Path | None:
    """Where a replay will look for what the log cannot hold."""
    folder: Path | None = namespace.header_dir
    if folder is None and wire is WireProfile.CLASSIC and namespace.log is not None:
        folder = log_folder(namespace.log)
    return folder


def run_shadow(namespace: argparse.Namespace) -> int:
    """A controller that only watches, until a signal."""
    from meshpoint.bus.driver import run_node
    from meshpoint.controller.run.warm_up import warm_up
    from meshpoint.replays.shadow import ShadowCore

    for name in ("arm", "keys", "calibration", "diagnosis", "xcp"):
        if getattr(namespace, name):
            raise CommandError(f"--{name}: a shadow sends nothing and keeps nothing")
    sheet, settings = arguments.sheet_of(namespace), arguments.settings_of(namespace)
    # Armed, so that the copies which are asked decide as a controller would; nothing is sent.
    header = new_header(product_version(), sheet, settings, None, armed=True)
    if namespace.header_dir is not None:
        save_header(header, namespace.header_dir)
    show = _printer(namespace)
    core: Core = ShadowCore(header)
    if _wire_of(namespace, sheet) is WireProfile.CLASSIC:
        from meshpoint.bus.classic.cores import ClassicListenerCore

        core = ClassicListenerCore(core, sheet)
    config = bus_config(namespace)
    show(f"controller: {listen_only_words(config)}")

    async def run() -> None:
        stop = asyncio.Event()
        with _stop(namespace, stop):
            async with _recording(namespace, header):
                warm_up(baselines=False)
                await run_node(
                    core,
                    _opener(namespace, f"sheet {sheet.name}, shadow, sends nothing"),
                    clock_of(namespace, namespace.command),
                    on_event=show,
                    stop=stop,
                    name="controller",
                )

    run_loop(run())
    return Exit.DONE


def run_rig_command(namespace: argparse.Namespace) -> int:
    """Runs the rig until a signal."""
    from meshpoint.bench.boards import around_rig
    from meshpoint.rig_sim.node import run_rig

    built = arguments.as_built_of(namespace)
    settings = RigSettings(
        preset=Preset(namespace.preset),
        seed=namespace.seed,
        start_gear=namespace.gear,
        main_speed_rpm=0.0 if namespace.stand else namespace.main_speed,
        profile=built.profile,
        as_built=STAND | built.fixed if namespace.stand else built.fixed,
        faults=arguments.faults_of(namespace),
        truck_nodes=namespace.truck_nodes,
    )
    sheet, keys = arguments.sheet_of(namespace), arguments.keys_of(namespace)
    if namespace.describe:
        from meshpoint.run.describe import describe_rig

        describe_rig(sheet, settings)
        return Exit.DONE
    wire = _wire_of(namespace, sheet)
    firmware = firmware_of(namespace)
    around = None if firmware is None else around_rig(firmware, sheet, wire)
    words = gearbox_words(sheet, settings.preset, settings.profile, settings.as_built)
    if firmware is not None:
        words += f", firmware {firmware}"
    with open_bus_from(namespace) as bus:
        check_no_rig(bus)

    async def run() -> None:
        stop = asyncio.Event()
        with _stop(namespace, stop):
            async with _recording(namespace, None):
                await run_rig(
                    sheet,
                    settings,
                    _opener(namespace, f"preset {settings.preset}, seed {settings.seed}, {words}"),
                    clock_of(namespace, namespace.command),
                    on_event=_printer(namespace),
                    stop=stop,
                    keys=keys,
                    wire=wire,
                    around=around,
                )

    run_loop(run())
    return Exit.DONE


def _wire_of(namespace: argparse.Namespace, sheet: GearboxSheet) -> WireProfile:
    """--profile; of the classic one it says how much of the bus it takes."""
    wire = arguments.wire_of(namespace)
    if wire is WireProfile.CLASSIC:
        from meshpoint.bus.classic.traffic import load_words

        _printer(namespace)(f"{namespace.command}: {load_words(sheet)}")
    return wire


@contextmanager
def _stop(namespace: argparse.Namespace, stop: asyncio.Event) -> Iterator[None]:
    """Sets `stop` on a signal and, with --until-eof, when standard input ends."""
    if namespace.until_eof:
        stop_at_end_of_input(stop)
    with stop_on_signals(stop):
        yield


def _opener(namespace: argparse.Namespace, greeting: str) -> Callable[[], can.BusABC]:
    """Opens the bus; the first time it says what runs there, so that an error stands alone."""
    show = _printer(namespace)

    def open_bus() -> can.BusABC:
        nonlocal greeting
        bus = open_bus_from(namespace)
        if greeting:
            show(f"{namespace.command}: {greeting}, on {bus.channel_info}")
            greeting = ""
        return bus

    return open_bus


def _recording(
    namespace: argparse.Namespace, header: RunHeader | None
) -> AbstractAsyncContextManager[None]:
    """Records the bus beside the node, where --log asks for it."""
    log = start_log(namespace, header, channel="meshpoint")
    if log is not None:
        _printer(namespace)(f"{namespace.command}: log {log.path}")
    clock = clock_of(namespace, namespace.command)
    return recording(log, lambda: open_bus_from(namespace), _printer(namespace), clock)


def _printer(namespace: argparse.Namespace) -> Callable[[str], None]:
    def show(line: str) -> None:
        if not namespace.quiet:
            complain(line)

    return show
