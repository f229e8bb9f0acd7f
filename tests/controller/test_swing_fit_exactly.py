"""What a swing tells of shafts and vehicle: the least squares and the integrals by other ways, what
is made of them by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from meshpoint.controller.records import Vector
from meshpoint.controller.shift import swing_fit
from meshpoint.controller.shift.swing_fit import (
    EngineCourse,
    Known,
    SwingFit,
    _answers,
    _scan,
    fit_swing,
)

ENGINE, RATIO = 400.0, 2.5
KNOWN = Known(16_000.0, 0.17, 1.0 / 900.0, 3e-4)
BEFORE = 1.0 / ENGINE + KNOWN.vehicle_inverse


def course(count: int = 40) -> EngineCourse:
    """Steps of time and torque that are not even; seed 7."""
    rng = np.random.default_rng(7)
    time_s = 3.0 + np.cumsum(rng.uniform(8e-3, 12e-3, count))
    torque = 900.0 + np.cumsum(rng.normal(0.0, 120.0, count))
    omega = 11.0 + 0.3 * (time_s - 3.0) + 0.2 * np.sin(7.0 * time_s) + rng.normal(0.0, 0.02, count)
    return EngineCourse(time_s, omega, torque)


OMEGAS = np.array([3.0, 6.5, 9.0])


def torque_integrals(seen: EngineCourse, omega: float, k: int) -> tuple[float, float]:
    """Of the torque beyond the first, and of it times cos w(t - s), up to a look; between two looks
    it acts as one impulse in their middle."""
    t, pull = seen.time_s, seen.torque_nm - seen.torque_nm[0]
    whole = swung = 0.0
    for j in range(k):
        impulse, _ = quad(lambda s, j=j: float(np.interp(s, t, pull)), t[j], t[j + 1], limit=20)
        whole += impulse
        swung += impulse * math.cos(omega * (t[k] - (t[j] + t[j + 1]) / 2.0))
    return whole, swung


def test_a_torque_turns_the_bodies_by_its_impulses_and_makes_them_swing_by_each() -> None:
    seen = course(12)
    at_s = seen.time_s - seen.time_s[0]
    turned = OMEGAS[:, None] * at_s
    pull = seen.torque_nm - seen.torque_nm[0]
    whole, swung = _answers(at_s, pull, OMEGAS, np.cos(turned), np.sin(turned))
    for k in range(12):
        for row, omega in enumerate(OMEGAS.tolist()):
            expected = torque_integrals(seen, omega, k)
            assert whole[k] == pytest.approx(expected[0], rel=1e-9, abs=1e-9)
            assert swung[row, k] == pytest.approx(expected[1], rel=1e-9, abs=1e-9)


def solved(seen: EngineCourse, omega: float, sd: float) -> tuple[float, float, float, float]:
    """The fit for one frequency by numpy's least squares, what is known of the vehicle as one more
    row: 1 / (J1 + J2), known as well as 1 / J2 is. Misfit, acceleration, and y with its sd."""
    t = seen.time_s - seen.time_s[0]
    pairs = [torque_integrals(seen, omega, k) for k in range(len(t))]
    whole, swung = np.array(pairs).T
    rows = np.column_stack(
        (np.ones_like(t), t, np.cos(omega * t), np.sin(omega * t), whole - swung)
    )
    wanted = seen.omega_rad_s - seen.omega_rad_s[0] - swung / ENGINE
    vehicle = 1.0 / KNOWN.vehicle_inverse
    y_sd = KNOWN.vehicle_sd * (vehicle / (ENGINE + vehicle)) ** 2
    all_rows = np.vstack((rows / sd, [0.0, 0.0, 0.0, 0.0, 1.0 / y_sd]))
    right = np.append(wanted / sd, 1.0 / (ENGINE + vehicle) / y_sd)
    found, (squares,), _, _ = np.linalg.lstsq(all_rows, right, rcond=None)
    covariance = np.linalg.inv(all_rows.T @ all_rows)
    return float(squares), float(found[1]), float(found[4]), math.sqrt(covariance[4, 4])


@pytest.mark.parametrize("sd", [0.04, 0.2])
def test_each_frequency_has_its_own_least_squares(sd: float) -> None:
    seen = course()
    misfits, found = _scan(seen, ENGINE, KNOWN, OMEGAS, sd)
    for row, omega in enumerate(OMEGAS.tolist()):
        squares, acceleration, y, y_sd = solved(seen, omega, sd)
        assert misfits[row] == pytest.approx(squares, rel=1e-6)
        assert found[row] == pytest.approx([acceleration, y, y_sd], rel=1e-5)


LOGS = np.linspace(-2.0, 2.0, 25) * math.hypot(0.17, KNOWN.vehicle_sd / BEFORE)
APART = float(LOGS[1] - LOGS[0])


class Laid:
    """Fits that are laid down: misfits, and for each frequency acceleration, y and its sd."""

    def __init__(
        self, misfits: dict[int, float], y: float = 1.0 / 1_300.0, y_sd: float = 1e-5
    ) -> None:
        self.misfits = np.full(25, 1e9)
        for k, misfit in misfits.items():
            self.misfits[k] = misfit
        self.found = np.tile([0.7, y, y_sd], (25, 1))
        self.asked: list[tuple[Any, ...]] = []

    def fit(self, monkeypatch: pytest.MonkeyPatch, known: Known = KNOWN) -> SwingFit:
        def scan(
            seen: EngineCourse, engine: float, known: Known, omegas: Vector, sd: float
        ) -> tuple[Vector, Vector]:
            self.asked.append((seen, engine, known, omegas, sd))
            return swing_fit._Scan(self.misfits, self.found)

        monkeypatch.setattr(swing_fit, "_scan", scan)
        return fit_swing(self.seen, RATIO, ENGINE, known)

    seen = course()


def test_twenty_five_frequencies_are_tried_two_deviations_to_either_side(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of w^2 = k (1 / J1 + 1 / J2), as well as both are known."""
    laid = Laid({12: 0.0})
    laid.fit(monkeypatch)
    for seen, engine, known, omegas, _ in laid.asked:
        assert (seen is laid.seen, engine, known) == (True, ENGINE, KNOWN)
        assert omegas**2 == pytest.approx(16_000.0 * BEFORE * np.exp(LOGS))


