"""A sleeve between two chambers against closed forms, an independent integrator, and its energies.

The five cylinders have a single stroke of 33 ms from the spool by five different means: a narrow
valve, long pipes, both, a detent, wide vents.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from meshpoint.rig_sim.parts.cylinder import HIGH, LOW, RESTS, STILL_PA, STOPS, Cylinder
from meshpoint.rig_sim.truck.axial_motion import AxialMotion, stroke_s

AMBIENT_PA: Final = 1.013e5
SUPPLY_PA: Final = 8.5e5 + AMBIENT_PA
FACE_M, STROKE_M, AREA_M2, MASS_KG = 5e-3, 12e-3, 18e-4, 3.0
POLYTROPIC: Final = 1.2
NORMAL: Final = 287.05 * 293.15 * 1.185
"""Gas constant, temperature and density of ISO 6358's reference air."""


def cylinder(
    fill: float = 4.2e-9, dead_cm3: float = 15.0, detent_n: float = 0.0, vent: float = 1.0,
    friction_n: float = 120.0, damping_nsm: float = 1200.0,
) -> Cylinder:  # fmt: skip
    c = Cylinder()
    c.area_m2, c.dead_m3, c.mass_kg, c.stroke_m = AREA_M2, dead_cm3 * 1e-6, MASS_KG, STROKE_M
    c.a_fill_m3_spa = c.b_fill_m3_spa = fill
    c.a_vent_m3_spa = c.b_vent_m3_spa = vent * fill
    c.sliding_n, c.static_n, c.damping_nsm = friction_n, 1.25 * friction_n, damping_nsm
    c.neutral_n, c.detent_m = detent_n, 2e-3
    c.atmosphere_pa, c.supply_pa = AMBIENT_PA, SUPPLY_PA
    c.low_m, c.high_m = -STROKE_M, STROKE_M
    return c


FIVE: Final = {
    "narrow valve": cylinder(4.20e-9),
    "long pipes": cylinder(2e-8, dead_cm3=179.0),
    "pipes and valve": cylinder(1e-8, dead_cm3=75.0),
    "detent": cylinder(6.24e-9, detent_n=400.0),
    "wide vents": cylinder(4.17e-9, vent=1.5),
}


class Axis:
    """A sleeve's motion with nothing in its way but the ends of its stroke."""

    def __init__(self, c: Cylinder, position_m: float = 0.0) -> None:
        self.motion = AxialMotion(c.copy(), position_m)
        self.now_s = 0.0
        self.most_m = position_m

    def spools(self, a: bool, b: bool, for_s: float) -> Axis:
        """Both as they are from now on; goes on for this long."""
        motion, end_s = self.motion, self.now_s + for_s
        motion.cut(1e6 * self.now_s)
        motion.cylinder.a_on, motion.cylinder.b_on = int(a), int(b)
        motion.run(1e6 * self.now_s)
        while motion.end_us < 1e6 * end_s:
            self.most_m = max(self.most_m, motion.position_m(motion.end_us))
            if motion.code in (HIGH, LOW):
                motion.stop()
                motion.cylinder.walled = 1 if motion.code == HIGH else -1
            motion.run(motion.end_us)
        self.now_s = end_s
        self.most_m = max(self.most_m, self.position_m)
        return self

    @property
    def position_m(self) -> float:
        return self.motion.position_m(1e6 * self.now_s)


def pushed(c: Cylinder, force_n: float) -> AxialMotion:
    """A sleeve under a constant force: chambers so large that no pressure changes."""
    c.dead_m3, c.high_m = 1e6, FACE_M
    motion = AxialMotion(c, 0.0)
    c.y.a_pa += force_n / AREA_M2
    motion.run(0.0)
    motion.run(motion.end_us)
    return motion


def test_a_constant_force_moves_it_by_the_square_of_time() -> None:
    motion = pushed(cylinder(friction_n=100.0, damping_nsm=0.0), 1100.0)
    assert motion.code == HIGH
    assert motion.end_us == pytest.approx(1e6 * math.sqrt(2 * FACE_M * MASS_KG / 1e3), abs=0.01)
    assert motion.position_m(motion.end_us / 2.0) == pytest.approx(FACE_M / 4.0, abs=1e-9)


def test_damping_lets_it_come_to_a_steady_speed() -> None:
    motion = pushed(cylinder(friction_n=0.0, damping_nsm=5000.0), 1000.0)
    t, settle_s, end_m_s = motion.end_us * 1e-6, MASS_KG / 5000.0, 1000.0 / 5000.0
    way_m = end_m_s * (t - settle_s * -math.expm1(-t / settle_s))
    assert way_m == pytest.approx(FACE_M, abs=1e-9)


