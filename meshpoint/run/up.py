"""`meshpoint up`: rig, controller and their bus time in one terminal, until Ctrl-C."""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import can

from meshpoint.base.exits import Exit
from meshpoint.bus.frames import frame_of
from meshpoint.bus.options import add_bus_arguments, given_bus_arguments, open_bus_from
from meshpoint.bus.pace import PaceFile
from meshpoint.bus.signals import stop_on_signals
from meshpoint.cli import arguments
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ControllerState, ControllerStatus
from meshpoint.dbc.node import Node
from meshpoint.results.output import complain
from meshpoint.run.children import Child, end_all, spawn
from meshpoint.run.firmware_argument import add_firmware, firmware_of
from meshpoint.run.free_bus import check_no_nodes
from meshpoint.run.nodes import add_header_dir, add_rig_start
from meshpoint.run.pace import keep_pace_alone

DESCRIPTION: Final = """\
Runs rig and controller as two processes on one bus time that waits for both, so that it works on a
busy machine too, and prints what they say. In another terminal `meshpoint request 10` asks for a
gear. Ctrl-C or SIGTERM ends both with all valves off: exit code 0, or 1 where a node could not
write its log or records. A node that ends by itself ends all: exit code 1, or 2 where its input was
bad; its own message stands above."""
AT_REST: Final = (ControllerState.IN_GEAR, ControllerState.NEUTRAL)


def add_parser(commands: Any) -> None:
    """The command's arguments."""
    parser: argparse.ArgumentParser = commands.add_parser("up", description=DESCRIPTION)
    parser.add_argument(
        "--pace-only",
        type=Path,
        metavar="FILE",
        help="start no node: keep a bus time in FILE, made anew and removed at the end, for nodes "
        "that are started elsewhere with `--pace FILE` and the same --speed. It goes with the wall "
        "clock, but waits wherever a node has not done its step yet",
    )
    both = parser.add_argument_group("both nodes")
    arguments.add_gearbox(both, has_preset=True)
    arguments.add_keys(both)
    arguments.add_wire(both)
    arguments.add_speed(both)
    both.add_argument(
        "-q", "--quiet", action="store_true", help="only errors, not the nodes' lines"
    )
    rig = parser.add_argument_group("rig")
    arguments.add_rig(rig)
    arguments.add_truck(rig)
    add_firmware(rig)
    add_rig_start(rig)
    controller = parser.add_argument_group("controller")
    arguments.add_controller(controller)
    arguments.add_arming(controller)
    arguments.add_xcp(controller)
    arguments.add_calibration(controller)
    add_header_dir(controller)
    arguments.add_log(controller)
    parser.set_defaults(
        run=run,
        both=_forwarded(both, but="quiet"),
        rig=_forwarded(rig),
        controller=_forwarded(controller),
    )
    add_bus_arguments(parser)


def _forwarded(group: argparse._ArgumentGroup, but: str = "") -> list[argparse.Action]:
    """The arguments of a group, which a node gets as they were given."""
    return [action for action in group._group_actions if action.dest != but]


def run(namespace: argparse.Namespace) -> int:
    """Runs both until a signal."""
    if namespace.pace_only is not None:
        keep_pace_alone(namespace.pace_only, namespace.speed)
        return Exit.DONE
    namespace.gearbox = arguments.gearbox_of(namespace)  # the controller knows no preset
    # Bad settings and keys are found before anything is started.
    arguments.armed_of(namespace)
    arguments.keys_of(namespace)
    arguments.settings_of(namespace)
    arguments.xcp_of(namespace)
    firmware_of(namespace)
    with open_bus_from(namespace) as bus:
        check_no_nodes(bus)
        return asyncio.run(_run(namespace, bus))


async def _run(namespace: argparse.Namespace, bus: can.BusABC) -> int:
    stop = asyncio.Event()
    children: list[Child] = []
    with (
        stop_on_signals(stop),
        tempfile.TemporaryDirectory(prefix="meshpoint-") as folder,
        _Greeting(bus, arguments.unpack_of(namespace)) as greeting,
    ):
        show = None if namespace.quiet else _show
        try:
            for name, command in _commands(namespace, Path(folder) / "pace"):
                children.append(await spawn(name, command, show))
            if not namespace.quiet:
                greeting.start()
            dead = await _until_stop(stop, children)
        finally:
            # The controller first: its valves are off before the gearbox goes.
            bad = await end_all(list(reversed(children)))
    if dead is not None:
        complain(f"meshpoint up: {dead.name} ended by itself with exit code {dead.code}")
        if namespace.quiet:
            complain("\n".join(dead.said))
        return Exit.BAD_INPUT if dead.code == Exit.BAD_INPUT else Exit.FAILED
    for child in bad:
        complain(f"meshpoint up: {child.name} ended with exit code {child.code}")
    return Exit.FAILED if bad else Exit.DONE


def _commands(namespace: argparse.Namespace, pace: Path) -> list[tuple[str, list[str]]]:
    """The three processes in the order in which they are started."""
    PaceFile.create(pace)
    bus = given_bus_arguments(namespace)
    both = [*_given(namespace, namespace.both), *bus, "--pace", str(pace), "--until-eof"]
    return [
        ("pace", ["-m", "meshpoint.bus.pace", str(pace), "--speed", str(namespace.speed)]),
        ("rig", ["-m", "meshpoint", "rig", *_given(namespace, namespace.rig), *both]),
        (
            "controller",
            ["-m", "meshpoint", "controller", *_given(namespace, namespace.controller), *both],
        ),
    ]


def _given(namespace: argparse.Namespace, actions: Sequence[argparse.Action]) -> list[str]:
    """These arguments as a node's own command line, where they are not the default."""
    words: list[str] = []
    for action in actions:
        value = getattr(namespace, action.dest)
        if value == action.default:
            continue
        if isinstance(action, argparse.BooleanOptionalAction):
            words.append(action.option_strings[0 if value else 1])
        elif action.nargs == 0:
            words.append(action.option_strings[-1])
        else:
            words += [action.option_strings[-1], str(value)]
    return words


async def _until_stop(stop: asyncio.Event, children: list[Child]) -> Child | None:
    """Waits for a signal or for a child that ends by itself; that child."""
    signalled = asyncio.ensure_future(stop.wait())
    ends = {asyncio.ensure_future(child.process.wait()): child for child in children}
    done, left = await asyncio.wait([signalled, *ends], return_when=asyncio.FIRST_COMPLETED)
    for task in left:
        task.cancel()
    return None if signalled in done else next(ends[task] for task in ends if task in done)


class _Greeting:
    """Says when the controller knows its gear: from then on it takes requests."""

    def __init__(self, bus: can.BusABC, unpack: Callable[[Frame], Iterable[Frame]]) -> None:
        self._bus = bus
        self._unpack = unpack
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._listen)

    def __enter__(self) -> _Greeting:
        return self

    def start(self) -> None:
        """Listens from now on."""
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()

    def _listen(self) -> None:
        receiver = Receiver(*Node)
        while not self._ending.is_set():
            try:
                message = self._bus.recv(0.1)
            except can.CanError:
                return  # the nodes say what became of the bus
            if message is None:
                continue
            for heard in self._unpack(frame_of(message)):
                status = receiver.receive(heard).message
                if isinstance(status, ControllerStatus) and status.state in AT_REST:
                    gear = status.current_gear
                    _show("up", f"in gear {gear}, ready for requests; Ctrl-C ends it")
                    return


def _show(name: str, line: str) -> None:
    complain(f"{name:10} | {line}")
