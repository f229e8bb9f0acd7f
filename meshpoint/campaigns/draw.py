"""What a run draws from its seed: gear change, shaft speeds, oil, load, slope, supply pressure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from meshpoint.bench.bench import PlannedShift, plan_shifts
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import DRIVE_GEARS, main_box_only
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Preset, Profile
from meshpoint.units import RPM

CAMPAIGN_STREAM: Final = 0xCA3
"""Keeps a run's draws apart from those of the rig of the same seed."""
LAYSHAFT_RPM: Final = (1100.0, 1500.0)
"""Layshaft speed in the old gear, drawn for each shift."""
SPREAD: Final[Mapping[str, tuple[float, float]]] = {
    "oil.temperature_c": (40.0, 100.0),
    "vehicle.mass_kg": (10_000.0, 44_000.0),
    "vehicle.slope_percent": (-4.0, 4.0),
    "air.supply_offset_bar": (-0.8, 0.3),
}
"""Conditions of work of the preset truck, drawn evenly; everything else as built (`truck.toml`)."""

MASS_KG: Final = ((8_000.0, 18_000.0), (18_000.0, 44_000.0))
"""Without a trailer and with one, in the profiles that are not clean."""


def upshifts() -> tuple[tuple[int, int], ...]:
    """Every upshift of the main box alone by one main gear, as (from, to)."""
    found = []
    for from_, before in DRIVE_GEARS.items():
        for to, after in DRIVE_GEARS.items():
            if main_box_only(from_, to) and after.main == before.main + 1:
                found.append((from_, to))
    return tuple(sorted(found))


@dataclass(frozen=True)
class Draw:
    """The work of one run. `plan`: learning shifts first, then the judged ones."""

    seed: int
    plan: tuple[PlannedShift, ...]
    as_built: Mapping[str, float] = field(default_factory=dict)
    """While the bench learns, and after it where `judged` does not say otherwise."""
    profile: Profile = DEFAULT_PROFILE
    judged: Mapping[str, float] = field(default_factory=dict)
    """Conditions of work drawn again for the judged shifts; none in the profile clean."""


def draw(
    seed: int,
    sheet: GearboxSheet,
    preset: Preset,
    pairs: tuple[tuple[int, int], ...],
    shifts: int,
    fixed: Mapping[str, float],
    profile: Profile = DEFAULT_PROFILE,
) -> Draw:
    """The run of a seed: one gear change, made `shifts` times at different shaft speeds.

    `fixed` as-built values win over drawn ones; everything is drawn whatever is fixed."""
    rng = np.random.Generator(np.random.PCG64([seed, CAMPAIGN_STREAM]))
    pair = pairs[int(rng.integers(len(pairs)))]
    speeds = [float(rpm) * RPM for rpm in rng.uniform(*LAYSHAFT_RPM, shifts)]
    plan = tuple(plan_shifts(sheet, [pair], 1, speed)[0] for speed in speeds)
    conditions: dict[str, float] = {}
    if preset is Preset.TRUCK:
        conditions = {
            name: float(f"{rng.uniform(low, high):.6g}") for name, (low, high) in SPREAD.items()
        }
    judged: dict[str, float] = {}
    if preset is Preset.TRUCK and profile is not Profile.CLEAN:
        conditions = _day(rng)
        judged = {name: value for name, value in _day(rng).items() if name not in fixed}
    return Draw(seed, plan, conditions | dict(fixed), profile, judged)


def _day(rng: np.random.Generator) -> dict[str, float]:
    """Conditions of a day's work, with a trailer coupled or without."""
    spread = dict(SPREAD) | {"vehicle.mass_kg": MASS_KG[int(rng.integers(2))]}
    return {name: float(f"{rng.uniform(low, high):.6g}") for name, (low, high) in spread.items()}
