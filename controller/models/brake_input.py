"""When the brake valve was and will be driven, in the sensor clock: u_brake of thesis 4.15b.

Commands carry activation times, so the filter's and the predictor's input is known to the
microsecond, the future included.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

SWITCHES_KEPT: Final = 16
"""Switches kept: a shift makes a handful, and pressure forgets within ten time constants."""


class Switch(NamedTuple):
    """From `time_us` on the valve is driven or not."""

    time_us: int
    on: bool


class BrakeInput:
    """The valve's switches: those that happened and at most one that is planned."""

    def __init__(self, valve_delay_us: int) -> None:
        self._delays_us = (valve_delay_us, valve_delay_us)
        self._switches: list[Switch] = []
        self._arrays: Vector | None = None
        self._arrays_of: list[Switch] = []

    def schedule(self, time_us: int, on: bool, now_us: int) -> None:
        """The valve will be `on` from `time_us`; replaces what was planned after `now_us`."""
        kept = [switch for switch in self._switches if switch.time_us <= now_us]
        if (not kept or kept[-1].on != on) and (kept or on):
            kept.append(Switch(time_us, on))
        if kept != self._switches:
            self._switches[:] = kept[-SWITCHES_KEPT:]

    def seen_through(self, valve_delay_us: int) -> BrakeInput:
        """The same switches, those still to come too, with another delay of the valve."""
        other = BrakeInput(valve_delay_us)
        other._switches = self._switches
        return other

    def follow(self, other: BrakeInput) -> None:
        """Takes over another's switches; the delays stay."""
        self._switches[:] = other.switches

    @property
    def switches(self) -> list[Switch]:
        """A copy of them."""
        return list(self._switches)

    def set_delays(self, off_us: int, on_us: int) -> None:
        """From a switch to the pressure's first reaction, as learned."""
        if (off_us, on_us) != self._delays_us:
            self._delays_us, self._arrays = (off_us, on_us), None

    @property
    def on_delay_us(self) -> int:
        """From switching on to the pressure's first reaction, as learned."""
        return self._delays_us[1]

    @property
    def commands(self) -> tuple[Vector, Vector]:
        """Times at which the valve is switched, without its delay, and u from then on."""
        times = np.array([switch.time_us for switch in self._switches], dtype=np.float64)
        return times, np.array([float(switch.on) for switch in self._switches])

    def arrays(self) -> Vector:
        """Times at which pressure starts to react, and u from then on: two rows, the switches of
        the kernels."""
        if self._arrays is None or self._arrays_of != self._switches:
            off_us, on_us = self._delays_us
            times = [time_us + (on_us if on else off_us) for time_us, on in self._switches]
            states = [on for _, on in self._switches]
            self._arrays = np.array((times, states), dtype=np.float64)
            self._arrays_of = self.switches
        return self._arrays

    def with_release(self, release_us: float) -> Vector:
        """The same if the brake were released at `release_us` instead, and left so."""
        switches, kept = self._switches, len(self._switches)
        # A release that is planned already is what is being moved, not a switch of its own.
        while kept and (not switches[kept - 1].on or switches[kept - 1].time_us >= release_us):
            kept -= 1
        found = np.empty((2, kept + 1))
        found[:, :kept] = self.arrays()[:, :kept]
        found[0, kept], found[1, kept] = release_us + self.off_delay_us, 0.0
        return found

    def commanded(self) -> Vector:
        """For `with_release` in a kernel: times at which the valve is switched, u from then on, and
        times at which pressure starts to react: three rows."""
        times = [switch.time_us for switch in self._switches]
        return np.array((times, *self.arrays()[::-1]), dtype=np.float64)

    @property
    def off_delay_us(self) -> int:
        """From a release to the pressure's first reaction, as learned."""
        return self._delays_us[0]
