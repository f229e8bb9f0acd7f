"""Baseline `thesis`: the Kalman filter and the prediction of the 2019 Linköping thesis.

The state is x = [layshaft angle, its speed, brake pressure over the air's] with the thesis's
equations 4.13 and 4.15: viscous friction, and a brake whose pressure follows its valve with a delay
and a time constant. Tooth edges correct it (5.1 to 5.9). It is predicted to the contact by its
zero-order hold (5.16 to 5.18) through every switch of the brake that had been commanded. The main
shaft keeps its speed (4.16), which a filter of its own estimates. All figures are those of the
data sheet (gearbox.json), none is learned from the shifts.

The model holds with the clutch open and the main box in neutral (4.1); where that had not begun,
the layshaft keeps its speed, too. The thesis treats upshifts; downshifts are made by the same.

    python thesis.py SET -o thesis.csv
"""

from __future__ import annotations

import math
import sys
from typing import Any, NamedTuple

import numpy as np
from known import Prediction, Shift, run

US = 1e-6
DEG = math.pi / 180.0
SEED_US = 10_000
"""A filter begins with the speed of so long."""
SD_PRESSURE_PA = 2e4
"""Of the brake's pressure when the filter begins."""


class Layshaft(NamedTuple):
    """Constants of 4.15: a = c/J, b = 1/tau, g = C_db/J, and the supply that pressure tends to."""

    a: float
    b: float
    g: float
    supply_pa: float

    def step(self, dt: float, valve_on: float) -> tuple[np.ndarray, np.ndarray]:
        """Phi, and Gamma times the valve's state, over dt seconds (5.17)."""
        a, b, g = self.a, self.b, self.g
        e_a, e_b = math.exp(-a * dt), math.exp(-b * dt)
        phi_a, phi_b = -math.expm1(-a * dt) / a, -math.expm1(-b * dt) / b
        h, big_h = (e_a - e_b) / (b - a), (phi_a - phi_b) / (b - a)
        phi = np.array([[1.0, phi_a, -g * big_h], [0.0, e_a, -g * h], [0.0, 0.0, e_b]])
        gamma = np.array([-g * ((dt - phi_a) / a - big_h), -g * (phi_a - h), 1.0 - e_b])
        return phi, gamma * self.supply_pa * valve_on


class Filter:
    """State and covariance of the layshaft at a time (us)."""

    def __init__(self, model: Layshaft, switches: list[tuple[float, float]], tuning: Any) -> None:
        self._model, self._switches = model, switches
        self._w = np.array([tuning["w_angle_rad_s"], tuning["w_speed_rad_s2"],
                            tuning["w_pressure_pa_s"]])  # fmt: skip
        self._r = tuning["r_angle_rad"] ** 2
        self.time_us, self.x, self.p = 0.0, np.zeros(3), np.zeros((3, 3))

    def begin(self, time_us: float, x: np.ndarray, sd: np.ndarray) -> None:
        """From here on."""
        self.time_us, self.x, self.p = time_us, x, np.diag(sd**2)

    def move(self, to_us: float) -> None:
        """Predicts to a time, through each switch of the brake's valve (5.2, 5.3, 5.8)."""
        for at_us in [*(at for at, _ in self._switches if self.time_us < at < to_us), to_us]:
            valve_on = next((on for at, on in reversed(self._switches) if at <= self.time_us), 0.0)
            dt = (at_us - self.time_us) * US
            phi, driven = self._model.step(dt, valve_on)
            noise = self._w * dt
            self.x = phi @ self.x + driven
            self.p = phi @ self.p @ phi.T + np.outer(noise, noise)
            self.time_us = at_us

    def correct(self, angle_rad: float) -> None:
        """An edge (5.4 to 5.7)."""
        gain = self.p[:, 0] / (self.p[0, 0] + self._r)
        self.x = self.x + gain * (angle_rad - self.x[0])
        self.p = self.p - np.outer(gain, self.p[0])


def switches_of(shift: Shift, delay_us: float) -> list[tuple[float, float]]:
    """When the brake's pressure begins to follow its valve, and whether that is on from then: as
    commanded by the cutoff. A later command takes the place of what was planned."""
    commands, found = shift.tables["commands"], list[tuple[float, float]]()
    for number in np.flatnonzero(commands["valve"] == "brake"):
        arrival_us, action = commands["arrival_us"][number], commands["action"][number]
        is_planned = action in ("off_at", "on_at")
        at_us = float(commands["switch_us"][number] if is_planned else arrival_us)
        found = [each for each in found if each[0] <= arrival_us + delay_us]
        found.append((at_us + delay_us, float(action.startswith("on"))))
    return found


