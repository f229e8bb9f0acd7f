"""The firmware between rig and bus: it sends and switches what the rig's own board would.

The rig's frames of a read are taken as what comes in at the pins; the valves' and the clutch's
outputs go to the rig as commands to switch now, at the microsecond at which they were switched.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final, NamedTuple

from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.dbc.edges import EDGE_IDS
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Transmitter
from meshpoint.dbc.messages import (
    ClutchAction,
    ClutchCommand,
    GearboxSensors,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.firmware.board import CHANNELS, Analogue, Board
from meshpoint.rig_sim.command_inbox import CLUTCH, VALVES, CommandInbox
from meshpoint.rig_sim.core import FROM_IO

IO_IDS: Final = frozenset(CODECS[message.__name__].spec.can_id for message in FROM_IO)
GEARBOX_SENSORS, SLEEVES_MAIN, SLEEVES_AUX = (
    CODECS[message.__name__].spec.can_id for message in (GearboxSensors, SleevesMain, SleevesAux)
)
EDGES: Final = EDGE_IDS[:CHANNELS]
"""The board has no input for any wheel beyond."""
ACTIONS: Final = [name for name in ValveCommand._fields if name.endswith("_action")]
FD_COMMANDS: Final[Mapping[int, frozenset[int]]] = {
    VALVES: frozenset((VALVES,)),
    CLUTCH: frozenset((CLUTCH,)),
}
"""By identifier of what the board alone hears, on CAN FD: which of the rig's commands it is."""
STAMPS: Final = 27
TO_BE_VALID: Final = 3
"""A receiver obeys the third good frame, not the first."""
RENEW_US: Final = 30_000
"""A command is repeated after this: 50 ms without a frame are a node that is off."""

_EDGES: Final = struct.Struct("<IHB27H")
_SLOW: Final = struct.Struct("<I4H")
_SLEEVES: Final = struct.Struct("<B10h10h")
_AT_TIME: Final = 3
_AT_SLEEVES: Final = 7


class Passed(NamedTuple):
    """An output as the rig was commanded last, and when."""

    output: int
    at_us: int


