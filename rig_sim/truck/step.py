"""The integrator of the truck plant: classical Runge-Kutta of fourth order."""

from __future__ import annotations

from meshpoint.kernels.jit import piece
from meshpoint.rig_sim.truck.layout import Rig
from meshpoint.rig_sim.truck.motion import rates


@piece
def step(rig: Rig, h: float) -> None:
    """One Runge-Kutta step from the state y into `after`. stages[0] holds the rates at y; the
    others are scratch."""
    y, after, stages = rig.y.vector, rig.after.vector, rig.stages
    for stage in range(3):
        part_way = h if stage == 2 else 0.5 * h
        rig.shaking.at_s = rig.shaking.since_s + part_way
        slope = stages[stage].vector
        for i in range(len(y)):
            after[i] = y[i] + part_way * slope[i]
        rates(rig.after, stages[stage + 1], rig)
    k0, k1, k2, k3 = stages[0].vector, stages[1].vector, stages[2].vector, stages[3].vector
    for i in range(len(y)):
        after[i] = y[i] + h / 6.0 * (k0[i] + 2.0 * (k1[i] + k2[i]) + k3[i])
