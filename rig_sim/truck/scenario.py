"""A scenario of faults as a TOML file:

[[fault]]
kind = "hall_dropout"     # as listed by `meshpoint rig --describe`
target = 2                # which channel, valve or sleeve; 0 where left out
at_ms = 1500.0            # after power-up
for_ms = 200.0            # until further notice where left out
value = 0.0               # how much, in the kind's unit
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

from meshpoint.dbc.messages import RigFault
from meshpoint.gearbox.tables import TableError, load_toml
from meshpoint.rig_sim.orders import FaultOrder, ScheduledFault
from meshpoint.rig_sim.truck.faults import KINDS
from meshpoint.units import MS_US

LONGEST_MS: Final = 1e9
KEYS: Final = ("kind", "target", "at_ms", "for_ms", "value")


class ScenarioError(TableError):
    """A scenario that cannot be used; the message names file, entry, found and allowed."""


def load_scenario(path: Path) -> tuple[ScheduledFault, ...]:
    """The faults of a file, in the order of time. ScenarioError says what is wrong with it."""
    try:
        table = load_toml(path)
    except TableError as error:
        raise ScenarioError(str(error)) from error
    unknown = sorted(set(table) - {"fault"})
    entries = table.get("fault", [])
    if unknown or not isinstance(entries, list):
        raise ScenarioError(f"{path}: found {unknown or 'fault'}, allowed is a list [[fault]]")
    faults = [_fault(entry, f"{path}: fault {i + 1}") for i, entry in enumerate(entries)]
    return tuple(sorted(faults, key=lambda fault: fault.at_us))


def _fault(entry: Any, where: str) -> ScheduledFault:
    if not isinstance(entry, dict):
        raise ScenarioError(f"{where} = {entry!r}, allowed is a table")
    for key in entry:
        if key not in KEYS:
            raise ScenarioError(f"{where}: unknown key '{key}', allowed are {', '.join(KEYS)}")
    names = {kind.name.lower(): kind for kind in RigFault}
    name = entry.get("kind")
    if name not in names:
        raise ScenarioError(f"{where}: kind = {name!r}, allowed is one of {', '.join(names)}")
    kind = names[name]
    first = KINDS[kind].first
    last = first + max(KINDS[kind].targets - 1, 0)
    target = entry.get("target", first)
    if not (isinstance(target, int) and not isinstance(target, bool) and first <= target <= last):
        raise ScenarioError(
            f"{where}: target = {target!r}, allowed is a whole number {first}..{last}"
        )
    at_us = round(_number(entry, "at_ms", where, 0.0, LONGEST_MS) * MS_US)
    for_us = round(_number(entry, "for_ms", where, 0.0, LONGEST_MS) * MS_US)
    value = _number(entry, "value", where, -1e6, 1e6)
    return ScheduledFault(at_us, FaultOrder(int(kind), target, value, for_us))


def _number(entry: dict[str, Any], key: str, where: str, low: float, high: float) -> float:
    value = entry.get(key, 0.0)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and math.isfinite(value) and low <= value <= high):
        raise ScenarioError(f"{where}: {key} = {value!r}, allowed is a number {low:g}..{high:g}")
    return float(value)
