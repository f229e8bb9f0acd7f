"""The XCP slave around the controller's core: commands that a step has consumed, in; answers and
DAQ packets out. None of the step's own frames is changed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from operator import itemgetter
from typing import Final

from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.settings.header import XcpAccess
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.strategy_file import StrategyError
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import XCP_RESPONSE_ID
from meshpoint.xcp.memory import (
    SLEEVES,
    CalibrationPages,
    Memory,
    StepFacts,
    changes_in_words,
)
from meshpoint.xcp.protocol import FD_LENGTHS, Event
from meshpoint.xcp.slave import XcpSlave

MOST_COMMANDS: Final = 64
"""Kept until they are answered: a whole block and more. A master waits for each answer."""


class XcpNode:
    """The slave without a core: from what a step sends and knows to a master's frames."""

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


class XcpCore(AroundCore[Core]):
    """A controller that answers an XCP master, as its run header allows."""

    def __init__(self, inside: Core, core: ControllerCore) -> None:
        """core: the controller's; inside: the same, or what stands around it."""
        super().__init__(inside)
        self._controller = core
        header = core.header
        self._node = XcpNode(header.version, header.settings, header.xcp)

    def step(self, now_us: int) -> Step:
        """The step inside, and what a master gets after it. Settings that it has changed are used
        from the next step on, unless a shift runs: then once it has ended."""
        step, core, node = self._core.step(now_us), self._controller, self._node
        for command in core.xcp_commands:
            node.receive(command)
        snapshot = core.snapshot
        if snapshot is None:
            raise RuntimeError("a step without a snapshot")
        tracks = snapshot.view.tracks
        facts = StepFacts(
            tuple(tracks[each].position_m if each in tracks else math.nan for each in SLEEVES),
            core.blocked_row or 0,
            lambda: core.learned,
        )
        ended = core.sequence.finished is not None
        answers, lines = node.step(step.frames, facts, snapshot.now_us, shift_ended=ended)
        if core.sequence.shift is None:
            lines += self._tune()
        # In order of bus priority, as the step's own: the status frame completes the step.
        return Step(sorted([*step.frames, *answers], key=itemgetter(0)), [*step.events, *lines])

    def _tune(self) -> list[str]:
        """Hands on what a master has changed since; lines for the log."""
        change = self._node.take_change()
        if change is None:
            return []
        settings, words = change
        try:
            self._controller.tune(settings)
        except StrategyError as error:  # a user's own, made anew from the settings
            return [f"XCP: {words}", f"own strategy: {error}"]
        return [f"XCP: {words}"]


def _frame(packet: bytes, is_fd: bool) -> Frame:
    """Filled up to a length that a CAN FD frame can have."""
    length = next(each for each in FD_LENGTHS if each >= len(packet))
    return Frame(XCP_RESPONSE_ID, packet.ljust(length, b"\0"), is_fd)
