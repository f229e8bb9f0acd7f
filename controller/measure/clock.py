"""The sensor clock as the controller knows it, and when in the sensors' cycle to step.

The controller steps in its own clock and plans in the sensor clock. The offset between them is the
least `now - stamp` seen lately: every frame says when it was read, and is consumed later than that,
so the least difference carries the least delay. It errs to the early side by that least delay,
which the activation lead covers.

A probe: a frame has no arrival time of its own; it counts from the step that consumes it, which may
be a tick later. Once a second the controller therefore steps as soon as the first edge frame of a
read is there, so that the least `now - stamp` contains the bus's delay alone. A controller that
switches valves itself needs that to be on time; with scheduled activations it saves a tick of lead,
and so a tick of prediction.

The place of the steps: the sensor side reads once a cycle and sends its frames one after the other.
A step just before the last of them decides by what is a cycle old, one just after it by what is as
old as the bus is slow. A tick is as long as that cycle or goes into it, so steps stay where in it
they began, wherever that was, until they are moved. They are moved to where a read's frames are
awaited no longer than needed: longer at once when a step came between the frames of a read, and
shorter by little with each that did not. Of several steps in a cycle, one is moved so, and the
others with it.

More lead: on a machine that is late, or a bus that is full, the least delay seen of a read is too
large as well, so the sensor clock is thought to be further behind than it is. A refused activation
is the proof: until some time without one, activations are sent a tick earlier, and after another
refusal two.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final

from meshpoint.controller.measure.inputs import StepInputs
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import EdgesInputRise, ValveStatus
from meshpoint.dbc.sensor_time import READ_CYCLE_US, unwrap

WINDOW: Final = 4000
"""Stamps the offset looks back over: about four seconds, in which 200 ppm of drift is 0.8 ms and
a shift is over."""
JUMP_US: Final = 500_000
"""A stamp this far from where the clock should be means that the sensor side has restarted."""
GOES_ON_US: Final = 100_000
"""The next stamp, ten lost frames later at most."""
ON_TIME_US: Final = 50_000
BACK_US: Final = 200_000
"""So does one this far behind the newest: frames keep their order, but for what a bus delays."""

EVERY_US: Final = 1_000_000
"""From probe to probe. In this time 200 ppm of drift are 0.2 ms, and one step more in a hundred
leaves cyclic frames their cycle; the clock looks back over some."""
FIRST_OF_A_READ: Final = CODECS[EdgesInputRise.__name__].spec.can_id
"""The edge frame with the highest bus priority of a read: it arrives first."""

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
"""A read's frames are awaited for no longer than this."""
CYCLE_OFF_US: Final = round(0.02 * READ_CYCLE_US)
"""The sensors' cycle may be off by so much; with another one there is nothing to keep."""

MOST_TICKS: Final = 3
KEPT_US: Final = 10_000_000
"""More lead is kept for so long after a refusal."""


class SensorClockEstimate:
    """Unwraps stamps, and estimates the present time of the sensor clock."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[int, int]] = deque()
        """Of the last WINDOW stamps those than which no later one is less: number and offset. So
        the first is the least of all, and none has to be looked for."""
        self._stamps = 0
        self._least = 0
        self.latest_us = 0
        """The newest stamp seen, unwrapped."""
        self.jumps = 0
        """Number of jumps of the sensor clock."""
        self.late = 0
        """How often stamps have begun to come late: the bus or the machine is overloaded."""
        self._is_late = False

    def stamp(self, stamp: int, now_us: int) -> int:
        """The unwrapped time of a frame read just before `now_us` of the controller's clock."""
        if not self._offsets:
            time_us = self.latest_us = stamp
        else:
            expected_us = now_us - self._least
            time_us = unwrap(stamp, expected_us)
            if self._goes_on(time_us) and time_us < expected_us - JUMP_US:
                self._came_late()
            elif abs(time_us - expected_us) > JUMP_US or time_us < self.latest_us - BACK_US:
                self.jumps += 1
                self._offsets.clear()
                time_us = self.latest_us = unwrap(stamp, self.latest_us)
            elif time_us > expected_us - ON_TIME_US:
                self._is_late = False
        # Frames of a read come one after the other, so one of an older read may be the last seen.
        self.latest_us = max(self.latest_us, time_us)
        self._note(now_us - time_us)
        return time_us

    def _goes_on(self, time_us: int) -> bool:
        """Whether a stamp follows the newest as frames do, whenever it may come: then the clock has
        not jumped, and its frames have waited somewhere."""
        return -BACK_US <= time_us - self.latest_us <= GOES_ON_US

    def _came_late(self) -> None:
        if not self._is_late:
            self.late += 1
        self._is_late = True

    def restart(self) -> None:
        """The sensor side has restarted, however near to the old one its clock reads."""
        self.jumps += 1
        self._offsets.clear()

    def set_back(self, stamp: int, now_us: int) -> int:
        """As `stamp`, for one that is known to be of a clock that was set back by however little:
        the message's counter went on, its time did not. Frames of one identifier keep their
        order."""
        self.jumps += 1
        self._offsets.clear()
        self.latest_us = unwrap(stamp, self.latest_us)
        self._note(now_us - self.latest_us)
        return self.latest_us

    def _note(self, offset: int) -> None:
        while self._offsets and self._offsets[-1][1] >= offset:
            self._offsets.pop()
        self._offsets.append((self._stamps, offset))
        if self._offsets[0][0] <= self._stamps - WINDOW:
            self._offsets.popleft()
        self._stamps += 1
        self._least = self._offsets[0][1]

    def now_us(self, now_us: int) -> int:
        """The sensor clock now; 0 before the first stamp."""
        return now_us - self._least if self._offsets else 0


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


class RefusedLead:
    """Counts refusals, by the valve side's own count."""

    def __init__(self, tick_us: int) -> None:
        self._tick_us = tick_us
        self._refused: int | None = None
        self._refused_us = 0
        self.more_us = 0
        """How much earlier activations are to be sent."""

    def take(self, status: ValveStatus | None, now_us: int) -> bool:
        """The newest status of the valves; returns whether it shows a refusal since the one
        before."""
        if self.more_us and now_us - self._refused_us > KEPT_US:
            self.more_us = 0
        if status is None:
            return False
        before, self._refused = self._refused, status.refused_count
        if before in (None, self._refused):
            return False
        self._refused_us = now_us
        self.more_us = min(self.more_us + self._tick_us, MOST_TICKS * self._tick_us)
        return True
