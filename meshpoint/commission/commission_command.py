"""`meshpoint commission`: what moves what, and what the gearbox is like, found out on its bus."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.table import Table

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.base.provenance import gearbox_words, provenance
from meshpoint.base.version import product_version
from meshpoint.bus import given_numbers
from meshpoint.bus.core import AroundCore, Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.fine_timers import run as run_loop
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.bus.profile import WireProfile
from meshpoint.bus.signals import stop_on_signals
from meshpoint.cli import arguments
from meshpoint.cli.pace import add_pace, clock_of
from meshpoint.commission.check_command import findings_table
from meshpoint.commission.drawn import draw_sheet
from meshpoint.commission.finding import Finding, answer, answer_words
from meshpoint.commission.measured import Commissioned, commissioned, value_of
from meshpoint.commission.rehearsal import draw_miswiring, findings_of, rehearse_turned
from meshpoint.commission.whole import WholeCommission
from meshpoint.controller.run.kept import save
from meshpoint.controller.run.node import ADDRESSES
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.keys import groups_of, to_toml
from meshpoint.identify.identify_command import figures_table
from meshpoint.identify.overlay import Entry
from meshpoint.results.output import complain, console, write_json
from meshpoint.rig_sim.settings import DEFAULT_PRESET, DEFAULT_PROFILE


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "commission",
        description="On a box that stands, with air: drives each valve once for 0.3 s, after you "
        "have said yes to it, and says which sleeve moved which way, what is miswired, and how "
        "long valves and sleeves take. All other outputs are off in every frame; a pulse ends when "
        "a shaft turns by more than a pulse turns it, air fails or an input is lost. With --turn "
        "the engine then turns each gear and the layshaft: sensors on wrong shafts are named, and "
        "tooth counts, ratios, brake, clutch and sleeves measured. Writes a data sheet and a "
        "calibration. docs/bench.md.",
    )
    parser.add_argument(
        "--yes",
        action="store_true",
        help="drive every output without asking: nobody may be near the gearbox",
    )
    parser.add_argument(
        "--turn",
        action="store_true",
        help="go on with turning shafts: the output must be free, wheels lifted or a stand "
        "without load. Each gear and each split asks for a yes of its own",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="write teeth and sleeve delays here, for `controller --calibration`; needs --turn",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write the data sheet with the measured values here, TOML; not if anything is wrong",
    )
    parser.add_argument(
        "--drawn",
        type=given_numbers.whole(1, 10_000),
        metavar="N",
        help="rehearse on this many drawn gearboxes in virtual time, their sheets withheld and a "
        "tenth of them miswired, and count what was named; no bus is opened",
    )
    arguments.add_seed(parser)
    arguments.add_gearbox(parser)
    arguments.add_wire(parser)
    add_pace(parser)
    arguments.add_json(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """On a bus, or on drawn boxes."""
    sheet = arguments.sheet_of(namespace)
    if arguments.wire_of(namespace) is WireProfile.CLASSIC:
        raise CommandError(
            "commission distinguishes wheels and shafts by their edges: --profile classic carries "
            "those of two shafts alone. Commission the box over CAN FD: the data sheet that it "
            "writes serves a controller with --profile classic as well"
        )
    if namespace.drawn is not None:
        return _rehearse(namespace, sheet)
    if namespace.calibration is not None and not namespace.turn:
        raise CommandError("--calibration needs --turn: teeth show when shafts turn")
    core = WholeCommission(sheet, consents=namespace.yes, turns=namespace.turn)
    run_loop(_on_bus(namespace, _Guided(core, None if namespace.yes else _ask)))
    findings = list(findings_of(core))
    is_right, reason = _answer(core, findings)
    written = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    found = commissioned(core, sheet, product_version(), written) if is_right else None
    if found is not None:
        findings += found.findings
        is_right, reason = _answer(core, findings)
    _show(namespace, sheet, found, findings, answer_words(is_right, reason))
    if is_right and found is not None:
        _write(namespace, found)
    if namespace.json is not None:
        values = {
            "ready": is_right,
            "reason": reason,
            "measured": [_row(entry, sheet) for entry in found.entries] if found else [],
            "sleeve_law": [asdict(figure) for figure in found.sleeve_law] if found else [],
            "findings": [finding.to_json() for finding in findings],
        }
        write_json(namespace.json, values)
    return Exit.DONE if is_right else Exit.FAILED


def _answer(core: WholeCommission, findings: list[Finding]) -> tuple[bool, str]:
    """Yes or no, and the reason; one that was stopped before its end has not said yes."""
    is_right, reason = answer(findings)
    if is_right and not (core.done and not core.standing.stopped):
        return False, core.standing.stopped or "ended before all was driven"
    return is_right, reason


def _show(
    namespace: argparse.Namespace,
    sheet: GearboxSheet,
    found: Commissioned | None,
    findings: list[Finding],
    last: str,
) -> None:
    out = console(namespace.json)
    out.print(findings_table(findings))
    if found is not None and found.entries:
        out.print(measured_table([_row(entry, sheet) for entry in found.entries]))
    if found is not None and found.sleeve_law:
        out.print(figures_table(found.sleeve_law, "sleeves by their law"))
    out.print(last, soft_wrap=True)


def _row(entry: Entry, sheet: GearboxSheet) -> dict[str, Any]:
    """A measured key beside what the data sheet has."""
    value = float(f"{entry.value:.6g}")
    of_sheet = value_of(sheet, entry.table, entry.key)
    key = f"{entry.table}.{entry.key}"
    return {
        "key": key,
        "measured": value,
        "low": entry.low,
        "high": entry.high,
        "interval": entry.interval,
        "sheet": of_sheet,
        "how": entry.why,
    }


def measured_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """What was measured, by key of the data sheet, beside what the sheet had."""
    table = Table(title="measured", title_justify="left", box=None, pad_edge=False)
    for column in ("key", "measured", "95 % interval", "data sheet", "how"):
        left = column in ("key", "how")
        table.add_column(column, justify="left" if left else "right", no_wrap=column == "key")
    for row in rows:
        values = f"{row['measured']:g}", row["interval"], f"{row['sheet']:g}"
        table.add_row(row["key"], *values, row["how"])
    return table


def _write(namespace: argparse.Namespace, found: Commissioned) -> None:
    """Data sheet and calibration, where they are asked for."""
    if namespace.out is not None:
        keys = ", ".join(_words(entry) for entry in found.entries)
        title = (
            f"Data sheet {found.sheet.name}; measured, with 95 % intervals: {keys or 'nothing'}. "
            "All else is as in the sheet that it began with."
        )
        namespace.out.write_text(to_toml(groups_of(GearboxSheet, found.sheet), title), "utf-8")
    if namespace.calibration is not None and found.calibration is not None:
        save(namespace.calibration, found.calibration)


def _words(entry: Entry) -> str:
    """A measured key with its 95 % interval."""
    within = f" ({entry.interval})" if entry.interval else ""
    return f"{entry.table}.{entry.key}{within}"


async def _on_bus(namespace: argparse.Namespace, guided: _Guided) -> None:
    stop = asyncio.Event()
    guided.stop = stop
    with stop_on_signals(stop):
        await run_node(
            guided,
            lambda: open_bus_from(namespace),
            clock_of(namespace, "controller"),  # whose place it takes
            on_event=complain,
            stop=stop,
            name="commission",
            own_addresses=ADDRESSES,
        )


async def _ask() -> bool:
    """A person's answer, typed; the end of the input is a no."""
    line = await asyncio.to_thread(sys.stdin.readline)
    return line.strip().lower() in ("y", "yes")


