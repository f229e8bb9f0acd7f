"""Predictions of what was kept out of a fit, beside those by the data sheet."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from meshpoint.gearbox import GearboxSheet
from meshpoint.identify.brake_fit import BrakeFit
from meshpoint.identify.brake_trajectory import (
    GRID_S,
    BrakeTrajectories,
    P,
    Trajectory,
    prior_of,
)
from meshpoint.kernels.records import Vector
from meshpoint.units import RPM

ENDS: Final = 6
"""Bins at either end of a run that give its first and its last speed."""


class HeldOut(NamedTuple):
    """RMS errors of predictions, in `unit`."""

    name: str
    unit: str
    samples: int
    identified: float
    """Each predicted by all others."""
    by_sheet: float


def check_samples(name: str, unit: str, kept_out: Vector, of_sheet: Vector) -> HeldOut:
    """Of samples that are predicted by the mean of the others."""
    return HeldOut(name, unit, kept_out.size, _rms(kept_out), _rms(of_sheet))


def _rms(errors: Vector) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def check_runs(
    model: BrakeTrajectories, trajectories: list[Trajectory], best: BrakeFit, sheet: GearboxSheet
) -> HeldOut:
    """The layshaft's speed at the end of each run, from that at its beginning."""
    by_sheet = prior_of(sheet).mean.copy()
    by_sheet[P.TOUCH] = 0.0
    omega = best.omega_rad_s[best.used.astype(bool)]
    errors = []
    for number, parameters in enumerate(best.without):
        both = np.stack((parameters, by_sheet))
        angles, speeds, _ = model.run(both, omega)
        errors.append(_end_errors(trajectories[number], angles[:, :, number], speeds[:, :, number]))
    found = np.array(errors) / RPM
    return HeldOut(
        "layshaft speed at the end of a run",
        "rpm",
        len(trajectories),
        _rms(found[:, 0]),
        _rms(found[:, 1]),
    )


def _end_errors(trajectory: Trajectory, angles: Vector, speeds: Vector) -> Vector:
    """Measured less predicted speed at the end, of each lane, the first speeds being equal."""
    weights, nodes = trajectory.weights, trajectory.nodes
    predicted = np.einsum("bn,nl->bl", weights[:, :, 0], angles[:nodes])
    predicted += np.einsum("bn,nl->bl", weights[:, :, 1], speeds[:nodes])
    seconds = (weights[:, :, 0] @ np.arange(nodes) - trajectory.first_node) * GRID_S
    rest = trajectory.angle[:, None] - predicted
    begin, end = rest[:ENDS], rest[-ENDS:]
    at_begin, at_end = seconds[:ENDS] - seconds[0], seconds[-ENDS:] - seconds[-1]
    return np.asarray(np.polyfit(at_end, end, 1)[0] - np.polyfit(at_begin, begin, 1)[0])
