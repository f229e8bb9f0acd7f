"""`meshpoint show calibration`: what a controller has learned of a gearbox, as people read it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from meshpoint.base.exits import Exit
from meshpoint.cli import arguments
from meshpoint.controller.run.kept import read_file
from meshpoint.controller.settings.learned import BrakeRecord, Calibration, WheelRecord
from meshpoint.controller.sleeve.stroke import PRIOR_SAMPLES
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.tables import to_table
from meshpoint.results.output import console, write_json
from meshpoint.results.tooth_parts import take_apart
from meshpoint.units import DEG


def add_parser(things: Any) -> None:
    """Its arguments."""
    show: argparse.ArgumentParser = things.add_parser(
        "calibration",
        help="what a controller has learned of a gearbox",
        description="Prints a calibration file, or says why a controller would refuse it.",
    )
    show.add_argument("file", type=Path, metavar="FILE", help="as --calibration wrote it")
    show.add_argument(
        "--gearbox",
        metavar="NAME|FILE",
        help="the data sheet it must be of (default: that is not checked)",
    )
    arguments.add_json(show)
    show.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints it. CalibrationError where a controller would refuse the file."""
    sheet = load_sheet(namespace.gearbox) if namespace.gearbox is not None else None
    calibration = read_file(namespace.file, sheet)
    if namespace.json is not None:
        write_json(namespace.json, _values(calibration))
    if namespace.json != "-":
        _show(console(namespace.json), calibration)
    return Exit.DONE


def _wheels(calibration: Calibration) -> dict[str, WheelRecord]:
    wheels = calibration.wheels
    both = {"layshaft": wheels.layshaft, "main": wheels.main}
    return {name: record for name, record in both.items() if record is not None}


def _values(calibration: Calibration) -> dict[str, Any]:
    """Everything in the file (SI), and the wheels' parts."""
    parts = {
        name: take_apart(record.error_rad)._asdict()
        for name, record in _wheels(calibration).items()
    }
    return to_table(calibration) | {"tooth_parts": parts}


def _show(out: Console, calibration: Calibration) -> None:
    given = calibration.provenance
    out.print(
        f"learned over {given.shifts} shifts with data sheet {given.sheet}, written by meshpoint "
        f"{given.meshpoint}: {given.written}\nsheet sha256 {given.sheet_sha256}\n",
    )
    out.print(_wheel_table(_wheels(calibration)))
    out.print()
    out.print(_gear_table(calibration))
    out.print()
    brake = calibration.brake
    out.print("brake: nothing learned" if brake is None else _brake(brake))


def _wheel_table(wheels: dict[str, WheelRecord]) -> Table:
    table = Table(
        title="sensor wheels", title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    for column in (
        "wheel", "teeth", "edges\nseen", "known to\ndeg", "teeth\nwider deg", "eccentricity\ndeg",
        "at\ntooth", "pitch error\nRMS deg", "worst\ndeg",
    ):  # fmt: skip
        table.add_column(column, justify="left" if column == "wheel" else "right", no_wrap=True)
    for name, record in wheels.items():
        parts = take_apart(record.error_rad)
        table.add_row(
            name,
            str(record.teeth),
            str(record.edges),
            f"{record.sd_rad / DEG:.4f}",
            f"{parts.wider_rad / DEG:+.3f}",
            f"{parts.eccentricity_rad / DEG:.3f}",
            str(parts.eccentric_tooth),
            f"{parts.pitch_rms_rad / DEG:.3f}",
            f"{parts.pitch_worst_rad / DEG:.3f}",
        )
    return table


def _gear_table(calibration: Calibration) -> Table:
    table = Table(title="gears", title_justify="left", box=None, pad_edge=False)
    for column in ("gear", "phase reference deg", "delay ms", "scatter ms", "contacts"):
        table.add_column(column, justify="left" if column == "gear" else "right")
    references = calibration.references.offsets_rad
    for gear in MAIN_GEARS:
        sleeve = calibration.sleeves.of(gear)
        table.add_row(
            gear.name.lower(),
            f"{references[gear] / DEG:+.3f}" if gear in references else "unknown",
            *(
                ("-", "-", "0")
                if sleeve is None
                else (
                    f"{1e3 * sleeve.delay_s:.2f}",
                    f"{1e3 * sleeve.scatter_s:.2f}",
                    f"{sleeve.samples - PRIOR_SAMPLES:.0f}",
                )
            ),
        )
    return table


def _brake(brake: BrakeRecord) -> str:
    emptying = ", ".join(f"{factor:.3f}" for factor in brake.emptying)
    filling = ", ".join(f"{factor:.3f}" for factor in brake.filling)
    return (
        f"brake, over {brake.shifts} shifts: gain {brake.gain:.3f} +- {brake.gain_sd:.3f}, "
        f"drag {brake.drag_nm:+.2f} +- {brake.drag_sd_nm:.2f} Nm, "
        f"pads touch at {brake.touch_pa / 1e5:.3f} +- {brake.touch_sd_pa / 1e5:.3f} bar, "
        f"pressure sensor late by {1e3 * brake.sensor_lag_s:.2f} "
        f"+- {1e3 * brake.sensor_lag_sd_s:.2f} ms\n"
        f"pressure rates over those of the data sheet: emptying {emptying}; filling {filling}\n"
        f"valve: off after {1e3 * brake.off_delay_s:.2f} +- {1e3 * brake.off_delay_sd_s:.2f} ms, "
        f"on after {1e3 * brake.on_delay_s:.2f} +- {1e3 * brake.on_delay_sd_s:.2f} ms"
    )
