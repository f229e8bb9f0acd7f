"""Brake and drag as learned from shift to shift: gain, drag, touch, pressure law, delays.

The brake's torque is gain x C_db x (p - p_touch) once its pads touch. The filter therefore uses the
pressure above p_touch, which is never negative.

The pressure law is p' = f_u(p), piecewise linear between knots at shares of the supply pressure, so
that it can describe a first-order valve (thesis 4.1) as well as one with choked flow (ISO 6358).
Each knot's rate is that of the data sheet times e^s; the s and both valve delays are fitted to the
pressure measured over a shift, by Gauss-Newton with what is known already as the prior: an extended
Kalman filter whose steps are shifts.

Touch pressure and the lag of the pressure sensor are learned together. A brake whose torque ends
sooner than its measured pressure says has pads that touch late, or a sensor that is late: one shift
hardly says which. Learned one after the other, the first to be fitted takes the whole difference
and is believed. So both are carried with their covariance, from shift to shift as well.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_filter import Pressures
from meshpoint.controller.estimate.figures import Estimate
from meshpoint.controller.measure.gearbox_view import PressureSamples
from meshpoint.controller.models.layshaft import MotionModel
from meshpoint.controller.models.layshaft_kernels import (
    DRAG,
    GAIN,
    PRESSURE,
    SEGMENTS,
    STATE,
    STATES,
    travel,
)
from meshpoint.controller.settings.learned import BrakeRecord
from meshpoint.gearbox import GearboxSheet
from meshpoint.kernels.jit import compiled, record_on
from meshpoint.kernels.records import Vector
from meshpoint.units import US

MOST_TOUCH_PA: Final = 1.0e5
MOST_LAG_S: Final = 20e-3
TOUCH_PROBE: Final = np.array([0.1e5, 1.5e-3])
"""Distance of the probes about a guess, touch (Pa) and lag (s)."""
MOST_STEP: Final = np.array([0.25e5, 3e-3])
"""Beyond that a paraboloid through probes is not believed."""
DRIFT_SD: Final = np.array([0.01e5, 0.1e-3])
"""Standard deviation of the change from shift to shift."""
CAUTION: Final = 2.0
"""Factor on the estimate's standard deviations, for other errors of the model."""
MOST_ROUNDS: Final = 3

EMPTYING: Final = (0.0, 0.08, 0.28, 0.6, 1.0)
FILLING: Final = (0.0, 0.3, 0.6, 0.85, 1.0)
"""Knots in shares of the supply pressure. An empty chamber does not empty, a full one not fill: the
rates at 0 and at 1 are zero."""
RATES: Final = len(EMPTYING) - 1
OFF_DELAY, ON_DELAY = 2 * RATES, 2 * RATES + 1
PARAMETERS: Final = 2 * RATES + 2
"""Logarithms of the emptying rates at knots 1.., of the filling rates at knots 0.., two delays."""
OWN_SD: Final = 0.15
"""By how much a knot's rate differs from what the others let expect, logarithm."""
LEAST_DELAY_SD_S: Final = 5e-4
FIT_PA: Final = 0.03e5
"""Standard deviation of the measured pressure from the fitted law."""
VARIANCE_GROWTH: Final = 1.1
"""Variances grow by this from shift to shift: temperatures change."""
ITERATIONS: Final = 3
LEAST_SAMPLES: Final = 8
PROBE: Final = 1e-3
LEAST_B: Final = 1e-3
LEAST_SD: Final = 1e-4
LEAST_SD_S: Final = 1e-6
"""Least standard deviations taken from a file, so that the covariance has an inverse."""
STILL: Final = np.array([0.0, 0.0, 1.0])
QUIET: Final = np.zeros(4)
"""Rates and noise densities of a shaft at rest: only the pressure is of interest."""
LAG_TOLERANCE: Final = 1.5
"""Standard deviation of a sensor's lag as a share of the sheet's: what else filters it is seldom
stated."""
TOUCH_SD_PA: Final = 0.15e5


@compiled
def pressure_trajectory(
    x: Vector, sample_us: Vector, switches: Vector, model: Vector, pressure_pa: Vector
) -> None:
    """Pressure at ascending times, the first of which is that of the state x (moved).

    switches and model as for `travel`, the model of a shaft that nothing moves."""
    state = record_on(x, STATE)
    pressure_pa[0] = state.pressure_pa
    for k in range(1, sample_us.shape[0]):
        travel(x, sample_us[k - 1], sample_us[k], switches, model)
        pressure_pa[k] = state.pressure_pa


