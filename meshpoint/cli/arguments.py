"""Arguments that several commands share, and how they become settings."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from meshpoint.base.errors import CommandError
from meshpoint.bench.schedules import SCHEDULES, UPSHIFTS, Pairs, check_preset, pairs
from meshpoint.bus.command_keys import CommandKeys, load_keys
from meshpoint.bus.given_numbers import speed, whole
from meshpoint.bus.logs.files import MIN_PART_BYTES
from meshpoint.bus.logs.reader import MAX_LOG_BYTES
from meshpoint.bus.options import is_local_bus
from meshpoint.bus.profile import WireProfile
from meshpoint.controller.settings.header import XcpAccess
from meshpoint.controller.settings.settings import (
    ESTIMATOR_NAMES,
    STRATEGY_NAMES,
    ControllerSettings,
    load_settings,
    load_settings_file,
)
from meshpoint.controller.settings.strategy_file import FORM, StrategyFile, is_file_name
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.results.output import folder_for
from meshpoint.rig_sim.orders import ScheduledFault
from meshpoint.rig_sim.settings import DEFAULT_PRESET, DEFAULT_PROFILE, Preset, Profile

if TYPE_CHECKING:
    from meshpoint.controller.run.kept import CalibrationWriter
    from meshpoint.controller.settings.learned import Calibration
    from meshpoint.rig_sim.truck.as_built import AsBuiltChoice

# Loading controller or rig takes longer than all else that a command does before it starts: the
# functions that need them do it, so that a mistyped word or the other node need not wait for it.

Arguments = argparse.ArgumentParser | argparse._ArgumentGroup
"""What arguments are added to: a command, or a group in its help."""
MAX_SHIFTS = 100_000
_SIZE = re.compile(
    r"(?P<number>\d{1,12}(\.\d{1,6})?) ?(?P<unit>[kmg]?i?b?)", re.IGNORECASE | re.ASCII
)
_UNITS = {
    prefix + infix + suffix: float(base**power)
    for power, prefix in enumerate(("", "k", "m", "g"))
    for infix, base in (("", 1000), ("i", 1024))
    for suffix in ("", "b")
}


def size_bytes(text: str) -> int:
    """An argparse type: a size in bytes, as 500kB, 10MB, 1GiB."""
    match = _SIZE.fullmatch(text.strip())
    size = 0.0
    if match is not None:
        size = float(match["number"]) * _UNITS[match["unit"].lower()]
    if not MIN_PART_BYTES <= size <= MAX_LOG_BYTES:
        raise argparse.ArgumentTypeError(
            f"{text!r}, allowed is a size from {MIN_PART_BYTES // 1024}KiB to "
            f"{MAX_LOG_BYTES // 1024**3}GiB, as 10MB"
        )
    return int(size)


def strategy_name(text: str) -> str:
    """An argparse type: the name of a strategy, or FILE.py:CLASS."""
    if text not in STRATEGY_NAMES and not is_file_name(text):
        allowed = ", ".join(STRATEGY_NAMES)
        raise argparse.ArgumentTypeError(f"{text!r}, allowed are {allowed}, or {FORM}")
    return text


def strategy_file(name: str) -> StrategyFile | None:
    """The user's file, where the name is one of FILE.py:CLASS; TableError or StrategyError where
    it cannot be used."""
    if not is_file_name(name):
        return None
    from meshpoint.controller.plan.own_strategy import read_strategy

    return read_strategy(name)


LOGS_HELP: Final = (
    ".log (candump), .blf, .asc, .trc, .csv or .mf4, each also .gz; several in order, or a folder "
    "of logs, are one bus"
)
"""What a command that reads logs takes."""


def add_logs(parser: Arguments) -> None:
    """LOG, one or more."""
    parser.add_argument("log", type=Path, nargs="+", metavar="LOG", help=LOGS_HELP)


def add_gearbox(parser: Arguments, has_preset: bool = False) -> None:
    """--gearbox; `has_preset`: beside --preset, whose own data sheet is the default."""
    others = (preset for preset in Preset if has_preset and preset is not DEFAULT_PRESET)
    default = DEFAULT_PRESET.sheet_name + "".join(
        f"; with --preset {preset}: {preset.sheet_name}" for preset in others
    )
    parser.add_argument(
        "--gearbox",
        metavar="NAME|FILE",
        help=f"data sheet: {', '.join(SHEET_NAMES)}, or a TOML file (default: {default})",
    )


def add_controller(parser: Arguments, strategy: bool = True) -> None:
    """--settings, --estimator and --strategy."""
    parser.add_argument("--settings", type=Path, metavar="FILE", help="controller settings, TOML")
    parser.add_argument(
        "--estimator",
        choices=tuple(ESTIMATOR_NAMES),
        help="layshaft estimator: window, the 10 ms window speed of today; thesis, its Kalman "
        "filter; crossing, a filter on the time of each edge (default)",
    )
    if strategy:
        parser.add_argument(
            "--strategy",
            type=strategy_name,
            metavar="NAME|FILE.py:CLASS",
            help="speed_window: fire when the slip is inside its window, as is done today; "
            "speed_window_anticipating: fire ahead, so that the slip is small at contact; "
            "target_phase: fire so that tooth meets gap (default); or a class of your own in a "
            "Python file (docs/strategy.md)",
        )


def add_arming(parser: Arguments) -> None:
    """--arm and --no-arm."""
    parser.add_argument(
        "--arm",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="whether the controller may command valves, clutch and engine; without it, it reads, "
        "estimates and logs, and refuses requests (default: `[outputs] armed` of --settings, else "
        "armed on the local bus of this machine alone)",
    )


def add_xcp(parser: Arguments) -> None:
    """--xcp."""
    parser.add_argument(
        "--xcp",
        nargs="?",
        choices=("read", "write"),
        const="read",
        help="answer an XCP master (CANape, INCA, pyxcp): `read`, it may measure and see settings; "
        "`write`, it may change settings between shifts as well, within their limits "
        "(`meshpoint a2l`, docs/calibration.md)",
    )


def xcp_of(namespace: argparse.Namespace) -> XcpAccess:
    """What --xcp allows. CommandError on the classic profile."""
    if namespace.xcp is None:
        return XcpAccess.OFF
    if wire_of(namespace) is WireProfile.CLASSIC:
        raise CommandError(
            "--xcp: allowed with --profile fd alone, where it answers masters of 8 bytes as well"
        )
    return XcpAccess[namespace.xcp.upper()]


def add_calibration(parser: Arguments) -> None:
    """--calibration."""
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="what the controller has learned of this gearbox, TOML: read where it exists, written "
        "after every shift (`meshpoint show calibration FILE`). A file that does not hold together "
        "is put aside as FILE.refused and the controller starts cold",
    )


def add_keys(parser: Arguments) -> None:
    """--keys."""
    parser.add_argument(
        "--keys",
        type=Path,
        metavar="FILE",
        help="valve, clutch and engine commands are proven to be the controller's by keys in this "
        "file, TOML; both nodes need it (docs/wire.md; default: commands are not proven)",
    )


def keys_of(namespace: argparse.Namespace) -> CommandKeys | None:
    """The keys asked for."""
    return None if namespace.keys is None else load_keys(namespace.keys)


def add_rig(parser: Arguments) -> None:
    """--preset, --seed, --as-built and --faults."""
    add_preset(parser)
    add_seed(parser)
    add_as_built(parser)
    parser.add_argument(
        "--faults",
        type=Path,
        metavar="FILE",
        help="preset truck: a scenario of faults, TOML (`meshpoint rig --describe` lists them)",
    )


def add_truck(parser: Arguments) -> None:
    """--truck."""
    parser.add_argument(
        "--truck",
        dest="truck_nodes",
        action="store_true",
        help="the rig plays the truck's other nodes too: EBC1, EBC2, HRW and VDC2 of a brake "
        "controller, TCO1 of a tachograph, CCVS1 of the engine (docs/wire.md)",
    )


def add_preset(parser: Arguments) -> None:
    """--preset."""
    parser.add_argument(
        "--preset",
        choices=tuple(preset.value for preset in Preset),
        default=DEFAULT_PRESET.value,
        help="physics of the rig: truck, a gearbox with friction, backlash and impacts, drawn from "
        "the seed; thesis, the thesis's equations 4.1-4.17 to the letter (default: %(default)s)",
    )


def add_as_built(parser: Arguments) -> None:
    """--as-built."""
    parser.add_argument(
        "--as-built",
        type=Path,
        default=Path(DEFAULT_PROFILE),
        metavar="PROFILE|FILE",
        help=f"preset truck: {', '.join(Profile)}, the ranges that its parts are drawn from, or a "
        "file of values that are fixed, TOML or a run's JSON, which may name the profile of the "
        "rest (default: %(default)s)",
    )


def add_wire(parser: Arguments) -> None:
    """--profile."""
    parser.add_argument(
        "--profile",
        dest="wire",
        choices=tuple(profile.value for profile in WireProfile),
        default=WireProfile.FD.value,
        help="the frames on the bus: fd, CAN FD with all edges; or classic, 500 kbit/s and frames "
        "of 8 bytes, with the rising edges of layshaft and main shaft (docs/wire.md; default: "
        "%(default)s)",
    )


def wire_of(namespace: argparse.Namespace) -> WireProfile:
    """The profile of --profile. CommandError where what else is asked for has no room in it."""
    wire = WireProfile(namespace.wire)
    if wire is WireProfile.CLASSIC and getattr(namespace, "keys", None) is not None:
        raise CommandError("--keys: proofs of commands have 32 bytes, --profile classic carries 8")
    return wire


def unpack_of(namespace: argparse.Namespace) -> Callable[[Frame], Iterable[Frame]]:
    """What makes frames of meshpoint.dbc of those on the bus, for states and outcomes."""
    if wire_of(namespace) is WireProfile.FD:
        return lambda frame: (frame,)
    from meshpoint.bus.classic.cores import bench_unpacker

    return bench_unpacker().take


def unpack_all_of(
    namespace: argparse.Namespace, sheet: GearboxSheet
) -> Callable[[Frame], Iterable[Frame]]:
    """The same for everything that is on the bus; falling edges are put by the sheet's wheels."""
    if wire_of(namespace) is WireProfile.FD:
        return lambda frame: (frame,)
    from meshpoint.bus.classic.cores import listener_unpacker

    return listener_unpacker(sheet).take


