"""The layshaft in neutral under its brake, by the equations of motion: the model that is fitted.

    J (1 + r / i^2) w' = -T_0 - (c + c_IS / i^2) w + T_c / i sgn(w_E - w / i)      thesis 4.10
                         - C (1 + k_w (w - w_ref)) (p - p_touch)^+                 thesis 4.4
    p' = a_f p_s psi(p / p_s)      valve on      p' = -a_e p psi(p_a / p)      valve off  (ISO 6358)

on absolute pressure, psi(x) = sqrt(1 - ((x - b) / (1 - b))^2) above the critical ratio b and 1
below it; or p' = (u p_s - p) / tau on gauge pressure (thesis 4.1). Each valve acts its delay after
its switch. T_c is the drag of the open clutch toward the engine's speed w_E. Torque and inertia are
seen as a quotient alone, so J is that of the data sheet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import Split
from meshpoint.identify.log_reader import FreeRun
from meshpoint.kernels.records import Vector
from meshpoint.units import BAR, MS, RPM, US

GRID_S: Final = 1e-3
LEAD_S: Final = 0.15
"""Before the run, so that a brake that was switched on or off just before it is known."""
BIN_S: Final = 5e-3
LEAST_BINS: Final = 12
TYPICAL_LAG_S: Final = 3e-3
LAMINAR_FROM: Final = 0.99
SOFT_RAD_S: Final = 2.0
"""Plates that slip less than this drag less: the sign is no step."""


CRITICAL: Final = 0.3
"""Critical pressure ratio of ISO 6358 of a pneumatic valve, typically 0.2 to 0.4."""


class P(IntEnum):
    """Parameters, in the order of the vector that is fitted."""

    GAIN = 0
    """Logarithm of the brake's torque over that of the data sheet."""
    BY_SPEED = 1
    """Change of friction, share per 1,000 rpm."""
    BY_TIME = 2
    """Change of friction from the log's first run to its last, as a share: discs warm."""
    INERTIA = 3
    """Logarithm of J_IS / J_LS over that of the data sheet."""
    DRAG = 4
    """Drag that does not depend on speed, Nm."""
    VISCOUS = 5
    """Drag for each rad/s, Nms."""
    ON_DELAY = 6
    """Delay of the valve from its command to its opening, s."""
    OFF_DELAY = 7
    """Delay of the valve from its command to its closing, s."""
    FILLING = 8
    """Logarithm of the filling rate over that of the data sheet's time constant."""
    EMPTYING = 9
    """Logarithm of the emptying rate over that of the data sheet's time constant."""
    TOUCH = 10
    """Gauge pressure at which the pads touch, bar."""
    SUPPLY = 11
    """True supply pressure less the measured one, bar."""
    SENSOR_LAG = 12
    """Logarithm of the lag of the pressure sensor at the brake over `TYPICAL_LAG_S`."""
    CRITICAL = 13
    """Pressure ratio up to which the valve's flow is choked."""
    INPUT_VISCOUS = 14
    """Drag of the input shaft for each rad/s of its own, Nms."""
    PLATES = 15
    """Drag of the open clutch's plates, toward the engine's speed, Nm at the input shaft."""


COUNT: Final = len(P)


@dataclass(frozen=True)
class Prior:
    """What is known before: means and standard deviations; also the scale of the probes."""

    mean: Vector
    sd: Vector


def prior_of(sheet: GearboxSheet) -> Prior:
    """From the data sheet, with tolerances so wide that a log of a few shifts outweighs them."""
    mean, sd = np.zeros(COUNT), np.ones(COUNT)
    delay = sheet.brake.valve_delay_s
    for parameter, m, s in (
        (P.GAIN, 0.0, 0.7),
        (P.BY_SPEED, 0.0, 0.15),
        (P.BY_TIME, 0.0, 0.1),
        (P.INERTIA, 0.0, 0.4),
        (P.DRAG, 0.0, 10.0),
        (P.VISCOUS, sheet.shafts.friction_nms, 0.15),
        (P.ON_DELAY, delay, max(0.5 * delay, 2.0 * MS)),
        (P.OFF_DELAY, delay, max(0.5 * delay, 2.0 * MS)),
        (P.FILLING, 0.0, 0.7),
        (P.EMPTYING, 0.0, 0.7),
        (P.TOUCH, 0.2, 0.3),
        (P.SUPPLY, 0.0, 0.2),
        (P.SENSOR_LAG, 0.0, 1.0),
        (P.CRITICAL, CRITICAL, 0.08),
        (P.INPUT_VISCOUS, 0.0, 0.01),
        (P.PLATES, 0.0, 2.0),
    ):
        mean[parameter], sd[parameter] = m, s
    return Prior(mean, sd)


