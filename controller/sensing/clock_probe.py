"""A step at the very arrival of a frame, now and then: how late does the bus bring a read?

A frame carries no arrival time; it counts from the step that consumes it, perhaps a tick later. So
the controller steps once a second as soon as the first edge frame of a read is there, and
the least `now - stamp` is the bus's share alone. Where it switches valves itself it must be on
time; where activations are scheduled, a tick less of lead is a tick less to predict over.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.sensing.step_inputs import StepInputs
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import EdgesInputRise

EVERY_US: Final = 1_000_000
"""In this time 200 ppm of drift are 0.2 ms, and one step more in a hundred leaves cyclic frames
their cycle; the clock looks back over some."""
FIRST_OF_A_READ: Final = CODECS[EdgesInputRise.__name__].spec.can_id
"""The edge frame that wins the bus against all others of its read."""


class ClockProbe:
    """When to step at once, and the stamp that such a step is for."""

    def __init__(self) -> None:
        self.is_armed = True
        """A frame that arrives may be the awaited one."""
        self._probed_us = 0
        self.is_due = False
        """The awaited frame has come: step now."""

    def receive(self, frame: Frame) -> None:
        """A frame as it arrives."""
        if self.is_armed and frame.can_id == FIRST_OF_A_READ:
            self.is_due = True

    def stamp(self, inputs: StepInputs, now_us: int) -> int | None:
        """The read time that this step was made for; None for a step like any other."""
        frames = inputs.edges[EdgesInputRise]
        found = frames[0].read_time_us if self.is_due and len(frames) == 1 else None
        if self.is_due:
            self.is_due = self.is_armed = False
            self._probed_us = now_us
        return found

    def plan(self, now_us: int, switch_us: int | None) -> None:
        """After a step: whether to await the next read. Not before a switch, which the frames of
        one step more would delay."""
        due = now_us - self._probed_us >= EVERY_US
        self.is_armed = switch_us is None and (due or self._probed_us == 0)
