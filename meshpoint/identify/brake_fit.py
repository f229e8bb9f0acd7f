"""Fits `brake_trajectory` to all runs at once: generalised least squares, and a jackknife over
runs.

Angles are weighed by what scatters them: the edges' own error, and a torque of chance that adds up
over a run. A run's first angle and speed are its own. Intervals come from leaving out each run in
turn, so they hold whatever the weights: a run is the unit that repeats.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from meshpoint.gearbox import GearboxSheet
from meshpoint.identify.brake_trajectory import (
    GRID_S,
    BrakeTrajectories,
    Prior,
    Trajectory,
    prior_of,
)
from meshpoint.kernels.records import Vector
from meshpoint.units import BAR

EDGE_SD_RAD: Final = 6e-4
"""Of an edge's angle with its tooth's error taken out, jitter included."""
BIN_SD_RAD: Final = 1e-4
"""Of a bin's mean, however many edges it has."""
CHANCE_RAD2_S3: Final = 0.25
"""Density of the acceleration's noise: 0.6 Nm over 40 ms on 0.36 kg m2."""
PRESSURE_SD_PA: Final = 0.06 * BAR
ITERATIONS: Final = 12
DOUBTING: Final = 5
"""Iterations after which runs that do not fit are left out."""
ODD: Final = 3.0
MOST_ODD: Final = 8.0
"""A run's reduced chi-square over the usual one: from here on it weighs less; beyond this it is
left out: a sleeve, a clutch or lost teeth have moved the shaft."""
PROBE: Final = 0.01
"""Of a parameter, in standard deviations of its prior."""
CONVERGED: Final = 1e-3
MOST_STEP: Final = 1.0
"""Of a parameter in one iteration, in standard deviations of its prior."""


@dataclass(frozen=True)
class RunFit:
    """One run's part of the equations, its own angle and speed eliminated."""

    normal: Vector
    right: Vector
    squares: float
    values: int

    @property
    def reduced_chi2(self) -> float:
        """Squared weighed residuals over their number."""
        return self.squares / self.values

    def weighed(self, share: float) -> RunFit:
        """The same with less weight."""
        return RunFit(share * self.normal, share * self.right, share * self.squares, self.values)


@dataclass(frozen=True)
class BrakeFit:
    """The result: parameters, what each run alone would take them to, and the reduced
    chi-square."""

    parameters: Vector
    without: Vector
    """(runs, COUNT): without each run."""
    covariance: Vector
    """Of the parameters, by the weights."""
    prior: Prior
    reduced_chi2: float
    """Squared weighed residuals over their number."""
    omega_rad_s: Vector
    """At each run's first node."""
    used: NDArray[np.bool_]
    """(runs,): False for those that do not fit the others and were left out."""


def fit(
    trajectories: list[Trajectory], sheet: GearboxSheet, is_choked: bool, omega_ref: float
) -> BrakeFit:
    """The best parameters. LinAlgError where the equations have no solution."""
    model = BrakeTrajectories(trajectories, sheet, is_choked)
    model.omega_ref = omega_ref
    prior = prior_of(sheet)
    weight = np.diag(prior.sd**-2.0)
    whitenings = [_whitening(trajectory) for trajectory in trajectories]
    at = prior.mean.copy()
    omega = np.array([trajectory.omega_rad_s for trajectory in trajectories])
    shares = np.ones(len(trajectories))
    for iteration in range(ITERATIONS):
        parts, own = _equations(model, trajectories, whitenings, at, omega, prior)
        odd = np.array([part.reduced_chi2 for part in parts]) / np.median(
            [p.reduced_chi2 for p in parts]
        )
        # First runs that do not fit weigh less, so that the others draw near; then they are out.
        shares = np.minimum(1.0, (ODD / odd) ** 2)
        if iteration >= DOUBTING:
            shares = np.where(odd > MOST_ODD, 0.0, 1.0)
        parts = [part.weighed(share) for part, share in zip(parts, shares, strict=True)]
        normal = weight + sum(part.normal for part in parts)
        right = weight @ (prior.mean - at) + sum(part.right for part in parts)
        step: Vector = np.linalg.solve(normal, right).astype(np.float64)
        step /= max(1.0, float(np.max(np.abs(step) / prior.sd)) / MOST_STEP)
        at = at + step
        omega = omega + np.array([one(step) for one in own])
        if iteration > DOUBTING and np.max(np.abs(step) / prior.sd) < CONVERGED:
            break
    used = shares > 0.0
    parts = [part for part, share in zip(parts, shares, strict=True) if share > 0.0]
    without = np.array([_without(at, normal, right, part) for part in parts])
    reduced_chi2 = sum(part.squares for part in parts) / max(1, sum(part.values for part in parts))
    covariance: Vector = np.linalg.inv(normal).astype(np.float64)
    return BrakeFit(at, without, covariance, prior, reduced_chi2, omega, used)


