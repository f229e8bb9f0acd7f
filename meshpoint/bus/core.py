"""What a core looks like to the drivers that run it: sans-I/O, no clock, no randomness."""

from typing import Generic, NamedTuple, Protocol, TypeVar

from meshpoint.dbc.frame import Frame


class Step(NamedTuple):
    """What one step of a core wants done."""

    frames: list[Frame]  # to be sent, in this order
    events: list[str]  # lines for a human's log


class Core(Protocol):
    """A node without its input and output: the same for the controller and the rig.

    The driver hands over every frame it has, then steps when a step is due. A frame takes
    effect at the step that consumes it, so a core needs no arrival times.
    """

    def receive(self, frame: Frame) -> None:
        """Takes a frame in. Never raises: what is wrong with a frame is counted by the core."""

    def step(self, now_us: int) -> Step:
        """Decides. `now_us` is the driver's clock in integer microseconds and never decreases."""

    @property
    def next_step_us(self) -> int:
        """When to be stepped again; a time not later than now asks for a step at once."""

    def shutdown(self, now_us: int) -> Step:
        """The last frames of this node (valves off). It is not stepped any more."""


C = TypeVar("C", bound=Core)


class AroundCore(Generic[C]):
    """A core around another one that lets everything through: what stands around a core derives
    from it, and says only what it does otherwise."""

    def __init__(self, core: C) -> None:
        self._core = core

    def receive(self, frame: Frame) -> None:
        """As the core inside."""
        self._core.receive(frame)

    @property
    def next_step_us(self) -> int:
        """As the core inside."""
        return self._core.next_step_us

    def step(self, now_us: int) -> Step:
        """As the core inside."""
        return self._core.step(now_us)

    def shutdown(self, now_us: int) -> Step:
        """As the core inside."""
        return self._core.shutdown(now_us)