def unpacking_of(
    namespace: argparse.Namespace, sheet: GearboxSheet
) -> Callable[[], Callable[[Frame], Iterable[Frame]]] | None:
    """Makes one of `unpack_all_of` for each reading of a log; None where its frames are those of
    meshpoint.dbc."""
    if wire_of(namespace) is WireProfile.FD:
        return None
    return lambda: unpack_all_of(namespace, sheet)


def add_seed(parser: Arguments) -> None:
    """--seed."""
    parser.add_argument(
        "--seed",
        type=whole(0, 2**63 - 1),
        default=1,
        metavar="N",
        help="draws start angles and delays, in the preset truck also every part (default: 1)",
    )


def add_speed(parser: Arguments) -> None:
    """--speed."""
    parser.add_argument(
        "--speed",
        type=speed,
        default=1.0,
        metavar="X",
        help="run X times as fast as the wall clock; give both nodes the same (default: 1)",
    )


def add_json(parser: Arguments) -> None:
    """--json."""
    parser.add_argument(
        "--json", metavar="FILE|-", help="write the results as JSON to a file, or - for stdout"
    )


def add_log(parser: Arguments) -> None:
    """--log and --log-size."""
    parser.add_argument(
        "--log",
        metavar="FILE|DIR/",
        help="record the bus: .log (candump), .blf or .asc by ending; in a folder the log is named "
        "as by candump -l. What a killed run leaves can be read up to its last second",
    )
    parser.add_argument(
        "--log-size",
        type=size_bytes,
        metavar="SIZE",
        help="no log file larger than this, as 10MB; goes on in FILE_001, FILE_002 ...",
    )


