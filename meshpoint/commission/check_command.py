"""`meshpoint check`: is this bus, and what is on it, ready for the controller?"""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from typing import Any, Final

import can
from rich.table import Table
from rich.text import Text

from meshpoint.base.errors import CommandError
from meshpoint.base.exits import Exit
from meshpoint.bus import given_numbers
from meshpoint.bus.clock import NodeClock
from meshpoint.bus.options import (
    DEFAULT_INTERFACE,
    BusOpenError,
    add_bus_arguments,
    bus_config,
    open_bus_from,
)
from meshpoint.bus.profile import WireProfile
from meshpoint.cli import arguments
from meshpoint.cli.pace import add_pace, clock_of
from meshpoint.commission.alive import SIGN_OF_LIFE, judge_alive
from meshpoint.commission.finding import Finding, Verdict, answer, answer_words
from meshpoint.commission.interface import (
    GROUP,
    NO_CONTROLLER,
    LinkError,
    LinkState,
    judge_link,
    judge_socket,
    read_link,
    without_link,
)
from meshpoint.commission.listener import Listener
from meshpoint.commission.shafts import CLASSIC_SHAFTS, FEW_EDGES, Shaft, judge_turned
from meshpoint.results.output import complain, console, write_json

WAIT_S: Final = 0.2
COLOURS: Final = {
    Verdict.GOOD: "green",
    Verdict.BAD: "red",
    Verdict.UNKNOWN: "yellow",
    Verdict.NOTE: "cyan",
}


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "check",
        description="Listens, sends nothing, and says whether the controller could work here: the "
        "interface as the system says it (bit rates, CAN FD, sample point, restart-ms, queue "
        "length, receive buffer, error counters), the scatter of its time stamps, each expected "
        "message with rate, age and end-to-end state, and whether sensors and tooth counts are "
        "plausible. Ends in yes (exit code 0) or no (1), with the reason; what cannot be known on "
        "this bus is said and is no reason for a no. docs/bench.md has the whole first day.",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--alive",
        choices=tuple(SIGN_OF_LIFE),
        metavar="NODE",
        help="only whether this node, controller or rig, is at work: yes as soon as its status "
        "frames are heard; for health checks of containers and services",
    )
    parser.add_argument(
        "--seconds",
        type=given_numbers.some_seconds,
        default=5.0,
        metavar="S",
        help="how long to listen (default: 5), with --alive at most; tooth counts need a shaft "
        "that turns meanwhile",
    )
    what.add_argument(
        "--turn",
        nargs="*",
        choices=tuple(Shaft),
        metavar="SHAFT",
        help="asks for each of these shafts to be turned by hand, one after the other, and says "
        "whose sensor counted (input, layshaft, main, propeller; alone: all four)",
    )
    parser.add_argument(
        "--turn-seconds",
        type=given_numbers.some_seconds,
        default=15.0,
        metavar="S",
        help="how long to wait for each shaft to turn (default: 15)",
    )
    arguments.add_gearbox(parser)
    arguments.add_wire(parser)
    add_pace(parser)
    arguments.add_json(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Listens, asks, judges."""
    sheet = arguments.sheet_of(namespace)
    config = bus_config_of(namespace)
    link = _link(config)
    findings: list[Finding] = []
    try:
        bus = open_bus_from(namespace)
    except BusOpenError as error:
        findings.append(Finding(GROUP, "open", Verdict.BAD, str(error)))
        if isinstance(link, LinkState):
            findings += judge_link(link, profile=arguments.wire_of(namespace))
        return _end(namespace, config, findings)
    if namespace.alive is not None:
        with bus:
            return _end(namespace, config, [judge_alive(bus, namespace)])
    profile = arguments.wire_of(namespace)
    is_classic = profile is WireProfile.CLASSIC
    uncounted = set(namespace.turn or ()) - {str(shaft) for shaft in _counted(namespace)}
    if uncounted:
        names = " and ".join(sorted(uncounted))
        raise CommandError(f"--turn {names}: --profile classic carries no edges of these shafts")
    listener = Listener(sheet, arguments.unpack_all_of(namespace, sheet) if is_classic else None)
    clock = clock_of(namespace, "controller")  # in whose place it listens
    with bus:
        socket_finding = judge_socket(bus)
        complain(f"listening for {namespace.seconds:g} s on {bus.channel_info}")
        try:
            _listen(bus, listener, clock, namespace.seconds)
            turned = _ask_to_turn(bus, listener, clock, namespace) if listener.frames else []
        except (can.CanError, OSError) as error:
            findings.append(Finding(GROUP, "bus", Verdict.BAD, f"lost while listening: {error}"))
            turned = []
    findings += _interface_findings(config, link, profile)
    findings.append(socket_finding)
    is_vcan = isinstance(link, LinkState) and link.kind == "vcan"
    has_controller = config["interface"] not in NO_CONTROLLER and not is_vcan
    where = f"{bus.channel_info} in {namespace.seconds:g} s"
    heard = listener.findings(where)
    findings += [f if has_controller else _machine_alone(f) for f in heard]
    return _end(namespace, config, findings + turned)


def bus_config_of(namespace: argparse.Namespace) -> dict[str, Any]:
    """The bus that is asked for; where python-can's settings forbid it, what of it was given."""
    try:
        return bus_config(namespace)
    except BusOpenError:
        given = {"interface": getattr(namespace, "interface", DEFAULT_INTERFACE)}
        with suppress(AttributeError):
            given["channel"] = namespace.channel
        return given


def _link(config: dict[str, Any]) -> LinkState | LinkError | None:
    """The state of a SocketCAN device before listening; None for other interfaces."""
    if config["interface"] != "socketcan" or config.get("channel") is None:
        return None
    try:
        return read_link(str(config["channel"]))
    except LinkError as error:
        return error


def _interface_findings(
    config: dict[str, Any], before: LinkState | LinkError | None, profile: WireProfile
) -> list[Finding]:
    if before is None:
        return [without_link(config["interface"])]
    now = _link(config)
    if isinstance(now, LinkState):
        earlier = before if isinstance(before, LinkState) else None
        return list(judge_link(now, earlier, profile))
    return [Finding(GROUP, "link", Verdict.UNKNOWN, str(now))]


def _machine_alone(finding: Finding) -> Finding:
    """Without any hardware, late stamps and drift are the machine's, not the bench's."""
    if finding.group == "stamps" and finding.verdict is Verdict.BAD:
        text = f"{finding.text} (no CAN hardware here: the machine's own delays)"
        return finding._replace(verdict=Verdict.NOTE, text=text)
    return finding


def _listen(bus: can.BusABC, listener: Listener, clock: NodeClock, seconds: float) -> None:
    end_us = clock.now_us() + round(seconds * 1e6)
    while (left_us := end_us - clock.now_us()) > 0:
        _take(bus, listener, clock, min(clock.wall_s(left_us), WAIT_S))


def _take(bus: can.BusABC, listener: Listener, clock: NodeClock, wait_s: float) -> None:
    message = bus.recv(wait_s)
    now_s = clock.now_us() * 1e-6
    if message is None:
        listener.heard.idle(now_s)
    else:
        listener.take(now_s, message)


def _ask_to_turn(
    bus: can.BusABC, listener: Listener, clock: NodeClock, namespace: argparse.Namespace
) -> list[Finding]:
    """Asks on standard error; goes on as soon as a shaft has counted."""
    if namespace.turn is None:
        return []
    found = []
    for name in namespace.turn or _counted(namespace):
        asked, before = Shaft(name), listener.edges()
        complain(f"turn the {asked} shaft by hand, and no other ({namespace.turn_seconds:g} s)")
        end_us = clock.now_us() + round(namespace.turn_seconds * 1e6)
        turned = dict.fromkeys(Shaft, 0)
        while clock.now_us() < end_us and max(turned.values()) < 3 * FEW_EDGES:
            _take(bus, listener, clock, WAIT_S)
            turned = {shaft: n - before[shaft] for shaft, n in listener.edges().items()}
        found.append(judge_turned(asked, turned))
        complain(f"  {found[-1].verdict}: {found[-1].text}")
    return found


def _counted(namespace: argparse.Namespace) -> tuple[Shaft, ...]:
    """The shafts whose edges are on the bus."""
    is_classic = arguments.wire_of(namespace) is WireProfile.CLASSIC
    return CLASSIC_SHAFTS if is_classic else tuple(Shaft)


def findings_table(findings: list[Finding]) -> Table:
    """One row a finding."""
    table = Table(box=None, pad_edge=False, collapse_padding=True)
    for column in ("what", "", "seen"):
        table.add_column(column, overflow="fold")
    for each in findings:
        verdict = Text(each.verdict, COLOURS[each.verdict])
        table.add_row(f"{each.group}: {each.subject}", verdict, each.text)
    return table


def _end(namespace: argparse.Namespace, config: dict[str, Any], findings: list[Finding]) -> int:
    is_ready, reason = answer(findings)
    channel = config.get("channel")
    out = console(namespace.json)
    out.print(findings_table(findings))
    out.print(answer_words(is_ready, reason), soft_wrap=True)
    if namespace.json is not None:
        values = {
            "interface": config["interface"],
            "channel": None if channel is None else str(channel),
            "seconds": namespace.seconds,
            "ready": is_ready,
            "reason": reason,
            "findings": [finding.to_json() for finding in findings],
        }
        write_json(namespace.json, values)
    sys.stdout.flush()
    return Exit.DONE if is_ready else Exit.FAILED
