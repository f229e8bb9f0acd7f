"""The closed forms of the layshaft model against SciPy and against the thesis written out."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete

from meshpoint.controller.models.thesis import (
    CRUISE_FILTER,
    HOLD,
    LINEAR,
    THESIS_FILTER,
    cruise_filter,
    hold,
    propagate,
    thesis_filter,
)
from meshpoint.kernels import jit
from meshpoint.kernels.records import RecordMemory
from meshpoint.units import US

# Pressure in units of the supply (K = 1), so that g is the full braking in rad/s2 and expm, whose
# error is relative to the largest element, is a fair judge of every element.
RATE_B = st.floats(2.0, 500.0)
RATE_A = st.one_of(st.just(0.0), st.floats(1e-9, 1e-3), st.floats(1e-3, 40.0))
BRAKING = st.floats(10.0, 500.0)
STEP_S = st.floats(1e-6, 0.2)


def matrices(a: float, b: float, g: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """A and B of thesis 4.15 for [theta, omega, p]."""
    return (
        np.array([[0.0, 1.0, 0.0], [0.0, -a, -g], [0.0, 0.0, -b]]),
        np.array([[0.0], [0.0], [b * k]]),
    )


def held(a: float, b: float, g: float, k: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi and Gamma of 5.18 by the exponential of the augmented matrix.

    With omega before theta the matrix is not triangular: for triangular ones SciPy takes a
    shorter way that loses digits where two rates are close."""
    augmented = np.zeros((4, 4))
    augmented[:3, :3], augmented[:3, 3:] = matrices(a, b, g, k)
    order = np.ix_([1, 0, 2, 3], [1, 0, 2, 3])
    both = np.zeros((4, 4))
    both[order] = expm(augmented[order] * dt)
    return both[:3, :3], both[:3, 3]