def test_a_chamber_that_is_closed_by_a_sleeve_that_stands_fills_at_a_constant_rate() -> None:
    """While the flow is choked."""
    c = cylinder(friction_n=1e4)
    axis = Axis(c).spools(True, False, 0.006)
    rate = POLYTROPIC * NORMAL * c.a_fill_m3_spa * SUPPLY_PA / (c.dead_m3 + AREA_M2 * STROKE_M)
    expected_pa = AMBIENT_PA + rate * 0.006
    assert expected_pa < 0.3 * SUPPLY_PA
    assert axis.motion.state(6000.0).a_pa == pytest.approx(expected_pa, rel=1e-9)


def flow(fed_pa: float, chamber_pa: float, conductance: float) -> float:
    """ISO 6358 either way, linear next to equal pressures, once more."""

    def share(ratio: float) -> float:
        if ratio > 0.99:
            edge = (0.99 - 0.3) / 0.7
            return math.sqrt(1.0 - edge**2) * (1.0 - ratio) / 0.01
        return 1.0 if ratio <= 0.3 else math.sqrt(1.0 - ((ratio - 0.3) / 0.7) ** 2)

    if fed_pa >= chamber_pa:
        return NORMAL * conductance * fed_pa * share(chamber_pa / fed_pa)
    return -NORMAL * conductance * chamber_pa * share(fed_pa / chamber_pa)


def independent_s(c: Cylinder) -> tuple[float, float]:
    """Time and speed at contact by `solve_ivp`, standing and moving one after the other."""

    def slope(moves: bool) -> Any:
        def rates(_: float, y: np.ndarray) -> list[float]:
            x, v, p_a, p_b = y.tolist()
            detent_n = -c.neutral_n * math.sin(math.pi * x / 2e-3) if abs(x) < 2e-3 else 0.0
            force_n = (p_a - p_b) * AREA_M2 + detent_n - c.sliding_n - c.damping_nsm * v
            a = flow(SUPPLY_PA, p_a, c.a_fill_m3_spa) - p_a * AREA_M2 * v
            b = flow(AMBIENT_PA, p_b, c.b_vent_m3_spa) + p_b * AREA_M2 * v
            return [
                v if moves else 0.0,
                force_n / MASS_KG if moves else 0.0,
                POLYTROPIC * a / (c.dead_m3 + AREA_M2 * (STROKE_M + x)),
                POLYTROPIC * b / (c.dead_m3 + AREA_M2 * (STROKE_M - x)),
            ]

        return rates

    def breaks(_: float, y: np.ndarray) -> float:
        return float((y[2] - y[3]) * AREA_M2 - c.static_n)

    def contact(_: float, y: np.ndarray) -> float:
        return float(y[0]) - FACE_M

    breaks.terminal = contact.terminal = True  # type: ignore[attr-defined]
    precise = {"rtol": 1e-9, "atol": [1e-12, 1e-9, 1e-3, 1e-3], "max_step": 1e-4}
    begin = [0.0, 0.0, AMBIENT_PA, AMBIENT_PA]
    stood = solve_ivp(slope(False), (0.0, 0.2), begin, events=breaks, **precise)
    moved = solve_ivp(slope(True), (0.0, 0.2), stood.y[:, -1], events=contact, **precise)
    return float(stood.t[-1] + moved.t[-1]), float(moved.y[1, -1])


@pytest.mark.parametrize("name", FIVE)
def test_a_stroke_is_that_of_an_independent_integrator(name: str) -> None:
    expected_s, speed_m_s = independent_s(FIVE[name])
    found_s = stroke_s(FIVE[name], FACE_M)
    assert found_s == pytest.approx(expected_s, abs=10e-6)
    assert found_s == pytest.approx(0.033, abs=0.2e-3)
    axis = Axis(FIVE[name]).spools(True, False, found_s)
    assert axis.motion.state(1e6 * found_s).v_m_s == pytest.approx(speed_m_s, rel=1e-3)


def test_both_sides_are_alike() -> None:
    for c in FIVE.values():
        assert stroke_s(c, -FACE_M) == pytest.approx(stroke_s(c, FACE_M), abs=1e-8)


def test_what_air_and_detent_do_goes_into_motion_friction_and_damping() -> None:
    c = cylinder(6.2e-9, detent_n=400.0)
    times_us = np.arange(0.0, 28e3, 20.0)
    axis = Axis(c).spools(True, False, 0.028)  # once round, to fill what is kept of the way
    axis = Axis(c)
    axis.motion.cylinder.a_on = 1
    states = []
    for time_us in times_us:
        axis.spools(True, False, 1e-6 * time_us - axis.now_s)
        y = axis.motion.state(time_us)
        states.append((y.x_m, y.v_m_s, (y.a_pa - y.b_pa) * AREA_M2))
    x, v, air_n = np.array(states).T
    detent_n = np.where(np.abs(x) < 2e-3, -400.0 * np.sin(np.pi * x / 2e-3), 0.0)
    put_in_j = np.trapezoid(air_n + detent_n, x)
    lost_j = c.sliding_n * x[-1] + c.damping_nsm * np.trapezoid(v**2, 1e-6 * times_us)
    assert x[-1] > 2e-3
    assert put_in_j == pytest.approx(0.5 * MASS_KG * v[-1] ** 2 + lost_j, rel=1e-3)


