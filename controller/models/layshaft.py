"""How the layshaft is taken to move: models for `layshaft_kernels`, their input, and predictions.

The input is the brake valve, as it was and will be driven, in the sensor clock: u_brake of thesis
4.15b. Commands carry activation times, so it is known to the microsecond, the future included.
"""

from __future__ import annotations

import copy
import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.models.layshaft_kernels import (
    MODEL,
    OMEGA,
    PRESSURE,
    SEGMENTS,
    STATES,
    THETA,
    forecast,
    settling,
    travel,
)
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.gearbox import GearboxSheet, Split
from meshpoint.gearbox.kinematics import are_finite
from meshpoint.kernels.records import RecordMemory, Vector
from meshpoint.units import US

_new: Final = tuple.__new__  # a NamedTuple without its constructor's argument handling
WALK_RAD_S2: Final = 50.0
"""By how much the steady acceleration of a layshaft that something drives wanders in a second."""

SWITCHES_KEPT: Final = 16
"""Switches kept: a shift makes a handful, and pressure forgets within ten time constants."""


class LayshaftState(NamedTuple):
    """x of thesis 4.15a at a time, and what it is disturbed by; with standard deviations."""

    time_us: float
    theta_rad: float
    omega_rad_s: float
    pressure_pa: float
    theta_sd_rad: float = 0.0
    omega_sd_rad_s: float = 0.0
    pressure_sd_pa: float = 0.0
    disturbance_rad_s2: float = 0.0
    """Acceleration by torques of short memory."""
    gain: float = 1.0
    """Brake torque over that of the data sheet."""
    drag_rad_s2: float = 0.0
    """Steady acceleration beside the viscous friction; negative: it brakes."""
    covariance: Vector | None = None
    """Of the six states of `layshaft_kernels` (6, 6), where the estimator has one."""
    edge_rad2_s: float = 0.0
    """Variance of an edge's angle times the time from edge to edge, where the estimator gives
    it."""

    @property
    def is_finite(self) -> bool:
        """Whether every number of it is one."""
        return are_finite(self[:10])

    @property
    def vector(self) -> Vector:
        """The six states of `layshaft_kernels`."""
        return np.array([*self[1:4], *self[7:10]])


class MotionModel(RecordMemory):
    """A `layshaft_kernels.Model`. It is not changed once it is made."""

    def __init__(self, rates: Vector, law: Vector, noise: Vector) -> None:
        """Rates a, g and b_d (3,); pressure law (2, SEGMENTS, 3); densities of the driving noises
        (4,), in the order of `Model`."""
        super().__init__(MODEL)
        self.flat[:] = np.concatenate((rates, law.ravel(), noise))

    @property
    def friction_per_s(self) -> float:
        """Viscous friction over inertia."""
        return float(self.part("friction_per_s")[0])

    @property
    def brake_rad_s2_pa(self) -> float:
        """Deceleration by the brake's pressure."""
        return float(self.part("brake_rad_s2_pa")[0])

    def changed(self, **fields: float | Vector) -> MotionModel:
        """The same motion with other values of these fields of `Model`."""
        other = copy.deepcopy(self)
        other.put(**fields)
        return other


def first_order_law(rate: float, supply_pa: float) -> Vector:
    """The pressure law of thesis 4.1: one segment a direction, b = 1/tau."""
    law = np.full((2, SEGMENTS, 3), np.inf)
    law[:, :, 1:] = 1.0, 0.0
    law[0, 0] = -np.inf, rate, 0.0
    law[1, 0] = -np.inf, rate, rate * supply_pa
    return law


class Disturbance(NamedTuple):
    """The torques at the layshaft that its model leaves out."""

    torque_nm: float
    """Their standard deviation."""
    memory_s: float
    """How long such a torque lasts."""

    def density(self, inertia_kgm2: float) -> tuple[float, float]:
        """Rate at which its acceleration is forgotten, and density of the noise that drives it."""
        rate, sigma = 1.0 / self.memory_s, self.torque_nm / inertia_kgm2
        return rate, 2.0 * sigma * sigma * rate


def free_motion(
    sheet: GearboxSheet,
    split: Split,
    law: Vector,
    tuning: CrossingFilterTuning,
    disturbance: Disturbance | None = None,
    friction_nms: float | None = None,
) -> MotionModel:
    """The layshaft with clutch open and main box in neutral (4.13, 4.15); without `disturbance` and
    `friction_nms`, those of settings and sheet."""
    inertia = sheet.inertia_kgm2(split)
    friction = sheet.shafts.friction_nms if friction_nms is None else friction_nms
    given = Disturbance(tuning.torque_disturbance_nm, tuning.disturbance_s)
    rate, density = (disturbance or given).density(inertia)
    rates = np.array([friction / inertia, sheet.brake_nm_per_pa / inertia, rate])
    noise = np.array(
        [
            density,
            tuning.pressure_walk_pa**2,
            tuning.gain_walk**2,
            (tuning.drag_walk_nm / inertia) ** 2,
        ]
    )
    return MotionModel(rates, law, noise)


