"""Truth and outcomes of a campaign's shifts, read off the bus by a node that never speaks."""

from __future__ import annotations

from typing import Final

from meshpoint.bus.core import Step
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ReferenceEngagement, ShiftOutcome
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.results.monitor import identifiers
from meshpoint.results.rows import RowCollector, ShiftRow

SCORED_IDS: Final = identifiers((ReferenceEngagement, ShiftOutcome))
NO_STEP_US: Final = 1 << 62


class Scorer:
    """A listener of the same call shape as every node."""

    def __init__(self, sheet: GearboxSheet, target_rad: float) -> None:
        self._receiver = Receiver(*Node)
        self._rows = RowCollector(sheet, target_rad)

    @property
    def rows(self) -> list[ShiftRow]:
        """The shifts so far."""
        return self._rows.rows

    @property
    def refusals(self) -> list[str]:
        """Of each request refused so far, the fault that it was refused for."""
        return self._rows.refusals

    @property
    def next_step_us(self) -> int:
        """It has nothing to say."""
        return NO_STEP_US

    def receive(self, frame: Frame) -> None:
        """An outcome or an event between gear and sleeve."""
        message = self._receiver.receive(frame).message
        if message is not None:
            self._rows.take(message)

    def step(self, now_us: int) -> Step:  # noqa: ARG002
        """Nothing."""
        return Step([], [])

    def shutdown(self, now_us: int) -> Step:
        """Nothing."""
        return self.step(now_us)
