"""Cost of one edge through the layshaft filter, beside filterpy with scipy's cont2discrete.

The peer is what the thesis does, in Python: A_d and B_d by c2d for every time step (5.3), then
predict and update. Both filters get the same edges and must end in the same state.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.signal import cont2discrete

from controller.kernels import thesis_filter
from controller.predictor import layshaft_model
from gearbox import Split, load_sheet

EDGES, BATCH = 160, 16
US = 1e-6
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


def ours(model: np.ndarray, times: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """The product's kernel, in batches as the bus delivers them."""
    x, p = start()
    none, time_us = np.empty(0), 0.0
    for i in range(0, EDGES, BATCH):
        time_us = thesis_filter(
            x, p, time_us, times[i : i + BATCH], angles[i : i + BATCH], none, none, model, W, R
        )
    return x


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


def cost_us(run: Callable[..., np.ndarray], *arguments: Any) -> float:
    """Microseconds an edge."""
    begin = time.perf_counter()
    run(*arguments)
    return (time.perf_counter() - begin) / EDGES / US


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeats", type=int, default=15)
    namespace = parser.parse_args(argv)
    model = layshaft_model(load_sheet("thesis"), Split.HIGH)
    times, angles = edges(model)
    # Angle, speed and pressure each in its own scale; the peer rounds differently, no more.
    gap = np.abs(ours(model, times, angles) - peer(model, times, angles)) / [1e-3, 1.0, 1e5]
    if gap.max() > 1e-5:
        print(f"the two filters disagree: {gap}", file=sys.stderr)
        return 1
    pairs = [
        (cost_us(ours, model, times, angles), cost_us(peer, model, times, angles))
        for _ in range(namespace.repeats)
    ]
    mine, theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
    figures = {
        "kernel_us_per_edge": round(mine, 4),
        "filterpy_cont2discrete_us_per_edge": round(theirs, 2),
        "ratio": round(theirs / mine, 1),
    }
    if namespace.json:
        print(json.dumps(figures))
    else:
        print(f"filter, batches of {BATCH}: {mine:.3f} us an edge")
        print(f"filterpy + cont2discrete:  {theirs:.1f} us an edge, {theirs / mine:.0f} x")
    return 0


if __name__ == "__main__":
    sys.exit(main())
