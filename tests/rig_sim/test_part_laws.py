"""Every law of a part against a closed form or an independent integrator, with its sign.

The expected values come from the equations in each part's docstring, written down here once more,
never from the part itself.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from meshpoint.kernels.structures import Record, RecordArray
from meshpoint.rig_sim.parts.brake_disc import DiscBrake, brake_nm, friction_share, heating_k_s
from meshpoint.rig_sim.parts.drag import drag_nm, thickening
from meshpoint.rig_sim.parts.engine import (
    IDLE,
    SPEED_CONTROL,
    TORQUE_CONTROL,
    ClutchPlates,
    EngineLimits,
    capacity_nm,
    demand_nm,
    torque_nm_s,
)
from meshpoint.rig_sim.parts.lash import Backlash, lash_rad_s
from meshpoint.rig_sim.parts.pneumatics import (
    BrakeAir,
    chamber_pa_s,
    choked_rate,
    flow_share,
    tank_pa_s,
)
from meshpoint.rig_sim.parts.vehicle import RoadLoad, resistance_n

speeds = st.floats(-300.0, 300.0)
AMBIENT_PA = 1.013e5
SUPPLY_PA = 9.5e5


def seen(record: Record) -> Any:
    """The record as compiled parts take it."""
    return RecordArray(record).array[0]


DISC = seen(
    DiscBrake(
        gain_nm_pa=2e-4,
        touch_pa=0.4e5,
        fade_per_k=0.0025,
        fade_per_rad_s=0.001,
        reference_k=313.15,
        reference_rad_s=100.0,
        heat_j_k=1200.0,
        cooling_w_k=15.0,
    )
)
AIR = seen(
    BrakeAir(
        model=1.0,
        rate=1.0 / 0.06,
        fill=choked_rate(2e-8, 0.2e-3, 1.0),
        exhaust=choked_rate(3e-8, 0.2e-3, 1.0),
        critical=0.3,
        atmosphere_pa=AMBIENT_PA,
        droop=0.01,
        recovery=0.5,
    )
)
ENGINE = seen(
    EngineLimits(
        lag_rate=1.0 / 0.08,
        limit_nm_s=8000.0,
        least_nm=-300.0,
        most_nm=2500.0,
        governor_nms=40.0,
        idle_rad_s=60.0,
    )
)
ROAD = seen(RoadLoad(wheel_m=0.2, rolling_n=1500.0, grade_n=-4000.0, air_ns2_m2=3.6))


def flow(upstream_pa: float, downstream_pa: float, critical: float) -> float:
    """ISO 6358 once more, without the linear part next to equal pressures."""
    ratio = min(downstream_pa / upstream_pa, 1.0)
    return 1.0 if ratio <= critical else math.sqrt(1.0 - ((ratio - critical) / (1 - critical)) ** 2)


@given(omega_rad_s=speeds.filter(lambda w: abs(w) > 2.0))
def test_drag_opposes_rotation_in_either_direction(omega_rad_s: float) -> None:
    torque_nm = drag_nm(omega_rad_s, 3.0, 0.02)  # subtracted from the shaft's torques
    assert torque_nm == pytest.approx(math.copysign(3.0, omega_rad_s) + 0.02 * omega_rad_s)
    assert torque_nm * omega_rad_s > 0.0


def test_drag_ends_at_rest_and_thickens_as_oil_gets_cold() -> None:
    assert drag_nm(0.0, 3.0, 0.02) == 0.0
    assert thickening(353.15, 0.03) == 1.0
    assert thickening(313.15, 0.03) == pytest.approx(math.exp(1.2))
    assert thickening(373.15, 0.03) < 1.0


def test_a_brake_grips_beyond_the_touch_pressure_and_pushes_nowhere_before_it() -> None:
    assert brake_nm(6e5, 1.0, DISC) == pytest.approx(2e-4 * 5.6e5)
    assert brake_nm(0.4e5, 1.0, DISC) == 0.0
    assert brake_nm(-0.2e5, 1.0, DISC) == 0.0


@given(omega_rad_s=speeds, disc_k=st.floats(293.0, 420.0))
def test_a_hot_disc_grips_less_in_either_direction_of_rotation(
    omega_rad_s: float, disc_k: float
) -> None:
    share = friction_share(omega_rad_s, disc_k, DISC)
    assert share == friction_share(-omega_rad_s, disc_k, DISC)
    by_hand = (1 - 0.0025 * (disc_k - 313.15)) * (1 + 0.001 * (abs(omega_rad_s) - 100.0))
    assert share == pytest.approx(by_hand)
    assert friction_share(omega_rad_s, disc_k + 10.0, DISC) < share


def test_braking_heats_the_disc_and_oil_takes_the_heat_away() -> None:
    """A shaft braked at constant torque: integrated, against the closed form of a first order."""
    power_w, oil_k, begin_k = 9000.0, 350.0, 330.0
    final_k = oil_k + power_w / 15.0
    found = solve_ivp(
        lambda _, t: [heating_k_s(power_w, t[0], oil_k, DISC)],
        (0.0, 60.0), [begin_k], rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    decay = math.exp(-60.0 * 15.0 / 1200.0)
    assert found.y[0, -1] == pytest.approx(final_k + (begin_k - final_k) * decay, rel=1e-8)
    assert heating_k_s(power_w, oil_k, oil_k, DISC) > 0.0
    assert heating_k_s(0.0, oil_k + 20.0, oil_k, DISC) < 0.0
    assert heating_k_s(0.0, oil_k - 20.0, oil_k, DISC) > 0.0


@pytest.mark.parametrize(("torque_nm", "side"), [(80.0, -1.0), (-80.0, 1.0), (0.0, 0.0)])
def test_a_wheel_that_is_pulled_forward_lags_by_half_its_backlash(
    torque_nm: float, side: float
) -> None:
    half_rad, tau_s, start_rad = 2e-3, 4e-3, 1.5e-3
    lash = seen(Backlash(half_rad=half_rad, rate=1.0 / tau_s))
    found = solve_ivp(
        lambda _, y: [lash_rad_s(y[0], torque_nm, lash)],
        (0.0, 10e-3), [start_rad], rtol=1e-10, atol=1e-13,
    )  # fmt: skip
    place_rad = side * half_rad
    expected = place_rad + (start_rad - place_rad) * math.exp(-10e-3 / tau_s)
    assert found.y[0, -1] == pytest.approx(expected, rel=1e-7)


@given(before=st.floats(1e5, 1.2e6), behind=st.floats(1e5, 1.2e6))
def test_air_flows_downhill_only_choked_up_to_the_critical_ratio(
    before: float, behind: float
) -> None:
    share = flow_share(before, behind, 0.3)
    if behind >= before:
        assert share == 0.0
    elif behind <= 0.99 * before:
        assert share == pytest.approx(flow(before, behind, 0.3))
    else:
        assert 0.0 < share <= flow(before, 0.99 * before, 0.3)


@pytest.mark.parametrize(
    ("begin_pa", "valve"), [(AMBIENT_PA, 1.0), (6e5, 0.0), (2e5, 1.0)], ids=["fill", "vent", "more"]
)
def test_a_chamber_fills_and_vents_as_an_independent_integrator_says(
    begin_pa: float, valve: float
) -> None:
    per_pa = 287.05 * 293.15 * 1.185 / 0.2e-3
    c = 2e-8 if valve else 3e-8

    def slope(_: float, p: np.ndarray) -> list[float]:
        if valve:
            return [per_pa * c * SUPPLY_PA * flow(SUPPLY_PA, p[0], 0.3)]
        return [-per_pa * c * p[0] * flow(p[0], AMBIENT_PA, 0.3)]

    def ours(_: float, p: np.ndarray) -> list[float]:
        return [chamber_pa_s(p[0], SUPPLY_PA, valve, AIR)]

    end_s = 0.03
    expected = solve_ivp(slope, (0.0, end_s), [begin_pa], rtol=1e-9, max_step=1e-4).y[0, -1]
    found = solve_ivp(ours, (0.0, end_s), [begin_pa], rtol=1e-9, max_step=1e-4).y[0, -1]
    assert found == pytest.approx(expected, rel=1e-6)
    assert bool(found > begin_pa) is bool(valve)


@pytest.mark.parametrize("valve", [0.0, 1.0])
def test_the_first_order_chamber_is_that_of_the_thesis(valve: float) -> None:
    """Equation 4.1 on gauge pressure."""
    air = seen(BrakeAir(model=0.0, rate=1.0 / 0.06, atmosphere_pa=AMBIENT_PA))
    begin = 4e5
    found = solve_ivp(
        lambda _, p: [chamber_pa_s(p[0] + AMBIENT_PA, SUPPLY_PA, valve, air)],
        (0.0, 0.05), [begin], rtol=1e-10,
    ).y[0, -1]  # fmt: skip
    final = valve * (SUPPLY_PA - AMBIENT_PA)
    assert found == pytest.approx(final + (begin - final) * math.exp(-0.05 / 0.06), rel=1e-8)


def test_filling_lowers_the_tank_and_the_compressor_raises_it_to_what_is_governed() -> None:
    assert tank_pa_s(9e5, 9e5, 5e6, AIR) == pytest.approx(-0.01 * 5e6)
    assert tank_pa_s(9e5, 9e5, -5e6, AIR) == 0.0  # venting takes nothing from the tank
    found = solve_ivp(lambda _, p: [tank_pa_s(p[0], 9e5, 0.0, AIR)], (0, 2.0), [8e5], rtol=1e-10)
    assert found.y[0, -1] == pytest.approx(9e5 - 1e5 * math.exp(-1.0), rel=1e-8)


@pytest.mark.parametrize(
    ("mode", "target", "omega_rad_s", "demanded_nm"),
    [
        (IDLE, 0.0, 50.0, 400.0),
        (IDLE, 0.0, 65.0, -200.0),
        (SPEED_CONTROL, 150.0, 140.0, 400.0),
        (SPEED_CONTROL, 150.0, 200.0, -300.0),  # more than it can brake with
        (SPEED_CONTROL, 150.0, 0.0, 2500.0),  # more than it has
        (TORQUE_CONTROL, -120.0, 140.0, -120.0),
    ],
)
def test_an_engine_below_its_target_speed_pulls_and_above_it_brakes_within_its_limits(
    mode: int, target: float, omega_rad_s: float, demanded_nm: float
) -> None:
    assert demand_nm(mode, target, omega_rad_s, ENGINE) == pytest.approx(demanded_nm)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_torque_follows_its_demand_with_lag_and_rate_limit(side: float) -> None:
    """Far away it goes at the limit, nearer than limit x lag on an exponential."""
    step_nm, tau_s, limit = 1000.0, 0.08, 8000.0
    near_nm = limit * tau_s
    until_near_s = (step_nm - near_nm) / limit
    found = solve_ivp(
        lambda _, t: [torque_nm_s(side * step_nm, t[0], ENGINE)],
        (0.0, until_near_s + 0.1), [0.0], rtol=1e-10, max_step=1e-3,
    ).y[0, -1]  # fmt: skip
    assert found == pytest.approx(side * (step_nm - near_nm * math.exp(-0.1 / tau_s)), rel=1e-5)


def test_clutch_plates_carry_nothing_up_to_the_kiss_point_and_all_when_closed() -> None:
    plates = seen(ClutchPlates(most_nm=3500.0, kiss=0.4))
    assert [capacity_nm(x, plates) for x in (0.0, 0.4, 0.7, 1.0)] == [
        0.0, 0.0, pytest.approx(1750.0), 3500.0,
    ]  # fmt: skip


@given(speed_m_s=st.floats(-30.0, 30.0).filter(lambda v: abs(v) > 0.2))
def test_road_and_air_resist_in_either_direction(speed_m_s: float) -> None:
    force_n = resistance_n(speed_m_s, ROAD)
    assert force_n == pytest.approx(math.copysign(1500.0 + 3.6 * speed_m_s**2, speed_m_s))