def ours(a: float, b: float, g: float, k: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    found = np.empty(len(HOLD.names))
    hold(dt, np.array([a, b, g, k]).view(LINEAR)[0], found.view(HOLD)[0])
    f01, f02, f11, f12, f22 = found[:5]
    return np.array([[1.0, f01, f02], [0.0, f11, f12], [0.0, 0.0, f22]]), found[5:]


def assert_same_hold(a: float, b: float, g: float, dt: float, relative: float) -> None:
    """Elements may differ by `relative` of what the input could move that state by in the step."""
    phi, gamma = ours(a, b, g, 1.0, dt)
    phi_expm, gamma_expm = held(a, b, g, 1.0, dt)
    reach = np.array([max(dt, g * dt * dt), max(1.0, g * dt), 1.0])
    assert np.all(np.abs(phi - phi_expm) <= relative * reach[:, None])
    assert np.all(np.abs(gamma - gamma_expm) <= relative * reach)


@settings(deadline=None, max_examples=100)
@given(a=RATE_A, b=RATE_B, g=BRAKING, dt=STEP_S)
def test_hold_is_the_matrix_exponential(a: float, b: float, g: float, dt: float) -> None:
    if abs(a - b) < 1e-3 * b:
        a = 0.5 * b
    assert_same_hold(a, b, g, dt, 1e-10)


@settings(deadline=None, max_examples=40)
@given(b=RATE_B, apart=st.floats(-1e-4, 1e-4), g=BRAKING, dt=STEP_S)
def test_equal_rates_are_no_singularity(b: float, apart: float, g: float, dt: float) -> None:
    """A layshaft that slows as fast as its brake fills: the closed form's 0/0."""
    assert_same_hold(b * (1.0 + apart), b, g, dt, 2e-6)


@settings(deadline=None, max_examples=25)
@given(
    a=RATE_A,
    b=RATE_B,
    g=BRAKING,
    x=st.tuples(st.floats(-10, 10), st.floats(50, 300), st.floats(0, 1)),
    switches=st.lists(st.integers(-50_000, 250_000), min_size=1, max_size=4, unique=True),
    horizon_us=st.integers(1, 200_000),
    first=st.booleans(),
)
def test_propagation_through_brake_switches_solves_the_equations(
    a: float,
    b: float,
    g: float,
    x: tuple[float, float, float],
    switches: list[int],
    horizon_us: int,
    first: bool,
) -> None:
    """Against a Runge-Kutta solver that is given u(t), wherever the switches lie."""
    switch_us = np.array(sorted(switches), dtype=float)
    switch_u = np.array([float((i % 2 == 0) == first) for i in range(len(switches))])
    state = np.array(x)
    switches_now = np.array((switch_us, switch_u))
    propagate(state, 0.0, float(horizon_us), switches_now, np.array([a, b, g, 1.0]))

    stops = [0.0, *[t for t in switch_us if 0.0 < t < horizon_us], float(horizon_us)]
    solved = np.array(x)
    for start, end in itertools.pairwise(stops):
        past = [u for t, u in zip(switch_us, switch_u, strict=True) if t <= start]
        u = past[-1] if past else 0.0
        solved = solve_ivp(
            lambda _t, y, u=u: [y[1], -a * y[1] - g * y[2], b * (u - y[2])],
            (start * US, end * US),
            solved,
            rtol=1e-9,
            atol=1e-10,
        ).y[:, -1]
    assert np.allclose(state, solved, rtol=1e-7, atol=1e-6)


class Thesis:
    """The filter of thesis 5.2 and 5.3 in plain NumPy, with SciPy's c2d: as it is written there.

    `events` are (time, angle or None, u from then on): a brake switch is a prediction alone."""

    def __init__(self, x: np.ndarray, p: np.ndarray, model: np.ndarray) -> None:
        self.x, self.p = x.reshape(3, 1).copy(), p.copy()
        self._a, self._b = matrices(*model)
        self._c = np.array([[1.0, 0.0, 0.0]])

    def predict(self, dt: float, u: float, w: np.ndarray) -> None:
        system = (self._a, self._b, self._c, np.zeros((1, 1)))
        a_d, b_d, *_ = cont2discrete(system, dt, method="zoh")
        self.x = a_d @ self.x + b_d * u  # 5.2
        noise = (w * dt).reshape(3, 1)
        self.p = a_d @ self.p @ a_d.T + noise @ noise.T  # 5.3, 5.8

    def update(self, y: float, r: float) -> None:
        innovation = y - self._c @ self.x  # 5.4
        gain = self.p @ self._c.T @ np.linalg.inv(self._c @ self.p @ self._c.T + r)  # 5.5
        self.x = self.x + gain @ innovation  # 5.6
        self.p = (np.eye(3) - gain @ self._c) @ self.p  # 5.7


START_P = np.diag([1e-6, 4.0, 0.01])
NOISE = np.array([0.01, 20.0, 1.0])
R = 1e-7


def braked_edges(model: np.ndarray, on_us: float, off_us: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of the half teeth of a 45-tooth wheel while it is braked, found in a dense solution."""
    a, b, g, _ = model

    def slope(t: float, y: np.ndarray) -> list[float]:
        u = float(on_us * US <= t < off_us * US)
        return [y[1], -a * y[1] - g * y[2], b * (u - y[2])]

    path = solve_ivp(slope, (0.0, 0.3), [0.0, 146.0, 0.0], max_step=1e-3, rtol=1e-9, atol=1e-9)
    angles = np.arange(1, int(path.y[0, -1] / (np.pi / 45))) * np.pi / 45
    return np.interp(angles, path.y[0], path.t) * 1e6, angles


def thesis_memory(x: np.ndarray, model: np.ndarray) -> tuple[RecordMemory, np.ndarray, np.ndarray]:
    """A filter in this state at time 0; and views of its state and covariance."""
    memory = RecordMemory(THESIS_FILTER)
    memory.part("x")[:], memory.part("p")[:] = x, START_P
    memory.part("model")[:], memory.part("w")[:], memory.part("r_rad2")[0] = model, NOISE, R
    return memory, memory.part("x"), memory.part("p")


@pytest.mark.parametrize("a", [0.0, 0.29])
@pytest.mark.parametrize("batch", [1, 7, 1000])
def test_the_filter_is_the_one_of_the_thesis(a: float, batch: int) -> None:
    """Whole run of a braked wheel, with jitter; in batches as frames bring them."""
    model = np.array([a, 16.7, 290.0, 1.0])
    switch_us, switch_u = np.array([40_000.5, 171_234.0]), np.array([1.0, 0.0])
    times, angles = braked_edges(model, *switch_us)
    times = np.round(times + np.random.default_rng(5).normal(0.0, 5.0, times.size))
    memory, x, p = thesis_memory(np.array([0.02, 140.0, 0.1]), model)
    thesis, at_us = Thesis(x.copy(), p.copy(), model), 0.0
    events = [(t, None, u) for t, u in zip(switch_us, switch_u, strict=True)]
    events += [(t, y, None) for t, y in zip(times, angles, strict=True)]
    u_now = 0.0
    for time_us, y, u in sorted(events, key=lambda event: event[0]):
        thesis.predict((time_us - at_us) * US, u_now, NOISE)
        at_us = time_us
        if y is None:
            u_now = u
        else:
            thesis.update(y, R)

    switches = np.array((switch_us, switch_u))
    for start in range(0, times.size, batch):
        cut = slice(start, start + batch)
        thesis_filter(memory.flat, times[cut], angles[cut], switches)
        assert np.allclose(p, p.T, rtol=1e-12, atol=0.0)
        assert np.linalg.eigvalsh(p).min() > -1e-12 * np.trace(p)
    assert memory.part("time_us")[0] == times[-1]
    assert np.allclose(x, thesis.x.ravel(), rtol=1e-8, atol=1e-8)
    assert np.allclose(p, thesis.p, rtol=1e-6, atol=1e-12)
    assert abs(x[1] - np.gradient(angles, times * US)[-5]) < 5.0


def test_an_edge_is_used_once() -> None:
    """Edges that came with an earlier frame again change nothing."""
    model, none = np.array([0.3, 16.7, 290.0, 1.0]), np.empty((2, 0))
    times, angles = np.array([1000.0, 2000.0, 3000.0]), np.array([0.14, 0.28, 0.42])
    memory, x, _ = thesis_memory(np.array([0.0, 140.0, 0.0]), model)
    thesis_filter(memory.flat, times, angles, none)
    assert memory.part("time_us")[0] == times[-1]
    assert x[0] != 0.0
    before = memory.flat.copy()
    thesis_filter(memory.flat, times, angles, none)
    assert np.array_equal(memory.flat, before)


def test_the_cruise_filter_is_a_kalman_filter_with_random_acceleration() -> None:
    """Joseph's form in plain NumPy, noise of an acceleration held over each interval."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(800.0, 1200.0, 60)).round()
    angles = np.arange(1, 61) * np.pi / 45
    memory = RecordMemory(CRUISE_FILTER)
    memory.part("acceleration_rad_s2")[0], memory.part("edge_time_s")[0] = 30.0, 1e-6
    x, p = memory.part("x"), memory.part("p")
    x[:], p[:] = np.array([0.0, 70.0]), np.diag([1e-4, 9.0])
    x_np, p_np, at = x.copy().reshape(2, 1), p.copy(), 0.0
    for time_us, y in zip(times, angles, strict=True):
        dt = (time_us - at) * US
        f, q = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[dt * dt / 2.0], [dt]]) * 30.0
        x_np, p_np = f @ x_np, f @ p_np @ f.T + q @ q.T
        r = (x_np[1, 0] * 1e-6) ** 2 + 1e-12
        gain = p_np[:, :1] / (p_np[0, 0] + r)
        x_np = x_np + gain * (y - x_np[0, 0])
        keep = np.eye(2) - gain @ np.array([[1.0, 0.0]])
        p_np = keep @ p_np @ keep.T + gain @ gain.T * r
        at = time_us
    cruise_filter(memory.flat, times, angles)
    assert memory.part("time_us")[0] == times[-1]
    assert np.allclose(x, x_np.ravel(), rtol=1e-10)
    assert np.allclose(p, p_np, rtol=1e-5, atol=1e-14)


