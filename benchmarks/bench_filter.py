"""Cost of one edge through the layshaft filters, beside filterpy with scipy's cont2discrete.

The peer is what the thesis does, in Python: A_d and B_d by c2d for every time step (5.3), then
predict and update. The thesis's filter gets the same edges and must end in the same state; the
crossing-time filter, the node's own, follows the same edges with six states: `CrossingFilter.take`,
the call by which the node's tracker hands over every batch, its memory for late edges included.

Each filter runs as often as the peer's one run takes long, so that what its first batch finds cold
(code, tables) counts as little as with the peer, whose 160 edges run the same code 160 times. A
node's batches come 10 ms apart, with other work in between: `first` is one pass right after the
peer's.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.signal import cont2discrete

from meshpoint.controller.estimate.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.models.layshaft import diagonal, first_order_law, free_motion
from meshpoint.controller.models.thesis import THESIS_FILTER, layshaft_model, thesis_filter
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.gearbox import Split, load_sheet
from meshpoint.kernels.records import RecordMemory
from meshpoint.units import US

EDGES, BATCH = 160, 16
PASSES = 200
"""About as long as the peer's one."""
W = np.array([0.009, 20.0, 1e5])
R = 1.2e-7


def edges(model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A layshaft slowing down by drag alone from 1,400 rpm: edge times in us, angles in rad."""
    pitch = np.pi / 45
    angles = pitch * np.arange(1, EDGES + 1)
    omega, drag = 146.6, model[0]
    times = -np.log1p(-angles * drag / omega) / drag
    return np.round(times / US), angles


def start() -> tuple[np.ndarray, np.ndarray]:
    """State and covariance to begin with."""
    return np.array([0.0, 146.6, 0.0]), np.diag([1e-6, 1.0, 4e8])


class Thesis:
    """The product's kernel, in batches as the bus delivers them."""

    def __init__(self, model: np.ndarray) -> None:
        self._memory = memory = RecordMemory(THESIS_FILTER)
        memory.part("model")[:], memory.part("w")[:], memory.part("r_rad2")[0] = model, W, R
        self._time_us, self._x, self._p = (memory.part(name) for name in ("time_us", "x", "p"))
        self._switches = np.empty((2, 0))

    def __call__(self, _model: np.ndarray, times: np.ndarray, angles: np.ndarray) -> np.ndarray:
        self._time_us[0] = 0.0
        self._x[:], self._p[:] = start()
        flat = self._memory.flat
        for i in range(0, EDGES, BATCH):
            thesis_filter(flat, times[i : i + BATCH], angles[i : i + BATCH], self._switches)
        return self._x


class Crossing:
    """The node's own filter, in the same batches."""

    def __init__(self, times: np.ndarray, angles: np.ndarray) -> None:
        sheet, tuning = load_sheet("thesis"), CrossingFilterTuning()
        law = first_order_law(1.0 / sheet.brake.time_constant_s, sheet.air.supply_gauge_pa)
        self._model = free_motion(sheet, Split.HIGH, law, tuning)
        self._filter = CrossingFilter(tuning)
        self._x = np.array([0.0, 146.6, 0.0, 0.0, 1.0, 0.0])
        self._p = diagonal(1e-3, 1.0, 2e4, 3.0, 0.1, 15.0)
        none = np.empty(0)
        self._batches = [
            np.array((times[i : i + BATCH], angles[i : i + BATCH])) for i in range(0, EDGES, BATCH)
        ]
        self._pressures, self._switches = Pressures(none, none), np.empty((2, 0))

    def __call__(self, *_arguments: np.ndarray) -> np.ndarray:
        self._filter.begin(0.0, self._x, self._p)
        for edges in self._batches:
            self._filter.take(edges, 1e-4, self._pressures, self._switches, self._model)
        return self._filter.x


def peer(model: np.ndarray, times: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """filterpy, discretised by scipy for every edge."""
    a, b, g, k = model
    a_c = np.array([[0.0, 1.0, 0.0], [0.0, -a, -g], [0.0, 0.0, -b]])
    b_c = np.array([[0.0], [0.0], [b * k]])
    kalman = KalmanFilter(dim_x=3, dim_z=1, dim_u=1)
    x, p = start()
    kalman.x, kalman.P = x.reshape(3, 1), p
    kalman.H, kalman.R = np.array([[1.0, 0.0, 0.0]]), np.array([[R]])
    before = 0.0
    for time_us, angle in zip(times, angles, strict=True):
        dt = (time_us - before) * US
        before = time_us
        a_d, b_d, *_ = cont2discrete((a_c, b_c, np.eye(3), np.zeros((3, 1))), dt)
        kalman.predict(u=np.zeros((1, 1)), F=a_d, B=b_d, Q=np.outer(W * dt, W * dt))
        kalman.update(np.array([[angle]]))
    return np.asarray(kalman.x).ravel()


def cost_us(passes: int, run: Callable[..., np.ndarray], *arguments: Any) -> float:
    """Microseconds of CPU time an edge, mean of some passes."""
    begin = time.process_time()
    for _ in range(passes):
        run(*arguments)
    return (time.process_time() - begin) / passes / EDGES / US


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the table: the least of the repeats, so that a busy machine counts little."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=15)
    namespace = parser.parse_args(argv)
    model = layshaft_model(load_sheet("thesis"), Split.HIGH)
    times, angles = edges(model)
    ours = Thesis(model)
    # Angle, speed and pressure each in its own scale; the peer rounds differently, no more.
    gap = np.abs(ours(model, times, angles) - peer(model, times, angles)) / [1e-3, 1.0, 1e5]
    if gap.max() > 1e-5:
        print(f"the two filters disagree: {gap}", file=sys.stderr)
        return 1
    crossing = Crossing(times, angles)
    found = crossing(model, times, angles)
    if abs(found[0] - angles[-1]) > 1e-3 or abs(found[1] - ours(model, times, angles)[1]) > 0.5:
        print(f"the crossing-time filter is elsewhere: {found}", file=sys.stderr)
        return 1
    runs = ((PASSES, ours), (1, peer), (1, crossing), (PASSES, crossing))
    rounds = [
        [cost_us(passes, run, model, times, angles) for passes, run in runs]
        for _ in range(namespace.repeats)
    ]
    thesis, theirs, first, node = (min(column) for column in zip(*rounds, strict=True))
    figures = {
        "crossing_us_per_edge": round(node, 4),
        "crossing_first_us_per_edge": round(first, 4),
        "thesis_kernel_us_per_edge": round(thesis, 4),
        "filterpy_cont2discrete_us_per_edge": round(theirs, 2),
        "crossing_ratio": round(theirs / node, 1),
        "thesis_ratio": round(theirs / thesis, 1),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(f"crossing, batches of {BATCH}: {node:.3f} us an edge, {theirs / node:.0f} x")
        print(f"crossing, first pass: {first:.3f} us an edge, {theirs / first:.0f} x")
        print(f"thesis, batches of {BATCH}: {thesis:.3f} us an edge, {theirs / thesis:.0f} x")
        print(f"filterpy + cont2discrete: {theirs:.1f} us an edge")
    return 0


if __name__ == "__main__":
    sys.exit(main())