def following_start(
    theta_sd: float, omega_sd: float, acceleration_rad_s2: float
) -> tuple[Vector, Vector]:
    """State, all none, and covariance of such a shaft of which only angle and speed are known."""
    follow = acceleration_rad_s2
    p = diagonal(theta_sd, omega_sd, 1.0, follow, 1e-9, follow)
    return np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]), p


def following_motion(
    acceleration_rad_s2: float, memory_s: float, walk_rad_s2: float
) -> MotionModel:
    """A shaft that something unknown drives: accelerations of short memory and a wandering one."""
    rate = 1.0 / memory_s
    noise = np.array([2.0 * acceleration_rad_s2**2 * rate, 1.0, 0.0, walk_rad_s2**2])
    return MotionModel(np.array([0.0, 0.0, rate]), first_order_law(1.0, 0.0), noise)


def predict(
    state: LayshaftState, to_us: float, switches: Vector, model: MotionModel
) -> LayshaftState:
    """The state at another time through every brake switch; standard deviations are kept."""
    x = state.vector
    travel(x, float(state.time_us), float(to_us), switches, model.flat)
    theta, omega, pressure, disturbance, gain, drag = x.tolist()
    return _new(
        LayshaftState,
        (to_us, theta, omega, pressure, *state[4:7], disturbance, gain, drag, *state[10:]),
    )


def predict_spread(
    state: LayshaftState, to_us: float, switches: Vector, model: MotionModel
) -> LayshaftState:
    """As `predict`, with the covariance grown to then. The state must have one."""
    if state.covariance is None:
        raise ValueError("the estimator of this state has no covariance")
    return ahead(state.vector, state.covariance, state.time_us, to_us, switches, model)


class Ticks(NamedTuple):
    """Steps in which edges come."""

    horizon_us: float
    """From a tick to the time that is predicted."""
    tick_us: float
    measurements: int


def outlook(state: LayshaftState, ticks: Ticks, switches: Vector, model: MotionModel) -> Vector:
    """Variances (rad2) of the angle predicted a horizon ahead: now, and after each further tick of
    edges. The state must have a covariance."""
    if state.covariance is None:
        raise ValueError("the estimator of this state has no covariance")
    horizon_us, tick_us, measurements = ticks
    found = np.empty(measurements)
    heard = state.edge_rad2_s / (tick_us * US)
    times = np.array((state.time_us, horizon_us, tick_us, heard), dtype=np.float64)
    settling(state.vector, state.covariance.copy(), times, switches, model.flat, found)
    # By way of the deviation, as `predict_spread` says it: the same to the last bit.
    return np.array([math.sqrt(max(0.0, variance)) ** 2 for variance in found.tolist()])


def ahead(
    x: Vector, p: Vector, time_us: float, to_us: float, switches: Vector, model: MotionModel
) -> LayshaftState:
    """The layshaft at another time, by a filter's state and covariance at this one."""
    x, p = x.copy(), p.copy()
    forecast(x, p, float(time_us), float(to_us), switches, model.flat)
    return state_of(x, p, to_us)


def state_of(x: Vector, p: Vector, time_us: float) -> LayshaftState:
    """The layshaft by a filter's state and covariance."""
    theta, omega, pressure, disturbance, gain, drag = x.tolist()
    variances = p.item(THETA, THETA), p.item(OMEGA, OMEGA), p.item(PRESSURE, PRESSURE)
    sds = [math.sqrt(variance) if variance > 0.0 else 0.0 for variance in variances]
    rest = (disturbance, gain, drag, p, 0.0)
    return _new(LayshaftState, (time_us, theta, omega, pressure, *sds, *rest))


def diagonal(*sds: float) -> Vector:
    """A covariance of independent states."""
    p = np.zeros((STATES, STATES))
    np.fill_diagonal(p, [sd * sd for sd in sds])
    return p


def switched(*switches: tuple[int, bool]) -> Vector:
    """The switches of the kernels: each the time at which pressure starts to react, and whether it
    fills."""
    return np.array(tuple(zip(*switches, strict=True)), dtype=np.float64)


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