def add_report(parser: Arguments) -> None:
    """--report."""
    parser.add_argument(
        "--report", type=Path, metavar="FILE", help="write a page with every shift's traces (HTML)"
    )


def add_shifts(parser: Arguments, default: int, least: int) -> None:
    """--shifts and --pairs."""
    parser.add_argument(
        "--shifts",
        type=whole(least, MAX_SHIFTS),
        default=default,
        metavar="N",
        help=f"number of shifts (default: {default})",
    )
    parser.add_argument(
        "--pairs",
        type=pairs,
        default=UPSHIFTS,
        metavar="LIST",
        help=f"shifts to cycle through: {', '.join(SCHEDULES)}, or a list (default: 8-10,10-12); "
        "all but upshifts of the main box need --preset truck",
    )


def sheet_of(namespace: argparse.Namespace) -> GearboxSheet:
    """The data sheet asked for."""
    return load_sheet(gearbox_of(namespace))


def gearbox_of(namespace: argparse.Namespace) -> str:
    """The data sheet asked for, else that of the preset: its name or file."""
    asked: str | None = namespace.gearbox
    return asked or Preset(getattr(namespace, "preset", DEFAULT_PRESET)).sheet_name


def pairs_of(namespace: argparse.Namespace, sheet: GearboxSheet, preset: Preset) -> Pairs:
    """The shifts asked for. TableError where the preset cannot make one."""
    chosen: Pairs = namespace.pairs
    check_preset(chosen, sheet, preset)
    return chosen


