"""Who sends and receives on the bus."""

from __future__ import annotations

from enum import StrEnum


class Node(StrEnum):
    """The nodes of `meshpoint.dbc` and `truck.dbc`, by their names there."""

    GEARBOX_IO = "GearboxIo"
    ENGINE = "Engine"
    REFERENCE = "Reference"
    TRANSMISSION_CONTROL = "TransmissionControl"
    BENCH = "Bench"
    BRAKES = "Brakes"
    TACHOGRAPH = "Tachograph"
