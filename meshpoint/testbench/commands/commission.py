"""`meshpoint commission`: which output moves what, one at a time, on a bus with a standing box."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from meshpoint.bus.clock import Clock
from meshpoint.bus.core import AroundCore, Step
from meshpoint.bus.driver import run_node
from meshpoint.bus.fine_timers import run as run_loop
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.bus.signals import stop_on_signals
from meshpoint.controller.node import ADDRESSES
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.keys import groups_of, to_toml
from meshpoint.testbench.check.finding import Finding, answer
from meshpoint.testbench.commands import arguments
from meshpoint.testbench.commands.check import findings_table
from meshpoint.testbench.commission.core import CommissionCore
from meshpoint.testbench.commission.rehearsal import draw_miswiring, rehearse
from meshpoint.testbench.commission.verdict import judge_outputs, measured_sheet
from meshpoint.testbench.exits import Exit
from meshpoint.testbench.results.output import complain, console, write_json


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "commission",
        description="On a box that stands, with air: drives each valve once for 0.3 s, after you "
        "have said yes to it, and says which sleeve moved which way, what is miswired, and how "
        "long valves and sleeves take. Writes a data sheet with what was measured. All other "
        "outputs are off in every frame; a pulse ends when a shaft turns, air fails or an input "
        "is lost. Run `meshpoint check --turn` first: it names sensors that are exchanged. "
        "docs/bench.md.",
    )
    parser.add_argument(
        "--yes",
        action="store_true",
        help="drive every output without asking: nobody may be near the gearbox",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write the data sheet with the measured values here, TOML",
    )
    parser.add_argument(
        "--drawn",
        type=arguments.whole(1, 10_000),
        metavar="N",
        help="rehearse on so many drawn gearboxes in virtual time, a tenth of them miswired, and "
        "count what was named; no bus is opened",
    )
    arguments.add_seed(parser)
    arguments.add_gearbox(parser)
    arguments.add_json(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """On a bus, or on drawn boxes."""
    sheet = arguments.sheet_of(namespace)
    if namespace.drawn is not None:
        return _rehearse(namespace, sheet)
    core = CommissionCore(sheet, consents=namespace.yes)
    run_loop(_on_bus(namespace, _Guided(core, None if namespace.yes else _ask)))
    findings = list(judge_outputs(core))
    measured, changed = measured_sheet(sheet, core)
    is_right, reason = answer(findings)
    is_right = is_right and not core.stopped and core.done
    out = console(namespace.json)
    out.print(findings_table(findings))
    out.print(f"measured: {', '.join(changed) or 'nothing'}", soft_wrap=True, markup=False)
    out.print(f"{'yes' if is_right else 'no'}: {reason}", soft_wrap=True, markup=False)
    if namespace.out is not None:
        title = f"Data sheet {sheet.name}; measured: {', '.join(changed) or 'nothing'}."
        namespace.out.write_text(to_toml(groups_of(GearboxSheet, measured), title), "utf-8")
    if namespace.json is not None:
        values = {
            "ready": is_right,
            "reason": core.stopped or reason,
            "measured": changed,
            "findings": [finding.to_json() for finding in findings],
        }
        write_json(namespace.json, values)
    return Exit.DONE if is_right else Exit.FAILED


async def _on_bus(namespace: argparse.Namespace, guided: _Guided) -> None:
    stop = asyncio.Event()
    guided.stop = stop
    with stop_on_signals(stop):
        await run_node(
            guided,
            lambda: open_bus_from(namespace),
            Clock(1.0),
            on_event=complain,
            stop=stop,
            name="commission",
            own_addresses=ADDRESSES,
        )


async def _ask() -> bool:
    """A person's answer, typed; the end of the input is a no."""
    line = await asyncio.to_thread(sys.stdin.readline)
    return line.strip().lower() in ("y", "yes")


class _Guided(AroundCore[CommissionCore]):
    """The core, and a person who is asked; ends when all is done."""

    def __init__(self, core: CommissionCore, ask: Callable[[], Any] | None) -> None:
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
    """Drawn boxes: every miswiring named, and none where there is none."""
    seeds = range(namespace.seed, namespace.seed + namespace.drawn)
    found = [rehearse(sheet, seed, draw_miswiring(seed)) for seed in seeds]
    wrong = [one for one in found if one.wrong.is_any]
    missed = [one for one in found if not one.is_right]
    out = console(namespace.json)
    for one in wrong:
        told = "named" if one.is_right else "not named"
        out.print(f"seed {one.seed}: {one.wrong}: {told}", soft_wrap=True, markup=False)
    for one in missed:
        out.print(f"seed {one.seed}: found {_bad(one.findings)}", soft_wrap=True, markup=False)
    named = sum(one.is_right for one in wrong)
    text = (
        f"{len(found)} boxes: {named} of {len(wrong)} miswirings named; "
        f"{sum(one.is_right for one in found if not one.wrong.is_any)} of "
        f"{len(found) - len(wrong)} sound boxes called sound"
    )
    out.print(text, soft_wrap=True, markup=False)
    if namespace.json is not None:
        boxes = [
            {"seed": one.seed, "wrong": str(one.wrong), "right": one.is_right,
             "findings": [f.to_json() for f in one.findings if f.verdict != "good"]}
            for one in found
        ]  # fmt: skip
        write_json(namespace.json, {"boxes": boxes, "summary": text})
    return Exit.DONE if not missed else Exit.FAILED


def _bad(findings: list[Finding]) -> str:
    return "; ".join(f"{f.subject}: {f.text}" for f in findings if f.verdict == "bad") or "nothing"
