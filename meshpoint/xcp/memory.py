"""What an XCP master reads and writes, by address: identity, measured values, calibration pages.

Measured are the controller's own messages as its newest step sent them, bit for bit, and what is in
no message: the guard's row, where the sleeves stand, the learned figures.

The pages hold the settings that may change between shifts, as four bytes each: a reference page,
which is the run header's, and a working page. Not among them: the guard's limits, the tick, and
what the estimators were built with.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, Final

from meshpoint.controller.settings.header import XcpAccess
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import ControllerSettings
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
from meshpoint.dbc.source import DBC_SHA256
from meshpoint.gearbox import Sleeve
from meshpoint.gearbox.tables import Rule, TableError, key_of
from meshpoint.units import MM
from meshpoint.xcp.protocol import RefusedError, XcpError

ROW_BYTES: Final = 4
GROUPS: Final = ("window", "aim", "prices", "limits", "engine")
OF_THE_GUARD: Final = frozenset({"valve_on_ms"})

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

IDENTITY_ADDRESS: Final = 0x1000_0000
MEASURED_ADDRESS: Final = 0x2000_0000
PAGE_ADDRESS: Final = 0x3000_0000


@dataclass(frozen=True)
class Parameter:
    """One key of a settings file: a float32 in the key's unit, or a whole number of 32 bits."""

    group: str
    attribute: str
    rule: Rule

    @property
    def name(self) -> str:
        """As `--sweep` and errors have it."""
        return f"{self.group}.{self.rule.key}"

    @property
    def is_whole(self) -> bool:
        """Whether it is a whole number."""
        return self.rule.kind is int

    @cached_property
    def _packed_limits(self) -> tuple[float, float]:
        """Its range in its unit, as four bytes can hold it: a limit may lie beyond the real one by
        its last digit."""
        return self.unpacked(self.packed(self.rule.low)), self.unpacked(self.packed(self.rule.high))

    def packed(self, value: float) -> bytes:
        """A value in the key's unit as bytes."""
        return struct.pack("<I", round(value)) if self.is_whole else struct.pack("<f", value)

    def unpacked(self, content: bytes) -> float:
        """The inverse."""
        value: float
        (value,) = struct.unpack("<I" if self.is_whole else "<f", content)
        return value

    def of(self, settings: ControllerSettings) -> float:
        """Its value in these settings, in the key's unit."""
        value: float = getattr(getattr(settings, self.group), self.attribute)
        return value / self.rule.si

    def in_si(self, content: bytes) -> float:
        """The attribute's value. RefusedError where it is out of range."""
        value, (low, high) = self.unpacked(content), self._packed_limits
        if not low <= value <= high:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        value = min(max(value, self.rule.low), self.rule.high)
        return value if self.is_whole else value * self.rule.si


def _parameters() -> tuple[Parameter, ...]:
    types = {field.name: field.metadata.get("group") for field in _fields(ControllerSettings)}
    return tuple(
        Parameter(group, field.name, field.metadata["rule"])
        for group in GROUPS
        for field in _fields(types[group])
        if field.name not in OF_THE_GUARD
    )


def _fields(of: Any) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(of)


PARAMETERS: Final = _parameters()
"""In the order of their addresses."""
PAGE_BYTES: Final = ROW_BYTES * len(PARAMETERS)


def changes_in_words(before: ControllerSettings, after: ControllerSettings) -> str:
    """Which of them have other values, and those."""
    pairs = [(each.name, each.of(before), each.of(after)) for each in PARAMETERS]
    return ", ".join(f"{name} {old:g} -> {new:g}" for name, old, new in pairs if old != new)


class Page(IntEnum):
    """Pages of the one segment."""

    REFERENCE = 0
    WORKING = 1


