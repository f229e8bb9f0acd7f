"""The engine's torque is taken away so that the driveline is at rest as the plates part: against
equations written down here once more and solved by SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from meshpoint.controller.motion.twist import (
    CREEP,
    ENGINE,
    ONE,
    SLIP,
    STATES,
    TWIST,
    TYRE,
    Twist,
    TwistFigures,
)
from meshpoint.controller.shift.unloading import unload
from meshpoint.kernels.records import Vector

STEP_S, LEAST = 0.01, 6
FIRST = TwistFigures(
    ratio=11.7, geared_kgm2=470.0, released_kgm2=0.55, constant_nm=-60.0, shaft_nm_rad=16e3,
    shaft_nms=10.0, wheels_kgm2=16.0, tyre_nm_rad=89e3, tyre_nms=60.0, fading=8.0,
    vehicle_inverse=1.0 / 900.0, hill_rad_s2=-0.3, lag_s=0.08,
)  # fmt: skip
TENTH = FIRST._replace(ratio=1.27, geared_kgm2=6.4, released_kgm2=0.75, fading=32.0)
GEARS = pytest.mark.parametrize("gear", [FIRST, TENTH])


def rates(f: TwistFigures, y: Vector, asked_nm: float) -> list[float]:
    """Of w_G, v, w_A, y, w_V and M."""
    gear, twist, wheels, tyre, vehicle, engine_nm = y
    shafts = f.shaft_nm_rad * twist + f.shaft_nms * (gear - wheels)
    held = 1.0 + f.fading * f.tyre_nms / f.tyre_nm_rad
    twisting = (wheels - vehicle - f.fading * tyre) / held
    traction = f.tyre_nm_rad * tyre + f.tyre_nms * twisting
    return [
        (f.ratio * engine_nm + f.constant_nm - shafts) / f.geared_kgm2,
        gear - wheels,
        (shafts - traction) / f.wheels_kgm2,
        twisting,
        traction * f.vehicle_inverse + f.hill_rad_s2,
        (asked_nm - engine_nm) / f.lag_s,
    ]


def run(f: TwistFigures, y: Vector, asked_nm: float, seconds: float) -> Vector:
    solved = solve_ivp(
        lambda _, at: rates(f, at, asked_nm), (0.0, seconds), y, rtol=1e-9, atol=1e-11
    )
    return np.asarray(solved.y[:, -1])


def state_of(y: Vector) -> Vector:
    gear, twist, wheels, tyre, vehicle, engine_nm = y
    state = np.zeros(STATES)
    state[[SLIP, TWIST, CREEP, TYRE, ENGINE, ONE]] = (
        gear - wheels, twist, wheels - vehicle, tyre, engine_nm, 1.0
    )  # fmt: skip
    return state


def pulling(f: TwistFigures, engine_nm: float) -> Vector:
    """The driveline after the engine has pulled with this torque for two minutes."""
    return run(f, np.array((10.0, 0.0, 10.0, 0.0, 10.0, engine_nm)), engine_nm, 120.0)


def unloaded(f: TwistFigures, y: Vector, off: float = 1.0) -> tuple[float, float, list[float]]:
    """How long the ramp took (s), what the shafts carried as the plates parted (Nm), and what was
    asked for. off: by this factor the shafts are stiffer than the plan takes them for."""
    own_nm, before, asked = float(y[-1]), None, []
    told = f._replace(shaft_nm_rad=f.shaft_nm_rad / off)
    steps = LEAST + 1
    while steps > LEAST and len(asked) < 300:
        at = state_of(y)
        at[TWIST] *= off  # the torque is what was measured
        plan = unload(Twist(told, at), own_nm, STEP_S, LEAST, before)
        assert plan is not None
        before = steps = plan.steps
        asked.append(plan.torque_nm)
        y = run(f, y, plan.torque_nm, STEP_S)
    begun_s = STEP_S * len(asked)
    for least in range(LEAST - 1, 0, -1):
        at = state_of(y)
        at[TWIST] *= off
        plan = unload(Twist(told, at), own_nm, STEP_S, least, least)
        assert plan is not None
        asked.append(plan.torque_nm)
        y = run(f, y, plan.torque_nm, STEP_S)
    return begun_s, float(f.shaft_nm_rad * y[1]), asked


@GEARS
def test_a_driveline_on_its_flank_moves_as_its_equations_say(gear: TwistFigures) -> None:
    y = np.array((10.1, 0.05, 10.0, 0.007, 9.97, 450.0))
    moved = Twist(gear, state_of(y)).within(0.03) @ np.array((*state_of(y), -80.0))
    expected = state_of(run(gear, y, -80.0, 0.03))
    assert moved == pytest.approx(np.array((*expected, -80.0)), rel=1e-6, abs=1e-8)


@GEARS
def test_coasting_along_the_shafts_carry_nothing(gear: TwistFigures) -> None:
    """Once engine and vehicle have been left to it for two minutes."""
    coasting_nm = Twist(gear, np.zeros(STATES)).coasting_nm
    y = pulling(gear, coasting_nm)
    assert gear.shaft_nm_rad * y[1] == pytest.approx(0.0, abs=1e-3)
    vehicle_rad_s2 = rates(gear, y, coasting_nm)[4]
    assert rates(gear, y, coasting_nm)[0] == pytest.approx(vehicle_rad_s2, rel=1e-6)


@GEARS
@pytest.mark.parametrize("engine_nm", [300.0, -120.0])
def test_the_shafts_are_at_rest_as_the_plates_part(gear: TwistFigures, engine_nm: float) -> None:
    """Or nearly: some 50 Nm are left where to wait for less costs more. It takes less than half of
    a swing's time."""
    y = pulling(gear, engine_nm)
    loaded_nm = gear.shaft_nm_rad * y[1]
    took_s, left_nm, asked = unloaded(gear, y)
    half_s = math.pi / math.sqrt(gear.shaft_nm_rad * (1.0 / gear.geared_kgm2 + 1.0 / 900.0))
    assert abs(left_nm) < max(0.05 * abs(loaded_nm), 50.0)
    assert took_s + LEAST * STEP_S < half_s + 3.0 * gear.lag_s
    coasting_nm = Twist(gear, np.zeros(STATES)).coasting_nm
    low, high = sorted((engine_nm, coasting_nm))
    assert all(low - 1e-3 <= torque_nm <= high + 1e-3 for torque_nm in asked)