def free_since_us(shift: Shift) -> float | None:
    """Since when the clutch is open and the main box in neutral; None: they are not."""
    estimates = shift.tables["estimates"]
    valid = estimates["model_valid"]
    if not valid[-1]:
        return None
    closed = np.flatnonzero(~valid)
    return float(estimates["time_us"][closed[-1] + 1 if closed.size else 0])


def held(times_us: np.ndarray, angles: np.ndarray) -> tuple[float, float]:
    """Angle (rad) of the newest edge, and speed (rad/s) of the time before it."""
    start = max(0, int(np.searchsorted(times_us, times_us[-1] - SEED_US, side="right")) - 1)
    speed = (angles[-1] - angles[start]) / ((times_us[-1] - times_us[start]) * US)
    return float(angles[-1]), float(speed)


def layshaft_at_contact(shift: Shift, gearbox: dict[str, Any]) -> tuple[float, float | None]:
    """The layshaft's angle (rad) and its variance (rad2); None: the model did not hold."""
    times, index = shift.edges("layshaft")
    pitch = 2.0 * math.pi / gearbox["wheel_teeth"]["layshaft"]
    angles, free_us = index * pitch, free_since_us(shift)
    before = times <= (math.inf if free_us is None else free_us)
    angle, speed = held(times[before], angles[before])
    if free_us is None:
        return angle + speed * (shift.contact_us - times[-1]) * US, None
    gear, brake = gearbox["gears"][str(shift.row["to_gear"])], gearbox["brake"]
    inertia = gear["inertia_kgm2"]
    model = Layshaft(
        gearbox["friction_nms"] / inertia, 1.0 / brake["time_constant_s"],
        brake["torque_nm_per_pa"] / inertia, brake["supply_gauge_pa"],
    )  # fmt: skip
    switches = switches_of(shift, brake["valve_delay_s"] / US)
    run_on = Filter(model, switches, gearbox["thesis_filter"])
    sd = np.array([0.1 * pitch, 0.05 * abs(speed) + 1.0, SD_PRESSURE_PA])
    run_on.begin(float(times[before][-1]), np.array([angle, speed, 0.0]), sd)
    for time_us, edge in zip(times[~before], angles[~before], strict=True):
        run_on.move(time_us)
        run_on.correct(edge)
    run_on.move(float(shift.contact_us))
    return float(run_on.x[0]), float(run_on.p[0, 0])


def main_at_contact(shift: Shift, gearbox: dict[str, Any]) -> tuple[float, float]:
    """The main shaft's angle (rad) and its variance (rad2), by a filter of constant speed."""
    tuning, (times, index) = gearbox["cruise_filter"], shift.edges("main")
    pitch = 2.0 * math.pi / gearbox["wheel_teeth"]["main"]
    angles = index * pitch
    first = int(np.searchsorted(times, times[0] + SEED_US))
    x = np.array(held(times[: first + 1], angles[: first + 1]))
    p = np.diag([(0.1 * pitch) ** 2, (0.05 * abs(x[1]) + 1.0) ** 2])
    before_us = times[first]
    for time_us, edge in zip(times[first + 1 :], angles[first + 1 :], strict=True):
        x, p = _cruise(x, p, (time_us - before_us) * US, tuning["acceleration_rad_s2"])
        r = (x[1] * tuning["edge_time_s"]) ** 2 + 1e-12
        gain = p[:, 0] / (p[0, 0] + r)
        x, p = x + gain * (edge - x[0]), p - np.outer(gain, p[0])
        before_us = time_us
    dt = (shift.contact_us - before_us) * US
    x, p = _cruise(x, p, dt, tuning["acceleration_rad_s2"])
    return float(x[0]), float(p[0, 0])


def _cruise(
    x: np.ndarray, p: np.ndarray, dt: float, acceleration: float
) -> tuple[np.ndarray, np.ndarray]:
    phi = np.array([[1.0, dt], [0.0, 1.0]])
    noise = acceleration * dt * np.array([0.5 * dt, 1.0])
    return phi @ x, phi @ p @ phi.T + np.outer(noise, noise)


def predict(shift: Shift, gearbox: dict[str, Any]) -> Prediction:
    """The phase at contact."""
    layshaft_rad, layshaft_var = layshaft_at_contact(shift, gearbox)
    main_rad, main_var = main_at_contact(shift, gearbox)
    phase_deg = shift.phase_deg(layshaft_rad / DEG, main_rad / DEG)
    if layshaft_var is None:
        return Prediction(phase_deg)
    ratio = shift.row["gear_ratio"]
    return Prediction(phase_deg, math.sqrt(ratio**2 * layshaft_var + main_var) / DEG)


if __name__ == "__main__":
    sys.exit(run(predict, __doc__))
