"""`meshpoint simulate`: shifts in virtual time."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.progress import MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

from bus.recorder import LogWriter
from dbc.frame import Frame
from rig_sim.settings import Preset
from testbench import arguments
from testbench.exits import Exit
from testbench.output import check_json, console, folder_for, rows_table, summary_table, write_json
from testbench.rows import ShiftRow, summarise
from testbench.simulate import Setup, simulate

LOG_CHANNEL = "virtual"


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "simulate",
        help="shifts in virtual time: one process, encoded frames, no waiting",
        description="Runs controller, rig and bench in one process on a virtual bus, as fast as "
        "it goes. The same seed gives the same bytes.",
    )
    arguments.add_rig(parser)
    arguments.add_gearbox(parser)
    arguments.add_controller(parser)
    arguments.add_shifts(parser, default=20, least=1)
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="record the bus: .log (candump), .blf or .asc"
    )
    arguments.add_json(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Runs it."""
    setup = Setup(
        sheet=arguments.sheet_of(namespace),
        settings=arguments.settings_of(namespace),
        preset=Preset(namespace.preset),
        seed=namespace.seed,
        shifts=namespace.shifts,
        pairs=namespace.pairs,
    )
    out = console(namespace.json)
    check_json(namespace.json)
    with ExitStack() as stack:
        log = None
        if namespace.log is not None:
            folder_for(namespace.log.parent)
            log = stack.enter_context(
                LogWriter(namespace.log, channel=LOG_CHANNEL, flush_every_s=None)
            )
            setup.header.save(namespace.log.parent)
        progress = stack.enter_context(
            Progress(
                SpinnerColumn(),
                TextColumn("simulating"),
                MofNCompleteColumn(),
                console=console("-"),
                transient=True,
            )
        )
        task = progress.add_task("shifts", total=setup.shifts)

        def on_frame(time_us: int, frame: Frame) -> None:
            if log is not None:
                log.write(time_us / 1e6, frame)

        def on_row(_row: ShiftRow) -> None:
            progress.advance(task)

        result = simulate(setup, on_frame, on_row)
    if namespace.json is not None:
        write_json(namespace.json, result.to_json(setup.settings.strategy_name))
    if namespace.json != "-":
        out.print(rows_table(f"{setup.settings.strategy_name}, seed {setup.seed}", result.rows))
        out.print()
        out.print(summary_table([summarise(setup.settings.strategy_name, result.rows)]))
        for name, figures in result.estimation.items():
            out.print(
                f"estimator {name}: angle RMS {figures['angle_rms_deg']} deg, "
                f"speed RMS {figures['speed_rms_rpm']} rpm (simulated)"
            )
    return Exit.DONE if not result.stuck else Exit.FAILED
