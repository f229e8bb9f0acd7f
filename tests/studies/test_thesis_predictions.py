"""Three ways of thesis 5.4 to tell where the layshaft will be."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.studies.thesis_predictions import predict_euler, predict_hold, predict_linear
from meshpoint.controller.models.layshaft import LayshaftState
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.gearbox import Split, load_sheet

SHEET = load_sheet("thesis")
BRAKED = LayshaftState(1000.0, 2.0, 140.0, 3e5)
NEVER = np.empty((2, 0))
ALWAYS = np.array([[0.0], [1.0]])
HORIZON_US = 46_000.0


def test_the_model_is_that_of_the_data_sheet() -> None:
    """J = J_LS + J_IS / i_split^2 (4.13), a torque of 100 Nm at full pressure (4.4)."""
    a, b, g, supply = layshaft_model(SHEET, Split.HIGH)
    inertia = 0.20 + 0.14 * (36 / 34) ** 2
    assert a == pytest.approx(0.10 / inertia)
    assert b == pytest.approx(1 / 0.060)
    assert g * supply == pytest.approx(100.0 / inertia)
    assert supply == pytest.approx(8e5)
    a_low = layshaft_model(SHEET, Split.LOW)[0]
    assert a_low == pytest.approx(0.10 / (0.20 + 0.14 * (41 / 30) ** 2))


def test_linear_keeps_the_speed() -> None:
    """5.12."""
    state = predict_linear(BRAKED, BRAKED.time_us + HORIZON_US)
    assert state.theta_rad == pytest.approx(2.0 + 140.0 * 0.046, rel=1e-14)
    assert state[2:] == BRAKED[2:]


@pytest.mark.parametrize("u", [0.0, 1.0])
def test_euler_comes_to_the_hold_with_the_step_to_the_first_power(u: float) -> None:
    model = layshaft_model(SHEET, Split.HIGH)
    to_us = BRAKED.time_us + HORIZON_US
    exact = predict_hold(BRAKED, to_us, ALWAYS if u else NEVER, model)

    def error(step_s: float) -> np.ndarray:
        euler = predict_euler(BRAKED, to_us, u, model, step_s)
        return np.array(euler[1:4]) - np.array(exact[1:4])

    ratio = error(1e-4) / error(0.5e-4)
    assert np.allclose(ratio, 2.0, atol=0.03)
    assert abs(error(1e-4)[0]) < 1e-2


def test_one_euler_step_is_the_slope_times_the_step() -> None:
    """5.14, 5.15: x + h (A x + B u)."""
    a, b, g, supply = model = layshaft_model(SHEET, Split.HIGH)
    euler = predict_euler(BRAKED, BRAKED.time_us + 1000.0, 1.0, model, 1.0)
    assert euler.theta_rad == pytest.approx(2.0 + 1e-3 * 140.0)
    assert euler.omega_rad_s == pytest.approx(140.0 - 1e-3 * (a * 140.0 + g * 3e5))
    assert euler.pressure_pa == pytest.approx(3e5 + 1e-3 * b * (supply - 3e5))
