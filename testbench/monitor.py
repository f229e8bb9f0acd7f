"""Everything a bench reads off the bus while a run goes on: rows, estimation, traces, counts."""

from __future__ import annotations

from collections import Counter

from controller.settings import ControllerSettings
from dbc.frame import Frame
from dbc.link import Receiver, Verdict
from dbc.messages import ControllerStatus, Message
from dbc.node import Node
from gearbox import GearboxSheet
from testbench.estimation import EstimationScore
from testbench.rows import RowCollector


class Monitor:
    """Decodes the whole bus, truth included, and feeds the collectors."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        half_gap = sheet.dog.backlash_rad / 2.0
        self.rows = RowCollector(sheet, settings.aim.target_rad_share * half_gap)
        self.estimation = EstimationScore(sheet, settings)
        self.status: ControllerStatus | None = None
        self.verdicts: Counter[Verdict] = Counter()
        self._receiver = Receiver(*Node)

    def take(self, frame: Frame) -> Message | None:
        """One frame in bus order; returns the message where there is one."""
        received = self._receiver.receive(frame)
        self.verdicts[received.verdict] += 1
        message = received.message
        if message is None:
            return None
        if isinstance(message, ControllerStatus):
            self.status = message
        self.rows.take(message)
        self.estimation.take(message)
        return message
