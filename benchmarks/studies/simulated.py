"""The simulated value of thesis 6.3: a shift of the rig's linear plant, sampled.

The rig's physics (`meshpoint.rig_sim.thesis.plant`, 4.1 to 4.16 in closed form) is written
independently of the controller's predictor, so a prediction that equals it says more than that code
equals itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.studies.record import Braking
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Split
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.shared.angles import Shafts, StartAngles
from meshpoint.rig_sim.thesis.plant import ThesisPlant
from meshpoint.units import MS_US, RPM, TURN, US


@dataclass(frozen=True)
class SimulatedShift:
    """Samples of the layshaft, and the brake valve's commands."""

    time_us: Vector
    theta_rad: Vector
    omega_rad_s: Vector
    pressure_pa: Vector
    """Gauge."""
    switch_us: Vector
    """When the pressure begins to react: command and valve delay."""
    switch_u: Vector

    def state(self, index: int) -> LayshaftState:
        """A sample as a state to predict from."""
        return LayshaftState(
            float(self.time_us[index]),
            float(self.theta_rad[index]),
            float(self.omega_rad_s[index]),
            float(self.pressure_pa[index]),
        )

    def at(self, time_ms: float) -> LayshaftState:
        """The sample next to a time."""
        return self.state(int(np.argmin(np.abs(self.time_us - time_ms * MS_US))))

    @property
    def time_ms(self) -> Vector:
        """Sample times in ms."""
        return self.time_us / MS_US

    @property
    def omega_rpm(self) -> Vector:
        """Speeds in rpm."""
        return self.omega_rad_s / RPM

    def known_at(self, time_us: float) -> Vector:
        """The switches whose effect has begun by then: all that the thesis's predictor knows."""
        until = int(np.searchsorted(self.switch_us, time_us, side="right"))
        return np.array((self.switch_us[:until], self.switch_u[:until]))


def simulate_shift(
    sheet: GearboxSheet, braking: Braking, step_us: int, split: Split = Split.HIGH
) -> SimulatedShift:
    """Runs the linear plant and samples it every `step_us`."""
    delay_us = sheet.brake.valve_delay_s / US
    switch_us = np.array([braking.on_ms, braking.off_ms]) * MS_US + delay_us
    times = np.arange(0, braking.until_ms * 1000 + 1, step_us, dtype=np.float64)
    plant = _coasting(sheet, braking.layshaft_rad_s, split)
    rows = np.empty((times.size, 3))
    due = list(zip(switch_us.tolist(), (True, False), strict=True))
    for i, time_us in enumerate(times.tolist()):
        while due and due[0][0] <= time_us:
            at_us, on = due.pop(0)
            plant.move_to(at_us)
            plant.set_brake(on)
        plant.move_to(time_us)
        turns, rest = plant.shafts.layshaft
        rows[i] = turns * TURN + rest, plant.layshaft_rad_s, plant.brake_gauge_pa
    return SimulatedShift(
        times, rows[:, 0], rows[:, 1], rows[:, 2], switch_us, np.array([1.0, 0.0])
    )


def _coasting(sheet: GearboxSheet, layshaft_rad_s: float, split: Split) -> ThesisPlant:
    """A plant whose layshaft has just left a gear at this speed."""
    start = StartAngles(0.0, 0.0, 0.0, 0.0, dict.fromkeys(MAIN_GEARS, 0.0))
    gear = MainGear.FIRST
    main_rad_s = layshaft_rad_s * sheet.main_mesh(gear).ratio
    plant = ThesisPlant(sheet, Shafts(sheet, start, split, Range.HIGH), main_rad_s)
    plant.lock(gear, 0.0)
    plant.coast()
    return plant
