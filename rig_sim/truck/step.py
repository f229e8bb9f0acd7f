"""The integrator of the truck plant: classical Runge-Kutta of fourth order."""

from __future__ import annotations

from meshpoint.rig_sim.jit import part
from meshpoint.rig_sim.shared.angle_kernels import Floats
from meshpoint.rig_sim.truck.layout import STATES
from meshpoint.rig_sim.truck.motion import rates


@part
def step(
    y: Floats, after: Floats, h: float, p: Floats, g: Floats, slots: Floats, k: Floats, aux: Floats
) -> None:
    """One Runge-Kutta step from y into `after`. k[0] holds the rates at y; k[1..3] are scratch."""
    for stage in range(3):
        part_way = h if stage == 2 else 0.5 * h
        for i in range(STATES):
            after[i] = y[i] + part_way * k[stage, i]
        rates(after, p, g, slots, k[stage + 1], aux)
    for i in range(STATES):
        after[i] = y[i] + h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])
