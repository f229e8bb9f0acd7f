"""The law of a sleeve against SciPy's integrator and equations of its own, written from the
sources: ISO 6358 for the valves, a polytropic chamber, Coulomb and viscous friction."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from meshpoint.controller.sleeve.cylinder import (
    DAMPING,
    DEAD,
    DETENT,
    FEED,
    FRICTION,
    IN_GEAR,
    LAW,
    PARAMETERS,
    TO_LEVEL,
    TO_TURN,
    VENT,
)
from meshpoint.controller.sleeve.driven import DrivenSleeve, Switch
from meshpoint.controller.sleeve.law import SleeveLaw
from meshpoint.gearbox import load_sheet

Vector = NDArray[np.float64]
SHEET = load_sheet("truck12")
LAW_OF_SHEET = SleeveLaw(SHEET)
SUPPLY_PA = LAW_OF_SHEET.sheet_pa
STATIC = 1.25
GAS = 1.2 * 287.05 * 293.15 * 1.185


class Equations:
    """One sleeve, with what was learned of it, as equations of motion."""

    def __init__(self, learned: Vector) -> None:
        sheet = {name: LAW_OF_SHEET.sheet.view(LAW)[name][0] for name in LAW.names or ()}
        self.area, self.mass, self.stroke = sheet["area_m2"], sheet["mass_kg"], sheet["stroke_m"]
        self.width = sheet["detent_m"]
        self.air, self.supply = sheet["atmosphere_pa"], sheet["atmosphere_pa"] + SUPPLY_PA
        self.friction = sheet["friction_n"] * math.exp(learned[FRICTION])
        self.damping = sheet["damping_nsm"] * math.exp(learned[DAMPING])
        self.dead = sheet["dead_m3"] * math.exp(learned[DEAD])
        self.vent = sheet["vent"] * math.exp(learned[VENT])
        self.detent, self.in_gear = 1e3 * learned[DETENT], 1e3 * learned[IN_GEAR]
        swept = self.area * self.stroke
        larger = (self.dead + swept) / (sheet["dead_m3"] + swept)
        self.feed = sheet["feed"] * larger * np.exp(learned[FEED : FEED + 2])

    def flow(self, c: float, from_pa: float, to_pa: float) -> float:
        """ISO 6358, critical ratio 0.3; linear near equal pressures."""
        if to_pa >= from_pa:
            return 0.0 if to_pa == from_pa else -self.flow(c, to_pa, from_pa)
        ratio = to_pa / from_pa
        if ratio > 0.99:
            at_edge = math.sqrt(1.0 - (0.69 / 0.7) ** 2)
            return c * from_pa * at_edge * (1.0 - ratio) / 0.01
        return c * from_pa * math.sqrt(1.0 - (max(ratio - 0.3, 0.0) / 0.7) ** 2)

    def push_n(self, y: Vector) -> float:
        """What pushes it towards +x, without friction."""
        x, left = y[0], self.stroke - abs(y[0])
        push = (y[2] - y[3]) * self.area
        if abs(x) < self.width:
            push -= self.detent * math.sin(math.pi * x / self.width)
        elif left < self.width:
            push += math.copysign(self.in_gear, x) * math.sin(math.pi * left / self.width)
        return float(push)

    def rates(self, y: Vector, open_: tuple[bool, bool], moves: bool) -> list[float]:
        """Rates of place, speed and both pressures."""
        x, v = y[0], y[1] if moves else 0.0
        grown = []
        for k, side in ((0, 1.0), (1, -1.0)):
            c = self.feed[k] if open_[k] else self.feed[k] * self.vent
            flow = self.flow(c, self.supply if open_[k] else self.air, y[2 + k])
            volume = self.dead + self.area * (self.stroke + side * x)
            grown.append((GAS * flow - 1.2 * y[2 + k] * self.area * side * v) / volume)
        side = math.copysign(1.0, v or self.push_n(y))
        pushed = self.push_n(y) - side * self.friction - self.damping * v
        return [v, pushed / self.mass if moves else 0.0, *grown]

    def moves(self, spools: list[tuple[float, int, bool]], until_s: float, level_m: float) -> float:
        """Time at which it comes by the level, or where it first stops (m) if it does not."""
        y = np.array([0.0, 0.0, self.air, self.air])
        open_, moves = [False, False], False
        for (t, valve, on), (end, *_) in pairwise([*spools, (until_s, 0, False)]):
            open_[valve] = on
            is_open = (open_[0], open_[1])
            while t < end:
                events = [lambda _t, z: z[0] - level_m]
                if moves:
                    events.append(lambda _t, z: z[1])
                else:
                    events.append(lambda _t, z: abs(self.push_n(z)) - STATIC * self.friction)
                for event in events:
                    event.terminal = True  # type: ignore[attr-defined]
                events[1].direction = -1.0 if moves else 1.0  # type: ignore[attr-defined]
                found = solve_ivp(
                    lambda _t, z, go=moves: self.rates(z, is_open, go),  # noqa: B023
                    (t, end), y, "LSODA", events=events, rtol=1e-9, atol=1e-9, max_step=1e-3,
                )  # fmt: skip
                t, y = found.t[-1], found.y[:, -1]
                if found.t_events[0].size:
                    return float(t)
                if found.t_events[1].size:
                    if moves:
                        return float(y[0])
                    moves, y[1] = True, 1e-9
        raise AssertionError("neither the level nor a stop")


def learned(seed: int) -> Vector:
    """A sleeve within the data sheet."""
    rng, prior = np.random.default_rng(seed), LAW_OF_SHEET.prior(SHEET)
    found = prior.mean + np.linalg.cholesky(prior.covariance) @ rng.standard_normal(PARAMETERS)
    found[0:4] = 0.0
    return np.asarray(found)


def carried(one: Vector, switches: list[Switch], ending: int, level_m: float) -> tuple[float, ...]:
    """When it comes by the level (s), and the furthest that it gets (m)."""
    sleeve = DrivenSleeve(LAW_OF_SHEET, LAW_OF_SHEET.prior(SHEET))
    sleeve.supply_pa = SUPPLY_PA
    rows = np.hstack([one, np.zeros(len(switches))])[np.newaxis]
    found = sleeve.ways(rows, switches, ending=ending, until_us=300_000.0, level_m=level_m)
    return float(found.of("crossed_s")[0]), float(found.of("furthest_m")[0])


@pytest.mark.parametrize("seed", range(8))
def test_a_stroke_meets_the_teeth_when_its_equations_say(seed: int) -> None:
    one = learned(seed)
    expected_s = Equations(one).moves([(0.0, 0, True)], 0.3, LAW_OF_SHEET.face_m)
    found_s, _ = carried(one, [Switch(0, 0, True)], TO_LEVEL, LAW_OF_SHEET.face_m)
    assert found_s == pytest.approx(expected_s, abs=20e-6)


@pytest.mark.parametrize("seed", range(8))
def test_a_stroke_that_is_stopped_gets_as_far_as_its_equations_say(seed: int) -> None:
    one = learned(seed)
    meets_s = Equations(one).moves([(0.0, 0, True)], 0.3, LAW_OF_SHEET.face_m)
    at_s = round(0.6 * meets_s, 4)
    spools = [(0.0, 0, True), (at_s, 0, False), (at_s, 1, True)]
    expected_m = Equations(one).moves(spools, 0.3, 1.0)
    at_us = round(1e6 * at_s)
    fired = [Switch(0, 0, True), Switch(at_us, 0, False), Switch(at_us, 1, True)]
    _, found_m = carried(one, fired, TO_TURN, LAW_OF_SHEET.stroke_m)
    assert found_m == pytest.approx(expected_m, abs=5e-6)
