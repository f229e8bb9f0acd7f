"""Fault confinement of ISO 11898-1: error counters, error-passive, bus-off."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

PASSIVE_FROM: Final = 128
WARNING_FROM: Final = 96
BUS_OFF_FROM: Final = 256
TRANSMIT_STEP: Final = 8
RECEIVE_STEP: Final = 1
PRIMARY_STEP: Final = 8
"""Added to a receiver that saw an error first: the others' flags follow its own."""
BACK_FROM_PASSIVE: Final = 119
"""What a good reception leaves of a receive error counter above 127."""


class ErrorState(IntEnum):
    """What a node may still do on the bus."""

    ACTIVE = 0
    """Everything; its error flag is dominant and stops a frame for all."""
    PASSIVE = 1
    """It waits eight bits longer after its own frame; its error flag is recessive."""
    BUS_OFF = 2
    """Nothing, until it has seen 128 times 11 recessive bits in a row."""


class ErrorCounters:
    """Transmit and receive error counter (TEC, REC) of one node, and the state that follows."""

    __slots__ = ("receive", "state", "transmit")

    def __init__(self) -> None:
        self.transmit = 0
        self.receive = 0
        self.state = ErrorState.ACTIVE

    @property
    def is_warning(self) -> bool:
        """Whether a counter has reached 96, the error warning limit."""
        return max(self.transmit, self.receive) >= WARNING_FROM

    def sent(self) -> None:
        """A frame of this node is through."""
        self.transmit = max(0, self.transmit - 1)
        self._judge()

    def received(self) -> None:
        """A frame of another node came without error."""
        if self.receive >= PASSIVE_FROM:
            self.receive = BACK_FROM_PASSIVE
        elif self.receive:
            self.receive -= 1
        self._judge()

    def transmit_error(self) -> None:
        """A frame of this node was destroyed."""
        self.transmit += TRANSMIT_STEP
        self._judge()

    def not_acknowledged(self) -> None:
        """Nobody acknowledged: a node that is passive does not count it, so that one that is alone
        never goes bus-off."""
        if self.state is ErrorState.ACTIVE:
            self.transmit_error()

    def receive_error(self, first: bool) -> None:
        """A frame of another node was destroyed; `first`: this node saw it before the others."""
        self.receive += RECEIVE_STEP + (PRIMARY_STEP if first else 0)
        self._judge()

    def go_bus_off(self) -> None:
        """As after too many transmit errors."""
        self.transmit = max(self.transmit, BUS_OFF_FROM)
        self._judge()

    def recover(self) -> None:
        """The recovery sequence is over: both counters are 0."""
        self.transmit = self.receive = 0
        self.state = ErrorState.ACTIVE

    def _judge(self) -> None:
        if self.state is ErrorState.BUS_OFF or self.transmit >= BUS_OFF_FROM:
            self.state = ErrorState.BUS_OFF
        elif max(self.transmit, self.receive) >= PASSIVE_FROM:
            self.state = ErrorState.PASSIVE
        else:
            self.state = ErrorState.ACTIVE
