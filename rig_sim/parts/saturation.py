"""A friction torque's sign, made smooth: what the models have where a book writes sign(x)."""

from __future__ import annotations

from typing import Final

from meshpoint.kernels.jit import piece

FULL: Final = 15.0 / 8.0
"""From here on, either way, the function is exactly 1."""
PER_FULL: Final = 1.0 / FULL


@piece
def saturated(x: float) -> float:
    """-1..1, odd, with slope 1 at zero like tanh, twice differentiable.

    The quintic smoothstep u (15 - 10 u^2 + 3 u^4) / 8 of u = x / FULL. Unlike tanh it reaches its
    end, and it is a handful of multiplications: half of all work was in tanh before.
    """
    u = min(max(x * PER_FULL, -1.0), 1.0)
    square = u * u
    return u * (15.0 - square * (10.0 - 3.0 * square)) / 8.0
