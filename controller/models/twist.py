"""Engine and gearbox, shafts, wheels and tyres with a gear in mesh, on one flank of the backlash:
linear, so that a plan of the engine's torque is a product of matrices.

    v' = w_G - w_A                                  T = k v + c v'
    w_G' = (i M + u - T) / J_G                      M' = (M* - M) / tau
    w_A' = (T - T_t) / J_A                          T_t = k_t y + d_t y'
    w_V' = T_t / J_V + g                            y' = (w_A - w_V - r y) / (1 + r d_t / k_t)

M is the engine's torque and M* the one asked for, i its speed over the propeller shaft's, v the
twist beyond the flank; the others as in `estimate/loaded_kernels`.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

SLIP, TWIST, CREEP, TYRE, ENGINE, ONE = range(6)
"""Rows of the state: `w_G - w_A`, `v`, `w_A - w_V`, `y`, `M`, and 1 for what is constant."""
STATES: Final = 6
HALVED: Final = 0.5
TERMS: Final = 14
"""A matrix of this norm has its exponential to the last bit by 14 terms of the series."""


class TwistFigures(NamedTuple):
    """What turns and twists, at the propeller shaft."""

    ratio: float
    """`i`."""
    geared_kgm2: float
    released_kgm2: float
    """Of what still turns with the shafts once the gear is out."""
    constant_nm: float
    """`u`: drag, and what the engine's torque is taken for wrongly."""
    shaft_nm_rad: float
    shaft_nms: float
    wheels_kgm2: float
    tyre_nm_rad: float
    tyre_nms: float
    fading: float
    """`r`, 1/s."""
    vehicle_inverse: float
    hill_rad_s2: float
    lag_s: float
    """`tau`."""


class Twist:
    """The driveline at a time, and where the engine's torque takes it."""

    def __init__(self, figures: TwistFigures, state: Vector) -> None:
        """state: (6,), as the rows above."""
        self.state = state
        self._figures = f = figures
        unit = np.eye(STATES)
        self.shafts_nm: Vector = f.shaft_nms * unit[SLIP] + f.shaft_nm_rad * unit[TWIST]
        """Times a state: what the shafts carry."""
        twisting = (unit[CREEP] - f.fading * unit[TYRE]) / (
            1.0 + f.fading * f.tyre_nms / f.tyre_nm_rad
        )
        self.tyres_nm: Vector = f.tyre_nm_rad * unit[TYRE] + f.tyre_nms * twisting
        """Times a state: what the tyres carry."""
        gear = f.ratio * unit[ENGINE] + f.constant_nm * unit[ONE] - self.shafts_nm
        gear /= f.geared_kgm2
        wheels = (self.shafts_nm - self.tyres_nm) / f.wheels_kgm2
        vehicle = f.vehicle_inverse * self.tyres_nm + f.hill_rad_s2 * unit[ONE]
        follows = -unit[ENGINE] / f.lag_s
        self._rates = np.array(
            (gear - wheels, unit[SLIP], wheels - vehicle, twisting, follows, np.zeros(STATES))
        )

    @property
    def coasting_nm(self) -> float:
        """The engine's torque with which engine and gearbox coast along with the vehicle, the
        shafts carrying nothing."""
        f = self._figures
        coasting_rad_s2 = f.hill_rad_s2 / (1.0 + f.wheels_kgm2 * f.vehicle_inverse)
        return (f.geared_kgm2 * coasting_rad_s2 - f.constant_nm) / f.ratio

    def within(self, seconds: float) -> Vector:
        """(7, 7): times the state and, below it, the torque (Nm) asked for, gives both after
        so long (Van Loan 1978)."""
        whole = np.zeros((STATES + 1, STATES + 1))
        whole[:STATES, :STATES], whole[ENGINE, STATES] = self._rates, 1.0 / self._figures.lag_s
        return exponential(seconds * whole)

    @property
    def left_nm(self) -> Vector:
        """(5, 6), times a state: what stays in shafts, gearbox, wheels and tyres once the engine is
        parted from them, as the torque (Nm) of shafts that hold as much energy; and half of the
        torque that parting takes away."""
        f, unit = self._figures, np.eye(STATES)
        parted = 0.5 * f.ratio * (unit[ENGINE] - self.coasting_nm * unit[ONE])
        return np.array((
            self.shafts_nm,
            math.sqrt(f.shaft_nm_rad * f.released_kgm2) * unit[SLIP],
            math.sqrt(f.shaft_nm_rad * f.wheels_kgm2) * unit[CREEP],
            math.sqrt(f.shaft_nm_rad / f.tyre_nm_rad) * self.tyres_nm,
            parted,
        ))  # fmt: skip


def exponential(matrix: Vector) -> Vector:
    """Of a square matrix, by the series of its half, quarter ... and as many squarings (method 3 of
    Moler and Van Loan 2003): scipy's is 113 MB, of which a node would need nothing else."""
    norm = float(np.abs(matrix).sum(axis=0).max())
    halvings = max(0, math.frexp(norm / HALVED)[1])
    part, unit = matrix / 2.0**halvings, np.eye(len(matrix))
    moved = unit
    for term in range(TERMS, 0, -1):
        moved = unit + part @ moved / term
    for _ in range(halvings):
        moved = moved @ moved
    return moved
