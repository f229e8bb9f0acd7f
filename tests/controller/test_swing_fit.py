"""What a ramp says of shafts and vehicle: a row of frequencies, each fitted by NumPy's least
squares to integrals by quadrature, weighed by Bayes' rule."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.shift.swing_fit import (
    CORRELATED,
    FREQUENCIES,
    LEAST_SPEED_SD,
    REACH_SD,
    EngineTrajectory,
    Known,
    fit_swing,
)

ENGINE, RATIO = 400.0, 2.5
KNOWN = Known(16_000.0, 0.17, 1.0 / 900.0, 3e-4)


def trajectory(error: float, seed: int = 7) -> EngineTrajectory:
    """Steps of time and torque that are not even; speeds off by as much beside a swing."""
    rng = np.random.default_rng(seed)
    time_s = 3.0 + np.cumsum(rng.uniform(8e-3, 12e-3, 40))
    torque = 900.0 + np.cumsum(rng.normal(0.0, 120.0, 40))
    swing = 0.2 * np.sin(7.0 * time_s) + rng.normal(0.0, error, 40)
    return EngineTrajectory(time_s, 11.0 + 0.3 * (time_s - 3.0) + swing, torque)


def fits(seen: EngineTrajectory, omegas: np.ndarray, sd: float) -> np.ndarray:
    """Deviance, acceleration, y = 1 / (J1 + J2) and its deviation for each frequency, what is known
    of the vehicle as one more equation. Between two measurements a torque beyond the first acts as
    one impulse in their middle: its integral, and that of it times cos w(t - s)."""
    t, pull = seen.time_s - seen.time_s[0], seen.torque_nm - seen.torque_nm[0]
    impulse, middle = 0.5 * (pull[1:] + pull[:-1]) * np.diff(t), 0.5 * (t[1:] + t[:-1])
    before = middle < t[:, np.newaxis]
    vehicle = 1.0 / KNOWN.vehicle_inverse
    y_sd = KNOWN.vehicle_sd * (vehicle / (ENGINE + vehicle)) ** 2
    found = []
    for omega in omegas.tolist():
        turned = before @ impulse
        swung = (before * np.cos(omega * (t[:, np.newaxis] - middle))) @ impulse
        rows = np.column_stack(
            (np.ones_like(t), t, np.cos(omega * t), np.sin(omega * t), turned - swung)
        )
        wanted = seen.omega_rad_s - seen.omega_rad_s[0] - swung / ENGINE
        rows = np.vstack((rows / sd, [0.0, 0.0, 0.0, 0.0, 1.0 / y_sd]))
        right = np.append(wanted / sd, 1.0 / (ENGINE + vehicle) / y_sd)
        solution, (squares,), _, _ = np.linalg.lstsq(rows, right, rcond=None)
        spread = np.linalg.inv(rows.T @ rows)[4, 4] ** 0.5
        found.append((squares, solution[1], solution[4], spread))
    return np.array(found).T


@pytest.mark.parametrize("error", [0.01, 0.1, 0.4])
def test_frequencies_weigh_by_how_well_they_explain_the_speeds(error: float) -> None:
    """Of w^2 = k (1 / J1 + 1 / J2), two deviations to either side. Errors are as large as the best
    fit says and last for four measurements. The stiffness is what was known of it and what was
    seen, each by its weight."""
    seen = trajectory(error)
    inverse = 1.0 / ENGINE + KNOWN.vehicle_inverse
    reach = REACH_SD * math.hypot(KNOWN.stiffness_sd, KNOWN.vehicle_sd / inverse)
    logs = np.linspace(-reach, reach, FREQUENCIES)
    omegas = np.sqrt(KNOWN.stiffness_nm_rad * inverse * np.exp(logs))
    sd = LEAST_SPEED_SD / RATIO
    least = fits(seen, omegas, sd)[0].min()
    sd *= math.sqrt(CORRELATED * max(1.0, least / seen.time_s.size))
    deviances, accelerations, ys, y_sds = fits(seen, omegas, sd)
    weights = np.exp(-0.5 * (deviances - deviances.min()))
    weights /= weights.sum()
    log, y = weights @ logs, weights @ ys
    within = (logs[1] - logs[0]) ** 2 / 12.0
    vehicle = 1.0 / y - ENGINE
    vehicle_sd = min(weights @ y_sds * (1.0 / y / vehicle) ** 2, KNOWN.vehicle_sd)
    after = 1.0 / ENGINE + 1.0 / vehicle
    seen_variance = weights @ (logs - log) ** 2 + within + (vehicle_sd / after) ** 2
    both = np.array((KNOWN.stiffness_sd**-2, 1.0 / seen_variance))
    stiff_log = (log + math.log(inverse / after)) * both[1] / both.sum()
    found = fit_swing(seen, RATIO, ENGINE, KNOWN)
    assert found.acceleration_rad_s2 == pytest.approx(weights @ accelerations, rel=1e-5)
    assert found.known == pytest.approx(
        (KNOWN.stiffness_nm_rad * math.exp(stiff_log), both.sum() ** -0.5, 1.0 / vehicle,
         vehicle_sd), rel=1e-5,
    )  # fmt: skip
