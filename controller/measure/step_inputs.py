"""The decoded messages of one step, sorted by use."""

from __future__ import annotations

from typing import Any, Final

from meshpoint.controller.measure.wheel_edges import EdgeFrame
from meshpoint.dbc.messages import (
    EEC1,
    TC1,
    EdgesInputFall,
    EdgesInputRise,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    EdgesPropellerFall,
    EdgesPropellerRise,
    GearboxSensors,
    Message,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)

EDGE_INPUTS: Final = (
    EdgesLayshaftRise,
    EdgesLayshaftFall,
    EdgesMainRise,
    EdgesMainFall,
    EdgesInputRise,
    EdgesInputFall,
    EdgesPropellerRise,
    EdgesPropellerFall,
)


class StepInputs:
    """The decoded messages of one step."""

    def __init__(self) -> None:
        self.edges: dict[type, list[EdgeFrame]] = {kind: [] for kind in EDGE_INPUTS}
        self.sleeves_main: list[SleevesMain] = []
        self.sleeves_aux: list[SleevesAux] = []
        self.sensors: list[GearboxSensors] = []
        self.engine: list[EEC1] = []
        self._valve_status: list[ValveStatus] = []
        self._requests: list[TC1] = []
        self._lists: dict[type, list[Any]] = {
            **self.edges,
            SleevesMain: self.sleeves_main,
            SleevesAux: self.sleeves_aux,
            GearboxSensors: self.sensors,
            ValveStatus: self._valve_status,
            EEC1: self.engine,
            TC1: self._requests,
        }

    def take(self, message: Message) -> None:
        """Adds one message."""
        kept = self._lists.get(type(message))
        if kept is not None:
            kept.append(message)

    @property
    def valve_status(self) -> ValveStatus | None:
        """The newest of this step."""
        return self._valve_status[-1] if self._valve_status else None

    @property
    def requested_gear(self) -> int | None:
        """The gear asked for last; None where none was, or the field was not available."""
        return self._requests[-1].requested_gear if self._requests else None
