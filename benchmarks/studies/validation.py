"""The model against the real system (thesis 6.1.1, 6.1.3): started in neutral, then on its own.

The `truck` rig stands for the real system. The model gets what the controller has: the state when
the main box comes free, and its own commands to the brake valve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from benchmarks.studies.jobs import LoopJob, LoopResult, ShiftTrace
from benchmarks.studies.record import Given
from meshpoint.base.errors import CommandError
from meshpoint.controller.models.thesis import layshaft_model, propagate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.gearbox.tables import count, quantity
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import BAR, RPM

RISE_SHARE: Final = 1.0 - math.exp(-1.0)
BEFORE_AIR_US: Final = 20_000.0
"""Two reads of the pressure sensor."""
REACTION_SHARE: Final = 0.02
"""A pressure that has risen by this share of the supply has begun to react."""
SPLIT: Final = Split.HIGH
"""The splitter in the shifts 8 to 10 and 10 to 12."""


@dataclass(frozen=True)
class Settings:
    """How many shifts are compared, and what deviation still counts as following."""

    shifts: int = count("shifts", 1, 1000)
    slight_share: float = quantity("slight_percent", 0.1, 100.0, 0.01)
    """RMS deviation that still counts as slight: of the supply's gauge pressure, or of the speed
    that the brake takes away."""


class Compared(NamedTuple):
    """A quantity of one shift: ms since the main box came free, measured, model."""

    time_ms: Vector
    measured: Vector
    model: Vector

    @property
    def error(self) -> Vector:
        """Model less measured."""
        return self.model - self.measured


def truck_run(given: Given[Settings]) -> tuple[LoopJob, ...]:
    """One run, the same for all studies that ask for as many shifts."""
    shifts = given.own.shifts
    settings = ControllerSettings()
    seed, profile = given.common.seed, given.profile
    return (
        LoopJob(given.sheet, settings, Preset.TRUCK, seed, shifts, keep=shifts, profile=profile),
    )


def traces(given: Given[Settings]) -> list[ShiftTrace]:
    """The shifts of the run in which the model held."""
    (job,) = truck_run(given)
    result: LoopResult = given.results[job]
    return [trace for trace in result.traces if trace.samples and trace.switches is not None]


def speeds(sheet: GearboxSheet, trace: ShiftTrace) -> Compared:
    """Layshaft speed in rpm: reference encoder and model."""
    samples = trace.of(trace.samples[0].estimator)
    times = np.array([sample.time_us for sample in samples], dtype=np.float64)
    measured = np.array([sample.omega_rad_s for sample in samples])
    x = _model(sheet, trace, float(measured[0]), times)
    return Compared((times - times[0]) / 1e3, measured / RPM, x[:, 1] / RPM)


def pressures(sheet: GearboxSheet, trace: ShiftTrace) -> Compared:
    """Brake pressure in bar absolute: pressure sensor and model. The air is on its way to the brake
    before the gear is out, so the reads begin with the valve."""
    first, last = trace.samples[0], trace.samples[-1]
    read = np.array(trace.pressure_us, dtype=np.float64)
    begin_us = min(float(first.time_us), _before_air_us(trace))
    inside = (read >= begin_us) & (read <= last.time_us)
    times = read[inside]
    measured = np.array(trace.pressure_pa)[inside]
    start = np.concatenate([[begin_us], times])
    x = _model(sheet, trace, first.omega_rad_s, start)
    model = x[1:, 2] + sheet.air.atmosphere_pa
    return Compared((times - begin_us) / 1e3, measured / BAR, model / BAR)


def time_constant_s(sheet: GearboxSheet, measured: Compared) -> float:
    """tau_valve as the thesis finds it (4.2.1): from the first reaction of the pressure to 63 % of
    its final value, the supply's; interpolated between the sensor's reads."""
    gauge = measured.measured - sheet.air.atmosphere_pa / BAR
    final = sheet.air.supply_gauge_pa / BAR
    at_63 = int(np.argmax(gauge >= RISE_SHARE * final))
    first = int(np.argmax(gauge >= REACTION_SHARE * final))
    if not 0 < first <= at_63:
        raise CommandError("the brake's pressure does not rise to 63 %: tau cannot be determined")
    return (
        _crossing(measured.time_ms, gauge, at_63, RISE_SHARE * final)
        - _crossing(measured.time_ms, gauge, first, 0.0)
    ) * 1e-3


def _crossing(time_ms: Vector, gauge: Vector, index: int, level: float) -> float:
    """When the pressure passed a level on its way to sample `index`; linear between samples, and
    for the first reaction back along the rise that follows."""
    before = index if level == 0.0 else index - 1
    slope = (gauge[before + 1] - gauge[before]) / (time_ms[before + 1] - time_ms[before])
    return float(time_ms[before] + (level - gauge[before]) / slope)


def _before_air_us(trace: ShiftTrace) -> float:
    """A moment before air first came to the brake in this shift; infinite where none did."""
    if trace.switches is None or not trace.pressure_us:
        return math.inf
    on = trace.switches[0][trace.switches[1] > 0.0]
    on = on[on >= trace.pressure_us[0]]
    return float(on[0]) - BEFORE_AIR_US if on.size else math.inf


def _model(sheet: GearboxSheet, trace: ShiftTrace, omega_rad_s: float, times: Vector) -> Vector:
    """The state at all times, started at the first with this speed, and with no pressure at the
    moment before the brake's air came."""
    if trace.switches is None:
        raise ValueError("a trace without switches has no model")
    model = layshaft_model(sheet, SPLIT)
    x = np.array([0.0, omega_rad_s, 0.0])
    begin_us = _before_air_us(trace)
    if begin_us < times[0]:
        propagate(x, begin_us, float(times[0]), trace.switches, model)
        x[:2] = 0.0, omega_rad_s
    states = np.empty((times.size, 3))
    states[0] = x
    for i in range(1, times.size):
        propagate(x, float(times[i - 1]), float(times[i]), trace.switches, model)
        states[i] = x
    return states
