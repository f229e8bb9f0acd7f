"""J1939-81: the controller claims its address, and gives way to whom it belongs.

The address is fixed (0x03, transmission 1, as the DBC has it, or what `--address` says on this
bus: `meshpoint.bus.source_address`), not negotiated. Of two nodes that
claim it, the one whose NAME is the smaller number keeps it; the other one says that it cannot
claim an address and is silent from then on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from meshpoint.dbc.frame import Frame
from meshpoint.dbc.j1939 import (
    ADDRESS_CLAIM,
    CONTROLLER,
    GLOBAL,
    REQUEST,
    destination_of,
    group_of,
)

CLAIM: Final = ADDRESS_CLAIM
NULL: Final = 0xFE
"""The source address of one that has none."""
TRANSMISSION: Final = 3
"""J1939's function of a transmission."""
ON_HIGHWAY: Final = 1
MOST_IDENTITY: Final = (1 << 21) - 1
NO_MAKER: Final = 0x7FF


@dataclass(frozen=True)
class Name:
    """A node's NAME, 64 bits: the smaller number has precedence."""

    identity: int = 1
    """Of this device among its maker's, 21 bits."""
    maker: int = NO_MAKER
    """SAE's code of the maker, 11 bits; all ones: none assigned."""
    function: int = TRANSMISSION
    function_instance: int = 0
    ecu_instance: int = 0
    vehicle_system: int = 0
    industry_group: int = ON_HIGHWAY

    @property
    def number(self) -> int:
        """All fields in one number. It cannot take another address: the highest bit is 0."""
        number = self.identity & MOST_IDENTITY | (self.maker & 0x7FF) << 21
        number |= (self.ecu_instance & 7) << 32 | (self.function_instance & 31) << 35
        number |= (self.function & 0xFF) << 40 | (self.vehicle_system & 0x7F) << 49
        return number | (self.industry_group & 7) << 60


class AddressClaim:
    """Claims, defends, gives way."""

    def __init__(
        self, name: Name, address: int = CONTROLLER, reported_as: int | None = None
    ) -> None:
        """reported_as: what the address is called in words, where the bus has another one."""
        self._reported_as = address if reported_as is None else reported_as
        self.name = name
        self.address = address
        self.is_held = True
        """Whether anything may be sent under the address."""
        self._claims = 1

    def hear(self, frame: Frame) -> str | None:
        """A frame of the bus; what there is to tell, if anything."""
        group = group_of(frame.can_id)
        if group == REQUEST:
            is_for_us = destination_of(frame.can_id) in (self.address, GLOBAL)
            self._claims += is_for_us and frame.data[:3] == CLAIM.to_bytes(3, "little")
            return None
        if group != CLAIM or frame.can_id & 0xFF != self.address or len(frame.data) != 8:
            return None
        other = int.from_bytes(frame.data, "little")
        if other == self.name.number:
            return None  # our own, returned by the interface
        self._claims += 1
        if other > self.name.number:
            return (
                f"another node claims address {self._reported_as}: ours is kept, its NAME is "
                "greater"
            )
        was_held, self.is_held = self.is_held, False
        if not was_held:
            return None
        return (
            f"address {self._reported_as} belongs to another node, whose NAME is smaller: this "
            "one is silent from now on"
        )

    def take_frames(self) -> list[Frame]:
        """The claims that are due; one that has lost says so."""
        count, self._claims = min(self._claims, 1), 0
        source = self.address if self.is_held else NULL
        can_id = 6 << 26 | CLAIM << 8 | GLOBAL << 8 | source
        return [Frame(can_id, self.name.number.to_bytes(8, "little"), is_fd=False)] * count

    @property
    def is_due(self) -> bool:
        """Whether a claim waits to be sent."""
        return self._claims > 0
