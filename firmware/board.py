"""A board that runs the firmware: its pins, clocks and bus, whichever way its code is run."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, StrEnum, auto
from typing import Final, NamedTuple, Protocol

from meshpoint.dbc.frame import Frame

CHANNELS: Final = 8
"""Of each wheel the rising edges, then the falling ones."""
SCANS: Final = 10


class Firmware(StrEnum):
    """How the board's code is run."""

    NATIVE = "native"
    """Built for this machine."""
    CORTEX_M4 = "cortex-m4"
    """Its linked image, on an emulated chip."""


class Analogue(NamedTuple):
    """The analogue inputs over a cycle, in steps of the wire."""

    sleeves: Sequence[Sequence[int]]
    """Ten samples of each sleeve, the newest first."""
    slow: tuple[int, int, int, int]
    """Brake pressure, supply pressure, oil, clutch."""
    bad_sleeves: int = 0
    """One bit a sleeve: its signal is out of electrical range."""


class Failure(Enum):
    """What can be made to fail."""

    BUS_OFF = auto()
    STUCK = auto()
    """The main loop does not go on; interrupts are served."""
    DEAF = auto()
    """No interrupt is served."""
    FAULT = auto()
    """The processor finds a fault."""


class Board(Protocol):
    """One board; it is off until `power_on`. Its code takes no time."""

    @property
    def is_on(self) -> bool:
        """Whether it was switched on."""

    @property
    def sensor_us(self) -> int:
        """Its sensor clock, 32 bits."""

    @property
    def own_us(self) -> int:
        """Time that has gone on for it, in us."""

    @property
    def resets(self) -> int:
        """How often its watchdog has reset it."""

    @property
    def driven(self) -> int:
        """The valves that are driven, one bit each in the order of ValveCommand."""

    @property
    def coils_together(self) -> int:
        """How often both valves of a sleeve were driven at once."""

    @property
    def clutch(self) -> bool | None:
        """Whether it closes the clutch; None until it was commanded."""

    @property
    def wake_us(self) -> int:
        """How long until it may switch an output by itself."""

    def power_on(self, sensor_us: int) -> None:
        """Starts it, or resets it; the sensor clock shows this then."""

    def set_sensor_us(self, sensor_us: int) -> None:
        """Its sensor clock shows this now."""

    def advance(self, for_us: int) -> None:
        """Time goes on, with all that is due in it: timers, main loop, watchdog."""

    def receive(self, frame: Frame) -> None:
        """A frame from the bus."""

    def capture(self, channel: int, stamps_us: Sequence[int]) -> None:
        """Edges of a channel, the oldest first, each at its low 32 bits of the sensor clock."""

    def read(self, analogue: Analogue) -> None:
        """The tenth scan has been made: what the board sends each 10 ms is made now."""

    def take_sent(self) -> list[Frame]:
        """The frames that it has sent since the last call."""

    def fail(self, failure: Failure) -> None:
        """Makes it fail, until `mend` or, but for the bus, a reset."""

    def mend(self) -> None:
        """Ends what was made to fail."""
