"""`meshpoint identify`: the gearbox that a log is of, figure by figure, as a data sheet."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.base.exits import Exit
from meshpoint.bus.logs.files import log_files, read_logs
from meshpoint.bus.logs.reader import LogError
from meshpoint.cli import arguments
from meshpoint.cli.interrupt import interruptible
from meshpoint.controller.settings.header import header_name
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.identify.held_out import HeldOut
from meshpoint.identify.identified import Figure, Identified
from meshpoint.identify.identify import identify
from meshpoint.identify.log_reader import LogReader
from meshpoint.identify.overlay import overlay
from meshpoint.logs.log_header import named_header
from meshpoint.logs.log_progress import (
    complain_of_interrupt,
    log_name,
    logged_frames,
)
from meshpoint.logs.logged_frames import LoggedFrames
from meshpoint.replays.sensor_replay import LogTime
from meshpoint.results.output import check_writable, complain, console, write_json
from meshpoint.results.progress import Shown
from meshpoint.rig_sim.settings import DEFAULT_PRESET
from meshpoint.units import DEG, RPM

COLUMNS: Final = ("figure", "unit", "identified", "95 % interval", "data sheet", "from")
CHECK_COLUMNS: Final = ("predicted, kept out of the fit", "unit", "identified", "data sheet", "of")


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "identify",
        description="Works out from a log what its gearbox is like: brake, valve, "
        "drag, inertia ratio, sleeve delays, kiss point, teeth, each with a 95 % interval; and "
        "says what the log does not show, and why. Sensor frames and valve commands are used, "
        "whoever sent them; exit code 4 where no equations of motion fit them (docs/replay.md).",
    )
    arguments.add_logs(parser)
    parser.add_argument(
        "--gearbox",
        metavar="NAME|FILE",
        help="the data sheet: tooth counts, and where the search begins (default: that of the run "
        f"header beside the log, else {DEFAULT_PRESET.sheet_name})",
    )
    parser.add_argument(
        "--bus", metavar="NAME", help="of a log of several buses: can0, or its number"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="TOML",
        help="write what was identified as a data sheet, for --gearbox",
    )
    arguments.add_json(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Reads, fits, shows. A log that is torn gives what is before that, and bad input."""
    check_writable(namespace.json)
    if namespace.output is not None:
        check_writable(str(namespace.output))
    files = _each_once(log_files(namespace.log))
    _check_there(files)
    sheet, gearbox, said = _sheet(namespace, files)
    if said is not None:
        complain(said)
    with interruptible() as stop:
        reader, log = _read(files, namespace.bus, sheet, stop)
    if log.interrupted:
        complain_of_interrupt(log.frames)
    out = console(namespace.json)
    with Shown("identifying", "fits", None) as shown:
        found = identify(reader.finish(), sheet, lambda step: shown.begin(f"fitting: {step}"))
    if namespace.output is not None:
        based_on = _base(gearbox, namespace.output)
        text = overlay(found, sheet, based_on, log_name(files))
        try:
            namespace.output.write_text(text, encoding="utf-8")
        except OSError as error:
            raise unwritten(namespace.output, error) from error
    if namespace.json is not None:
        write_json(namespace.json, _values(found, files, gearbox, log))
    if namespace.json != "-":
        _show(out, found, log)
    if log.defect is not None:
        complain(f"the log cannot be read on: {log.defect}")
        return Exit.BAD_INPUT
    if log.interrupted:
        return Exit.INTERRUPTED
    return Exit.NOT_DECIDED if found.refused else Exit.DONE


def _check_there(files: list[Path]) -> None:
    """LogError for a file that is not there, before anything is said of the others."""
    for path in files:
        try:
            path.stat()
        except OSError as error:
            raise LogError(path, "", error.strerror or str(error)) from error


def _each_once(files: list[Path]) -> list[Path]:
    """These files. CommandError where one is named twice, by whatever name: its samples would count
    twice, and intervals come out too narrow."""
    seen: dict[Path, Path] = {}
    for path in files:
        before = seen.setdefault(path.resolve(), path)
        if before is not path:
            raise CommandError(
                f"{path}: is the same log as {before}; each log counts once, so name it once"
            )
    return files


