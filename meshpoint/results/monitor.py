"""What a bench reads off the bus while a run goes on: rows, and how well the estimators did."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    ControllerStatus,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    GearboxSensors,
    Message,
    ReferenceEncoder,
    ReferenceEngagement,
    ReferencePhase,
    ShiftOutcome,
    SleevesAux,
    SleevesMain,
    ValveCommand,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.results.estimation import EstimationScore, Sample
from meshpoint.results.rows import RowCollector

READ_FOR_ROWS: Final = (ControllerStatus, ReferenceEngagement, ReferencePhase, ShiftOutcome)
"""What rows need."""
READ_AT_REST: Final = (
    *READ_FOR_ROWS, EdgesLayshaftRise, EdgesLayshaftFall, SleevesMain, SleevesAux, GearboxSensors,
    ValveCommand,
)  # fmt: skip
"""What estimation needs besides: less than half of the bus; the rest stays undecoded. Edges are
needed between shifts too, so that the tooth count goes on."""
MONITORED: Final = (*READ_AT_REST, ReferenceEncoder)


def identifiers(kinds: tuple[type[Message], ...]) -> frozenset[int]:
    """The CAN identifiers of message types."""
    return frozenset(CODECS[kind.__name__].spec.can_id for kind in kinds)


class RowMonitor:
    """Decodes what the rows of shifts need, the rig's truth included."""

    unread: ClassVar[tuple[type[Message], ...]] = (ReferenceEncoder,)
    """What a rig works out for onlookers, and this one does not read."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        aim_rad = settings.aim.target_rad(sheet.dog.backlash_rad)
        self.rows = RowCollector(sheet, aim_rad, settings)
        self.status: ControllerStatus | None = None
        self._wanted = identifiers(READ_FOR_ROWS)
        self._receiver = Receiver(*Node)

    def take(self, frame: Frame) -> Message | None:
        """One frame in bus order; returns the message where there is one."""
        if frame.can_id not in self._wanted:
            return None
        message = self._receiver.receive(frame).message
        if isinstance(message, ControllerStatus):
            self.status = message
        if message is not None:
            self.rows.take(message)
        return message

    def scores(self) -> dict[str, Any]:
        """Figures by estimator; empty where none is scored."""
        return {}


class Monitor(RowMonitor):
    """Scores the estimators as well, which takes longer than all else here."""

    unread = ()

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        on_sample: Callable[[Sample], None] | None = None,
    ) -> None:
        """`on_sample` sees every instant at which the estimators are scored."""
        super().__init__(sheet, settings)
        self.estimation = EstimationScore(sheet, settings, on_sample)
        self._read, self._read_at_rest = identifiers(MONITORED), identifiers(READ_AT_REST)
        self._wanted = self._read_at_rest

    def take(self, frame: Frame) -> Message | None:
        """One frame in bus order; returns the message where there is one."""
        message = super().take(frame)
        if message is not None:
            self.estimation.take(message)
            self._wanted = self._read if self.estimation.active else self._read_at_rest
        return message

    def scores(self) -> dict[str, Any]:
        """Figures by estimator."""
        return self.estimation.figures()