@dataclass(frozen=True)
class Trajectory:
    """One run made ready for the fit."""

    angle: Vector
    """Mean of the measured angles less that of the first bin, a bin each (rad)."""
    weights: Vector
    """(bins, nodes, 2): mean of a bin's angles from angles and speeds at the grid's nodes."""
    edges: Vector
    """How many edges each bin has."""
    nodes_of_edges: Vector
    """Of each edge: its place among the grid's nodes, as a real number."""
    theta_rad: Vector
    """Of each edge: its nominal angle less the first one's."""
    place: Vector
    """Of each edge: which of the wheel's edges it is."""
    first_node: int
    nodes: int
    start_us: float
    switches: tuple[tuple[float, bool], ...]
    """Of the brake's valve, s after `start_us`, and whether on."""
    pressure_s: Vector
    pressure_pa: Vector
    """Gauge, the sensor's offset taken out."""
    supply_pa: float
    """Gauge."""
    i_split: float
    omega_rad_s: float
    """A first guess of the speed at `first_node`."""
    engine_rad_s: Vector
    """At each node; NaN where no speed of the engine is known."""
    share_of_log: float
    """-0.5 at the log's first run, 0.5 at its last."""


def make_trajectory(
    run: FreeRun, sheet: GearboxSheet, error_rad: Vector, zero_pa: float, share_of_log: float
) -> Trajectory | None:
    """A run as the fit wants it; None where it is too short. error_rad: of each of the wheel's
    edges; zero_pa: what the pressure sensor shows of an empty brake, absolute."""
    wheel = run.layshaft
    seconds = (wheel.time_us - run.start_us) * US
    bins = int((run.end_us - run.start_us) * US / BIN_S)
    if bins < LEAST_BINS or wheel.time_us.size < 3 * bins:
        return None
    theta = wheel.theta_rad + error_rad[wheel.place.astype(np.int64)]
    lead = round(LEAD_S / GRID_S)
    nodes = lead + math.ceil((run.end_us - run.start_us) * US / GRID_S) + 2
    number = np.minimum((seconds / BIN_S).astype(np.int64), bins - 1)
    count = np.bincount(number, minlength=bins)
    used = count > 0
    weights = np.zeros((bins, nodes, 2))
    place = seconds / GRID_S
    node = place.astype(np.int64)
    s = place - node
    for k, (at, part) in enumerate(zip(node, s, strict=True)):
        row, left = number[k], lead + at
        weights[row, left, 0] += 1.0 - part * part * (3.0 - 2.0 * part)
        weights[row, left + 1, 0] += part * part * (3.0 - 2.0 * part)
        weights[row, left, 1] += GRID_S * part * (1.0 - part) ** 2
        weights[row, left + 1, 1] += GRID_S * part * part * (part - 1.0)
    angle = np.bincount(number, theta - theta[0], bins)[used] / count[used]
    weights = weights[used] / count[used][:, None, None]
    early = seconds < 0.02
    slope = np.polyfit(seconds[early], theta[early], 1)[0] if early.sum() > 3 else 100.0
    atmosphere, start_us = sheet.air.atmosphere_pa, run.start_us - LEAD_S / US
    return Trajectory(
        angle=angle,
        weights=weights,
        edges=count[used].astype(np.float64),
        nodes_of_edges=lead + place,
        theta_rad=wheel.theta_rad - wheel.theta_rad[0],
        place=wheel.place,
        first_node=lead,
        nodes=nodes,
        start_us=start_us,
        switches=_from_the_first_on(run, start_us),
        pressure_s=(run.pressure[0] - start_us) * US,
        pressure_pa=run.pressure[1] - zero_pa,
        supply_pa=run.supply_pa - atmosphere,
        i_split=sheet.split_mesh(Split(run.split)).ratio,
        omega_rad_s=float(slope),
        engine_rad_s=_engine(run, start_us, nodes),
        share_of_log=share_of_log,
    )