def _without(at: Vector, normal: Vector, right: Vector, part: RunFit) -> Vector:
    """The parameters without one run, by one step from the optimum of all."""
    return np.asarray(at + np.linalg.solve(normal - part.normal, right - part.right))


def _whitening(trajectory: Trajectory) -> Vector:
    """Makes a run's angle residuals independent and of variance 1."""
    seconds = (
        trajectory.weights[:, :, 0] @ np.arange(trajectory.nodes) - trajectory.first_node
    ) * GRID_S
    return whitening(seconds, EDGE_SD_RAD**2 / trajectory.edges + BIN_SD_RAD**2)


def whitening(seconds: Vector, variances: Vector) -> Vector:
    """Makes angle errors independent and of variance 1 that consist of a chance acceleration since
    the run's beginning (s) and of independent errors of these variances (rad2)."""
    earlier = np.minimum(seconds[:, None], seconds[None, :])
    later = np.maximum(seconds[:, None], seconds[None, :])
    covariance = CHANCE_RAD2_S3 * earlier**2 * (3.0 * later - earlier) / 6.0
    covariance += np.diag(variances)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


class _Own:
    """How a run's own speed follows the parameters."""

    def __init__(self, base: float, slope: Vector) -> None:
        self._base, self._slope = base, slope

    def __call__(self, step: Vector) -> float:
        return self._base - float(self._slope @ step)


def _equations(
    model: BrakeTrajectories,
    trajectories: list[Trajectory],
    whitenings: list[Vector],
    at: Vector,
    omega: Vector,
    prior: Prior,
) -> tuple[list[RunFit], list[_Own]]:
    probes = PROBE * prior.sd
    lanes = np.concatenate((at[None, :], at + np.diag(probes)))
    angles, speeds, felts = model.run(lanes, omega)
    moved, _, _ = model.run(at[None, :], omega + 1.0)
    parts, own = [], []
    for number, trajectory in enumerate(trajectories):
        nodes = trajectory.nodes
        predicted = np.einsum("bn,nl->bl", trajectory.weights[:, :, 0], angles[:nodes, :, number])
        predicted += np.einsum("bn,nl->bl", trajectory.weights[:, :, 1], speeds[:nodes, :, number])
        by_omega = trajectory.weights[:, :, 0] @ (
            moved[:nodes, 0, number] - angles[:nodes, 0, number]
        )
        slopes = (predicted[:, 1:] - predicted[:, :1]) / probes
        residual = trajectory.angle - predicted[:, 0]
        white = whitenings[number]
        nuisance = white @ np.stack((np.ones(residual.size), by_omega), axis=1)
        slopes, residual = white @ slopes, white @ residual
        solved, *_ = np.linalg.lstsq(
            nuisance, np.concatenate((residual[:, None], slopes), axis=1), rcond=None
        )
        own.append(_Own(float(solved[1, 0]), solved[1, 1:]))
        residual = residual - nuisance @ solved[:, 0]
        slopes = slopes - nuisance @ solved[:, 1:]
        felt, by_felt = _pressures(trajectory, felts[:, :, number], probes)
        both, rest = np.concatenate((slopes, by_felt)), np.concatenate((residual, felt))
        parts.append(RunFit(both.T @ both, both.T @ rest, float(rest @ rest), rest.size))
    return parts, own


def _pressures(trajectory: Trajectory, felts: Vector, probes: Vector) -> tuple[Vector, Vector]:
    """Residuals of the pressure samples and their slopes, weighed."""
    inside = (trajectory.pressure_s > 0.0) & (
        trajectory.pressure_s < (trajectory.nodes - 1) * GRID_S
    )
    place = trajectory.pressure_s[inside] / GRID_S
    node = place.astype(np.int64)
    part = (place - node)[:, None]
    predicted = felts[node] * (1.0 - part) + felts[node + 1] * part
    residual = (trajectory.pressure_pa[inside] - predicted[:, 0]) / PRESSURE_SD_PA
    return residual, (predicted[:, 1:] - predicted[:, :1]) / probes / PRESSURE_SD_PA
