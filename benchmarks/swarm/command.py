"""`python -m benchmarks.swarm`: worlds in which anything fails, held against plant truth."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from benchmarks.swarm.events import load_world
from benchmarks.swarm.swarm import NAMES, Swarm, SwarmSpec, run_swarm
from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bench.compiling import prepare
from meshpoint.bus import given_numbers
from meshpoint.cli import arguments
from meshpoint.cli.main import run_parsed
from meshpoint.cli.parsing import Parser, examples
from meshpoint.results.output import complain, console, write_json

TELL_EVERY_S: Final = 60.0
WORDS: Final = {
    "faults": "faults",
    "fault_codes": "fault codes",
    "guard_rows": "rows of the guard",
    "transitions": "transitions",
}


def main(given: Sequence[str] | None = None) -> int:
    """Runs the swarm that a command line asks for; returns its exit code."""
    return run_parsed(lambda: parser().parse_args(given))


def parser() -> Parser:
    """The command's arguments."""
    found = Parser(
        prog="python -m benchmarks.swarm",
        description="Worlds in which anything may fail: kinds and rates of faults are drawn by "
        "seed, and every step is held against the gearbox's true state. See docs/safety.md.",
        epilog=examples("python -m benchmarks.swarm --hours 2 --seed 1 --jobs 2 --json -"),
    )
    found.add_argument(
        "--hours", type=given_numbers.number(1e-6, 1e6), default=1.0, metavar="H",
        help="simulated hours (default: 1)",
    )  # fmt: skip
    found.add_argument(
        "--wall", type=given_numbers.some_seconds, metavar="S",
        help="begin no world after S seconds",
    )  # fmt: skip
    found.add_argument(
        "--scenario", type=Path, metavar="FILE", help="repeat a world that was found, alone"
    )
    found.add_argument(
        "--jobs", type=given_numbers.whole(1, 1024), default=os.cpu_count() or 1, metavar="J",
        help="worker processes (default: one a processor)",
    )  # fmt: skip
    found.add_argument(
        "--out", type=Path, metavar="DIR", help="keep what was reached and what broke here"
    )
    found.add_argument("--resume", action="store_true", help="go on with the swarm in --out")
    found.add_argument("--debug", action="store_true", help="show the traceback of an error")
    arguments.add_seed(found)
    arguments.add_as_built(found)
    arguments.add_gearbox(found)
    arguments.add_controller(found, strategy=False)
    arguments.add_json(found)
    found.set_defaults(run=run, program=found.prog)
    return found


def run(namespace: argparse.Namespace) -> int:
    """Runs it."""
    sheet, built = arguments.sheet_of(namespace), arguments.as_built_of(namespace)
    settings = arguments.settings_of(namespace)
    spec = SwarmSpec(sheet, settings, namespace.seed, built.profile, built.fixed)
    if namespace.scenario is not None:
        return _repeat(namespace, spec)
    if namespace.resume and namespace.out is None:
        raise CommandError("--resume needs the --out of the swarm to go on with")
    prepare()
    begun_s = time.monotonic()
    swarm = run_swarm(
        spec, namespace.hours, namespace.wall, namespace.jobs, namespace.out, namespace.resume,
        _Teller(),
    )  # fmt: skip
    values = swarm.to_json(time.monotonic() - begun_s) | {"provenance": spec.provenance}
    if namespace.json is not None:
        write_json(namespace.json, values)
    if namespace.json != "-":
        out = console(namespace.json)
        out.print(reached_table(values, spec.gearbox_words))
        for found in values["found"]:
            out.print(f"seed {found['seed']}: {found['what']} at {found['at_ms']} ms, "
                      f"{found['text']}")  # fmt: skip
    return Exit.FAILED if swarm.found else Exit.DONE


def _repeat(namespace: argparse.Namespace, spec: SwarmSpec) -> int:
    world = load_world(namespace.scenario)
    result = spec.run(world)
    values = {
        "simulated_s": result.simulated_s,
        "shifts": result.shifts,
        "broken": [broken._asdict() for broken in result.broken],
        "provenance": spec.provenance,
    }
    if namespace.json is not None:
        write_json(namespace.json, values)
    for broken in result.broken:
        complain(f"{broken.what} at {broken.at_ms} ms: {broken.text}")
    return Exit.FAILED if result.broken else Exit.DONE


class _Teller:
    """Says how far it is, now and then, where it does not get into anybody's results."""

    def __init__(self) -> None:
        self._reported_s = time.monotonic()

    def __call__(self, swarm: Swarm) -> None:
        now_s = time.monotonic()
        if now_s - self._reported_s >= TELL_EVERY_S:
            self._reported_s = now_s
            hours = swarm.simulated_s / 3600.0
            text = f"{hours:.2f} h simulated, {swarm.shifts} shifts, {len(swarm.found)} violations"
            complain(text)


def reached_table(values: dict[str, Any], gearbox: str) -> Table:
    """How much was simulated, and how much of what there is was reached."""
    hours, shifts = values["simulated_hours"], values["shifts"]
    title = f"{hours:.2f} h, {values['worlds']} worlds, {shifts} shifts"
    title += f", {values['violations']} violations, {gearbox}"
    table = Table("reached", "of", "missing", title=title)
    for name in NAMES:
        part = values[f"{name}_reached"]
        missing = ", ".join(part["missing"]) or "-"
        table.add_row(f"{part['reached']} {WORDS[name]}", str(part["declared"]), missing)
    return table