def _from_the_first_on(run: FreeRun, start_us: float) -> tuple[tuple[float, bool], ...]:
    switches = [((one.time_us - start_us) * US, one.on) for one in run.brake]
    while switches and not switches[0][1]:
        del switches[0]
    return tuple(switches)


def _engine(run: FreeRun, start_us: float, nodes: int) -> Vector:
    if run.engine.shape[1] < 2:
        return np.full(nodes, np.nan)
    at_us = start_us + np.arange(nodes) * GRID_S / US
    return np.asarray(np.interp(at_us, run.engine[0], run.engine[1]))


def angles_at(place: Vector, angles: Vector, speeds: Vector) -> Vector:
    """Angles between the grid's nodes, from angles and speeds (rad, rad/s) at them."""
    node = place.astype(np.int64)
    s = place - node
    left, right = angles[node], angles[node + 1]
    bend = GRID_S * s * (1.0 - s) * ((1.0 - s) * speeds[node] - s * speeds[node + 1])
    return np.asarray(left + s * s * (3.0 - 2.0 * s) * (right - left) + bend)


class BrakeTrajectories:
    """All runs, gone through at once for many parameter vectors."""

    def __init__(
        self, trajectories: list[Trajectory], sheet: GearboxSheet, is_choked: bool
    ) -> None:
        self._trajectories = trajectories
        self._sheet = sheet
        self._is_choked = is_choked
        self._nodes = max(trajectory.nodes for trajectory in trajectories)
        self._rate = 1.0 / sheet.brake.time_constant_s
        self.omega_ref = 1000.0 * RPM
        """Speed (rad/s) at which gain and drag are reported; set from the log."""
        shares = sheet.shafts
        self._ratio = shares.input_inertia_kgm2 / shares.layshaft_inertia_kgm2
        self._i2 = np.array([trajectory.i_split**-2 for trajectory in trajectories])
        self._split = np.array([trajectory.i_split for trajectory in trajectories])
        # Where the engine's speed is not known the plates are taken to turn with the shaft's own.
        self._engine = np.zeros((self._nodes, len(trajectories)))
        self._knows = np.zeros(len(trajectories))
        for number, trajectory in enumerate(trajectories):
            known = bool(np.isfinite(trajectory.engine_rad_s).all())
            self._knows[number] = float(known)
            self._engine[: trajectory.nodes, number] = trajectory.engine_rad_s if known else 0.0
        self._late = np.array([trajectory.share_of_log for trajectory in trajectories])
        self._measured_pa = np.array([trajectory.supply_pa for trajectory in trajectories])

    def run(self, parameters: Vector, omega_rad_s: Vector) -> tuple[Vector, Vector, Vector]:
        """Angles, speeds and felt pressures at the grid's nodes, (nodes, lanes, runs); pressure is
        gauge. parameters: (lanes, COUNT); omega_rad_s: at each run's first node, (runs,). Angles
        are those since the first node."""
        p, sheet = parameters[:, :, None], self._sheet
        first = self._trajectories[0].first_node
        switched = self._switched(parameters)
        supply = np.maximum(self._measured_pa + p[:, P.SUPPLY] * BAR, 1e4)
        gain = sheet.brake_nm_per_pa * np.exp(p[:, P.GAIN]) * (1.0 + p[:, P.BY_TIME] * self._late)
        by_speed = p[:, P.BY_SPEED] / (1000.0 * RPM)
        ratio = self._ratio * np.exp(p[:, P.INERTIA])
        inertia = sheet.shafts.layshaft_inertia_kgm2 * (1.0 + ratio * self._i2)
        drag, touch = p[:, P.DRAG], p[:, P.TOUCH] * BAR
        viscous = p[:, P.VISCOUS] + p[:, P.INPUT_VISCOUS] * self._i2
        plates = p[:, P.PLATES] / self._split * self._knows
        lag_share = TYPICAL_LAG_S * np.exp(np.clip(p[:, P.SENSOR_LAG], -5.0, 4.0)) / GRID_S
        shape = supply.shape
        pressure, felt = np.zeros(shape), np.zeros(shape)
        omega, theta = np.broadcast_to(omega_rad_s, shape).copy(), np.zeros(shape)
        angles, speeds, felts = (np.zeros((self._nodes, *shape)) for _ in range(3))
        keep = np.exp(-1.0 / lag_share)
        for node in range(self._nodes):
            angles[node], speeds[node], felts[node] = theta, omega, felt
            on = switched[node]
            slope = self._rates(pressure, on, supply, p)
            middle = pressure + 0.5 * GRID_S * slope
            after = pressure + GRID_S * self._rates(middle, on, supply, p)
            after = np.minimum(np.maximum(after, 0.0), supply)
            mean = 0.5 * (pressure + after)
            lagging = (after - pressure) * lag_share
            felt = after - lagging + (felt - pressure + lagging) * keep
            if node >= first:
                torque = gain * np.maximum(mean - touch, 0.0)
                half = omega
                ahead = self._engine[node] - omega / self._split
                pulled = plates * np.tanh(ahead / SOFT_RAD_S)
                for _ in range(2):  # torque by the speed in the middle of the step
                    friction = 1.0 + by_speed * (half - self.omega_ref)
                    slowing = (torque * friction + drag - pulled + viscous * half) / inertia
                    half = omega - 0.5 * GRID_S * slowing
                theta = theta + GRID_S * half
                omega = omega - GRID_S * slowing
            pressure = after
        return angles, speeds, felts

    def _switched(self, parameters: Vector) -> Vector:
        """Share of each step in which the valve acts as on, (nodes, lanes, runs)."""
        shape = (self._nodes, parameters.shape[0], len(self._trajectories))
        acting = np.zeros(shape)
        begins = np.arange(self._nodes)[:, None] * GRID_S
        for number, trajectory in enumerate(self._trajectories):
            for at_s, on in trajectory.switches:
                delay = parameters[:, P.ON_DELAY if on else P.OFF_DELAY]
                passed = np.clip((begins + GRID_S - at_s - delay) / GRID_S, 0.0, 1.0)
                acting[:, :, number] += passed if on else -passed
        return np.clip(acting, 0.0, 1.0)

    def _rates(self, gauge: Vector, on: Vector, supply: Vector, p: Vector) -> Vector:
        fill, empty = np.exp(p[:, P.FILLING]), np.exp(p[:, P.EMPTYING])
        if not self._is_choked:
            rates: Vector = self._rate * (on * fill * (supply - gauge) - (1.0 - on) * empty * gauge)
            return rates
        atmosphere = self._sheet.air.atmosphere_pa
        pressure, before = gauge + atmosphere, supply + atmosphere
        critical = np.clip(p[:, P.CRITICAL], 0.0, 0.6)
        rates = np.zeros(gauge.shape)
        if on.any():
            rates += on * fill * before * flow_share(pressure / before, critical)
        if (on < 1.0).any():
            emptying = empty * pressure * flow_share(atmosphere / pressure, critical)
            rates -= (1.0 - on) * emptying
        rates *= self._rate
        return rates