class TouchAndLag(NamedTuple):
    """What is known: mean (2,) of touch (Pa, gauge) and lag (s), covariance (2, 2)."""

    mean: Vector
    covariance: Vector

    @property
    def sd(self) -> Vector:
        """Standard deviations (2,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def uncorrelated(touch: tuple[float, float], lag: tuple[float, float]) -> TouchAndLag:
    """Of values and standard deviations alone."""
    means, sds = zip(touch, lag, strict=True)
    return TouchAndLag(np.array(means), np.diag(sds) ** 2)


def best_of(deviance: Callable[[float, float], float], known: TouchAndLag) -> TouchAndLag:
    """What is known after a shift in which `deviance(touch_pa, lag_s)` is the sum of normalised
    innovation squares, so minus twice a log-likelihood: the minimum of the paraboloid through six
    probes and of what was known, by Gauss and Newton. While the minimum lies further away than the
    probes are to be believed, values move towards it and their covariance stays."""
    prior = known.covariance + np.diag(np.where(np.diag(known.covariance) > 0.0, DRIFT_SD**2, 0.0))
    at, left = known.mean, prior
    for _ in range(MOST_ROUNDS):
        centre = np.maximum(at, [TOUCH_PROBE[0], 0.0])
        gradient, curvature = _paraboloid(deviance, centre)
        if not (np.isfinite(gradient).all() and np.isfinite(curvature).all()):
            break
        slope, upright = gradient / (2.0 * CAUTION**2), _upright(curvature) / (2.0 * CAUTION**2)
        # (P^-1 + A) d = P^-1 (m - c) - b, times P: a figure that is known for certain has no P^-1.
        weight = np.eye(2) + prior @ upright
        step = np.linalg.solve(weight, known.mean - centre - prior @ slope)
        share = min(1.0, float(np.min(MOST_STEP / np.maximum(np.abs(step), 1e-12))))
        at = np.clip(centre + share * step, 0.0, [MOST_TOUCH_PA, MOST_LAG_S])
        if share == 1.0:
            left = np.linalg.solve(weight, prior)
            break
    return TouchAndLag(at, (left + left.T) / 2.0)


def _paraboloid(deviance: Callable[[float, float], float], at: Vector) -> tuple[Vector, Vector]:
    """Gradient (2,) and second derivatives (2, 2) by differences."""
    touch_pa, lag_s = at.tolist()
    probe_pa, probe_s = TOUCH_PROBE.tolist()
    middle = deviance(touch_pa, lag_s)
    more_pa, less_pa = deviance(touch_pa + probe_pa, lag_s), deviance(touch_pa - probe_pa, lag_s)
    more_s, less_s = deviance(touch_pa, lag_s + probe_s), deviance(touch_pa, lag_s - probe_s)
    both = deviance(touch_pa + probe_pa, lag_s + probe_s)
    gradient = np.array([more_pa - less_pa, more_s - less_s]) / (2.0 * TOUCH_PROBE)
    mixed = (both - more_pa - more_s + middle) / (probe_pa * probe_s)
    bend_pa = (more_pa - 2.0 * middle + less_pa) / probe_pa**2
    bend_s = (more_s - 2.0 * middle + less_s) / probe_s**2
    return gradient, np.array([[bend_pa, mixed], [mixed, bend_s]])


def _upright(curvature: Vector) -> Vector:
    """The nearest curvature that is none downwards: a saddle says nothing along its fall."""
    scaled = curvature * np.outer(TOUCH_PROBE, TOUCH_PROBE)
    values, vectors = np.linalg.eigh(scaled)
    upright: Vector = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return upright / np.outer(TOUCH_PROBE, TOUCH_PROBE)


def above_touch(samples: PressureSamples, touch_pa: float, lag_s: float) -> Pressures:
    """The pressure above that at which the pads touch, in front of the sensor's lag."""
    time_us, pressure_pa = samples.before_the_lag(lag_s)
    return Pressures(time_us, np.maximum(pressure_pa - touch_pa, 0.0))


