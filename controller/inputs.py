"""One step's decoded messages, sorted by what they are for."""

from __future__ import annotations

from typing import Final

from controller.edges import EdgeFrame
from dbc.messages import (
    TC1,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    GearboxSensors,
    Message,
    SleevesAux,
    SleevesMain,
    ValveStatus,
)

EDGES: Final = (EdgesLayshaftRise, EdgesLayshaftFall, EdgesMainRise, EdgesMainFall)


class StepInputs:
    """What the frames of one step said. Input and propeller shaft are on the bus for later use."""

    def __init__(self) -> None:
        self.edges: dict[type, list[EdgeFrame]] = {kind: [] for kind in EDGES}
        self.sleeves_main: list[SleevesMain] = []
        self.sleeves_aux: list[SleevesAux] = []
        self.sensors: list[GearboxSensors] = []
        self.valve_status: ValveStatus | None = None
        self.requested_gear: int | None = None

    def take(self, message: Message) -> None:
        """Files one message; the newest wins where only the newest matters."""
        edges = self.edges.get(type(message))
        if edges is not None:
            edges.append(message)  # type: ignore[arg-type]
        elif isinstance(message, SleevesMain):
            self.sleeves_main.append(message)
        elif isinstance(message, SleevesAux):
            self.sleeves_aux.append(message)
        elif isinstance(message, GearboxSensors):
            self.sensors.append(message)
        elif isinstance(message, ValveStatus):
            self.valve_status = message
        elif isinstance(message, TC1):
            self.requested_gear = message.requested_gear