RUN = """
from meshpoint.bus.light_can import load_can
load_can()
import json, numpy as np
from meshpoint.controller.models.backlash import (
    ROWS, SPEED, STIFF, TYRE_STIFF, LashModel, move,
)
from meshpoint.controller.models.thesis import CRUISE_FILTER, THESIS_FILTER
from meshpoint.controller.models.thesis import cruise_filter, propagate, thesis_filter
from meshpoint.kernels.records import RecordMemory
rng = np.random.default_rng(11)
times = np.cumsum(rng.uniform(300.0, 900.0, 200)).round()
angles = np.arange(1, 201) * np.pi / 45
model = np.array([0.29, 16.7, 290.0 / 8e5, 8e5])
switches = np.array([[20000.0, 70000.0], [1.0, 0.0]])
thesis = RecordMemory(THESIS_FILTER)
thesis.part("x")[:], thesis.part("p")[:] = [0.0, 120.0, 0.0], np.diag([1e-6, 4.0, 4e8])
thesis.part("model")[:], thesis.part("w")[:] = model, [0.01, 20.0, 1e5]
thesis.part("r_rad2")[0] = 1e-7
thesis_filter(thesis.flat, times, angles, switches)
x, t = thesis.part("x").copy(), thesis.part("time_us")[0]
propagate(x, t, t + 90000.0, switches, model)
cruise = RecordMemory(CRUISE_FILTER)
cruise.part("x")[:], cruise.part("p")[:] = [0.0, 120.0], np.eye(2)
cruise.part("acceleration_rad_s2")[0], cruise.part("edge_time_s")[0] = 30.0, 1e-6
cruise_filter(cruise.flat, times, angles)
crowd = np.linspace(0.01, 0.2, 3 * ROWS).reshape(ROWS, 3)
crowd[STIFF], crowd[TYRE_STIFF] = 4800.0, 5500.0
crowd[SPEED] = [2.0, -2.0, 0.5]
move(crowd, 30e-3, LashModel(0.25, 4.0, 17.0))
print(json.dumps([*x, *thesis.flat, *cruise.flat, *crowd.flat]))
"""


def test_compiled_and_plain_python_agree() -> None:
    """One code, two ways to run it: an error of the compiler or a type that wraps would show."""

    def run(disabled: str) -> np.ndarray:
        environment = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        root = Path(__file__).parents[2]
        command = [sys.executable, "-c", RUN]
        done = subprocess.run(command, env=environment, cwd=root, capture_output=True, check=True)
        return np.array(json.loads(done.stdout))

    assert np.allclose(run("0"), run("1"), rtol=1e-9, atol=1e-12)


def test_no_kernel_reads_a_record_whose_memory_has_been_given_back() -> None:
    # A record does not keep the array alive that it lies in: numba gives back an array that is not
    # named again, and the next one made overwrites the record. `new_record` lasts for the call.
    made = re.compile(r"(zeros|empty|ones|copy)\([^\n]*\)\.view\(")
    kernels = sorted(Path(jit.__file__).parent.rglob("*.py"))
    kernels.remove(Path(jit.__file__))  # without numba nothing is given back
    assert len(kernels) > 5
    found = [f"{path.name}: {line}" for path in kernels for line in path.read_text().splitlines()
             if made.search(line)]  # fmt: skip
    assert not found
