"""`meshpoint fmu`: packs the virtual gearbox as an FMU."""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any, Final

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.base.exits import Exit
from meshpoint.base.extra import needed
from meshpoint.results.output import tell

EXTRA: Final = "fmu"
SCRIPT: Final = Path(__file__).with_name("rig_fmu.py")


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "fmu",
        description="Writes the virtual gearbox as an FMI 3.0 co-simulation unit for Simulink, "
        "FMPy and the like: valves, clutch, engine and slope in; shafts, sleeves, pressures and "
        "contacts out; gearbox, profile and seed are parameters (docs/fmu.md). It runs in the "
        "Python of whoever imports it, which needs meshpoint. Needs meshpoint[fmu].",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("rig.fmu"), metavar="FILE",
        help="the file to write (default: %(default)s)",
    )  # fmt: skip
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes it."""
    path: Path = namespace.output
    if path.suffix != ".fmu":
        raise CommandError(f"-o {path}: ends in {path.suffix!r}, allowed is .fmu")
    pythonfmu3 = needed("pythonfmu3", EXTRA)
    with tempfile.TemporaryDirectory() as folder:
        made = pythonfmu3.FmuBuilder.build_FMU(SCRIPT, folder)
        try:
            shutil.copyfile(made, path)
        except OSError as error:
            raise unwritten(path, error) from error
    tell(f"{path}: FMI 3.0 co-simulation, needs meshpoint where it is imported")
    return Exit.DONE
