"""`meshpoint replay` of a log that our controller has not made: open loop on its sensor frames."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.base.version import product_version
from meshpoint.cli import arguments
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import load_settings
from meshpoint.gearbox import load_sheet
from meshpoint.logs.bus_map import BusMap, load_map
from meshpoint.logs.log_progress import (
    complain_of_interrupt,
    log_name,
    logged_frames,
)
from meshpoint.logs.logged_frames import LoggedFrames
from meshpoint.logs.seen_shift import SeenShift
from meshpoint.replays.sensor_replay import SensorReplay
from meshpoint.replays.sensors_page import SensorPage, SensorTraces
from meshpoint.report.write import check_report
from meshpoint.results.output import console
from meshpoint.rig_sim.settings import DEFAULT_PRESET

MOST_EVENTS: Final = 10_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """--sensors, --dbc and --map."""
    group = parser.add_argument_group("a log that our controller has not made (docs/replay.md)")
    group.add_argument(
        "--sensors",
        action="store_true",
        help="open loop on the log's sensor frames alone, whoever controlled the gearbox; chosen "
        "by itself where no controller's run is in the log",
    )
    group.add_argument("--dbc", type=Path, metavar="FILE", help="the other bus's DBC, with --map")
    group.add_argument(
        "--map",
        type=Path,
        metavar="TOML",
        help="which of its signals are edges, speeds, positions and pressures of ours",
    )


def asked(namespace: argparse.Namespace) -> bool:
    """Whether sensor frames alone are to be used."""
    if (namespace.dbc is None) != (namespace.map is None):
        raise CommandError("--dbc and --map go together: a DBC, and what its signals are here")
    return bool(namespace.sensors or namespace.dbc is not None)


def run(
    namespace: argparse.Namespace, files: list[Path], why: str, stop: Callable[[], bool]
) -> tuple[int, dict[str, Any]]:
    """Replays, and shows what the log shows and what it does not. why: it was chosen, if it was
    not asked for. A log that is torn gives all before that, and bad input."""
    check_report(namespace.report)
    gearbox = namespace.gearbox or DEFAULT_PRESET.sheet_name
    sheet = load_sheet(gearbox)
    name = namespace.strategy
    file = None if name is None else arguments.strategy_file(name)
    settings = load_settings(namespace.settings, strategy_name=name, strategy_file=file)
    bus_map: BusMap | None = None
    if namespace.dbc is not None:
        bus_map = load_map(namespace.dbc, namespace.map)
    events: list[dict[str, Any]] = []

    def on_event(since_s: float, line: str) -> None:
        if len(events) < MOST_EVENTS:
            events.append({"s": round(since_s, 3), "event": line})

    drawn = SensorTraces()
    header = new_header(product_version(), sheet, settings)
    replay = SensorReplay(header, bus_map, on_event, drawn.take)
    with logged_frames(files, namespace.bus, stop, in_sensor_time=True) as log:
        for time_s, frame in log:
            replay.take(time_s, frame)
    replay.finish()
    values = {
        "logs": [str(path) for path in files],
        "mode": "sensors alone",
        "why": why,
        "gearbox": gearbox,
        "frames": log.frames,
        "buses": dict(log.buses),
        "account": log.account.to_json(),
        "log_clock": log.clock.to_json(),
        "defect": None if log.defect is None else str(log.defect),
        "interrupted": log.interrupted,
        **replay.to_json(),
        "decisions": replay.decided(),
        "events": events,
    }
    lines = _words(replay, log, why)
    if namespace.json != "-":
        _show(console(namespace.json), replay, lines)
    if namespace.report is not None:
        page = SensorPage(log_name(files), name or settings.strategy_name, sheet, lines)
        page.write(namespace.report, replay, drawn, events)
    if log.interrupted:
        complain_of_interrupt(log.frames)
        return Exit.INTERRUPTED, values
    return (Exit.DONE if log.defect is None else Exit.BAD_INPUT), values


def _words(replay: SensorReplay, log: LoggedFrames, why: str) -> list[str]:
    """What was used, what was not, and what cannot be said, a line each."""
    values = replay.to_json()
    lines = [f"open loop on sensor frames alone{': ' + why if why else ''}"]
    lines.append(f"{values['seconds']} s, {replay.steps} steps")
    lines += [f"  {name}: {n} frames" for name, n in values["inputs"].items()]
    lines += [f"  mapped {name}: {n} values" for name, n in values["mapped"].items()]
    for title, key in (
        ("foreign", "foreign_frames"),
        ("another controller's", "controller_frames"),
    ):
        if values[key]:
            each = ", ".join(f"{can_id} ({n})" for can_id, n in list(values[key].items())[:8])
            more = f" and {len(values[key]) - 8} more" if len(values[key]) > 8 else ""
            lines.append(f"  {title}, not used: {each}{more}")
    for shaft, (least, most) in values["speeds_rpm"].items():
        lines.append(f"{shaft} shaft: {least:g} to {most:g} rpm")
    if replay.unfinished:
        lines.append(f"requests whose shift had not ended before the next one or the log's end, "
                     f"not judged: {replay.unfinished}")  # fmt: skip
    lines += [f"log: {line}" for line in log.words()]
    lines += [f"cannot be said: {line}" for line in replay.cannot]
    if log.defect is not None:
        lines.append(f"the log cannot be read on: {log.defect}")
    return lines


def _show(out: Any, replay: SensorReplay, lines: list[str]) -> None:
    for line in lines:
        out.print(line)
    seen, by = replay.seen
    if seen:
        out.print(seen_table(f"shifts that the log shows, by {by}", seen))
    for row in replay.decided():
        after = "" if row["fired_ms"] is None else f" after {row['fired_ms']} ms"
        phase = row["predicted_phase_deg"]
        reported = "phase unknown" if phase is None else f"phase {phase:+.2f} deg expected"
        line = f"asked {row['from']} -> {row['to']}: {row['status']}{after}, {reported}"
        out.print(line)


def seen_table(title: str, shifts: list[SeenShift]) -> Table:
    """One row a shift."""
    table = Table(
        title=title, title_justify="left", box=None, pad_edge=False, collapse_padding=True
    )
    for column in ("from", "to", "left s", "there s", "open ms"):
        table.add_column(column, justify="right")
    for shift in shifts:
        table.add_row(
            str(shift.from_gear), str(shift.to_gear), f"{shift.left_s:.2f}",
            f"{shift.there_s:.2f}", f"{shift.open_ms:.0f}",
        )  # fmt: skip
    return table
