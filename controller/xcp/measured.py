"""What a master may measure: the controller's own messages as its newest step sent them, bit for
bit, and what is in no message: the guard's row, where the sleeves stand, the learned figures."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from meshpoint.controller.calibration.learned import Calibration
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

    def of(self, calibration: Calibration) -> float:
        """Its value; NaN before anything is known of it."""
        found: Any = calibration
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
    calibration: Callable[[], Calibration]
    """What has been learned; it takes time to collect, and is asked for where a master reads it."""


class MeasuredMemory:
    """The bytes of the newest step."""

    def __init__(self) -> None:
        self._sent = bytearray(SENT_BYTES)
        self._facts: StepFacts | None = None
        self._figures: bytes | None = bytes(FIGURE_BYTES * FIGURES)

    def take(self, frames: Iterable[Frame], facts: StepFacts) -> None:
        """What a step sends; a message that it does not send stays as it was."""
        for frame in frames:
            start = OFFSETS.get(frame.can_id)
            if start is not None:
                self._sent[start : start + len(frame.data)] = frame.data
        self._facts, self._figures = facts, None

    def read(self, start: int, length: int) -> bytes:
        """Some of the bytes."""
        end = start + length
        if end <= SENT_BYTES:
            return bytes(self._sent[start:end])
        if self._figures is None and self._facts is not None:
            self._figures = _packed(self._facts)
        return (bytes(self._sent) + (self._figures or b""))[start:end]


def _packed(facts: StepFacts) -> bytes:
    calibration = facts.calibration()
    sleeves_mm = (place_m / MM for place_m in facts.sleeves_m)
    learned = (figure.of(calibration) for figure in LEARNED)
    return struct.pack(f"<{FIGURES}f", *sleeves_mm, facts.guard_row, *learned)
