"""Edges taken together: one by itself tells little, and a shaft swings slowly."""

from __future__ import annotations

import numpy as np

from meshpoint.controller.records import Vector


def grouped(edges: Vector, within_us: float) -> tuple[Vector, Vector]:
    """Mean times and mean angles of edges (2, n) that lie within so long of one another; n is at
    least 1."""
    times, angles, _ = grouped_counts(edges, within_us)
    return times, angles


def grouped_counts(edges: Vector, within_us: float) -> tuple[Vector, Vector, Vector]:
    """The same, and of how many edges each is."""
    group = np.floor((edges[0] - edges[0, 0]) / within_us)
    _, first, count = np.unique(group, return_index=True, return_counts=True)
    times = np.add.reduceat(edges[0], first) / count
    return times, np.add.reduceat(edges[1], first) / count, count.astype(np.float64)
