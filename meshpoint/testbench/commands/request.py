"""`meshpoint request`: asks the controller for a gear over the bus, as a bench would."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import can

from meshpoint.bus.frames import frame_of
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import TC1, ControllerState, ControllerStatus, ShiftOutcome, ShiftResult
from meshpoint.dbc.node import Node
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.testbench.commands import arguments
from meshpoint.testbench.exits import Exit

AGAIN_S = 0.2
"""The request is repeated until the controller is seen to act on it."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "request",
        help="ask for a gear over the bus",
        description="Sends J1939 TC1 with the gear asked for and waits for the shift's outcome. "
        "Gears are 1 to 12; 13 and 14 are the crawl gears.",
    )
    parser.add_argument("gear", type=arguments.whole(1, len(DRIVE_GEARS)), metavar="GEAR")
    parser.add_argument(
        "--timeout",
        type=float,
        default=10.0,
        metavar="S",
        help="wall seconds to wait for the outcome; 0: send once and do not wait (default: 10)",
    )
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Sends the request and reports what comes of it."""
    request = Transmitter(Node.BENCH).encode(TC1(requested_gear=namespace.gear))
    message = can.Message(
        arbitration_id=request.can_id, data=request.data, is_extended_id=True, is_fd=False
    )
    with open_bus_from(namespace) as bus:
        if namespace.timeout <= 0:
            bus.send(message)
            print(f"asked for gear {namespace.gear}")
            return Exit.DONE
        return _wait(bus, message, namespace.gear, namespace.timeout)


def _wait(bus: can.BusABC, request: can.Message, gear: int, timeout_s: float) -> int:
    receiver = Receiver(Node.BENCH)
    end_s, again_s = time.monotonic() + timeout_s, 0.0
    heard = acting = False
    while (now_s := time.monotonic()) < end_s:
        if now_s >= again_s and not acting:
            bus.send(request)
            again_s = now_s + AGAIN_S
        received = bus.recv(min(0.05, end_s - now_s))
        if received is None:
            continue
        frame = frame_of(received)
        answer = receiver.receive(frame).message
        if isinstance(answer, ControllerStatus):
            heard = True
            acting = answer.target_gear == gear
            if acting and answer.current_gear == gear and answer.state is ControllerState.IN_GEAR:
                print(f"in gear {gear}")
                return Exit.DONE
        elif isinstance(answer, ShiftOutcome) and answer.to_gear == gear:
            return _report(answer)
    why = "the shift did not end" if heard else "no controller was heard on this bus"
    print(f"meshpoint request: {why} within {timeout_s:g} s", file=sys.stderr)
    return Exit.FAILED


def _report(outcome: ShiftOutcome) -> int:
    took_ms = ((outcome.end_time_us - outcome.request_time_us) & 0xFFFF_FFFF) / 1000
    result = outcome.result.name.lower().replace("_", " ")
    line = f"{outcome.from_gear} -> {outcome.to_gear}: {result}"
    if outcome.result is ShiftResult.ENGAGED:
        strategy = outcome.strategy.name.lower()
        print(f"{line} after {took_ms:.0f} ms ({strategy}, {outcome.attempts} fired)")
        return Exit.DONE
    print(f"{line}, fault {outcome.fault.name.lower()}", file=sys.stderr)
    return Exit.FAILED
