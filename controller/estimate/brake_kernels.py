"""The brake's pressure over one shift, as the fit of its law runs it again and again."""

from __future__ import annotations

from meshpoint.controller.models.layshaft_kernels import STATE, travel
from meshpoint.kernels.jit import compiled, record_on
from meshpoint.kernels.records import Vector


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