class _Guided(AroundCore[WholeCommission]):
    """The core, and a person who is asked; ends when all is done."""

    def __init__(self, core: WholeCommission, ask: Callable[[], Any] | None) -> None:
        super().__init__(core)
        self._ask = ask
        self._asking: asyncio.Task[bool] | None = None
        self.stop: asyncio.Event | None = None

    def step(self, now_us: int) -> Step:
        """The core's step; then the person, and the end."""
        core = self._core
        step = core.step(now_us)
        if core.done and self.stop is not None:
            self.stop.set()
        if self._ask is None:
            return step
        if self._asking is not None and self._asking.done():
            core.answer(self._asking.result(), now_us)
            self._asking = None
        elif core.is_asking and self._asking is None:
            self._asking = asyncio.ensure_future(self._ask())
        return step


def _rehearse(namespace: argparse.Namespace, sheet: GearboxSheet) -> int:
    """Drawn boxes of withheld sheets: every miswiring named, and none where there is none."""
    seeds = range(namespace.seed, namespace.seed + namespace.drawn)
    found = [rehearse_turned(draw_sheet(sheet, s), s, draw_miswiring(s)) for s in seeds]
    wrong = [one for one in found if one.wrong.is_any]
    missed = [one for one in found if not one.is_right]
    out = console(namespace.json)
    for one in wrong:
        reported = "named" if one.is_right else "not named"
        out.print(f"seed {one.seed}: {one.wrong}: {reported}", soft_wrap=True)
    for one in missed:
        out.print(f"seed {one.seed}: found {_bad(one.findings)}", soft_wrap=True)
    named = sum(one.is_right for one in wrong)
    text = (
        f"{len(found)} boxes drawn around {gearbox_words(sheet, DEFAULT_PRESET, DEFAULT_PROFILE)}: "
        f"{named} of {len(wrong)} miswirings named; "
        f"{sum(one.is_right for one in found if not one.wrong.is_any)} of "
        f"{len(found) - len(wrong)} sound boxes called sound"
    )
    out.print(text, soft_wrap=True)
    if namespace.json is not None:
        boxes = [
            {"seed": one.seed, "wrong": str(one.wrong), "right": one.is_right,
             "findings": [f.to_json() for f in one.findings if f.verdict != "good"]}
            for one in found
        ]  # fmt: skip
        source = provenance(sheet, namespace.seed, DEFAULT_PRESET, DEFAULT_PROFILE)
        write_json(namespace.json, {"boxes": boxes, "summary": text, "provenance": source})
    return Exit.DONE if not missed else Exit.FAILED


def _bad(findings: list[Finding]) -> str:
    return "; ".join(f"{f.subject}: {f.text}" for f in findings if f.verdict == "bad") or "nothing"
