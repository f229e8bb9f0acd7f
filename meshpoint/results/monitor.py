"""Everything a bench reads off the bus while a run goes on: rows, estimation, traces, counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

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

READ_AT_REST: Final = (
    EdgesLayshaftRise, EdgesLayshaftFall, SleevesMain, SleevesAux, GearboxSensors, ValveCommand,
    ControllerStatus, ReferenceEngagement, ReferencePhase, ShiftOutcome,
)  # fmt: skip
"""What rows and estimation need: less than half of the bus; the rest stays undecoded. Edges are
needed between shifts too, so that the tooth count goes on."""
MONITORED: Final = (*READ_AT_REST, ReferenceEncoder)


def identifiers(kinds: tuple[type[Message], ...]) -> frozenset[int]:
    """The CAN identifiers of message types."""
    return frozenset(CODECS[kind.__name__].spec.can_id for kind in kinds)


READ_FOR_ROWS: Final = identifiers(
    (ControllerStatus, ReferenceEngagement, ReferencePhase, ShiftOutcome)
)


class Monitor:
    """Decodes the whole bus, truth included, and feeds the collectors."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        also: tuple[type[Message], ...] = (),
        on_sample: Callable[[Sample], None] | None = None,
    ) -> None:
        """`also`: further messages that `take` should return; `on_sample` sees every instant at
        which the estimators are scored."""
        aim_rad = settings.aim.target_rad(sheet.dog.backlash_rad)
        self.rows = RowCollector(sheet, aim_rad, settings)
        self.estimation = EstimationScore(sheet, settings, on_sample)
        self.status: ControllerStatus | None = None
        self._read = identifiers(MONITORED + also)
        self._read_at_rest = identifiers(READ_AT_REST + also)
        self._receiver = Receiver(*Node)

    def take(self, frame: Frame) -> Message | None:
        """One frame in bus order; returns the message where there is one."""
        wanted = self._read if self.estimation.active else self._read_at_rest
        if frame.can_id not in wanted:
            return None
        message = self._receiver.receive(frame).message
        if message is None:
            return None
        if isinstance(message, ControllerStatus):
            self.status = message
        self.rows.take(message)
        self.estimation.take(message)
        return message


class RowMonitor(Monitor):
    """Rows and status alone. The estimators are not scored: that costs more than all else here."""

    def take(self, frame: Frame) -> Message | None:
        """One frame in bus order; returns the message where there is one."""
        if frame.can_id not in READ_FOR_ROWS:
            return None
        message = self._receiver.receive(frame).message
        if isinstance(message, ControllerStatus):
            self.status = message
        if message is not None:
            self.rows.take(message)
        return message
