"""Keeps what the log of a link outage cannot hold: when each step was, and what it consumed.

While its bus is away a controller goes on deciding, but nothing that it sends reaches a log, and so
a replay could not go on after the hole. What the lost steps were made of is little: their times,
and the frames that had still arrived. They are written beside the run header, with those of two
seconds before (what was sent then may have got stuck on its way) and one second after.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.records import Records
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox.reading import read_text

BEFORE_STEPS: Final = 200
AFTER_STEPS: Final = 100
MOST_STEPS: Final = 720_000
"""Two hours; an outage that lasts longer is not kept to its end."""
RECORD_LIMIT_BYTES: Final = 200_000_000
MOST_STEP: Final = 1 << 32
LONGEST_BYTES: Final = 64


class OutageError(ValueError):
    """A record of an outage that cannot be used; names file, line and what is wrong."""


class StepInput(NamedTuple):
    """What one step was made of."""

    number: int
    time_us: int
    frames: list[Frame]


class OutageRecord(AroundCore[Core]):
    """A core with its memory of the newest steps, which it hands over to be written where frames
    were not sent."""

    def __init__(
        self, core: Core, records: Records, run_hash: int, discarded: Callable[[], int]
    ) -> None:
        """discarded: how many frames the driver could not send so far."""
        super().__init__(core)
        self._records, self._run_hash = records, run_hash
        self._discarded = discarded
        self._discarded_before = 0
        self._newest: deque[StepInput] = deque(maxlen=BEFORE_STEPS)
        self._heard: list[Frame] = []
        self._number = 0
        self._name = ""
        """Of the file of the outage that is recorded; empty: none is."""
        self._left = self._kept = 0
        self._sent = 0
        """Steps in a row that could be sent."""

    def receive(self, frame: Frame) -> None:
        """As the core does; kept."""
        self._heard.append(frame)
        self._core.receive(frame)

    def step(self, now_us: int) -> Step:
        """The core's step; a line of its own where a record begins."""
        lines = self._measure()
        heard, self._heard = self._heard, []
        self._take(StepInput(self._number, now_us, heard))
        self._number += 1
        step = self._core.step(now_us)
        return step if not lines else Step(step.frames, [*step.events, *lines])

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames; ends the record."""
        lines = self._measure()
        self._end()
        step = self._core.shutdown(now_us)
        return Step(step.frames, [*step.events, *lines])

    def _measure(self) -> list[str]:
        """Whether the step before could be sent."""
        discarded = self._discarded()
        is_lost = discarded > self._discarded_before
        self._discarded_before = discarded
        self._sent = 0 if is_lost else self._sent + 1
        if self._sent > AFTER_STEPS:
            self._kept = 0  # that outage is over
        if not is_lost or self._kept >= MOST_STEPS:
            return []
        self._left = AFTER_STEPS
        return [] if self._name else self._begin()

    def _begin(self) -> list[str]:
        if not self._newest:
            return []
        self._name = record_name(self._run_hash, self._newest[0].number)
        self._kept = 0
        for each in self._newest:
            self._keep(each)
        return [f"outage: what its steps were made of goes to {self._name}"]

    def _take(self, step: StepInput) -> None:
        self._newest.append(step)
        if not self._name:
            return
        self._keep(step)
        self._left -= 1
        if self._left <= 0 or self._kept >= MOST_STEPS:
            self._end()

    def _keep(self, step: StepInput) -> None:
        frames = [[f.can_id, f.data.hex(), f.is_fd, f.is_extended] for f in step.frames]
        self._records.put(self._name, json.dumps([step.number, step.time_us, frames]))
        self._kept += 1

    def _end(self) -> None:
        if self._name:
            self._records.end(self._name)
        self._name = ""


def record_name(run_hash: int, first_step: int) -> str:
    """File name of the record of an outage."""
    return f"outage-{run_hash:016x}-{first_step}.jsonl"


def load_outages(folder: Path, run_hash: int) -> dict[int, StepInput]:
    """All steps of a run that its records hold, by number. OutageError for a file that is none; a
    last line that was cut off is left out."""
    found: dict[int, StepInput] = {}
    for path in sorted(folder.glob(record_name(run_hash, 0).replace("-0.", "-*."))):
        try:
            lines = read_text(path, RECORD_LIMIT_BYTES).split("\n")
        except (OSError, ValueError) as error:
            raise OutageError(f"{path}: {error}") from error
        for number, line in enumerate(lines[:-1], 1):
            try:
                step = _step(json.loads(line))
            except (ValueError, TypeError, RecursionError) as error:
                raise OutageError(f"{path}, line {number}: not a step: {error}") from error
            found[step.number] = step
    return found


def _step(values: Any) -> StepInput:
    number, time_us, frames = values
    if not (type(number) is int and 0 <= number < MOST_STEP):
        raise ValueError(f"step {number!r}")
    if not (type(time_us) is int and 0 <= time_us < 1 << 63):
        raise ValueError(f"time {time_us!r}")
    return StepInput(number, time_us, [_frame(each) for each in frames])


def _frame(values: Any) -> Frame:
    can_id, text, is_fd, is_extended = values
    if not (type(can_id) is int and 0 <= can_id < 1 << 29):
        raise ValueError(f"identifier {can_id!r}")
    data = bytes.fromhex(text)
    if len(data) > LONGEST_BYTES:
        raise ValueError(f"{len(data)} bytes of data")
    return Frame(can_id, data, bool(is_fd), bool(is_extended))
