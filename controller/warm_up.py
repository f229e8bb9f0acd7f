"""Compiles the numeric kernels before the first frame, so that no step waits for the compiler."""

from __future__ import annotations

import numpy as np

from controller import edge_gate, edge_kernels
from controller.kernels import cruise_filter, propagate, thesis_filter


def warm_up() -> None:
    """Calls each kernel once on a standing shaft; a second with a cold cache, else milliseconds."""
    edge_kernels.warm_up()
    edge_gate.warm_up()
    x, p, model = np.zeros(3), np.eye(3), np.array([0.1, 10.0, 0.0, 1.0])
    edges, switches = np.array([1.0]), np.array([0.5])
    propagate(x, 0.0, 1.0, switches, switches, model)
    thesis_filter(x, p, 0.0, edges, edges, switches, switches, model, np.zeros(3), 1.0)
    cruise_filter(np.zeros(2), np.eye(2), 0.0, edges, edges, 1.0, 1e-6)