def _sheet(
    namespace: argparse.Namespace, files: list[Path]
) -> tuple[GearboxSheet, str, str | None]:
    """The data sheet to begin with, its name, and what is to be said about where it is from."""
    if namespace.gearbox is not None:
        return load_sheet(namespace.gearbox), namespace.gearbox, None
    with contextlib.suppress(LogError):  # what is wrong with the log is said when it is read
        header = named_header(read_logs(files, namespace.bus), files[0].parent)
        if header is not None:
            sheet = header.sheet
            known = next((name for name in SHEET_NAMES if load_sheet(name) == sheet), None)
            if known is None and namespace.output is not None:
                raise CommandError(
                    f"{namespace.output}: to be based on a file, it needs --gearbox: the log's "
                    f"data sheet ({sheet.name}, by its run header) is no sheet of the product"
                )
            name = known or f"{sheet.name} ({header_name(header.run_hash)})"
            return sheet, name, f"data sheet: {name}, by the log's run header"
    name = DEFAULT_PRESET.sheet_name
    return load_sheet(name), name, f"data sheet: {name}; no run header says another (--gearbox)"


def _read(
    files: list[Path], bus: str | None, sheet: GearboxSheet, stop: Any
) -> tuple[LogReader, LoggedFrames]:
    reader, time = LogReader(sheet), LogTime()
    with logged_frames(files, bus, stop, "reading", in_sensor_time=True) as log:
        for time_s, frame in log:
            reader.take(time.take(time_s), frame)
    if not reader.content.messages:
        raise CommandError(f"{files[0]}: {log.frames} frames, none of them of our sensors")
    return reader, log


def _base(gearbox: str, output: Path) -> str:
    """How the new file names the sheet that it is based on."""
    if gearbox in SHEET_NAMES:
        return gearbox
    path = Path(gearbox).resolve()
    if path.parent == output.resolve().parent:
        if path == output.resolve():
            raise CommandError(f"{output}: is the data sheet itself")
        return path.name
    return str(path)


def _values(
    found: Identified, files: list[Path], gearbox: str, log: LoggedFrames
) -> dict[str, Any]:
    return {
        "logs": [str(path) for path in files],
        "gearbox": gearbox,
        "frames": log.frames,
        "account": log.account.to_json(),
        "log_clock": log.clock.to_json(),
        "defect": None if log.defect is None else str(log.defect),
        "interrupted": log.interrupted,
        "layshaft_rpm": found.omega_ref_rad_s / RPM,
        "supply_bar": found.supply_pa / 1e5,
        "figures": [dataclasses.asdict(one) for one in found.figures],
        "refused": found.refused,
        "held_out": [one._asdict() for one in found.held_out],
        "notes": found.notes,
        "teeth": {
            name: {
                "error_deg": (fitted.error_rad / DEG).tolist(),
                "half_interval_deg": (fitted.half_rad / DEG).tolist(),
            }
            for name, fitted in found.teeth.items()
        },
    }


def _show(out: Console, found: Identified, log: LoggedFrames) -> None:
    for line in log.words():
        out.print(f"log: {line}")
    reported = [one for one in found.figures if one.value is not None]
    if reported:
        out.print(figures_table(reported))
    rpm = found.omega_ref_rad_s / RPM
    if rpm:
        out.print(
            f"torque and drag at {rpm:.0f} rpm of the layshaft, over the inertia of the sheet"
        )
    if found.supply_pa:
        out.print(f"sleeve delays at {found.supply_pa / 1e5:.2f} bar of supply (absolute)")
    for line in found.notes:
        out.print(line)
    if found.held_out:
        out.print(checks_table(found.held_out))
    for one in found.figures:
        if one.value is None:
            out.print(f"not reported: {one.name}: {one.why}")


def figures_table(figures: Sequence[Figure], title: str = "identified") -> Table:
    """What was identified, with intervals, beside the data sheet."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column in COLUMNS:
        is_name = column in COLUMNS[:2]
        # A name may take two lines, a number never: at 80 columns it would be cut.
        table.add_column(column, justify="left" if is_name else "right", no_wrap=not is_name)
    for one in figures:
        interval = f"{_number(one.low)} to {_number(one.high)}"
        sheet, samples = _number(one.sheet), str(one.samples)
        table.add_row(one.name, one.unit, _number(one.value), interval, sheet, samples)
    return table


def checks_table(checks: Sequence[HeldOut]) -> Table:
    """Errors of predictions, each by the samples that were kept out."""
    table = Table(title="RMS errors", title_justify="left", box=None, pad_edge=False)
    for column in CHECK_COLUMNS:
        is_name = column in CHECK_COLUMNS[:2]
        table.add_column(column, justify="left" if is_name else "right", no_wrap=not is_name)
    for one in checks:
        own, by_sheet = _number(one.identified), _number(one.by_sheet)
        table.add_row(one.name, one.unit, own, by_sheet, str(one.samples))
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
