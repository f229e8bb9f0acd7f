"""The sleeves' position sensors: gain, offset and noise of each, and what they do when they lie.

    x_read = gain x + offset + noise

Noise comes from a table drawn once, read by instant and sleeve: the same instant has the same noise
however often it is read.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from gearbox.gears import Sleeve
from gearbox.sheet import MM
from rig_sim.as_built import AsBuilt

TABLE: Final = 4096
STREAM: Final = 0x905
SAMPLE_US: Final = 1_000
REACH_M: Final = 0.0199  # the signal's range; the sensor saturates


class PositionSensors:
    """Four sensors. `offset_m` and `frozen` are the faults' to set."""

    def __init__(self, built: AsBuilt) -> None:
        rng = np.random.Generator(np.random.PCG64([built.teeth_seed, STREAM]))
        self._noise_m = (built["position.noise_mm"] * MM * rng.standard_normal(TABLE)).tolist()
        # one drawn value would be the same for all: spread it over the four with their own signs
        signs = {name: float(rng.uniform(-1.0, 1.0)) for name in Sleeve}
        self._offset_m = {name: built["position.offset_mm"] * MM * signs[name] for name in Sleeve}
        self._gain = {name: 1.0 + (built["position.gain"] - 1.0) * signs[name] for name in Sleeve}
        self._quiet = built["position.noise_mm"] == 0.0
        self.extra_m = dict.fromkeys(Sleeve, 0.0)
        self.frozen: dict[Sleeve, tuple[float, ...] | None] = dict.fromkeys(Sleeve)
        self._last: dict[Sleeve, tuple[float, ...]] = {}

    def read(self, name: Sleeve, true_m: tuple[float, ...], now_us: int) -> tuple[float, ...]:
        """What the sensor says of these positions, 1 ms apart, the newest first."""
        held = self.frozen[name]
        if held is not None:
            return held
        gain, offset_m = self._gain[name], self._offset_m[name] + self.extra_m[name]
        base = now_us // SAMPLE_US + 1021 * name
        noise = self._noise_m
        read = tuple(
            min(max(gain * x + offset_m + noise[(base - back) % TABLE], -REACH_M), REACH_M)
            for back, x in enumerate(true_m)
        )
        self._last[name] = read
        return read

    def freeze(self, name: Sleeve, frozen: bool) -> None:
        """From now on the sensor repeats itself, or no more."""
        last = self._last.get(name, (0.0,) * 10)
        self.frozen[name] = (last[0],) * len(last) if frozen else None
