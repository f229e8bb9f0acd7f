"""The brake's pressure over one shift, as the fit of its law runs it again and again."""

from __future__ import annotations

from meshpoint.controller.jit import compiled
from meshpoint.controller.motion.kernels import PRESSURE, Vector, travel


@compiled
def pressure_course(
    x: Vector, sample_us: Vector, switch_us: Vector, switch_u: Vector, still: Vector, law: Vector,
    pressure_pa: Vector,
) -> None:  # fmt: skip
    """Pressure at ascending times, the first of which is that of the state x (six states, moved).

    still: the motion's parameters of a shaft that nothing moves; the rest as for `travel`."""
    pressure_pa[0] = x[PRESSURE]
    for k in range(1, sample_us.shape[0]):
        travel(x, sample_us[k - 1], sample_us[k], switch_us, switch_u, still, law)
        pressure_pa[k] = x[PRESSURE]
