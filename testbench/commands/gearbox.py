"""`meshpoint gearbox show`: a data sheet as people read it."""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

from rich.table import Table

from gearbox import Split, load_sheet
from gearbox.gears import DRIVE_GEARS
from testbench import arguments
from testbench.exits import Exit
from testbench.output import console, write_json


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "gearbox", help="show a data sheet: ratios, tooth counts, derived figures"
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    show = actions.add_parser("show", help="print a data sheet")
    show.add_argument("gearbox", metavar="NAME|FILE", nargs="?", default="thesis")
    arguments.add_json(show)
    show.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Prints the sheet."""
    sheet = load_sheet(namespace.gearbox)
    if namespace.json is not None:
        ratios = {gear.name: sheet.overall_ratio(gear) for gear in DRIVE_GEARS.values()}
        values = {"sheet": json.loads(sheet.canonical()), "sha256": sheet.sha256, "ratios": ratios}
        write_json(namespace.json, values)
        return Exit.DONE
    out = console()
    table = Table(title=f"gearbox {sheet.name}", title_justify="left", box=None, pad_edge=False)
    for column in ("gear", "number", "main", "split", "range", "ratio", "teeth"):
        table.add_column(column, justify="right")
    for gear in sorted(DRIVE_GEARS.values(), key=lambda gear: -sheet.overall_ratio(gear)):
        meshes = (
            sheet.split_mesh(gear.split),
            sheet.main_mesh(gear.main),
            sheet.range_mesh(gear.range_),
        )
        table.add_row(
            gear.name,
            str(gear.number),
            gear.main.name.lower(),
            gear.split.name.lower(),
            gear.range_.name.lower(),
            f"{sheet.overall_ratio(gear):.3f}",
            "  ".join(f"{mesh.driving}/{mesh.driven}" for mesh in meshes),
        )
    out.print(table)
    dog = sheet.dog
    deceleration = sheet.brake.max_torque_nm / sheet.inertia_kgm2(Split.HIGH) * 30.0 / math.pi
    out.print(
        f"\ndog teeth {dog.teeth}: pitch {math.degrees(dog.pitch_rad):.3f} deg, "
        f"gap {math.degrees(dog.backlash_rad):.3f} deg\n"
        f"inertia at the layshaft: {sheet.inertia_kgm2(Split.LOW):.4f} kg m2 in low split, "
        f"{sheet.inertia_kgm2(Split.HIGH):.4f} in high\n"
        f"full brake: {deceleration:.0f} rpm/s at the layshaft in high split\n"
        f"sha256 {sheet.sha256}"
    )
    return Exit.DONE