def flow_share(ratio: Vector, critical: Vector) -> Vector:
    """Mass flow over that of the choked valve, by the ratio of the pressures behind and before."""
    part = np.maximum((np.minimum(ratio, LAMINAR_FROM) - critical) / (1.0 - critical), 0.0)
    share = np.sqrt(1.0 - part * part)
    laminar = np.maximum((1.0 - ratio) / (1.0 - LAMINAR_FROM), 0.0)
    found: Vector = share * np.minimum(laminar, 1.0)
    return found


def time_constant_s(
    rates_per_s: Vector, supply_pa: float, atmosphere_pa: float, critical: Vector, on: bool
) -> Vector:
    """Until the pressure has gone 63.2 % of its way, from empty or from full, by ISO 6358 (s).

    rates_per_s: of the choked flow (lanes,); pressures gauge and absolute, Pa."""
    end = 1.0 - math.exp(-1.0)
    shares = np.linspace(0.0, end, 400) if on else np.linspace(1.0, 1.0 - end, 400)
    pressure = (shares * supply_pa + atmosphere_pa)[:, None]
    if on:
        flow = (supply_pa + atmosphere_pa) * flow_share(
            pressure / (supply_pa + atmosphere_pa), critical
        )
    else:
        flow = pressure * flow_share(atmosphere_pa / pressure, critical)
    return np.asarray(
        np.trapezoid(supply_pa / flow, np.abs(shares - shares[0]), axis=0) / rates_per_s
    )
