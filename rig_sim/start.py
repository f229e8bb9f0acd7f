"""Everything a seed draws: start angles, flank, sensor clock, and then the sleeves' delays."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from gearbox.gears import MAIN_GEARS, MainGear
from gearbox.sheet import GearboxSheet
from rig_sim.settings import CLOCK_MODULUS, RigSettings
from rig_sim.shafts import StartAngles

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


class Delays:
    """Delay from a sleeve valve's activation to contact: normal, cut by drawing again."""

    def __init__(self, rng: np.random.Generator, sheet: GearboxSheet) -> None:
        self._rng = rng
        self._actuator = sheet.sleeve

    def draw_s(self) -> float:
        """The next delay, s."""
        actuator = self._actuator
        if actuator.delay_sd_s == 0.0 or actuator.delay_limit_s == 0.0:
            return actuator.delay_s
        while True:
            deviation_s = float(self._rng.normal(0.0, actuator.delay_sd_s))
            if abs(deviation_s) <= actuator.delay_limit_s:
                return actuator.delay_s + deviation_s
