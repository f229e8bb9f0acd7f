"""The XCP slave in the controller's step: commands that the step has consumed, in; answers and DAQ
packets out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from meshpoint.controller.settings.header import XcpAccess
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.xcp.memory import CalibrationPages, Memory, StepFacts, changes_in_words
from meshpoint.controller.xcp.protocol import FD_LENGTHS, Event
from meshpoint.controller.xcp.slave import XcpSlave
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_RESPONSE_ID

MOST_COMMANDS: Final = 64
"""Kept until they are answered: a whole block and more. A master waits for each answer."""


class XcpNode:
    """What the controller's core has of XCP."""

    def __init__(self, version: str, settings: ControllerSettings, access: XcpAccess) -> None:
        self._pages = CalibrationPages(settings)
        self._taken = settings
        self._memory = Memory(version, self._pages, access)
        self._slave = XcpSlave(self._memory, self._pages, settings.timing.tick_ms)
        self._commands: deque[Frame] = deque()
        self._packets: deque[Frame] = deque()
        """What a step could not send any more."""
        self._unheard = 0

    def take_change(self) -> tuple[ControllerSettings, str] | None:
        """The settings that the master wants, and in words what they change; None where it wants
        those that were taken last."""
        wanted, before = self._pages.settings, self._taken
        if wanted == before:
            return None
        self._taken = wanted
        return wanted, changes_in_words(before, wanted)

    def receive(self, frame: Frame) -> None:
        """A command of a master."""
        if len(self._commands) < MOST_COMMANDS:
            self._commands.append(frame)
        else:
            self._unheard += 1

    def step(
        self, sent: Iterable[Frame], facts: StepFacts, now_us: int, *, shift_ended: bool
    ) -> tuple[list[Frame], list[str]]:
        """The frames for a master after a step that sends these frames at this sensor time; and
        lines for the log."""
        self._memory.measured.take(sent, facts)
        slave, waiting = self._slave, self._packets
        while self._commands and len(waiting) < slave.packets_a_step:
            command = self._commands.popleft()
            packets = slave.answer(command.data, command.is_fd, now_us)
            waiting += [_frame(packet, command.is_fd) for packet in packets]
        for event in (Event.STEP, Event.SHIFT_END) if shift_ended else (Event.STEP,):
            waiting += [_frame(each, slave.is_fd) for each in slave.sampled(event, now_us)]
        frames = [waiting.popleft() for _ in range(min(len(waiting), slave.packets_a_step))]
        lines = []
        if self._unheard:
            lines.append(f"{self._unheard} XCP commands left: more than {MOST_COMMANDS} at once")
            self._unheard = 0
        return frames, lines


def _frame(packet: bytes, is_fd: bool) -> Frame:
    """Filled up to a length that a CAN FD frame can have."""
    length = next(each for each in FD_LENGTHS if each >= len(packet))
    return Frame(XCP_RESPONSE_ID, packet.ljust(length, b"\0"), is_fd)