class FirmwareRig(AroundCore[Core]):
    """A rig whose board is this firmware. On the bus it does what the rig alone does."""

    def __init__(
        self,
        rig: Core,
        board: Board,
        commands: Mapping[int, frozenset[int]] = FD_COMMANDS,
        valves: int = VALVES,
    ) -> None:
        """commands: as `FD_COMMANDS`; valves: the identifier of that of the valves."""
        super().__init__(rig)
        self._board = board
        self._transmitter = Transmitter(Node.TRANSMISSION_CONTROL)
        self._commands = commands
        self._inbox = CommandInbox(valves)
        self._held = Step([], [])
        self._at_us: int | None = None
        self._index = [0] * CHANNELS
        self._pins: dict[int, bytes] = {}
        self._passed: dict[int, Passed] = {}

    def receive(self, frame: Frame) -> None:
        """As `RigCore`: a valve command, and a change of the clutch's, ask for a step at once."""
        self._inbox.receive(frame)

    @property
    def next_step_us(self) -> int:
        """That of the rig."""
        return 0 if self._inbox.is_urgent else self._core.next_step_us

    def step(self, now_us: int) -> Step:
        """Lets rig and board go on to now, then hands over what was received. However late a step
        comes, as on a real bus, what was due by then is done at its own times."""
        at_us = now_us if self._at_us is None else self._at_us
        while at_us < now_us:
            due_us = min(at_us + self._board.wake_us, self._core.next_step_us)
            next_us = min(max(at_us + 1, due_us), now_us)
            self._board.advance(next_us - at_us)
            at_us = next_us
            self._step_rig(at_us, has_switched=self._pass_on(at_us, frozenset()))
        self._at_us = now_us
        self._step_rig(now_us, has_switched=False)
        return self._exchange(now_us)

    def _step_rig(self, now_us: int, *, has_switched: bool) -> None:
        if has_switched or self._core.next_step_us <= now_us:
            self._keep(self._core.step(now_us))

    def shutdown(self, now_us: int) -> Step:
        """Goes on to now; the board loses its power, and so do the valves."""
        frames, events = self.step(now_us)
        last = self._core.shutdown(now_us)
        own = [frame for frame in last.frames if frame.can_id not in IO_IDS]
        return Step(frames + own, events + last.events)

    def _keep(self, step: Step) -> None:
        """What the rig sends when only an output is switched waits for its own next step, so that
        the same frames are on the bus with the firmware and without."""
        self._held.frames.extend(self._with_ours(step.frames))
        self._held.events.extend(step.events)

    def _exchange(self, now_us: int) -> Step:
        """What was received, to the board and to the rig; what they have to send."""
        inbox = self._inbox.take()
        others = [frame for frame in inbox if frame.can_id not in self._commands]
        for frame in inbox:
            self._board.receive(frame)
        heard = [self._commands.get(frame.can_id, frozenset()) for frame in inbox]
        self._pass_on(now_us, frozenset().union(*heard))
        for frame in others:
            self._core.receive(frame)
        self._keep(self._core.step(now_us))
        step, self._held = self._held, Step([], [])
        return step

    def _pass_on(self, now_us: int, heard: frozenset[int]) -> bool:
        """Commands to the rig of the outputs as they are: where one has been switched, where the
        board has heard a command, and often enough for the rig not to think that nobody is there.
        Whether there was one."""
        outputs: dict[int, int] = {VALVES: self._board.driven}
        clutch = self._board.clutch
        if clutch is not None:  # until the first command, nothing drives the actuator
            outputs[CLUTCH] = clutch
        has_passed = False
        for can_id, output in outputs.items():
            last = self._passed.get(can_id)
            is_known = last is not None and last.output == output and can_id not in heard
            if last is not None and is_known and now_us - last.at_us < RENEW_US:
                continue
            self._passed[can_id] = Passed(output, now_us)
            has_passed = True
            message = _valves(output) if can_id == VALVES else _clutch(output)
            for _ in range(1 if last else TO_BE_VALID):
                self._core.receive(self._transmitter.encode(message))
        return has_passed

    def _with_ours(self, frames: list[Frame]) -> list[Frame]:
        """The board's frames in place of the rig's own ones of the same read."""
        sent = []
        for frame in frames:
            if frame.can_id not in IO_IDS:
                sent.append(frame)
                continue
            self._pins[frame.can_id] = frame.data
            if frame.can_id == SLEEVES_AUX:  # the last of a read
                sent += self._read()
        return sent

    def _read(self) -> list[Frame]:
        board, pins = self._board, self._pins
        sensor_us, *slow = _SLOW.unpack_from(pins[GEARBOX_SENSORS], _AT_TIME)
        if not board.is_on:
            board.power_on(sensor_us)
        board.set_sensor_us(sensor_us)
        for channel, can_id in enumerate(EDGES):
            self._capture(channel, pins[can_id])
        main_bad, *main = _SLEEVES.unpack_from(pins[SLEEVES_MAIN], _AT_SLEEVES)
        aux_bad, *aux = _SLEEVES.unpack_from(pins[SLEEVES_AUX], _AT_SLEEVES)
        sleeves = (main[:10], main[10:], aux[:10], aux[10:])
        board.read(Analogue(sleeves, tuple(slow), main_bad | aux_bad << 2))
        return board.take_sent()

    def _capture(self, channel: int, data: bytes) -> None:
        """The edges since the last read, at their full times: all of them are less than 10 ms old,
        so that 16 bits place each. Of more than a frame holds, the oldest are only counted."""
        at_us, index, _, *stamps_us = _EDGES.unpack_from(data, _AT_TIME)
        new = (index - self._index[channel]) & 0xFFFF
        if new == 0:
            return
        self._index[channel] = index
        edges_us = []
        for low_us in stamps_us[:new]:
            at_us = at_us - ((at_us - low_us) & 0xFFFF)
            edges_us.append(at_us & 0xFFFF_FFFF)
        edges_us += edges_us[-1:] * (new - STAMPS)
        self._board.capture(channel, edges_us[::-1])


def _valves(driven: int) -> ValveCommand:
    """The command that drives exactly these valves, one bit each."""
    return ValveCommand(
        **{
            name: ValveAction.ON_NOW if driven >> place & 1 else ValveAction.OFF_NOW
            for place, name in enumerate(ACTIONS)
        }
    )


def _clutch(is_closed: int) -> ClutchCommand:
    return ClutchCommand(action=ClutchAction.CLOSE if is_closed else ClutchAction.OPEN)
