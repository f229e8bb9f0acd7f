"""The settings that may change between shifts, as four bytes each: a reference page, which is the
run header's, and a working page.

Not among them: the guard's limits, the tick, and what the estimators were built with.
"""

from __future__ import annotations

import dataclasses
import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, Final

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.xcp.protocol import RefusedError, XcpError
from meshpoint.gearbox.tables import Rule, TableError

ROW_BYTES: Final = 4
GROUPS: Final = ("window", "aim", "prices", "limits", "engine")
OF_THE_GUARD: Final = frozenset({"valve_on_ms"})


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
