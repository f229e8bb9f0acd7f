"""The reference pages, generated from the code: settings, calibration, data sheet, rig, commands.

With a folder it writes them there (`make reference`); with `--check` behind the folder it compares
and ends with 1 where one is out of date:

    python -m meshpoint.cli.reference docs/reference --check
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from meshpoint.base.exits import Exit
from meshpoint.bus.simulated.contract_traffic import (
    AT_ONCE,
    JITTER_NS,
    PROBE_NS,
    RIG_QUEUES,
    STEP_NS,
    contract_traffic,
)
from meshpoint.bus.simulated.core import QueueOrder
from meshpoint.bus.simulated.frame_bits import BitTiming
from meshpoint.bus.simulated.response_time import load, worst_response_ns
from meshpoint.cli import vectors
from meshpoint.cli.json_keys import COUNTERFACTUAL_KEYS, JUDGED_KEYS, STRATEGY_KEYS
from meshpoint.cli.parsing import subparsers
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import SettingsFile
from meshpoint.dbc.schema import SCHEMA
from meshpoint.gearbox import GearboxSheet, load_sheet
from meshpoint.gearbox.keys import groups_of, rounded
from meshpoint.gearbox.sheet import SHEET_NAMES
from meshpoint.rig_sim.settings import Profile

if TYPE_CHECKING:
    from meshpoint.rig_sim.truck.as_built import Parameter

SPECS: Final = {spec.name: spec for spec in SCHEMA.messages}
GENERATED: Final = "Generated from the code by `make reference`; a test holds it equal."


def settings_page() -> str:
    """docs/reference/settings.md."""
    lines = [
        "# Settings of the controller", "", GENERATED, "",
        "`--settings FILE` of `controller`, `simulate`, `campaign`, `demo` and `up` reads a TOML "
        "file. A key that is left out keeps its default; an unknown key, a wrong type or a value "
        "out of range is an error that names file, key and what is allowed. `meshpoint show "
        "settings --toml` prints a whole file to start from.",
    ]  # fmt: skip
    for group in groups_of(SettingsFile):
        lines += ["", f"## `[{group.name}]`" if group.name else "## At the top", ""]
        lines += [group.meaning, ""]
        rows = [
            (f"`{key.name}`", f"`{rounded(key.default)}`" if key.default else "", key.unit,
             key.allowed, key.meaning)
            for key in group.keys
        ]  # fmt: skip
        lines += _table(("key", "default", "unit", "allowed", "meaning"), rows)
    return "\n".join(lines) + "\n"


def calibration_page() -> str:
    """docs/reference/calibration.md."""
    lines = [
        "# The calibration file", "", GENERATED, "",
        "What a controller has learned of one gearbox, in TOML; a table that is not known is left "
        "out. What is learned when, and when a file is refused: "
        "[calibration.md](../calibration.md).",
    ]  # fmt: skip
    alike: dict[tuple[str, tuple[tuple[str, str, str, str], ...]], list[str]] = {}
    for group in groups_of(Calibration):
        keys = tuple((f"`{k.name}`", k.unit, k.allowed, k.meaning) for k in group.keys)
        if keys:
            alike.setdefault((group.meaning, keys), []).append(group.name)
    for (meaning, rows), names in alike.items():
        head = ", ".join(f"`[{name}]`" for name in names if name)
        meaning = meaning.replace("`estimate/", "`controller/estimate/")
        lines += ["", f"## {head or 'At the top'}", "", meaning, ""]
        lines += _table(("key", "unit", "allowed", "meaning"), rows)
    return "\n".join(lines) + "\n"


def gearbox_page() -> str:
    """docs/reference/gearbox.md."""
    lines = [
        "# The data sheet", "", GENERATED, "",
        "`--gearbox FILE` reads a TOML file with these keys; all but `missing` must be there. "
        "`meshpoint show gearbox thesis --toml` prints a whole file to start from. The last "
        "columns are the sheets that come with the product.",
    ]  # fmt: skip
    sheets = [groups_of(GearboxSheet, load_sheet(name)) for name in SHEET_NAMES]
    for index, group in enumerate(sheets[0]):
        if not group.keys:
            continue
        lines += ["", f"## `[{group.name}]`" if group.name else "## At the top", ""]
        lines += [group.meaning, ""] if group.name else []
        # No sheet of ours has teeth of its own for its splitter.
        having = () if group.name == "splitter.dog" else sheets
        rows = [
            (f"`{key.name}`", key.unit, key.allowed, key.meaning,
             *(f"`{rounded(sheet[index].keys[k].default)}`" for sheet in having))
            for k, key in enumerate(group.keys)
        ]  # fmt: skip
        names = SHEET_NAMES if having else ()
        lines += _table(("key", "unit", "allowed", "meaning", *names), rows)
    return "\n".join(lines) + "\n"


def commands_page() -> str:
    """docs/reference/commands.md."""
    from meshpoint.cli.table import COMMANDS, EXIT_CODES, build_parser

    lines = [
        "# Commands", "", GENERATED, "",
        "Commands that open a bus also take python-can's own arguments: `meshpoint help bus`.", "",
        "```", *EXIT_CODES.splitlines(), "```",
    ]  # fmt: skip
    parser = build_parser()
    for name in COMMANDS:
        lines += _command(f"meshpoint {name}", subparsers(parser)[name])
    return "\n".join(lines) + "\n"


def bus_page() -> str:
    """docs/reference/bus.md."""
    timing = BitTiming()
    apart, together = contract_traffic(timing), contract_traffic(timing, RIG_QUEUES)
    columns = [
        worst_response_ns(messages, order, timing.nominal_ns)
        for messages, order in ((apart, QueueOrder.PRIORITY), (together, QueueOrder.FIFO))
    ]
    rows = [
        (m.name, f"`{SPECS[m.name].can_id:08X}`", str(SPECS[m.name].sender),
         f"{SPECS[m.name].length}{' FD' if SPECS[m.name].is_fd else ''}",
         f"{m.longest_ns / 1e3:.1f}", f"{m.period_ns / 1e6:g}",
         *(_milliseconds(column[m.name]) for column in columns))
        for m in apart
    ]  # fmt: skip
    lines = [
        "# How long a message may take", "", GENERATED, "",
        "Each message of the DBC by priority, at 500 kbit/s and 2 Mbit/s: its longest frame with "
        "the intermission, bit stuffing at its worst, and its worst response: from when it is due "
        "until it is through, queuing jitter of "
        f"{JITTER_NS / 1e6:g} ms included, on a bus without errors and without other nodes.",
        "",
        "- *by priority*: every sender of the DBC is a node that sends its waiting frames by "
        "priority (Davis, Burns, Bril, Lukkien, Real-Time Systems 35, 2007).",
        "- *in order*: every node sends them in the order given, as a SocketCAN interface does, "
        "and the rig is one node. This bound is safe and far from what happens: on a bus as full "
        "as this, each queue's waiting adds to the others' (after Davis, Kollmann, Pollex, "
        "Slomka, ECRTS 2011).", "",
        f"Assumed: an event message comes at most once each {STEP_NS / 1e6:g} ms (of "
        f"{', '.join(AT_ONCE)} {', '.join(map(str, AT_ONCE.values()))} at once), and the "
        f"controller makes one step more each {PROBE_NS / 1e9:g} s, to measure the delay of the "
        "bus. A node whose waiting frames overtake each other mixes the frames of two steps when "
        "the bus is full; a log of it cannot be verified, because the status frame closes a step "
        "([decision 0002](../decisions/0002-messages-from-the-dbc.md)).", "",
        f"All frames at their longest take {load(apart):.1%} of the bus.", "",
    ]  # fmt: skip
    heads = ("message", "identifier", "sender", "bytes", "longest us", "least interval ms",
             "by priority ms", "in order ms")  # fmt: skip
    return "\n".join([*lines, *_table(heads, rows)]) + "\n"


def rig_page() -> str:
    """docs/reference/rig.md."""
    from meshpoint.rig_sim.truck.as_built import parameters

    lines = [
        "# Parameters of the simulated gearbox", "", GENERATED, "",
        "What the preset `truck` has beyond the data sheet. A gearbox as built has each value "
        "evenly within the middle +- the deviation, kept within the range; an as-built file sets "
        "any of them within the range. A profile without a value of its own has that of `clean`. "
        "Units are in the names. Sources: T the thesis; S published, named; D derived; M "
        "representative. Equations and profiles: [gearbox.md](../gearbox.md).",
    ]  # fmt: skip
    clean, *others = (parameters(profile) for profile in Profile)
    groups: dict[str, list[tuple[str, ...]]] = {}
    for name, parameter in clean.items():
        group, _, key = name.partition(".")
        note, _, source = parameter.note.rpartition("; ")
        drawn = [_drawn(each[name]) for each in (clean, *others)]
        own = [text if text != drawn[0] else "" for text in drawn[1:]]
        spread = f"{parameter.low:g} to {parameter.high:g}"
        row = (f"`{key}`", drawn[0], *own, spread, note, source)
        groups.setdefault(group, []).append(row)
    heads = ("parameter", *Profile, "range", "what it is", "source")
    for group, rows in groups.items():
        lines += ["", f"## `[{group}]`", "", *_table(heads, rows)]
    return "\n".join(lines) + "\n"


def _drawn(parameter: Parameter) -> str:
    spread = f" +- {parameter.deviation:g}" if parameter.deviation else ""
    return f"{parameter.default:g}{spread}"


def json_page() -> str:
    """docs/reference/json.md."""
    lines = ["# Keys of `--json`", "", GENERATED]
    for head, keys in (
        ("A row of `shifts` of `replay --strategy`", JUDGED_KEYS),
        ("`counterfactual` of such a row", COUNTERFACTUAL_KEYS),
        ("`strategies.NAME` of `campaign`, over all judged shifts", STRATEGY_KEYS),
    ):
        rows = [(f"`{key}`", meaning) for key, meaning in keys.items()]
        lines += ["", f"## {head}", "", *_table(("key", "meaning"), rows)]
    lines += [
        "", "Times of a replay are ms since the request; what they say: "
        "[replay.md](../replay.md#open-loop). The figures that `--fail-if` takes: "
        "[ci.md](../ci.md#without-any-can-virtual-time).",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def vectors_page() -> str:
    """docs/reference/vectors.md."""
    heads = ("message", "what it says", "identifier", "data ID", "frame, as cansend takes it")
    lines = [
        "# Test vectors", "", GENERATED, "",
        "Whole frames of both sides ([wire.md](../wire.md)). Counters begin at 0, rise with each "
        "frame of an identifier; the data ID is AUTOSAR E2E profile 5's. `##1` is CAN FD with "
        "bit rate switch, `#` a classic one: `cansend can0 IDENTIFIERFRAME` sends it.", "",
        *_table(heads, vectors.rows()), "",
        "## What a valve side does", "",
        "The rig's valve drivers are held to each of these (`tests/rig_sim/test_valves.py`).", "",
        *_table(("it is sent", "it does"), vectors.VALVE_SIDE),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _milliseconds(time_ns: int | None) -> str:
    return "none" if time_ns is None else f"{time_ns / 1e6:.2f}"


def _command(name: str, parser: argparse.ArgumentParser) -> list[str]:
    lines = ["", f"## {name}", "", " ".join((parser.description or "").split())]
    lines = lines if parser.description else lines[:-2]
    rows = [
        (_words(action), _help(action, parser))
        for action in parser._actions
        if action.help not in (None, argparse.SUPPRESS)
        and not isinstance(action, (argparse._HelpAction, argparse._SubParsersAction))
    ]
    if rows:
        lines += ["", *_table(("argument", "meaning"), rows)]
    if parser.epilog:
        lines += ["", "```sh", *(line.strip() for line in parser.epilog.splitlines()[1:]), "```"]
    for action, inner in subparsers(parser).items():
        lines += _command(f"{name} {action}", inner)
    return lines


def _words(action: argparse.Action) -> str:
    metavar = action.metavar or ("|".join(map(str, action.choices)) if action.choices else "")
    if not action.option_strings:
        return f"`{metavar or action.dest}`"
    value = f" {metavar or action.dest.upper()}" if action.nargs != 0 else ""
    return f"`{', '.join(action.option_strings)}{value}`"


def _help(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    return (action.help or "") % {**vars(action), "prog": parser.prog}


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    cells = [[" ".join(cell.split()).replace("|", "\\|") for cell in row] for row in rows]
    lines = [columns, ["---"] * len(columns), *cells]
    return [f"| {' | '.join(line)} |" for line in lines]


PAGES: Final[dict[str, Callable[[], str]]] = {
    "settings.md": settings_page,
    "calibration.md": calibration_page,
    "gearbox.md": gearbox_page,
    "commands.md": commands_page,
    "bus.md": bus_page,
    "json.md": json_page,
    "rig.md": rig_page,
    "vectors.md": vectors_page,
}
"""Each page by its file's name."""


def main(given: Sequence[str] | None = None) -> int:
    """Writes or checks the pages."""
    parser = argparse.ArgumentParser(description="Reference pages from the code.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing; 1 where one differs")
    chosen = parser.parse_args(given)
    stale = []
    for name, page in PAGES.items():
        path: Path = chosen.folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != page():
            stale.append(str(path))
            if not chosen.check:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(page(), encoding="utf-8", newline="\n")
    if chosen.check and stale:
        sys.stderr.write(f"out of date: {', '.join(stale)}; `make reference` writes them\n")
        return Exit.FAILED
    return Exit.DONE


if __name__ == "__main__":
    sys.exit(main())
