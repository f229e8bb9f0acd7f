"""The pressure sensors of brake and supply: what they say of the pressure.

    p_read = round((gain (p_felt - p_0) + p_0 + offset + noise) / step) step

p_felt follows the pressure with the sensor's lag (`motion`), p_0 is the atmosphere. Noise comes
from a table drawn once, read by instant, so the same instant has the same noise however often it is
read.
"""

from __future__ import annotations

from array import array
from typing import Final

import numpy as np

from meshpoint.rig_sim.shared.world import READ_US
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.units import BAR

NOISE_SAMPLES: Final = 4096
PRESSURE_STREAM: Final = 0xBA5
SUPPLY_APART: Final = 2027
"""Places in the table between the noise of the brake's sensor and that of the supply's."""


class PressureSensors:
    """Two sensors; the brake's has a lag, which is part of the plant's state."""

    def __init__(self, built: AsBuilt, atmosphere_pa: float) -> None:
        rng = np.random.Generator(np.random.PCG64([built.teeth_seed, PRESSURE_STREAM]))
        noise_pa = built["pressure.noise_bar"] * BAR * rng.standard_normal(NOISE_SAMPLES)
        self._noise_pa = array("d", noise_pa.tolist())
        self._atmosphere_pa = atmosphere_pa
        self._gain = built["pressure.brake_gain"]
        self._offset_pa = built["pressure.brake_offset_bar"] * BAR
        self._supply_offset_pa = built["pressure.supply_offset_bar"] * BAR
        self._step_pa = built["pressure.step_bar"] * BAR
        self._has_noise = built["pressure.noise_bar"] > 0.0

    def brake_pa(self, felt_pa: float, now_us: int) -> float:
        """What the brake's sensor says, absolute."""
        gauge_pa = self._gain * (felt_pa - self._atmosphere_pa) if self._gain != 1.0 else None
        level_pa = felt_pa if gauge_pa is None else gauge_pa + self._atmosphere_pa
        return self._said(level_pa + self._offset_pa, now_us // READ_US)

    def supply_pa(self, supply_pa: float, now_us: int) -> float:
        """What the supply's sensor says, absolute."""
        return self._said(supply_pa + self._supply_offset_pa, now_us // READ_US + SUPPLY_APART)

    def _said(self, level_pa: float, place: int) -> float:
        if self._has_noise:
            level_pa += self._noise_pa[place % NOISE_SAMPLES]
        if self._step_pa > 0.0:
            level_pa = round(level_pa / self._step_pa) * self._step_pa
        return max(level_pa, 0.0)