@GEARS
@pytest.mark.parametrize("off", [0.8, 1.25])
def test_a_stiffness_that_is_a_quarter_off_is_made_up_for(gear: TwistFigures, off: float) -> None:
    y = pulling(gear, 300.0)
    loaded_nm = gear.shaft_nm_rad * y[1]
    _, left_nm, _ = unloaded(gear, y, off)
    assert abs(left_nm) < max(0.12 * loaded_nm, 60.0)


@GEARS
def test_a_driveline_at_rest_is_parted_at_once(gear: TwistFigures) -> None:
    coasting_nm = Twist(gear, np.zeros(STATES)).coasting_nm
    took_s, left_nm, _ = unloaded(gear, pulling(gear, coasting_nm))
    assert took_s == STEP_S
    assert abs(left_nm) < 1.0


@settings(max_examples=60, deadline=None)
@given(
    twist=st.floats(-0.3, 0.3), slip=st.floats(-3.0, 3.0), engine_nm=st.floats(-300.0, 2500.0),
    own_nm=st.floats(-300.0, 2500.0), least=st.integers(1, 12),
)  # fmt: skip
def test_whatever_the_state_nothing_beyond_its_bounds_is_asked_for(
    twist: float, slip: float, engine_nm: float, own_nm: float, least: int
) -> None:
    state = np.array((slip, twist, 0.0, 0.0, engine_nm, 1.0))
    driveline = Twist(FIRST, state)
    plan = unload(driveline, own_nm, STEP_S, least, None)
    assert plan is not None
    low, high = sorted((own_nm, driveline.coasting_nm))
    assert low - 1e-3 <= plan.torque_nm <= high + 1e-3
    assert plan.steps >= least


@pytest.mark.parametrize("row", [SLIP, TWIST, TYRE, ENGINE])
@pytest.mark.parametrize("wild", [math.nan, math.inf, -1e300, 1e30])
def test_a_driveline_that_cannot_be_has_no_plan(row: int, wild: float) -> None:
    state = np.array((0.0, 0.0, 0.0, 0.0, 100.0, 1.0))
    state[row] = wild
    with np.errstate(all="ignore"):
        assert unload(Twist(FIRST, state), 100.0, STEP_S, LEAST, None) is None
