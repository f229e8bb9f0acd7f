"""What a master may measure: the controller's own messages as its newest step sent them, bit for
bit, and what is in no message: the guard's row, where the sleeves stand, the learned figures."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from meshpoint.controller.settings.learned import Calibration
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.messages import (
    ClutchCommand,
    ControllerEstimates,
    ControllerStatus,
    ShiftOutcome,
    ShiftPrediction,
    ValveCommand,
)
from meshpoint.gearbox import Sleeve
from meshpoint.gearbox.tables import Rule, key_of
from meshpoint.units import MM

MESSAGES: Final = tuple(
    CODECS[message.__name__].spec
    for message in (
        ValveCommand, ClutchCommand, ControllerStatus, ControllerEstimates, ShiftPrediction,
        ShiftOutcome,
    )
)  # fmt: skip
MESSAGE_BYTES: Final = 64
"""From one message to the next."""
OFFSETS: Final = {spec.can_id: MESSAGE_BYTES * i for i, spec in enumerate(MESSAGES)}
"""Where each message's bytes begin, by identifier."""
SENT_BYTES: Final = MESSAGE_BYTES * len(MESSAGES)
FIGURE_BYTES: Final = 4
SLEEVES: Final = tuple(Sleeve)


@dataclass(frozen=True)
class LearnedFigure:
    """A number of the calibration file, in that file's unit."""

    groups: tuple[str, ...]
    attribute: str
    rule: Rule

    @property
    def name(self) -> str:
        """As the calibration file has it."""
        return ".".join(("learned", *self.groups, self.rule.key))

    def of(self, learned: Any) -> float:
        """Its value, of something with the groups of `Calibration`; NaN before anything is known of
        it."""
        found = learned
        for name in (*self.groups, self.attribute):
            if found is None:
                break
            found = getattr(found, name)
        return math.nan if found is None else found / self.rule.si


def _learned(of: Any, groups: tuple[str, ...] = ()) -> Iterator[LearnedFigure]:
    """The numbers of a record and of those in it; lists of them (teeth, knots) are left out."""
    for field in dataclasses.fields(of):
        rule: Rule | None = field.metadata.get("rule")
        if rule is None:
            yield from _learned(field.metadata["group"], (*groups, key_of(field)))
        elif rule.kind in (float, int) and groups:
            yield LearnedFigure(groups, field.name, rule)


LEARNED: Final = tuple(_learned(Calibration))
FIGURES: Final = len(SLEEVES) + 1 + len(LEARNED)
"""Float32 after the messages: sleeves in mm, the guard's row, the learned figures."""
MEASURED_BYTES: Final = SENT_BYTES + FIGURE_BYTES * FIGURES


@dataclass(frozen=True)
class StepFacts:
    """What a step leaves for a master besides its frames."""

    sleeves_m: tuple[float, ...]
    """In the order of `SLEEVES`; NaN before its first sample."""
    guard_row: int
    """That blocked this step's valve command; 0: none."""
    learned: Callable[[], Any]
    """What has been learned, with the groups of `Calibration`. Each takes time to work out: it is
    asked for where a master reads it."""


class MeasuredMemory:
    """The bytes of the newest step."""

    def __init__(self) -> None:
        self._sent = bytearray(SENT_BYTES)
        self._facts: StepFacts | None = None
        self._learned: Any = None
        """Of the newest step, once any of it was read."""

    def take(self, frames: Iterable[Frame], facts: StepFacts) -> None:
        """What a step sends; a message that it does not send stays as it was."""
        for frame in frames:
            start = OFFSETS.get(frame.can_id)
            if start is not None:
                self._sent[start : start + len(frame.data)] = frame.data
        self._facts, self._learned = facts, None

    def read(self, start: int, length: int) -> bytes:
        """Some of the bytes."""
        end = start + length
        sent = bytes(self._sent[start:end])
        if end <= SENT_BYTES:
            return sent
        begin = max(start, SENT_BYTES) - SENT_BYTES
        first, last = begin // FIGURE_BYTES, -(-(end - SENT_BYTES) // FIGURE_BYTES)
        numbers = [self._figure(number) for number in range(first, min(last, FIGURES))]
        figures = struct.pack(f"<{len(numbers)}f", *numbers)
        return sent + figures[begin - FIGURE_BYTES * first :][: length - len(sent)]

    def _figure(self, number: int) -> float:
        """One of the floats behind the messages; what it does not need is not worked out."""
        facts = self._facts
        if facts is None:
            return 0.0
        if number < len(SLEEVES):
            return facts.sleeves_m[number] / MM
        if number == len(SLEEVES):
            return facts.guard_row
        if self._learned is None:
            self._learned = facts.learned()
        return LEARNED[number - len(SLEEVES) - 1].of(self._learned)
