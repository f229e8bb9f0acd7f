"""The rig as a node: frames in, frames out, the gearbox in between. No clock and no I/O."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

from meshpoint.bus.core import Step
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import is_intact, torque_share
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import FrameVerdict, Receiver, Transmitter
from meshpoint.dbc.messages import (
    TSC1,
    BenchAction,
    BenchCommand,
    BenchFault,
    ClutchAction,
    ClutchCommand,
    Message,
    TscOverrideMode,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.command_inbox import CommandInbox
from meshpoint.rig_sim.frames import TRUTH, engagement_message, read_messages, valve_status
from meshpoint.rig_sim.orders import EngineRequest, FaultOrder
from meshpoint.rig_sim.presets import build_world
from meshpoint.rig_sim.settings import RigSettings
from meshpoint.rig_sim.shared.valve_drivers import EXPIRY_US, Order
from meshpoint.rig_sim.suspicions import Suspicions
from meshpoint.rig_sim.truck_nodes.nodes import TruckNodes

NODES: Final = (Node.GEARBOX_IO, Node.ENGINE, Node.REFERENCE)
FROM_IO: Final = frozenset(
    codec.message_type for codec in CODECS.values() if codec.spec.sender == Node.GEARBOX_IO
)
ENGINE_REQUEST: Final = CODECS[TSC1.__name__].spec.can_id


class RigCore:
    """Plays GearboxIo, Engine and Reference, and the truck's other nodes where it is asked to.
    Power-up, time zero, is the first step.

    A frame takes effect at the step that consumes it, after everything that was due by then. What
    the receiver does not pass is counted there and changes nothing.
    """

    def __init__(self, sheet: GearboxSheet, settings: RigSettings) -> None:
        self._world = build_world(sheet, settings)
        self._transmitter = Transmitter(*NODES)
        self.receiver = Receiver(*NODES)
        self._inbox = CommandInbox()
        self._start_us: int | None = None
        self._last_sequence: int | None = None
        self._last_fault: int | None = None
        self._last_valves: ValveCommand | None = None
        self._node = self._world.node
        self._restarts = 0
        self._suspicions = Suspicions()
        self._dropped = 0
        self.truth = self._world.truth
        self._truck_nodes = TruckNodes(settings.seed) if settings.truck_nodes else None

    @property
    def as_built(self) -> dict[str, Any] | None:
        """What was drawn for the rig, and the conditions it works in; None in preset thesis."""
        return self._world.as_built

    def change_conditions(self, values: Mapping[str, float]) -> None:
        """Other oil, load, slope or supply from now on, by their as-built names; preset truck."""
        self._world.change_conditions(values)

    def skip_unsubscribed(self, messages: Collection[type[Message]]) -> None:
        """Nobody on this bus reads these messages: of those that take time to work out, empty
        frames are sent."""
        self._transmitter.skip_unsubscribed(messages)

    @property
    def next_step_us(self) -> int:
        """The next read; at once where a valve command waits or nothing has been stepped yet. A
        rig that hangs (a fault) is not called before it goes on."""
        if self._start_us is None:
            return 0
        stalled_us = self._node.stalled_until_us
        if self._inbox.is_urgent:
            return self._start_us + stalled_us if stalled_us else 0
        return self._start_us + max(self._world.next_read_us, stalled_us)

    def receive(self, frame: Frame) -> None:
        """Keep a frame for the next step; a valve command asks for that step at once, and so does
        a clutch command other than the one before."""
        self._inbox.receive(frame)

    def step(self, now_us: int) -> Step:
        """Go on to now, sending every read that was due; then obey the frames received."""
        if self._start_us is None:
            self._start_us = now_us
        time_us = now_us - self._start_us
        if time_us < self._node.stalled_until_us:
            return Step([], [])
        frames: list[Frame] = []
        read_us = self._world.next_read_us
        while self._world.run_to(time_us):
            self._send_engaged(frames)
            self._send_read(frames, read_us)
            read_us = self._world.next_read_us
        heard = [self._hear(frame) for frame in self._inbox.take()]
        self.receiver.tick(now_us)
        for message in heard:
            if message is not None:
                self._obey(message, time_us)
        self._send_engaged(frames)
        return Step(frames, self._take_lines(time_us))

    def _hear(self, frame: Frame) -> Message | None:
        if frame.can_id == ENGINE_REQUEST and len(frame.data) == 8 and not is_intact(frame):
            self._suspicions.judge(frame.can_id, FrameVerdict.E2E)
            return None
        verdict, message = self.receiver.receive(frame)
        self._suspicions.judge(frame.can_id, verdict)
        return message

    def shutdown(self, now_us: int) -> Step:
        """Go on to now, switch all valves off and say so."""
        frames, events = self.step(now_us)
        time_us = now_us - (self._start_us or 0)
        self._world.all_valves_off(time_us)
        if not self._node.away:
            frames.append(self._transmitter.encode(valve_status(self._world, time_us)))
        return Step(frames, events + self._take_lines(time_us))

    def _obey(self, message: Message, time_us: int) -> None:
        if self._node.away and isinstance(message, (ValveCommand, ClutchCommand)):
            return
        if isinstance(message, ValveCommand):
            if self.receiver.valid(ValveCommand):
                self._command_valves(message, time_us)
        elif isinstance(message, ClutchCommand):
            if self.receiver.valid(ClutchCommand):
                self._world.command_clutch(message.action is ClutchAction.CLOSE, time_us)
        elif isinstance(message, BenchCommand):
            asked = message.action is BenchAction.RETURN_TO_GEAR
            if asked and message.sequence != self._last_sequence:
                self._last_sequence = message.sequence
                self._world.return_to_gear(message.gear, message.main_speed_rad_s, time_us)
        elif isinstance(message, BenchFault):
            if message.sequence != self._last_fault:
                self._last_fault = message.sequence
                self._world.inject(_fault(message), time_us)
        elif isinstance(message, TSC1):
            self._world.command_engine(_engine_request(message), time_us)

    def _command_valves(self, command: ValveCommand, time_us: int) -> None:
        if command == self._last_valves and self._world.renew_valves(time_us):
            return
        self._last_valves = command
        self._world.command_valves(_orders(command), time_us)

    def _send_read(self, frames: list[Frame], read_us: int) -> None:
        messages, node = read_messages(self._world, read_us), self._node
        if node.away:
            messages = [message for message in messages if type(message) not in FROM_IO]
        elif node.restarts != self._restarts:
            self._restarts = node.restarts
            self._transmitter.restart(Node.GEARBOX_IO)
            self.receiver = Receiver(*NODES)
            self._last_valves = None
        encode = self._transmitter.encode
        frames.extend(map(encode, messages))
        for kind, read in TRUTH.items():
            unread = self._transmitter.unread(kind)
            frames += [encode(read(self._world, read_us))] if unread is None else unread
        if self._truck_nodes is not None:
            frames += self._truck_nodes.frames(self.truth, read_us)

    def _send_engaged(self, frames: list[Frame]) -> None:
        for engaged in self._world.take_engaged():
            message = engagement_message(engaged, self._world.clock)
            frames.append(self._transmitter.encode(message))

    def _take_lines(self, time_us: int) -> list[str]:
        lines = [
            f"{at_us / 1e6:.6f} s since its start: {text}"
            for at_us, text in self._world.take_lines()
        ]
        if self._world.valves.dropped > self._dropped:
            self._dropped = self._world.valves.dropped
            silent_ms = EXPIRY_US // 1000
            lines.append(
                f"{time_us / 1e6:.6f} s since its start: no valve command for {silent_ms} ms: "
                "all valves off"
            )
        return lines + self._suspicions.take_lines(time_us)


def _orders(command: ValveCommand) -> tuple[Order, ...]:
    return (
        Order(command.brake_action, command.brake_time_us),
        Order(command.split_low_action, command.split_low_time_us),
        Order(command.split_high_action, command.split_high_time_us),
        Order(command.main_first_action, command.main_first_time_us),
        Order(command.main_second_action, command.main_second_time_us),
        Order(command.main_crawl_action, command.main_crawl_time_us),
        Order(command.main_third_action, command.main_third_time_us),
        Order(command.range_low_action, command.range_low_time_us),
        Order(command.range_high_action, command.range_high_time_us),
    )


def _fault(message: BenchFault) -> FaultOrder:
    return FaultOrder(int(message.fault), message.target, message.value, message.duration_us)


def _engine_request(message: TSC1) -> EngineRequest:
    """TSC1 as the engine takes it; torque limits (mode 3) are no request here."""
    if message.override_control_mode is TscOverrideMode.SPEED_CONTROL:
        return EngineRequest(message.requested_speed_rad_s, None)
    if message.override_control_mode is TscOverrideMode.TORQUE_CONTROL:
        whole, fine = message.requested_torque_fraction, message.requested_torque_fine_fraction
        return EngineRequest(None, torque_share(whole, fine)[0])
    return EngineRequest(None, None)
