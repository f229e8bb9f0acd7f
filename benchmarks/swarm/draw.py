"""A world by its seed: which faults are possible in it, how often they come, what is asked for."""

from __future__ import annotations

from typing import Final

import numpy as np

from benchmarks.swarm.deeds import DEEDS
from benchmarks.swarm.events import (
    BUS_KINDS,
    NODE_KINDS,
    REQUEST,
    RIG_KINDS,
    Event,
    Group,
    World,
)
from meshpoint.dbc.messages import RigFault
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.rig_sim.truck.faults import KINDS

FIRST_MS: Final = 300
"""Nothing is asked for sooner, but a deed may begin with the first step."""
MOST_FAULTS: Final = 5
DEED_SHARE: Final = 0.35
TIGHT_SHARE: Final = 0.15
DOG_SHARE: Final = 0.3
"""Of the worlds, have a splitter with dog teeth."""
DOG_STREAM: Final = 0xD06
IMPOSSIBLE_GEAR: Final = 15
WILD_SHARE: Final = 0.1
TIGHT: Final[tuple[tuple[str, float], ...]] = (
    ("limits.synchronise_ms", 150.0),
    ("guard.brake_on_ms", 150.0),
    ("limits.valve_on_ms", 120.0),
    ("limits.engage_ms", 100.0),
    ("limits.attempts", 1.0),
    ("limits.blocks", 1.0),
)
"""Settings at their edge, by which limits come into play that a good gearbox never meets."""
VALUES: Final[dict[str, tuple[float, float]]] = {
    "hall_missing_tooth": (0.0, 39.0),
    "hall_noise_burst": (1.0, 8.0),
    "valve_slow": (5.0, 80.0),
    "valve_slow_on": (5.0, 80.0),
    "valve_slow_off": (5.0, 80.0),
    "valve_leaks": (1.0, 50.0),
    "sleeve_stiff": (10.0, 400.0),
    "sleeve_heavy": (10.0, 200.0),
    "supply_drop": (2.0, 7.0),
    "position_offset": (-14.0, 14.0),
    "brake_fade": (0.0, 80.0),
    "clock_drift": (-200.0, 200.0),
    "clock_step": (-2e6, 2e6),
    "wheel_factor": (0.5, 2.0),
    "bus_drop": (0.01, 1.0),
    "bus_duplicate": (0.01, 1.0),
    "bus_bit_flip": (0.01, 1.0),
    "bus_delay": (1.0, 60.0),
    "bus_reorder": (0.01, 0.5),
    "bus_babble": (1.0, 20.0),
    "bus_own_identifier": (1.0, 20.0),
}
"""Least and most of a kind's value."""


def draw_world(seed: int) -> World:
    """The world of a seed."""
    rng = np.random.Generator(np.random.PCG64([seed, 0x5A4A]))
    safety_ms = int(rng.integers(6_000, 14_000))
    events = _faults(rng, safety_ms)
    has_dog = np.random.Generator(np.random.PCG64([seed, DOG_STREAM])).random() < DOG_SHARE
    start_gear, layshaft_rpm = int(rng.choice([5, 6, 7, 8, 9, 10])), float(rng.uniform(900, 1600))
    if rng.random() < DEED_SHARE:
        name = str(rng.choice(list(DEEDS)))
        deed = DEEDS[name]
        at_ms = 0 if deed.begins is None else int(rng.integers(FIRST_MS, safety_ms // 2))
        events.append(Event(at_ms, name, 0, 0.0, int(rng.integers(400, 4_500))))
        start_gear, layshaft_rpm = deed.start_gear, deed.layshaft_rpm
        has_dog = deed.dog_splitter
    settings = {}
    if rng.random() < TIGHT_SHARE:
        name, value = TIGHT[int(rng.integers(len(TIGHT)))]
        settings[name] = value
    events += _requests(rng, start_gear, safety_ms)
    return World(
        seed, start_gear, layshaft_rpm, settings, tuple(sorted(events)), safety_ms, has_dog
    )


def _faults(rng: np.random.Generator, safety_ms: int) -> list[Event]:
    """A few kinds are possible in a world: others then cannot hide what they do."""
    kinds = (*RIG_KINDS, *BUS_KINDS, *NODE_KINDS)
    chosen = rng.choice(kinds, size=int(rng.integers(1, 4)), replace=False)
    events = []
    for _ in range(int(rng.integers(0, MOST_FAULTS + 1))):
        kind = str(rng.choice(chosen))
        low, high = VALUES.get(kind, (0.0, 0.0))
        value = (
            float(np.exp(rng.uniform(np.log(low), np.log(high))))
            if low > 0.0
            else float(rng.uniform(low, high))
        )
        first, targets = _targets(kind)
        events.append(
            Event(
                int(rng.integers(FIRST_MS, safety_ms - 1_000)),
                kind,
                first + int(rng.integers(targets)),
                round(value, 3),
                int(np.exp(rng.uniform(np.log(30.0), np.log(3_000.0)))),
            )
        )
    return events


def _targets(kind: str) -> tuple[int, int]:
    """The lowest target of a kind, and how many it has."""
    if kind in RIG_KINDS:
        described = KINDS[RigFault[kind.upper()]]
        return described.first, max(described.targets, 1)
    return 0, len(Group) if kind in BUS_KINDS else 1


def _requests(rng: np.random.Generator, gear: int, safety_ms: int) -> list[Event]:
    """Mostly a gear or two up or down; now and then any, or none that there is."""
    events, at_ms = [], FIRST_MS
    while at_ms < safety_ms:
        if rng.random() < WILD_SHARE:
            gear = int(rng.choice([1, 3, 12, 14, IMPOSSIBLE_GEAR]))
        else:
            near = max(min(DRIVE_GEARS), min(max(DRIVE_GEARS), gear + int(rng.integers(-2, 3))))
            gear = near
        events.append(Event(at_ms, REQUEST, 0, float(gear)))
        at_ms += int(rng.integers(400, 3_000))
    return events
