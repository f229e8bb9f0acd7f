"""Points of a sweep: the same draws with one thing made otherwise, for curves and the frontier.

`backlash_percent` and `delay_sd_ms` change the gearbox and its data sheet; any number of the
controller's settings, as `window.aim_slip_rpm`, changes the controller.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, NamedTuple

from meshpoint.base.errors import CommandError
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import Rule, TableError
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import MS

BACKLASH: Final = "backlash_percent"
DELAY_SD: Final = "delay_sd_ms"
LIMIT_SDS: Final = 2.5
"""The delay's scatter is cut no nearer than this many standard deviations."""


class SweepPoint(NamedTuple):
    """A name and its value, in the units of the name."""

    name: str
    value: float

    def __str__(self) -> str:
        """As given on the command line."""
        return f"{self.name}={self.value:g}"


BASE_POINT: Final = SweepPoint("", 0.0)
"""Nothing changed."""
Changed = tuple[GearboxSheet, ControllerSettings, dict[str, float]]


def at_point(
    point: SweepPoint, sheet: GearboxSheet, settings: ControllerSettings, preset: Preset
) -> Changed:
    """Data sheet, controller settings and as-built values at a point. CommandError where the name
    is not known or the value is out of its range."""
    if point == BASE_POINT:
        return sheet, settings, {}
    try:
        if point.name == BACKLASH:
            dog = dataclasses.replace(sheet.dog, backlash_share=_within(point, 2.0, 50.0) / 100.0)
            return dataclasses.replace(sheet, dog=dog), settings, {}
        if point.name == DELAY_SD:
            return _delay_sd(_within(point, 0.0, 10.0), sheet, settings, preset)
        return sheet, _with_setting(settings, point), {}
    except TableError as error:
        raise CommandError(f"--sweep {point}: {error}") from error


def _delay_sd(
    sd_ms: float, sheet: GearboxSheet, settings: ControllerSettings, preset: Preset
) -> Changed:
    limit_ms = max(LIMIT_SDS * sd_ms, sheet.sleeve.delay_limit_s / MS)
    sleeve = dataclasses.replace(sheet.sleeve, delay_sd_s=sd_ms * MS, delay_limit_s=limit_ms * MS)
    fixed = {}
    if preset is Preset.TRUCK:
        fixed = {"sleeve.noise_sd_ms": sd_ms, "sleeve.noise_limit_ms": LIMIT_SDS * sd_ms}
    return dataclasses.replace(sheet, sleeve=sleeve), settings, fixed


def _within(point: SweepPoint, low: float, high: float) -> float:
    if not low <= point.value <= high:
        raise TableError(f"allowed is a number from {low:g} to {high:g}")
    return point.value


def _with_setting(settings: ControllerSettings, point: SweepPoint) -> ControllerSettings:
    group_name, _, key = point.name.partition(".")
    group: Any = getattr(settings, group_name, None)
    if not dataclasses.is_dataclass(group):
        raise TableError(f"allowed are {BACKLASH}, {DELAY_SD}, or GROUP.KEY of the settings")
    rules: dict[str, tuple[str, Rule]] = {
        field.metadata["rule"].key: (field.name, field.metadata["rule"])
        for field in dataclasses.fields(group)
        if field.metadata and field.metadata["rule"].kind in (int, float)
    }
    if key not in rules:
        raise TableError(f"keys of '{group_name}' are {', '.join(rules)}")
    name, rule = rules[key]
    value = _within(point, rule.low, rule.high)
    inside: float | int = round(value) if rule.kind is int else value * rule.si
    changed: Any = dataclasses.replace(group, **{name: inside})  # type: ignore[type-var]
    other: dict[str, Any] = {group_name: changed}
    return dataclasses.replace(settings, **other)
