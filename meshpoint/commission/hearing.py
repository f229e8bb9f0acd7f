"""What both commissioning nodes hear of a box: positions, pressures, whether there is air."""

from __future__ import annotations

from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import GearboxSensors, Message, SleevesAux, SleevesMain
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import Sleeve

LEAST_SUPPLY: Final = 0.6
"""Supply pressure over that of the sheet, below which nothing is driven."""


class HearingCore:
    """A core that keeps frames until its next step, and the newest of what they say."""

    def __init__(
        self, sheet: GearboxSheet, consents: bool, transmitter: Transmitter | None
    ) -> None:
        self._sheet, self._consents = sheet, consents
        self._receiver = Receiver(Node.TRANSMISSION_CONTROL)
        self._transmitter = transmitter or Transmitter(Node.TRANSMISSION_CONTROL)
        self._inbox: list[Frame] = []
        self._positions_m: dict[Sleeve, float] = {}
        self._sensors: GearboxSensors | None = None
        self._due_us = 0

    @property
    def next_step_us(self) -> int:
        """Every 10 ms."""
        return self._due_us

    def receive(self, frame: Frame) -> None:
        """Keeps a frame for the next step."""
        self._inbox.append(frame)

    def _take_in(self, now_us: int) -> None:
        """Hears what has come since the last step."""
        self._receiver.tick(now_us)
        inbox, self._inbox = self._inbox, []
        for frame in inbox:
            message = self._receiver.receive(frame).message
            if message is not None:
                self._hear(message)

    def _hear(self, message: Message) -> None:
        if isinstance(message, SleevesMain):
            self._positions_m[Sleeve.FIRST_SECOND] = message.sleeve_first_second_m[0]
            self._positions_m[Sleeve.CRAWL_THIRD] = message.sleeve_crawl_third_m[0]
        elif isinstance(message, SleevesAux):
            self._positions_m[Sleeve.SPLITTER] = message.sleeve_splitter_m[0]
            self._positions_m[Sleeve.RANGE] = message.sleeve_range_m[0]
        elif isinstance(message, GearboxSensors):
            self._sensors = message

    def _lacks_air(self, sensors: GearboxSensors) -> bool:
        """Whether there is too little to drive anything."""
        air = self._sheet.air
        return sensors.supply_pressure_pa - air.atmosphere_pa < LEAST_SUPPLY * air.supply_gauge_pa
