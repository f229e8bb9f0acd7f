"""The controller with diagnosis around it: address claim, DM1, UDS over ISO-TP.

It listens to the controller's own status frame on its way to the bus, and takes frames of diagnosis
out of what the controller hears. It adds frames to a step and never changes one. A node that has
lost its address sends nothing more: its valves expire.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from meshpoint.bus.core import Core, Step
from meshpoint.bus.diagnosis.address import CLAIM, AddressClaim, Name
from meshpoint.bus.diagnosis.diagnostic_messages import (
    ACKNOWLEDGE,
    ANNOUNCE,
    DM1,
    DM2,
    PACKET,
    DiagnosticMessages,
)
from meshpoint.bus.diagnosis.services import Services
from meshpoint.bus.diagnosis.transport import IsoTp
from meshpoint.bus.diagnosis.trouble_codes import TroubleMemory
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import CONTROLLER, REQUEST, destination_of, group_of
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import ControllerStatus

UDS: Final = 0xDA00
"""ISO 15765-4, normal fixed addressing to one node."""
UDS_PRIORITY: Final = 6
GROUPS: Final = frozenset({CLAIM, REQUEST, UDS})
"""What is heard here and not by the controller."""
SENT_GROUPS: Final = frozenset({CLAIM, DM1, DM2, ACKNOWLEDGE, ANNOUNCE, PACKET, UDS})
"""What is sent from here under the controller's address."""
STATUS: Final = CODECS[ControllerStatus.__name__]

VERSION, RUN_HASH, GEAR, TARGET, STATE, FAULT, STEPS, BLOCKS, ERRORS = (
    0xF195, 0xF1A0, 0x0100, 0x0101, 0x0102, 0x0103, 0x0104, 0x0105, 0x0106,
)  # fmt: skip
"""Data identifiers; F195 is ISO 14229's for the software's version."""


class DiagnosedCore:
    """Of the call shape of the core inside it."""

    def __init__(
        self, core: Core, version: str, name: Name | None = None, reported_as: int = CONTROLLER
    ) -> None:
        """reported_as: the controller's address on the bus, for what is said of it."""
        self._core = core
        self._claim = AddressClaim(name or Name(), reported_as=reported_as)
        self.memory = TroubleMemory()
        """Trouble codes."""
        self._messages = DiagnosticMessages(self.memory)
        self._status = ControllerStatus()
        self._services = Services(self.memory, self._data(version))
        self._testers: dict[int, IsoTp] = {}
        self._asked: list[Frame] = []
        self._events: list[str] = []

    def _data(self, version: str) -> dict[int, Callable[[], bytes]]:
        def of(form: str, *names: str) -> Callable[[], bytes]:
            return lambda: struct.pack(form, *(int(getattr(self._status, n)) for n in names))

        return {
            VERSION: lambda: version.encode("ascii", "replace"),
            RUN_HASH: of(">II", "run_hash_high", "run_hash_low"),
            GEAR: of(">b", "current_gear"),
            TARGET: of(">b", "target_gear"),
            STATE: of(">B", "state"),
            FAULT: of(">B", "active_fault"),
            STEPS: of(">I", "step_number"),
            BLOCKS: of(">H", "guard_blocks"),
            ERRORS: of(">HH", "e2e_errors", "format_errors"),
        }

    def receive(self, frame: Frame) -> None:
        """Diagnosis stays here; everything else goes on."""
        if not frame.is_extended or group_of(frame.can_id) not in GROUPS:
            self._core.receive(frame)
            return
        reported = self._claim.hear(frame)
        if reported is not None:
            self._events.append(reported)
        group = group_of(frame.can_id)
        if group == REQUEST:
            asks_claim = frame.data[:3] == CLAIM.to_bytes(3, "little")
            if not asks_claim:
                self._messages.hear(frame)
        elif group == UDS and destination_of(frame.can_id) == CONTROLLER:
            self._asked.append(frame)

    @property
    def next_step_us(self) -> int:
        """The core's, or when diagnosis has something to send."""
        if self._asked or self._claim.is_due:
            return 0
        due = [self._core.next_step_us, self._messages.next_us]
        due += [us for tester in self._testers.values() if (us := tester.next_us) is not None]
        return min(due)

    def step(self, now_us: int) -> Step:
        """The core's step where it is due, and diagnosis behind it."""
        frames: list[Frame] = []
        events: list[str] = []
        if now_us >= self._core.next_step_us:
            frames, events = self._core.step(now_us)
            self._look(frames)
        frames = [*self._claim.take_frames(), *frames]
        events = [*events, *self._events]
        self._events = []
        self._answer(now_us)
        behind = self._messages.take_frames(now_us)
        for tester in self._testers.values():
            behind += tester.take_frames(now_us)
        if not self._claim.is_held:
            return Step([f for f in frames if f.can_id & 0xFF != CONTROLLER], events)
        return Step([*frames, *behind], events)

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames, if it still has its address."""
        step = self._core.shutdown(now_us)
        return step if self._claim.is_held else Step([], step.events)

    def _look(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.can_id != STATUS.spec.can_id:
                continue
            status = STATUS.decode(frame.data)
            if isinstance(status, ControllerStatus):
                self._status = status
                if self.memory.take(status.active_fault):
                    self._messages.news()

    def _answer(self, now_us: int) -> None:
        asked, self._asked = self._asked, []
        for frame in asked:
            source = frame.can_id & 0xFF
            tester = self._testers.get(source)
            if tester is None:
                can_id = UDS_PRIORITY << 26 | UDS << 8 | source << 8 | CONTROLLER
                tester = self._testers[source] = IsoTp(can_id)
            request = tester.hear(frame.data, now_us)
            answer = None if not request else self._services.answer(request)
            if answer is not None:
                tester.send(answer, now_us)
