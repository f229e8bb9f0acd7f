"""Everything a seed draws: start angles, flank, sensor clock, and then the sleeves' delays."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.gearbox.gears import MAIN_GEARS, MainGear
from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.rig_sim.settings import CLOCK_MODULUS, RigSettings
from meshpoint.rig_sim.shared.angles import StartAngles

WRAP_EARLIEST_US: Final = 500_000
WRAP_LATEST_US: Final = 5_000_000


class Start(NamedTuple):
    """What is drawn before the first step. flank: +1 or -1, where the start gear is locked."""

    angles: StartAngles
    flank: int
    clock_us: int


def seeded(seed: int) -> np.random.Generator:
    """The rig's one source of chance."""
    return np.random.Generator(np.random.PCG64(seed))


def draw_start(rng: np.random.Generator, sheet: GearboxSheet, settings: RigSettings) -> Start:
    """Draw the start. The same values are drawn whatever the settings, so runs stay comparable."""
    wheels = [float(rng.uniform(0.0, 2.0 * math.pi)) for _ in range(4)]
    half = sheet.dog.pitch_rad / 2.0
    phases: dict[MainGear, float] = {gear: float(rng.uniform(-half, half)) for gear in MAIN_GEARS}
    flank = 1 if rng.random() < 0.5 else -1
    drawn_us = CLOCK_MODULUS - int(rng.integers(WRAP_EARLIEST_US, WRAP_LATEST_US))
    clock_us = drawn_us if settings.clock_start_us is None else settings.clock_start_us
    angles = StartAngles(wheels[0], wheels[1], wheels[2], wheels[3], phases)
    return Start(angles, flank, clock_us)
