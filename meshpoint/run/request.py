"""`meshpoint request`: asks the controller for a gear over the bus, as a bench would."""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import can

from meshpoint.base.exits import Exit
from meshpoint.bus import given_numbers
from meshpoint.bus.frames import frame_of
from meshpoint.bus.options import add_bus_arguments, open_bus_from
from meshpoint.bus.slowness import times_slower
from meshpoint.cli import arguments
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import (
    TC1,
    ControllerState,
    ControllerStatus,
    FaultCode,
    Message,
    ShiftOutcome,
    ShiftResult,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.results.aborts import aborts_words, halt_mm
from meshpoint.results.faults import STALE_FAULTS, explain
from meshpoint.results.output import complain, tell
from meshpoint.results.states import standing_words

AGAIN_S = 0.2
"""The request is repeated until the controller is seen to act on it."""
POLL_S = 0.05
SILENT_S = 2.0
"""How long nothing is said while no controller is heard."""


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "request",
        description="Sends J1939 TC1 with the gear asked for and waits for the shift's outcome. "
        "Gears are 1 to 12; 13 and 14 are the crawl gears. Where the shift fails because a node "
        "was late, it says so and asks again.",
    )
    parser.add_argument("gear", type=given_numbers.whole(1, len(DRIVE_GEARS)), metavar="GEAR")
    parser.add_argument(
        "--timeout",
        type=given_numbers.seconds,
        default=10.0,
        metavar="S",
        help="seconds to wait for the outcome, of bus time where that goes slower than the wall "
        "clock; 0: send once and do not wait (default: 10)",
    )
    arguments.add_wire(parser)
    add_bus_arguments(parser)
    parser.set_defaults(run=run)


def run(namespace: argparse.Namespace) -> int:
    """Sends the request and reports what comes of it."""
    request = Transmitter(Node.BENCH).encode(TC1(requested_gear=namespace.gear))
    message = can.Message(
        arbitration_id=request.can_id, data=request.data, is_extended_id=True, is_fd=False
    )
    with open_bus_from(namespace) as bus:
        if namespace.timeout == 0.0:
            bus.send(message)
            tell(f"asked for gear {namespace.gear}")
            return Exit.DONE
        unpack = arguments.unpack_of(namespace)
        return _wait(bus, message, namespace.gear, namespace.timeout, unpack)


def _wait(
    bus: can.BusABC,
    request: can.Message,
    gear: int,
    timeout_s: float,
    unpack: Callable[[Frame], Iterable[Frame]],
) -> int:
    receiver = Receiver(Node.BENCH)
    asking = _Asking(gear, timeout_s, time.monotonic())
    while not asking.over(now_s := time.monotonic()):
        if asking.begins_to_wait(now_s):
            _complain(
                f"no controller is heard on {bus.channel_info} yet; waits for {timeout_s:g} s"
            )
        if asking.due(now_s):
            bus.send(request)
        received = bus.recv(POLL_S)
        if received is None:
            continue
        for heard in unpack(frame_of(received)):
            code = asking.hear(receiver.receive(heard).message, time.monotonic())
            if code is not None:
                return code
    _complain(asking.failure())
    return Exit.FAILED


class _Asking:
    """One request, from its first frame to an outcome that is final."""

    def __init__(self, gear: int, timeout_s: float, now_s: float) -> None:
        self._gear, self._timeout_s = gear, timeout_s
        self._patience_s = timeout_s * times_slower()
        """How long a controller that was heard may be silent: one on a slow machine computes."""
        self._again_s = now_s
        self._asked = 0
        self._acting = False
        self._status: ControllerStatus | None = None
        self._says_waiting_s = now_s + SILENT_S
        self._late: Counter[FaultCode] = Counter()
        """Outcomes that only a late node was to blame for."""
        self._waited_s = 0.0
        """Up to the last status frame."""
        self._heard_s = now_s
        """When that came; before the first, when the waiting began."""

    def due(self, now_s: float) -> bool:
        """Whether to send the request now; then it counts as sent."""
        if self._acting or now_s < self._again_s:
            return False
        self._again_s = now_s + AGAIN_S
        self._asked += 1
        return True

    def begins_to_wait(self, now_s: float) -> bool:
        """Whether to say that no controller is heard; once."""
        begins = self._status is None and now_s >= self._says_waiting_s
        if begins:
            self._says_waiting_s = math.inf
        return begins

    def over(self, now_s: float) -> bool:
        """Whether the time is up: that of the bus, or the wall's where no controller is heard."""
        silent_s = now_s - self._heard_s
        patience_s = self._timeout_s if self._status is None else self._patience_s
        return self._waited_s >= self._timeout_s or silent_s >= patience_s

    def hear(self, message: Message | None, now_s: float) -> int | None:
        """The exit code, once the outcome is final."""
        if isinstance(message, ControllerStatus):
            return self._hear_status(message, now_s)
        if isinstance(message, ShiftOutcome) and message.to_gear == self._gear:
            return self._hear_outcome(message)
        return None

    def _hear_status(self, status: ControllerStatus, now_s: float) -> int | None:
        passed_s = now_s - self._heard_s
        if self._status is not None:
            bus_s = (status.step_time_us - self._status.step_time_us) / 1e6
            passed_s = min(passed_s, bus_s) if bus_s >= 0.0 else passed_s  # a new controller
        self._waited_s += passed_s
        self._heard_s, self._status = now_s, status
        self._acting = status.target_gear == self._gear
        there = status.current_gear == self._gear and status.state is ControllerState.IN_GEAR
        if not (self._acting and there):
            return None
        tell(f"in gear {self._gear}")
        return Exit.DONE

    def _hear_outcome(self, outcome: ShiftOutcome) -> int | None:
        result = outcome.result.name.lower().replace("_", " ")
        line = f"{outcome.from_gear} -> {outcome.to_gear}: {result}"
        if outcome.result is ShiftResult.ENGAGED:
            took_ms = ((outcome.end_time_us - outcome.request_time_us) & 0xFFFF_FFFF) / 1000
            strategy = outcome.strategy.name.lower()
            fired = f"{outcome.attempts} fired"
            if outcome.aborts:
                fired += f", aborted {aborts_words(outcome.aborts, halt_mm(outcome))}"
            tell(f"{line} after {took_ms:.0f} ms ({strategy}, {fired})")
            return Exit.DONE
        if outcome.fault not in STALE_FAULTS:
            _complain(f"{line}, {explain(outcome.fault)}")
            return Exit.FAILED
        self._late[outcome.fault] += 1
        self._acting = False
        if self._late[outcome.fault] == 1:
            _complain(f"{line}, {explain(outcome.fault)}; asking again")
        return None

    def failure(self) -> str:
        """Why there is no outcome, and what was tried."""
        if self._status is None:
            return (
                f"no controller was heard on this bus within {self._timeout_s:g} s; "
                "`meshpoint up` in another terminal starts one"
            )
        if self._waited_s < self._timeout_s:
            return f"the controller was heard, then was silent for {self._patience_s:g} s"
        tried = f"asked {self._asked} times"
        if self._late:
            late = ", ".join(f"{n} x {fault.name.lower()}" for fault, n in self._late.items())
            tried += f", a node was late each time ({late})"
        return (
            f"the shift did not end within {self._timeout_s:g} s of bus time: {tried}; "
            f"the controller stands {_where(self._status)}"
        )


def _where(status: ControllerStatus) -> str:
    state = standing_words(status)
    fault = status.active_fault
    return f"{state}, {explain(fault)}" if fault is not FaultCode.NONE else state


def _complain(line: str) -> None:
    complain(f"meshpoint request: {line}")