def settings_of(namespace: argparse.Namespace, strategy: str | None = None) -> ControllerSettings:
    """The controller settings asked for; `strategy` wins over the namespace's."""
    name = strategy or getattr(namespace, "strategy", None)
    return load_settings(
        namespace.settings,
        strategy_name=name,
        strategy_file=None if name is None else strategy_file(name),
        estimator_name=namespace.estimator,
    )


def armed_of(namespace: argparse.Namespace) -> bool:
    """Whether the controller's outputs are armed: by --arm, else by the settings, else on the local
    bus alone."""
    asked: bool | None = namespace.arm
    if asked is None:
        asked = load_settings_file(namespace.settings).outputs.armed
    return is_local_bus(namespace) if asked is None else asked


def calibration_of(
    namespace: argparse.Namespace, sheet: GearboxSheet, threaded: bool, tell: Callable[[str], None]
) -> tuple[Calibration | None, CalibrationWriter | None]:
    """The calibration to start with and who writes it; CommandError where nothing can be written
    there. What became of the file is reported in a line."""
    path: Path | None = namespace.calibration
    if path is None:
        return None, None
    if path.is_dir():
        raise CommandError(f"{path}: is a folder, allowed is a file")
    folder_for(path.parent)
    from meshpoint.controller.run.kept import CalibrationWriter, load

    loaded = load(path, sheet)
    tell(loaded.line)
    writer = CalibrationWriter(path, sheet, threaded) if loaded.writable else None
    return loaded.calibration, writer


def as_built_of(namespace: argparse.Namespace) -> AsBuiltChoice:
    """The profile, and the as-built values that are fixed."""
    from meshpoint.rig_sim.truck.as_built import read_as_built

    return read_as_built(namespace.as_built)


def faults_of(namespace: argparse.Namespace) -> tuple[ScheduledFault, ...]:
    """The scenario of faults."""
    if namespace.faults is None:
        return ()
    from meshpoint.rig_sim.truck.scenario import load_scenario

    return load_scenario(namespace.faults)
