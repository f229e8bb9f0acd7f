"""What may happen to a world: its kinds, and the file that repeats it.

Faults of the gearbox go by the names of `RigFault`; those of the bus and of the controller's own
node are here. A deed is a sequence gone mad (`deeds`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, NamedTuple

from benchmarks.swarm.deeds import DEEDS
from meshpoint.base.errors import CommandError
from meshpoint.dbc.messages import ControllerState, RigFault
from meshpoint.gearbox.reading import read_text
from meshpoint.rig_sim.truck.faults import KINDS

REQUEST: Final = "request"
"""A gear is asked for: value."""
STATES: Final = ("", *(state.name.lower() for state in ControllerState))
FILE_LIMIT_BYTES: Final = 1_000_000
LONGEST_MS: Final = 600_000
MOST_EVENTS: Final = 10_000


class Group(IntEnum):
    """The frames that a fault of the bus strikes."""

    ALL = 0
    SLOW = 1
    """Positions, pressures, clutch."""
    EDGES = 2
    VALVE_STATUS = 3
    COMMANDS = 4
    """Valve and clutch commands, on their way to the gearbox."""
    J1939 = 5
    """Engine speed, engine request and the gear asked for."""


BUS_KINDS: Final = {
    "bus_drop": "this share of the frames does not arrive",
    "bus_duplicate": "this share of the frames arrives twice",
    "bus_bit_flip": "this share of the frames arrives with a wrong bit",
    "bus_delay": "frames arrive this many ms late",
    "bus_reorder": "this share of the frames is overtaken by the next",
    "bus_babble": "another node sends frames of the highest priority, one each value ms",
    "bus_own_identifier": "another node sends valve commands without protection, one each value ms",
    "bus_off": "the controller is off the bus; what it had waiting is sent afterwards",
}
NODE_KINDS: Final = {
    "controller_stalled": "the controller's event loop hangs",
    "controller_restarted": "the controller starts anew",
}
RIG_KINDS: Final = tuple(kind.name.lower() for kind in RigFault if kind is not RigFault.NO_FAULT)
FAULT_KINDS: Final = (*RIG_KINDS, *BUS_KINDS, *NODE_KINDS, *DEEDS)
"""Every fault that can be drawn."""


class Event(NamedTuple):
    """Something that happens at a time since the start, and for how long."""

    at_ms: int
    kind: str
    target: int = 0
    value: float = 0.0
    for_ms: int = 0
    state: str = ""
    """Where one is named: it waits, from `at_ms` on, until the sequence enters this state."""


@dataclass(frozen=True)
class World:
    """All that an episode depends on besides data sheet and program."""

    seed: int
    start_gear: int = 8
    layshaft_rpm: float = 1400.0
    settings: dict[str, float] = field(default_factory=dict)
    """Controller settings other than the default, as group.name in SI."""
    events: tuple[Event, ...] = ()
    safety_ms: int = 10_000
    """How long anything may fail; then faults end, and shifts must come back."""
    dog_splitter: bool = False
    """Whether its splitter has dog teeth, whatever the swarm's sheet says: `truck12-dog`."""

    def to_json(self) -> dict[str, Any]:
        """As the scenario file has it."""
        return {
            "seed": self.seed,
            "start_gear": self.start_gear,
            "layshaft_rpm": self.layshaft_rpm,
            "settings": dict(self.settings),
            "safety_ms": self.safety_ms,
            "dog_splitter": self.dog_splitter,
            "events": [event._asdict() for event in self.events],
        }


def save_world(path: Path, world: World, more: dict[str, Any]) -> None:
    """Writes a scenario file; `more` says what came of it."""
    values = {"scenario": world.to_json()} | more
    path.write_text(json.dumps(values, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def load_world(path: Path) -> World:
    """Reads a scenario file. CommandError names file, entry and what is allowed."""
    try:
        values = json.loads(read_text(path, FILE_LIMIT_BYTES))["scenario"]
        return _world(values)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise CommandError(f"{path}: not a scenario of the swarm: {error}") from error


def _world(values: dict[str, Any]) -> World:
    settings = {str(key): _number(values["settings"], key, -1e9, 1e9) for key in values["settings"]}
    entries = values["events"]
    if len(entries) > MOST_EVENTS:
        raise ValueError(f"{len(entries)} events, allowed are {MOST_EVENTS}")
    return World(
        seed=int(_number(values, "seed", 0, 2**63)),
        start_gear=int(_number(values, "start_gear", 1, 14)),
        layshaft_rpm=_number(values, "layshaft_rpm", 100.0, 2500.0),
        settings=settings,
        events=tuple(sorted(_event(entry) for entry in entries)),
        safety_ms=int(_number(values, "safety_ms", 0, LONGEST_MS)),
        dog_splitter=values.get("dog_splitter") is True,
    )


def _event(entry: dict[str, Any]) -> Event:
    kind = entry["kind"]
    if kind != REQUEST and kind not in FAULT_KINDS:
        raise ValueError(f"kind {kind!r}, allowed are {REQUEST}, {', '.join(FAULT_KINDS)}")
    last = len(Group) - 1
    if kind in RIG_KINDS:
        last = max(0, KINDS[RigFault[kind.upper()]].targets - 1)
    return Event(
        int(_number(entry, "at_ms", 0, LONGEST_MS)),
        kind,
        int(_number(entry, "target", 0, last)),
        _number(entry, "value", -1e7, 1e7),
        int(_number(entry, "for_ms", 0, LONGEST_MS)),
        _state(entry),
    )


def _state(entry: dict[str, Any]) -> str:
    state = entry.get("state", "")
    if state not in STATES:
        raise ValueError(f"state {state!r}, allowed are {', '.join(STATES[1:])}")
    return str(state)


def _number(values: dict[str, Any], key: str, low: float, high: float) -> float:
    value = values[key]
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{key} = {value!r}, allowed is {low:g}..{high:g}")
    return float(value)
