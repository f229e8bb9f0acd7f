"""The shapes of a checked DBC: what is on the wire, who sends it, who may read it."""

from __future__ import annotations

from dataclasses import dataclass

from meshpoint.dbc.node import Node


@dataclass(frozen=True)
class SignalSpec:
    """One signal: value in `unit` = raw * scale + offset, allowed from `raw_min` to `raw_max`."""

    name: str
    start_bit: int
    bits: int
    signed: bool
    scale: float
    offset: float
    unit: str
    raw_min: int
    raw_max: int
    raw_start: int
    value_table: str | None
    comment: str

    @property
    def type_min(self) -> int:
        """Smallest raw value the bits can hold."""
        return -(1 << self.bits - 1) if self.signed else 0

    @property
    def type_max(self) -> int:
        """Largest raw value the bits can hold."""
        return (1 << self.bits - self.signed) - 1

    @property
    def is_ranged(self) -> bool:
        """Whether the DBC's range is tighter than what the bits can hold."""
        return self.raw_min > self.type_min or self.raw_max < self.type_max


@dataclass(frozen=True)
class MessageSpec:
    """One message. `cycle_time_us` is 0 for event messages, `data_id` None for unprotected ones."""

    name: str
    can_id: int
    length: int
    is_fd: bool
    sender: Node
    receivers: frozenset[Node]
    cycle_time_us: int
    data_id: int | None
    signals: tuple[SignalSpec, ...]
    comment: str
    is_short: bool = False
    """Whether the E2E header is that of profile 1, for frames of 8 bytes, instead of profile 5."""

    @property
    def is_cyclic(self) -> bool:
        """Whether the message comes by the clock, so that its absence means something."""
        return self.cycle_time_us > 0

    @property
    def is_protected(self) -> bool:
        """Whether the frame starts with an E2E header; the others are J1939's."""
        return self.data_id is not None

    @property
    def protected_id(self) -> int:
        """The data ID; ValueError where the message has none."""
        if self.data_id is None:
            raise ValueError(f"{self.name} is not a protected message")
        return self.data_id


@dataclass(frozen=True)
class Schema:
    """A whole DBC: messages in the order of the file, value tables as raw value -> name."""

    messages: tuple[MessageSpec, ...]
    value_tables: dict[str, dict[int, str]]
