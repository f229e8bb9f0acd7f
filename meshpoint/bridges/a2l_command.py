"""`meshpoint a2l`: the controller's description for calibration tools."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from meshpoint.base.errors import CommandError, unwritten
from meshpoint.base.exits import Exit
from meshpoint.base.version import product_version
from meshpoint.bridges.a2l_module import a2l
from meshpoint.results.output import tell
from meshpoint.xcp.memory import identity


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "a2l",
        description="Writes what a calibration tool (CANape, INCA, pyxcp) has to know of "
        "`meshpoint controller --xcp`: every setting that may change between shifts, with its "
        "limits, and every value that can be measured (docs/calibration.md). It fits this version "
        "alone: the controller answers with the name that stands in it.",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("meshpoint.a2l"), metavar="FILE",
        help="the file to write (default: %(default)s)",
    )  # fmt: skip
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Writes it."""
    path: Path = namespace.output
    if path.suffix != ".a2l":
        raise CommandError(f"-o {path}: ends in {path.suffix!r}, allowed is .a2l")
    version = product_version()
    try:
        path.write_text(a2l(version), encoding="utf-8", newline="\n")
    except OSError as error:
        raise unwritten(path, error) from error
    tell(f"{path}: fits {identity(version)}, as the controller names itself")
    return Exit.DONE