def test_a_look_or_a_cut_changes_nothing() -> None:
    """A cut at any instant, after which nothing is otherwise."""
    for c in FIVE.values():
        cut = c.copy()
        cut.high_m, cut.a_on = FACE_M, 1
        motion = AxialMotion(cut, 0.0)
        motion.run(0.0)
        for cut_us in (1_234.5, 9_876.5, 20_000.1, 31_415.9):
            while motion.end_us < cut_us:
                motion.run(motion.end_us)
            motion.cut(cut_us)
            motion.run(cut_us)
        while motion.code != HIGH:
            motion.run(motion.end_us)
        assert motion.end_us == pytest.approx(1e6 * stroke_s(c, FACE_M), abs=0.1)


def aborted(c: Cylinder, before_contact_s: float, for_s: float) -> Axis:
    """A stroke that is broken off this long before contact, the opposite spool on for so long."""
    fired_s = stroke_s(c, FACE_M) - before_contact_s
    axis = Axis(c).spools(True, False, fired_s)
    return axis.spools(False, True, for_s).spools(False, False, 0.3)


@pytest.mark.parametrize("name", FIVE)
def test_a_stroke_broken_off_8_5_ms_before_contact_stops_short_and_stands(name: str) -> None:
    """With the opposite spool on for some time from 8 to 13 ms, as its pipes need."""
    tried = [aborted(FIVE[name], 8.5e-3, 1e-3 * for_ms) for for_ms in (8.0, 10.0, 12.0, 13.0)]
    short = [axis for axis in tried if axis.most_m < FACE_M - 0.3e-3]
    assert any(axis.position_m > 3e-3 for axis in short)
    for axis in short:
        assert axis.motion.code == RESTS
        there_m = axis.position_m
        assert axis.spools(False, False, 5.0).position_m == there_m  # friction holds it


@pytest.mark.parametrize("name", FIVE)
def test_4_ms_before_contact_nothing_stops_it_any_more(name: str) -> None:
    assert aborted(FIVE[name], 4e-3, 13e-3).most_m > FACE_M


@pytest.mark.parametrize("name", FIVE)
def test_a_second_stroke_of_a_millimetre_takes_15_to_20_ms_from_the_spool(name: str) -> None:
    c = FIVE[name].copy()
    c.a_on, c.high_m = 1, FACE_M
    motion = AxialMotion(c, FACE_M - 1e-3)
    motion.run(0.0)
    while motion.code not in (HIGH, RESTS):
        motion.run(motion.end_us)
    assert motion.code == HIGH
    assert 15e3 < motion.end_us < 20.5e3


def test_both_chambers_filled_push_it_nowhere() -> None:
    axis = Axis(cylinder()).spools(True, True, 0.5)
    assert axis.position_m == 0.0
    assert axis.motion.state(5e5).a_pa == pytest.approx(SUPPLY_PA, abs=STILL_PA)


def test_a_detent_pulls_back_what_friction_does_not_hold() -> None:
    near = Axis(cylinder(detent_n=600.0), 1e-3).spools(False, False, 0.2)
    assert abs(near.position_m) < 0.3e-3
    far = Axis(cylinder(detent_n=600.0), 2.5e-3).spools(False, False, 0.2)
    assert far.position_m == 2.5e-3


@pytest.mark.check
def test_less_air_more_mass_friction_and_detent_make_it_slower() -> None:
    usual_s = stroke_s(cylinder(), FACE_M)
    for name, factor in (("supply_pa", 0.7), ("mass_kg", 1.5), ("sliding_n", 1.3)):
        c = cylinder()
        setattr(c, name, factor * getattr(c, name))
        assert stroke_s(c, FACE_M) > usual_s + 0.3e-3
    assert stroke_s(cylinder(detent_n=400.0), FACE_M) > usual_s + 2e-3
    assert stroke_s(cylinder(friction_n=5000.0), FACE_M) == math.inf


def test_a_sleeve_at_rest_has_nothing_to_come() -> None:
    axis = Axis(cylinder()).spools(True, False, 0.02).spools(False, False, 1.0)
    assert axis.motion.code == RESTS
    assert axis.motion.end_us == math.inf
    assert axis.motion.rests(1e6 * axis.now_s)


def test_a_stop_is_an_event() -> None:
    axis = Axis(cylinder()).spools(True, False, 0.024)
    axis.motion.cut(24e3)
    axis.motion.cylinder.a_on, axis.motion.cylinder.b_on = 0, 1
    axis.motion.run(24e3)
    assert axis.motion.code == STOPS
    assert axis.motion.state(axis.motion.end_us).v_m_s == pytest.approx(0.0, abs=1e-3)
