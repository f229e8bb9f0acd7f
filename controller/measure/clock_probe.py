"""An extra step at the arrival of a frame, once a second, to measure the delay of the bus.

A frame has no arrival time of its own: it counts from the step that consumes it, which may be a
tick later. Once a second the controller therefore steps as soon as the first edge frame of a read
is there, so that the least `now - stamp` contains the bus's delay alone. A controller that switches
valves itself needs that to be on time; with scheduled activations it saves a tick of lead, and so a
tick of prediction.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.step_inputs import StepInputs
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import EdgesInputRise

EVERY_US: Final = 1_000_000
"""In this time 200 ppm of drift are 0.2 ms, and one step more in a hundred leaves cyclic frames
their cycle; the clock looks back over some."""
FIRST_OF_A_READ: Final = CODECS[EdgesInputRise.__name__].spec.can_id
"""The edge frame with the highest bus priority of a read: it arrives first."""


class ClockProbe:
    """When to step at once, and the stamp that such a step is for."""

    def __init__(self) -> None:
        self.is_armed = False
        """Whether an arriving frame may be the awaited one. Not before the first step, which takes
        frames that have waited for it."""
        self._probed_us = 0
        self.is_due = False
        """Whether the awaited frame has come, so that the controller should step now."""

    def receive(self, frame: Frame) -> None:
        """A frame as it arrives."""
        if self.is_armed and frame.can_id == FIRST_OF_A_READ:
            self.is_due = True

    def repeat(self) -> None:
        """The next read is awaited at once: what is believed of the clock has proved wrong."""
        self._probed_us = 0

    def stamp(self, inputs: StepInputs, now_us: int) -> int | None:
        """The read time that this step was made for; None for a step like any other."""
        frames = inputs.edges[EdgesInputRise]
        found = frames[0].read_time_us if self.is_due and len(frames) == 1 else None
        if self.is_due:
            self.is_due = self.is_armed = False
        if found is not None:
            self._probed_us = now_us
        return found

    def plan(self, now_us: int, switch_us: int | None) -> None:
        """After a step: whether to await the next read. Not before a switch, which the frames of
        one step more would delay."""
        due = now_us - self._probed_us >= EVERY_US
        self.is_armed = switch_us is None and (due or self._probed_us == 0)
