"""Keeps what a log of the classic profile cannot hold: when each step was, and what it consumed.

On CAN FD every status frame says so. Eight bytes have no room for it, so a controller that shall be
repeated to the byte writes it beside the run header, a line a step: its time, how many frames of
our contracts it consumed, their CRC, and how many foreign ones.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, Final, NamedTuple

from meshpoint.bus.core import AroundCore, Core, Step
from meshpoint.bus.diagnosis.core import GROUPS
from meshpoint.bus.records import Records
from meshpoint.dbc.classic.codecs import CLASSIC_IDS
from meshpoint.dbc.frame import Frame, crc_of
from meshpoint.dbc.j1939 import XCP_COMMAND_ID, canonical, group_of
from meshpoint.dbc.layout import CODECS
from meshpoint.gearbox.reading import UnreadableError, open_regular

OWN_ADDRESS: Final = 0x03
_KNOWN: Final = CLASSIC_IDS | {codec.spec.can_id for codec in CODECS.values()}
_DIAGNOSED: Final = "diagnosed"
LONGEST_LINE: Final = 200
MOST_FRAMES: Final = 1 << 20


class StepRecordError(ValueError):
    """A record of steps that cannot be used; names file, line and what is wrong."""


class Kind(Enum):
    """What a frame on a classic bus is to the controller."""

    KNOWN = "known"
    """Of our contracts, from another node."""
    FOREIGN = "foreign"
    """Of nobody here: the controller counts it."""
    UNHEARD = "unheard"
    """Under its own address, or what never comes as far as its core."""


def kind_of(frame: Frame, *, diagnosed: bool = False) -> Kind:
    """frame: as `canonical` has it. diagnosed: garage diagnosis keeps what is for it."""
    if not frame.is_extended:
        return Kind.FOREIGN
    if frame.can_id & 0xFF == OWN_ADDRESS:
        return Kind.UNHEARD
    if frame.can_id in _KNOWN or (frame.can_id == XCP_COMMAND_ID and not frame.is_fd):
        return Kind.KNOWN
    if frame.is_fd or (diagnosed and group_of(frame.can_id) in GROUPS):
        return Kind.UNHEARD
    return Kind.FOREIGN


class RecordedStep(NamedTuple):
    """What one step was made of."""

    time_us: int
    known: int
    """Frames of our contracts that it consumed."""
    crc: int
    foreign: int
    is_last: bool
    """The controller ended here, with its last frames."""


class StepRecord(AroundCore[Core]):
    """A core whose steps are handed over to be written."""

    def __init__(self, core: Core, records: Records, run_hash: int, *, diagnosed: bool) -> None:
        """diagnosed: the core answers garage diagnosis, too."""
        super().__init__(core)
        self._records, self._run_hash, self._diagnosed = records, run_hash, diagnosed
        self._known: list[Frame] = []
        self._foreign = 0
        self._name = ""

    def receive(self, frame: Frame) -> None:
        """As the core does; counted."""
        heard = canonical(frame)
        kind = kind_of(heard, diagnosed=self._diagnosed)
        if kind is Kind.KNOWN:
            self._known.append(heard)
        elif kind is Kind.FOREIGN:
            self._foreign += 1
        self._core.receive(frame)

    def step(self, now_us: int) -> Step:
        """The core's step."""
        self._put(now_us, is_last=False)
        return self._core.step(now_us)

    def shutdown(self, now_us: int) -> Step:
        """The core's last frames; ends the record."""
        self._known, self._foreign = [], 0  # no step consumes them any more
        self._put(now_us, is_last=True)
        self._records.end(self._name)
        return self._core.shutdown(now_us)

    def _put(self, now_us: int, *, is_last: bool) -> None:
        if not self._name:
            self._name = step_record_name(self._run_hash, now_us)
            self._records.put(self._name, json.dumps({_DIAGNOSED: self._diagnosed}))
        line = RecordedStep(now_us, len(self._known), crc_of(self._known), self._foreign, is_last)
        self._records.put(self._name, json.dumps(line))
        self._known, self._foreign = [], 0


def step_record_name(run_hash: int, first_us: int) -> str:
    """File name of the record of a run whose first step was at that time."""
    return f"steps-{run_hash:016x}-{first_us}.jsonl"


class RecordedSteps:
    """Reads the record of a run, a step at a time: it may be of many hours."""

    def __init__(self, path: Path) -> None:
        """StepRecordError where there is none."""
        self._path = path
        self._lines = self._read()
        first = next(self._lines, None)
        if not (isinstance(first, dict) and isinstance(first.get(_DIAGNOSED), bool)):
            raise StepRecordError(f"{path}: not a record of steps")
        self.diagnosed: bool = first[_DIAGNOSED]
        """Whether the controller answered garage diagnosis."""

    def __iter__(self) -> Iterator[RecordedStep]:
        """The steps; StepRecordError at a line that is none."""
        for number, values in enumerate(self._lines, 2):
            try:
                yield _step(values)
            except (ValueError, TypeError) as error:
                raise StepRecordError(f"{self._path}, line {number}: not a step: {error}") from None

    def _read(self) -> Iterator[Any]:
        try:
            with open_regular(self._path) as file:
                while line := file.readline(LONGEST_LINE):
                    if not line.endswith(b"\n"):
                        return  # cut off
                    yield json.loads(line)
        except UnreadableError as error:
            raise StepRecordError(str(error)) from error
        except (OSError, ValueError, RecursionError) as error:
            raise StepRecordError(f"{self._path}: cannot be read: {error}") from error


def _step(values: Any) -> RecordedStep:
    step = RecordedStep(*values)
    limits = (1 << 63, MOST_FRAMES, 1 << 32, MOST_FRAMES)
    for name, value, limit in zip(RecordedStep._fields, values, limits, strict=False):
        if not (type(value) is int and 0 <= value < limit):
            raise ValueError(f"{name} {value!r}")
    if type(step.is_last) is not bool:
        raise ValueError(f"is_last {step.is_last!r}")
    return step
