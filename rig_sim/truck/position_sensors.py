"""The sleeves' position sensors: gain, offset and noise of each, and what they do when they lie.

    x_read = gain x + offset + noise

Noise comes from a table drawn once, read by instant and sleeve: the same instant has the same noise
however often it is read.
"""

from __future__ import annotations

from array import array
from typing import Final

import numpy as np

from meshpoint.gearbox.gears import Sleeve
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.units import MM

NOISE_SAMPLES: Final = 4096
POSITION_STREAM: Final = 0x905
SAMPLE_US: Final = 1_000
READ_SAMPLES: Final = 10
REACH_M: Final = 0.0199  # the signal's range; the sensor saturates


class PositionSensors:
    """Four sensors. `lie` and `freeze` are for faults."""

    def __init__(self, built: AsBuilt) -> None:
        rng = np.random.Generator(np.random.PCG64([built.teeth_seed, POSITION_STREAM]))
        noise_m = (built["position.noise_mm"] * MM * rng.standard_normal(NOISE_SAMPLES)).tolist()
        # backwards and a little beyond its start: a read is then a slice, the newest first. An
        # array, because a copy of the rig copies four thousand numbers of a list one by one
        self._noise_m = array("d", noise_m[::-1] + noise_m[: -READ_SAMPLES - 1 : -1])
        # one drawn value would be the same for all: spread it over the four with their own signs
        signs = {name: float(rng.uniform(-1.0, 1.0)) for name in Sleeve}
        self._offset_m = {name: built["position.offset_mm"] * MM * signs[name] for name in Sleeve}
        self._gain = {name: 1.0 + (built["position.gain"] - 1.0) * signs[name] for name in Sleeve}
        self._extra_m = dict.fromkeys(Sleeve, 0.0)
        self.frozen: dict[Sleeve, tuple[float, ...] | None] = dict.fromkeys(Sleeve)
        self._last: dict[Sleeve, tuple[float, ...]] = {}

    def read(self, name: Sleeve, true_m: tuple[float, ...], now_us: int) -> tuple[float, ...]:
        """What the sensor says of these positions, 1 ms apart, the newest first."""
        held = self.frozen[name]
        if held is not None:
            return held
        gain, offset_m = self._gain[name], self._offset_m[name] + self._extra_m[name]
        newest = NOISE_SAMPLES - 1 - (now_us // SAMPLE_US + 1021 * name) % NOISE_SAMPLES
        noise_m = self._noise_m[newest : newest + READ_SAMPLES]
        if true_m.count(true_m[0]) == READ_SAMPLES:
            level_m = gain * true_m[0] + offset_m
            read = tuple([level_m + noise for noise in noise_m])
        else:
            read = tuple(
                [gain * x + offset_m + noise for x, noise in zip(true_m, noise_m, strict=True)]
            )
        if max(read) > REACH_M or min(read) < -REACH_M:
            read = tuple(min(max(x, -REACH_M), REACH_M) for x in read)
        self._last[name] = read
        return read

    def lie(self, name: Sleeve, by_m: float) -> None:
        """From now on the sensor is off by this much more."""
        self._extra_m[name] = by_m

    def freeze(self, name: Sleeve, frozen: bool) -> None:
        """From now on the sensor repeats itself, or no more."""
        last = self._last.get(name, (0.0,) * READ_SAMPLES)
        self.frozen[name] = (last[0],) * len(last) if frozen else None
