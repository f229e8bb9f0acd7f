"""`meshpoint show gearbox`: a data sheet as people read it."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any

from rich.table import Table

from meshpoint.base.exits import Exit
from meshpoint.cli import arguments
from meshpoint.gearbox import GearboxSheet, Sleeve, load_sheet
from meshpoint.gearbox.derived import SheetFigures, sheet_figures
from meshpoint.gearbox.keys import groups_of, to_toml
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.results.output import console, write_json
from meshpoint.rig_sim.settings import DEFAULT_PRESET
from meshpoint.units import RPM


def add_parser(things: Any) -> None:
    """Its arguments."""
    show: argparse.ArgumentParser = things.add_parser(
        "gearbox", help="a data sheet: ratios, tooth counts, derived figures"
    )
    show.add_argument(
        "gearbox",
        metavar="NAME|FILE",
        nargs="?",
        default=DEFAULT_PRESET.sheet_name,
        help=f"{', '.join(SHEET_NAMES)}, or a TOML file (default: %(default)s)",
    )
    show.add_argument(
        "--toml",
        action="store_true",
        help="print it as a file with every key, its unit, range and meaning: to copy and change",
    )
    arguments.add_json(show)
    show.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints the sheet."""
    sheet = load_sheet(namespace.gearbox)
    if namespace.toml:
        sys.stdout.write(sheet_toml(sheet))
        return Exit.DONE
    figures = sheet_figures(sheet)
    if namespace.json is not None:
        values = {
            "sheet": json.loads(sheet.canonical()),
            "sha256": sheet.sha256,
            "ratios": {one.gear.name: one.ratio for one in figures.gears},
            "derived": figures.to_json(),
        }
        write_json(namespace.json, values)
    if namespace.json != "-":
        out = console(namespace.json)
        out.print(_gear_table(sheet, figures))
        out.print(_derived(sheet, figures))
    return Exit.DONE


def sheet_toml(sheet: GearboxSheet) -> str:
    """A data sheet as a file with every key explained; read again it is the same sheet."""
    title = (
        f"Data sheet {sheet.name}; `--gearbox FILE` takes it.\n"
        f"sha256 of the sheet as shown, before any change of yours:\n{sheet.sha256}"
    )
    left_out = "splitter.dog" if sheet.splitter.dog is None else None
    groups = [group for group in groups_of(GearboxSheet, sheet) if group.name != left_out]
    return to_toml(groups, title)


def _gear_table(sheet: GearboxSheet, figures: SheetFigures) -> Table:
    table = Table(title=f"gearbox {sheet.name}", title_justify="left", box=None, pad_edge=False)
    for column in ("gear", "number", "split", "main", "range", "ratio", "step", "teeth"):
        table.add_column(column, justify="right")
    for one in figures.gears:
        gear = one.gear
        meshes = (
            sheet.split_mesh(gear.split),
            sheet.main_mesh(gear.main),
            sheet.range_mesh(gear.range_),
        )
        table.add_row(
            gear.name,
            str(gear.number),
            gear.split.name.lower(),
            gear.main.name.lower(),
            gear.range_.name.lower(),
            f"{one.ratio:.3f}",
            "" if one.step is None else f"{one.step:.3f}",
            "  ".join(f"{mesh.driving}/{mesh.driven}" for mesh in meshes),
        )
    return table


def _derived(sheet: GearboxSheet, figures: SheetFigures) -> str:
    dog, sleeve = sheet.dog, sheet.sleeve
    wheels = ", ".join(f"{name} {wheel.teeth}" for name, wheel in sheet.wheels.rows.items())
    low_inertia, high_inertia = figures.inertia_kgm2
    low_rpm_s, high_rpm_s = (value / RPM for value in figures.braking_rad_s2)
    slip_rpm = figures.delay_slip_rad_s / RPM
    shared = ", ".join(f"{name} ({factor})" for name, factor in figures.shared_factors.items())
    coprime = f"all but {shared} by the factor they share" if shared else "all"
    bound = f"up to {slip_rpm:.0f} rpm slip" if math.isfinite(slip_rpm) else "at any slip"
    return (
        f"\nspread {figures.spread:.2f}; coprime wheel pairs, whose teeth all meet: {coprime}\n"
        f"dog teeth {dog.teeth}: pitch {math.degrees(dog.pitch_rad):.3f} deg, "
        f"gap {math.degrees(dog.backlash_rad):.3f} deg = {1e3 * figures.gap_m:.2f} mm on "
        f"{1e3 * dog.radius_m:.0f} mm, met by chance {100 * dog.backlash_share:.0f} times of 100\n"
        f"sleeve: contact {1e3 * sleeve.delay_s:.0f} ms +- {1e3 * sleeve.delay_limit_s:.0f} ms "
        f"after its valve; that spread alone stays in the gap {bound}\n"
        f"splitter: {_splitter(sheet)}\n"
        f"layshaft, clutch open: {low_inertia:.4f} kg m2 in low split, {high_inertia:.4f} in high; "
        f"full brake {low_rpm_s:.0f} and {high_rpm_s:.0f} rpm/s\n"
        f"sensor wheels: {wheels} teeth\n"
        f"sha256 {sheet.sha256}"
    )


def _splitter(sheet: GearboxSheet) -> str:
    """What engages its steps."""
    if not sheet.has_dog_splitter:
        return "friction cones"
    dog, sleeve = sheet.teeth_of(Sleeve.SPLITTER), sheet.sleeve
    return (
        f"dog teeth {dog.teeth}, gap {math.degrees(dog.backlash_rad):.3f} deg; "
        f"contact {1e3 * sleeve.delay_s:.0f} ms +- {1e3 * sleeve.delay_limit_s:.0f} ms after its "
        f"valve"
    )