@pytest.mark.parametrize(("least", "larger"), [(0.0, 2.0), (40.0, 2.0), (90.0, 3.0), (360.0, 6.0)])
def test_errors_last_for_four_looks_and_are_as_large_as_the_best_fit_says(
    least: float, larger: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not smaller than 0.1 rad/s of the engine, of 40 looks."""
    laid = Laid({3: least, 4: least + 5.0})
    laid.fit(monkeypatch)
    first, second = (each[-1] for each in laid.asked)
    assert first == pytest.approx(0.1 / RATIO)
    assert second == pytest.approx(larger * 0.1 / RATIO)


def stiffness(found: SwingFit) -> tuple[float, float]:
    return found.known.stiffness_nm_rad, found.known.stiffness_sd


def by_bayes(log_seen: float, seen_sd: float) -> tuple[float, float]:
    """The logarithm of the stiffness, known before and seen, each by its weight."""
    weight, seen = 0.17**-2, seen_sd**-2
    mean = log_seen * seen / (weight + seen)
    return 16_000.0 * math.exp(mean), (weight + seen) ** -0.5


@pytest.mark.parametrize("k", [0, 7, 12, 24])
def test_a_frequency_that_explains_all_tells_the_stiffness(
    k: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As well as frequencies are apart, and as the vehicle is known: 1 / J2 = y / (1 - J1 y)."""
    found = Laid({k: 2.0}).fit(monkeypatch)
    vehicle = 1_300.0 - ENGINE
    vehicle_sd = 1e-5 * (1_300.0 / vehicle) ** 2
    assert found.acceleration_rad_s2 == pytest.approx(0.7)
    assert found.known.vehicle_inverse == pytest.approx(1.0 / vehicle)
    assert found.known.vehicle_sd == pytest.approx(vehicle_sd)
    after = 1.0 / ENGINE + 1.0 / vehicle
    seen_sd = math.hypot(APART / math.sqrt(12.0), vehicle_sd / after)
    assert stiffness(found) == pytest.approx(by_bayes(LOGS[k] + math.log(BEFORE / after), seen_sd))


@pytest.mark.parametrize("worse", [0.0, 1.0, 4.0])
def test_frequencies_weigh_by_how_well_they_explain_the_speeds(
    worse: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """exp(-misfit / 2); what is found is their mean, and its variance is between and within."""
    laid = Laid({5: 3.0, 9: 3.0 + worse}, y=1.0 / (ENGINE + 900.0), y_sd=0.0)
    laid.found[9, 0] = 0.9
    found = laid.fit(monkeypatch)
    share = math.exp(-worse / 2.0) / (1.0 + math.exp(-worse / 2.0))
    log = (1.0 - share) * LOGS[5] + share * LOGS[9]
    variance = share * (1.0 - share) * (4.0 * APART) ** 2 + APART**2 / 12.0
    assert found.acceleration_rad_s2 == pytest.approx(0.7 + 0.2 * share)
    assert stiffness(found) == pytest.approx(by_bayes(log, math.sqrt(variance)))


@pytest.mark.parametrize(
    ("y", "kept"), [(-1.0, 0.01), (0.009, 0.01), (0.011, 0.011), (0.98, 0.98), (2.0, 0.99)]
)
def test_no_vehicle_is_so_heavy_or_light_that_nothing_could_be_said_of_it(
    y: float, kept: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """J1 / (J1 + J2) between a hundredth and 99 of them."""
    found = Laid({12: 0.0}, y=y / ENGINE).fit(monkeypatch)
    assert found.known.vehicle_inverse == pytest.approx(kept / (1.0 - kept) / ENGINE)


def test_speeds_that_no_frequency_explains_weigh_each_by_what_sets_it_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However large all misfits are."""
    found = Laid({7: 5_000.0}).fit(monkeypatch)
    assert found == Laid({7: 0.0}).fit(monkeypatch)


def test_a_vehicle_is_never_known_worse_than_before(monkeypatch: pytest.MonkeyPatch) -> None:
    found = Laid({12: 0.0}, y_sd=1.0).fit(monkeypatch)
    assert found.known.vehicle_sd == KNOWN.vehicle_sd
