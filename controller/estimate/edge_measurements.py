"""Edges taken together: one by itself says little, and a shaft swings slowly."""

from __future__ import annotations

import numpy as np

from meshpoint.kernels.records import Vector


def grouped(edges: Vector, within_us: float) -> tuple[Vector, Vector]:
    """Mean times and mean angles of edges (2, n), in order of time, that lie within so long of one
    another; n is at least 1."""
    times, angles, _ = grouped_counts(edges, within_us)
    return times, angles


def grouped_counts(edges: Vector, within_us: float) -> tuple[Vector, Vector, Vector]:
    """The same, and of how many edges each is."""
    group = np.floor((edges[0] - edges[0, 0]) / within_us)
    # Where a group begins: numpy's `unique` sorts what is sorted, for four times as long.
    begins = np.flatnonzero(group[1:] != group[:-1])
    first = np.zeros(begins.size + 2, dtype=np.intp)
    first[1:-1], first[-1] = begins + 1, group.size
    count = (first[1:] - first[:-1]).astype(np.float64)
    times, angles = np.add.reduceat(edges, first[:-1], axis=1) / count
    return times, angles, count