class BrakeModel:
    """What is learned of the path from a brake command to the layshaft's deceleration."""

    def __init__(self, sheet: GearboxSheet, gain_sd: float, drag_sd_nm: float) -> None:
        self._rate = 1.0 / sheet.brake.time_constant_s
        self.supply_pa = sheet.air.supply_gauge_pa
        self.gain = Estimate(1.0, gain_sd)
        self.drag_nm = Estimate(0.0, drag_sd_nm)
        lag_s = sheet.air.sensor_lag_s
        self.touch_and_lag = uncorrelated((0.0, TOUCH_SD_PA), (lag_s, LAG_TOLERANCE * lag_s))
        delay = sheet.brake.valve_delay_s
        delay_sd_s = max(sheet.brake.valve_delay_tolerance * delay, LEAST_DELAY_SD_S)
        self._mean: Vector = np.zeros(PARAMETERS)
        self._mean[[OFF_DELAY, ON_DELAY]] = delay
        self._covariance = np.diag([OWN_SD**2] * 2 * RATES + [delay_sd_s**2] * 2)
        for half in (slice(0, RATES), slice(RATES, 2 * RATES)):
            self._covariance[half, half] += sheet.brake.time_constant_tolerance**2
        self.shifts = 0
        """From how many shifts the law was learned."""

    @property
    def touch_pa(self) -> Estimate:
        """Gauge pressure at which the pads touch."""
        known = self.touch_and_lag
        return Estimate(float(known.mean[0]), float(known.sd[0]))

    @property
    def sensor_lag_s(self) -> Estimate:
        """By how much the measured pressure comes late; a sheet without a lag leaves none to be
        learned."""
        known = self.touch_and_lag
        return Estimate(float(known.mean[1]), float(known.sd[1]))

    def carry(self, x: Vector, p: Vector, inertia_kgm2: float) -> None:
        """Gain and drag as the filter's state (STATES,) and covariance at the end of a run say."""
        sd = np.sqrt(np.maximum(np.diag(p), 0.0))
        self.gain = Estimate(float(x[GAIN]), float(sd[GAIN]))
        self.drag_nm = Estimate(float(x[DRAG]) * inertia_kgm2, float(sd[DRAG]) * inertia_kgm2)

    def take_touch_and_lag(self, found: TouchAndLag) -> None:
        """What is known of both from now on. The valve's delays were found from pressures that came
        as late as was believed until now."""
        sooner_s = found.mean[1] - self.touch_and_lag.mean[1]
        self.touch_and_lag = found
        by = np.zeros(PARAMETERS)
        by[[OFF_DELAY, ON_DELAY]] = -sooner_s
        self.move_law(by)

    def above_touch(self, samples: PressureSamples) -> Pressures:
        """The pressure that brakes, by measured ones."""
        return above_touch(samples, self.touch_pa.value, self.sensor_lag_s.value)

    def record(self) -> BrakeRecord | None:
        """What a calibration file keeps; None before the first shift it was learned from."""
        if self.shifts == 0:
            return None
        mean, sd = self._mean, np.sqrt(np.diag(self._covariance))
        factors = np.exp(mean[: 2 * RATES])
        off, on = (Estimate(float(mean[k]), float(sd[k])) for k in (OFF_DELAY, ON_DELAY))
        return BrakeRecord.of(
            *(self.gain, self.drag_nm, self.touch_pa, self.sensor_lag_s, off, on),
            shifts=self.shifts,
            emptying=tuple(factors[:RATES].tolist()),
            emptying_sd=tuple(sd[:RATES].tolist()),
            filling=tuple(factors[RATES:].tolist()),
            filling_sd=tuple(sd[RATES : 2 * RATES].tolist()),
        )

    def restore(self, record: BrakeRecord) -> None:
        """Starts from a record; correlations between its errors are not stored."""
        self.shifts = record.shifts
        gain, drag_nm, touch, lag, *delays = record.figures
        self.gain, self.drag_nm = Estimate(*gain), Estimate(*drag_nm)
        self.touch_and_lag = uncorrelated(touch, lag)
        delays_s, delays_sd_s = zip(*delays, strict=True)
        rates = np.log([*record.emptying, *record.filling])
        self._mean = np.array([*rates, *delays_s])
        sd = [*record.emptying_sd, *record.filling_sd]
        delays_sd = np.maximum(delays_sd_s, LEAST_SD_S)
        self._covariance = np.diag([*np.maximum(sd, LEAST_SD), *delays_sd]) ** 2

    def varied(self, normal: Vector) -> BrakeModel:
        """Another brake that is as likely: law and delays moved by `normal` (PARAMETERS,) standard
        deviations, correlations kept. Gain, drag and touch stay."""
        other = copy.copy(self)
        other.move_law(np.linalg.cholesky(self._covariance) @ normal)
        return other

    def move_law(self, by: Vector) -> None:
        """Moves rates and delays (PARAMETERS,); a delay is never negative."""
        self._mean = self._mean + by
        self._mean[2 * RATES :] = np.maximum(self._mean[2 * RATES :], 0.0)

    @property
    def off_delay_us(self) -> int:
        """From switching off to the first fall of the torque."""
        return round(float(self._mean[OFF_DELAY]) / US)

    @property
    def on_delay_us(self) -> int:
        """From switching on to the first torque: the valve's delay, then the fill to the touch."""
        at_zero = self._rate * self.supply_pa * math.exp(float(self._mean[RATES]))
        return round((float(self._mean[ON_DELAY]) + self.touch_pa.value / at_zero) / US)

    def law(self, touch_pa: float | None = None) -> Vector:
        """The law of the pressure above the touch, for `layshaft_kernels`."""
        touch = self.touch_pa.value if touch_pa is None else touch_pa
        whole = self._law(self._mean)
        law = np.full((2, SEGMENTS, 3), np.inf)
        law[:, :, 1:] = LEAST_B, 0.0
        law[:, 1 : RATES + 1] = whole[:, :RATES]
        law[:, 1 : RATES + 1, 2] -= law[:, 1 : RATES + 1, 1] * touch
        law[:, 1:, 0] -= touch
        # Below the touch no torque acts: the pressure stays 0 when emptying, and the segment is
        # passed at once when filling.
        law[0, 0] = -np.inf, LEAST_B, 0.0
        law[0, 1, 0] = 0.0
        law[1, 0], law[1, 1, 0] = law[1, 1], 0.0
        law[1, 0, 0] = -np.inf
        return law

    def _law(self, parameters: Vector) -> Vector:
        law = np.full((2, SEGMENTS, 3), np.inf)
        law[:, :, 1:] = 1.0, 0.0
        k, rate = self.supply_pa, self._rate
        emptying = [0.0] + [
            -rate * k * EMPTYING[i] * math.exp(parameters[i - 1]) for i in range(1, RATES + 1)
        ]
        filling = [
            rate * k * (1.0 - FILLING[i]) * math.exp(parameters[RATES + i]) for i in range(RATES)
        ] + [0.0]
        for u, (knots, rates) in enumerate(((EMPTYING, emptying), (FILLING, filling))):
            for i in range(RATES):
                slope = (rates[i + 1] - rates[i]) / (k * (knots[i + 1] - knots[i]))
                b = -slope if abs(slope) > LEAST_B else LEAST_B
                law[u, i] = k * knots[i], b, rates[i] + b * k * knots[i]
            law[u, 0, 0] = -np.inf
        return law

    def learn(self, samples: PressureSamples, command_us: Vector, command_u: Vector) -> bool:
        """Fits law and delays to a shift's pressure samples and the brake's commands.

        Returns False, and learns nothing, with too few samples or if the fit fails."""
        sample_us, pressure_pa = samples.before_the_lag(self.sensor_lag_s.value)
        if sample_us.size < LEAST_SAMPLES or command_u.size == 0 or command_u.max() < 1.0:
            return False
        prior_mean, prior = self._mean, self._covariance * VARIANCE_GROWTH
        weight = np.linalg.inv(prior)
        mean = prior_mean.copy()
        for _ in range(ITERATIONS):
            predicted = self._run(mean, sample_us, pressure_pa[0], command_us, command_u)
            slope = np.empty((sample_us.size, PARAMETERS))
            for k in range(PARAMETERS):
                step = PROBE if k < 2 * RATES else 0.1 * PROBE
                probe = mean.copy()
                probe[k] += step
                moved = self._run(probe, sample_us, pressure_pa[0], command_us, command_u)
                slope[:, k] = (moved - predicted) / step
            residual = np.clip(pressure_pa - predicted, -20 * FIT_PA, 20 * FIT_PA)
            normal = slope.T @ slope / FIT_PA**2 + weight
            right = slope.T @ residual / FIT_PA**2 + weight @ (prior_mean - mean)
            mean = mean + np.linalg.solve(normal, right)
            mean[: 2 * RATES] = np.clip(mean[: 2 * RATES], -1.5, 1.5)
            mean[2 * RATES :] = np.clip(mean[2 * RATES :], 0.0, 0.1)
        if not np.isfinite(mean).all():
            return False
        self._mean, self._covariance = mean, np.linalg.inv(normal)
        self.shifts += 1
        return True

    def _run(
        self,
        parameters: Vector,
        sample_us: Vector,
        start_pa: float,
        command_us: Vector,
        command_u: Vector,
    ) -> Vector:
        """The pressure at the samples, by the law with these parameters."""
        delays = parameters[[OFF_DELAY, ON_DELAY]][command_u.astype(np.int64)]
        switches = np.array((np.maximum.accumulate(command_us + delays / US), command_u))
        model = MotionModel(STILL, self._law(parameters), QUIET)
        x = np.zeros(STATES)
        x[PRESSURE] = start_pa
        pressure = np.empty(sample_us.size)
        pressure_trajectory(x, sample_us, switches, model.flat, pressure)
        return pressure