class CalibrationPages:
    """The two pages, which of them the controller uses, and which one a master sees."""

    def __init__(self, settings: ControllerSettings) -> None:
        """settings: the reference page."""
        self._reference = self._changed = settings
        image = b"".join(each.packed(each.of(settings)) for each in PARAMETERS)
        self._images = {Page.REFERENCE: image, Page.WORKING: image}
        self.used = self.seen = Page.WORKING

    @property
    def settings(self) -> ControllerSettings:
        """Those of the page that the controller uses."""
        return self._reference if self.used is Page.REFERENCE else self._changed

    def read(self, start: int, length: int) -> bytes:
        """Bytes of the page that a master sees."""
        return self._images[self.seen][start : start + length]

    def write(self, start: int, content: bytes) -> None:
        """All of it or nothing. RefusedError: on the reference page, for a part of a value, or
        where one would be out of its range or would not suit the others."""
        if self.seen is Page.REFERENCE:
            raise RefusedError(XcpError.WRITE_PROTECTED)
        if start % ROW_BYTES or len(content) % ROW_BYTES:
            raise RefusedError(XcpError.OUT_OF_RANGE)
        image = self._images[Page.WORKING]
        image = image[:start] + content + image[start + len(content) :]
        self._changed = self._settings_of(image)
        self._images[Page.WORKING] = image

    def copy_to_working(self) -> None:
        """The reference page's values again."""
        self._images[Page.WORKING] = self._images[Page.REFERENCE]
        self._changed = self._reference

    def _settings_of(self, image: bytes) -> ControllerSettings:
        """A row that is as in the reference keeps that one's value to its last digit."""
        changes: dict[str, dict[str, float]] = {}
        for row, parameter in enumerate(PARAMETERS):
            place = slice(ROW_BYTES * row, ROW_BYTES * (row + 1))
            if image[place] != self._images[Page.REFERENCE][place]:
                of_group = changes.setdefault(parameter.group, {})
                of_group[parameter.attribute] = parameter.in_si(image[place])
        try:
            groups = {
                name: dataclasses.replace(getattr(self._reference, name), **values)
                for name, values in changes.items()
            }
            return dataclasses.replace(self._reference, **groups)
        except TableError as error:
            raise RefusedError(XcpError.OUT_OF_RANGE) from error


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


def identity(version: str) -> str:
    """Name of the A2L that fits this build: a checksum over all that the A2L is made from (ASAM's
    EPK)."""
    made_from = (version, DBC_SHA256, repr(PARAMETERS), repr(LEARNED))
    return f"meshpoint_{hashlib.sha256(''.join(made_from).encode()).hexdigest()[:16]}"


class Memory:
    """What lies at which address."""

    def __init__(self, version: str, pages: CalibrationPages, access: XcpAccess) -> None:
        self.name = identity(version).encode()
        self.measured = MeasuredMemory()
        self._pages = pages
        self.is_writable = access is XcpAccess.WRITE

    def read(self, address: int, length: int) -> bytes:
        """RefusedError where not all of it lies in one region."""
        for start, size, read in (
            (IDENTITY_ADDRESS, len(self.name), self._identity),
            (MEASURED_ADDRESS, MEASURED_BYTES, self.measured.read),
            (PAGE_ADDRESS, PAGE_BYTES, self._pages.read),
        ):
            if start <= address and address + length <= start + size:
                return read(address - start, length)
        raise RefusedError(XcpError.ACCESS_DENIED)

    def write(self, address: int, content: bytes) -> None:
        """RefusedError: not of a page, not allowed, or a value that is."""
        start = address - PAGE_ADDRESS
        if not 0 <= start <= PAGE_BYTES - len(content):
            raise RefusedError(XcpError.ACCESS_DENIED)
        self.check_writable()
        self._pages.write(start, content)

    def check_writable(self) -> None:
        """RefusedError unless the node was started with `--xcp write`."""
        if not self.is_writable:
            raise RefusedError(XcpError.WRITE_PROTECTED)

    def _identity(self, start: int, length: int) -> bytes:
        return self.name[start : start + length]
