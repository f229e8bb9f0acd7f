"""How the engine's torque is taken away so that nothing swings when the clutch opens.

With a gear in mesh engine and vehicle swing against each other on the shafts and tyres between
them. A torque that is taken away at once leaves the engine but not the twisted shafts. So it is
planned what is asked of the engine until the plates part, between its own torque as it was and the
one with which it coasts along with the vehicle, that leaves shafts, wheels and tyres at rest then:
for several times until then, and the one is taken that costs least. Only the plan's beginning is
asked for; the next plan is made anew from what was seen since (model predictive control; Rawlings,
Mayne, Diehl 2017, ch. 1; taking a swing away by bounded torque: Singhose, Singer, Seering 1994).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.models.twist import Twist
from meshpoint.kernels.jit import compiled
from meshpoint.kernels.records import Vector

LATER_S: Final = (0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.17, 0.25, 0.4, 0.6)
"""The plates part so much later than they could: tried from the first."""
NEAR_S: Final = (-0.03, -0.02, -0.01, 0.0, 0.02)
"""About what was planned before."""
PIECES: Final = 6
"""A plan asks for no more torques than this, one after the other."""
MS_PER_NM: Final = 2.0
"""What is left in the shafts costs as much as a shift that takes this much longer (docs/decisions,
0036)."""
QUIET: Final = 1e-2
"""Nm left, for a Nm that is asked for beyond coasting: of equal plans the quieter one."""
CLOSE_NM: Final = 1e-4
"""Torques that move by no more are found."""
SWEEPS: Final = 2000
"""No search goes on for longer: of 700 in ramps of `typical` the longest took 1,322."""
MOST_NM: Final = 1e9
"""No driveline carries that."""


class Unloading(NamedTuple):
    """What is asked of the engine, and when the plates part."""

    torque_nm: float
    steps: int
    """Until the plates part."""
    left_nm: float
    """What stays in the driveline then, as a torque of the shafts."""


def unload(
    twist: Twist, own_nm: float, step_s: float, least: int, before: int | None
) -> Unloading | None:
    """The plan from here on; None where the driveline's figures lead nowhere finite. own_nm: the
    engine's torque before any of it was taken away; least: the steps that the clutch takes until
    its plates part; before: those which were planned last until then."""
    if before is None:
        later = {least + round(more_s / step_s) for more_s in LATER_S}
    else:
        later = {least} | {max(least, before + round(more_s / step_s)) for more_s in NEAR_S}
    paths = _Paths(twist, step_s, max(later))
    if not np.abs(paths.left).max() < MOST_NM:
        return None
    coasting_nm = twist.coasting_nm
    low, high = min(own_nm, coasting_nm), max(own_nm, coasting_nm)
    found, least_ms = None, np.inf
    for steps in sorted(later):
        waits_ms = 1e3 * step_s * (steps - least)
        if waits_ms >= least_ms:
            break
        plan = _plan(paths, steps, low, high, coasting_nm)
        cost_ms = waits_ms + MS_PER_NM * plan.left_nm
        if cost_ms < least_ms:
            found, least_ms = plan, cost_ms
    return found


class _Paths:
    """Where the driveline goes by itself, and what a torque asked for adds."""

    def __init__(self, twist: Twist, step_s: float, most: int) -> None:
        moves = twist.within(step_s)
        paths = np.zeros((most + 1, len(moves), 2))
        paths[0, :-1, 0], paths[0, -1, 1] = twist.state, 1.0
        for k in range(most):
            paths[k + 1] = moves @ paths[k]
        self.left: Vector = twist.left_nm @ paths[:, :-1]
        self.free = self.left[:, :, 0]
        """What is left after n steps without a torque asked for (n, 5)."""
        self.added = self.left[:, :, 1]
        """What one adds for each Nm asked for in all of them (n, 5)."""


def _plan(paths: _Paths, steps: int, low: float, high: float, coasting_nm: float) -> Unloading:
    """The torques, each for a share of the steps, that leave least."""
    ends = steps - np.unique(np.linspace(0, steps, min(PIECES, steps) + 1).round().astype(int))
    adds = (paths.added[ends[:-1]] - paths.added[ends[1:]]).T
    coasts = paths.free[steps] + coasting_nm * paths.added[steps]
    found = _least(adds, coasts, low - coasting_nm, high - coasting_nm)
    return Unloading(
        coasting_nm + float(found[0]), steps, float(np.linalg.norm(coasts + adds @ found))
    )


def _least(adds: Vector, coasts: Vector, low: float, high: float) -> Vector:
    """The x within low and high that makes |adds x + coasts| least."""
    count = adds.shape[1]
    x: Vector = np.full(count, min(max(0.0, low), high))
    least_within(adds.T @ adds + QUIET**2 * np.eye(count), coasts @ adds, low, high, x)
    return x


@compiled
def least_within(matrix: Vector, slope: Vector, low: float, high: float, x: Vector) -> None:
    """Moves x (n,) to where x' matrix x / 2 + slope' x is least within low and high, one of x after
    the other (projected Gauss-Seidel; Hildreth, Naval Research Logistics Quarterly 4, 1957)."""
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(x.shape[0]):
            off = slope[i]
            for j in range(x.shape[0]):
                off += matrix[i, j] * x[j]
            there = min(max(x[i] - off / matrix[i, i], low), high)
            moved = max(moved, abs(there - x[i]))
            x[i] = there
        if moved < CLOSE_NM:
            return
