"""Where in the sensors' cycle the steps lie: soon after the frames of a read are all there.

The sensor side reads once a cycle and sends its frames one after the other. A step just before the
last of them decides by what is a cycle old, one just after it by what is as old as the bus is slow.
A tick is as long as that cycle or goes into it, so steps stay where in it they began, wherever that
was, until they are moved. They are moved to where a read's frames are awaited no longer than
needed: longer at once when a step came between the frames of a read, and shorter by little with
each that did not. Of several steps in a cycle, one is moved so, and the others with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from meshpoint.controller.measure.step_inputs import StepInputs
from meshpoint.controller.settings.settings import READ_CYCLE_US
from meshpoint.dbc.messages import EdgesInputRise
from meshpoint.dbc.sensor_time import unwrap

LONGER_US: Final = 300
"""After a step before which frames had not all come, they are awaited for so much longer."""
SHORTER_US: Final = 1
"""After each step that had them all, they are awaited for so much less."""
SOONER_AFTER: Final = 300
"""After this number of steps in a row that had them all, they are awaited for `SHORTER_US` less
once more with each. So one step in some two hundred comes too soon, and a time in which frames came
late is forgotten within seconds."""
MOST_MOVED_US: Final = 500
"""A step is moved by no more than this against the one before."""
MOST_US: Final = round(0.8 * READ_CYCLE_US)
"""They are awaited no longer."""
CYCLE_OFF_US: Final = round(0.02 * READ_CYCLE_US)
"""The sensors' cycle may be off by so much; with another one there is nothing to keep."""


class StepTiming:
    """How much sooner the next step should come than a tick after this one."""

    def __init__(self, tick_us: int) -> None:
        self._tick_us = tick_us
        self._fits = READ_CYCLE_US % tick_us == 0
        """Whether each cycle has steps at the same times."""
        self._waits_us = 0
        """How long after a read its frames are awaited."""
        self._had_all = 0
        """How many steps in a row have had them all."""
        self._read_us: int | None = None
        """When the newest read was made of which a frame has come (sensor time)."""
        self._ticks = 0
        """How many ticks ago that read's frame came."""
        self._whole_us: int | None = None
        """When the newest read was made of which all frames have come (sensor time)."""
        self._is_kept = False
        """Whether reads follow each other as they should."""
        self.sooner_us = 0
        """To be taken from the tick that follows; negative to step later."""

    def between(self, inputs: StepInputs, sensor_us: int) -> None:
        """The frames of a step between two ticks."""
        self._see_last(inputs, sensor_us)
        first = _reads(inputs, sensor_us)
        if first:
            self._read_us, self._ticks = first[-1], -1

    def take(self, inputs: StepInputs, sensor_us: int) -> None:
        """The frames of a tick's step, made at this time of the sensor clock."""
        self.sooner_us = 0
        self._ticks += 1
        self._see_last(inputs, sensor_us)
        first = _reads(inputs, sensor_us)
        if first:
            self._follow(len(first), first[-1])
        if not self._is_kept or self._read_us is None:
            return
        age_us = sensor_us - self._read_us
        is_whole = self._whole_us is not None and self._whole_us >= self._read_us
        if not -self._tick_us <= 2 * self._off_us(age_us) < self._tick_us:
            return  # of the steps in this cycle another one is nearer
        if age_us > READ_CYCLE_US - LONGER_US:
            # Nothing has come yet of the read that is due.
            age_us, is_whole = age_us - READ_CYCLE_US, False
        if is_whole:
            self._had_all += 1
            shorter_us = SHORTER_US * (1 + self._had_all // SOONER_AFTER)
            self._waits_us = max(0, self._waits_us - shorter_us)
        else:
            self._had_all = 0
            # By no more for a step that was itself held up: that is the machine's doing, not the
            # read's.
            longer_us = min(self._waits_us, age_us) + LONGER_US
            self._waits_us = min(max(self._waits_us, longer_us), MOST_US)
        self.sooner_us = max(-MOST_MOVED_US, min(MOST_MOVED_US, self._off_us(age_us)))

    def _see_last(self, inputs: StepInputs, sensor_us: int) -> None:
        """The last frame of a read."""
        if inputs.sleeves_aux:
            self._whole_us = unwrap(inputs.sleeves_aux[-1].sample_time_us, sensor_us)

    def _follow(self, frames: int, read_us: int) -> None:
        """The first frames of this many reads have come, the newest of this one."""
        before_us, self._read_us = self._read_us, read_us
        ticks, self._ticks = self._ticks, 0
        if before_us is None or not self._fits:
            return
        # A first frame that comes as a step does is taken by this one or by the next.
        apart_us = abs(frames * READ_CYCLE_US - ticks * self._tick_us)
        off_us = abs(read_us - before_us - frames * READ_CYCLE_US)
        follows = apart_us < READ_CYCLE_US and off_us <= CYCLE_OFF_US
        self._is_kept = follows and (self._is_kept or frames == 1)

    def _off_us(self, age_us: int) -> int:
        """How much later than awaited a step is at which the newest read is so old."""
        half = READ_CYCLE_US // 2
        return (age_us - self._waits_us + half) % READ_CYCLE_US - half


def _reads(inputs: StepInputs, sensor_us: int) -> Sequence[int]:
    """When the reads were made of which a first frame has come: the edge frame that has the highest
    bus priority. The splitter's and range's sleeves come last."""
    return [unwrap(each.read_time_us, sensor_us) for each in inputs.edges[EdgesInputRise]]
