"""The swinging driveline: natural frequencies, an independent integrator, and what excites it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from truck_bench import run, world

from meshpoint.rig_sim.orders import EngineRequest
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import linear, nominal
from meshpoint.rig_sim.truck.driveline import FILM_NM, modes_rad_s
from meshpoint.rig_sim.truck.world import TruckWorld

DRIVELINE = {k: v for k, v in nominal(Profile.TYPICAL).items() if k.startswith("driveline.")}
ALONE = linear() | {
    "vehicle.constant_speed": 0.0,
    "vehicle.rolling_resistance": 0.0,
    "vehicle.drag_area_m2": 0.0,
    "vehicle.slope_percent": 0.0,
}
"""Nothing acts on main shaft, wheels and vehicle but the driveline."""
STICKS_M = 1e9
"""Relaxation length of a tyre that does not slip."""
CALM = {k: 0.0 for k in nominal() if k.startswith("disturbance.") and not k.endswith("_ms")}
"""No torque of chance."""


def gearbox_kgm2(truck: TruckWorld) -> float:
    """Inertia of what is linked to the propeller shaft, felt there."""
    plant = truck.plant
    members = plant.chain.rates(plant.chain.group(at.PROPELLER), at.PROPELLER)
    return sum(plant.p.inertia_kgm2[k] * rate**2 for k, rate in members.items())


def swinging(step_us: float = 2000.0, main_rpm: float = 644.0, **changed: float) -> TruckWorld:
    """In neutral, nothing but the driveline at work."""
    values = {f"driveline.{name}": value for name, value in changed.items()}
    values["numerics.step_us"] = step_us
    truck = world(ALONE | DRIVELINE | values, start_gear=12, main_speed_rpm=main_rpm)
    truck.plant.coast()
    return truck


def linear_driveline(truck: TruckWorld, speed_m_s: float) -> np.ndarray:
    """Rates of the speeds of gearbox, wheels and vehicle and of both twists, over those five: the
    driveline without backlash, rolling at a speed."""
    shafts = truck.plant.p.twisting
    k, d = shafts.stiff_nm_rad, shafts.damping_nms
    k_t, d_t, release = shafts.tyre_nm_rad, shafts.tyre_nms, speed_m_s / shafts.relaxation_m
    torque = np.array([d, -d, 0.0, k, 0.0])
    twisting = np.array([0.0, 1.0, -1.0, 0.0, -release]) / (1.0 + release * d_t / k_t)
    traction = np.array([0.0, 0.0, 0.0, 0.0, k_t]) + d_t * twisting
    rows = [-torque / gearbox_kgm2(truck), (torque - traction) / shafts.wheels_kgm2]
    rows += [traction / shafts.vehicle_kgm2, np.array([1.0, -1.0, 0.0, 0.0, 0.0]), twisting]
    return np.array(rows)


def eigen_rad_s(truck: TruckWorld) -> list[float]:
    """Natural frequencies of three masses and two springs, from their matrices."""
    shafts = truck.plant.p.twisting
    k, t = shafts.stiff_nm_rad, shafts.tyre_nm_rad
    springs = np.array([[k, -k, 0.0], [-k, k + t, -t], [0.0, -t, t]])
    masses = np.array([gearbox_kgm2(truck), shafts.wheels_kgm2, shafts.vehicle_kgm2])
    squares = np.sort(np.linalg.eigvals(springs / masses[:, None]).real)
    return [math.sqrt(square) for square in squares[1:]]


def test_modes_are_the_eigenvalues_of_the_two_compliance_system() -> None:
    truck = swinging()
    found = modes_rad_s(truck.plant.p.twisting, gearbox_kgm2(truck))
    assert found == pytest.approx(eigen_rad_s(truck), rel=1e-9)


@pytest.mark.parametrize("mode", [0, 1])
def test_a_mode_rings_with_its_frequency(mode: int) -> None:
    """Begun in the mode's own shape and without damping, each swing takes as long as it should."""
    truck = swinging(damping_nms=0.0, tyre_nms=0.0, tyre_relaxation_m=STICKS_M, backlash_deg=0.0)
    plant, shafts = truck.plant, truck.plant.p.twisting
    expected_rad_s = eigen_rad_s(truck)[mode]
    # from the equation of the gearbox's side: -w2 J theta_P = -k (theta_P - theta_A)
    share = 1.0 - expected_rad_s**2 * gearbox_kgm2(truck) / shafts.stiff_nm_rad
    vehicle = share * shafts.tyre_nm_rad
    vehicle /= shafts.tyre_nm_rad - expected_rad_s**2 * shafts.vehicle_kgm2
    plant.y.twist_rad = 0.01 * (1.0 - share)
    plant.y.tyre_rad = 0.01 * (share - vehicle)
    twists = []
    for now_us in range(1_000, 2_000_000, 1_000):
        run(truck, now_us)
        twists.append(plant.y.twist_rad if mode else plant.y.tyre_rad)
    rising = [
        i - 1 + twists[i - 1] / (twists[i - 1] - twists[i])
        for i in range(1, len(twists))
        if twists[i - 1] < 0.0 <= twists[i]
    ]
    found_hz = (len(rising) - 1) / ((rising[-1] - rising[0]) * 1e-3)
    assert found_hz == pytest.approx(expected_rad_s / (2.0 * math.pi), rel=1e-3)
    late = twists[-200:]
    assert max(late) - min(late) == pytest.approx(max(twists) - min(twists), rel=0.02)


@pytest.mark.parametrize(
    ("main_rpm", "damping"), [(0.0, 0.0243), (270.0, 0.0818), (680.0, 0.1684), (1085.0, 0.2533)]
)
def test_the_tyres_swing_fades_as_the_rolling_tyre_slips(main_rpm: float, damping: float) -> None:
    """The slow mode's eigenvalue at 0, 20, 50 and 80 km/h, and so does the rig swing: begun in that
    mode's shape, its twist after 0.2 s is the eigenvalue's. As a wheel on a spring in series with a
    damper it fades with v / (2 sigma) and the carcass's d_t / (2 J)."""
    truck = swinging(main_rpm=main_rpm, backlash_deg=0.0, damping_nms=0.0)
    plant, shafts = truck.plant, truck.plant.p.twisting
    speed_m_s = plant.road_speed_m_s
    values, shapes = np.linalg.eig(linear_driveline(truck, speed_m_s))
    slow = min((k for k in range(5) if values[k].imag > 1.0), key=lambda k: values[k].imag)
    alone = speed_m_s / (2.0 * shafts.relaxation_m) + shafts.tyre_nms / (2.0 * shafts.wheels_kgm2)
    assert -values[slow].real == pytest.approx(alone, rel=0.1)
    assert -values[slow].real / abs(values[slow]) == pytest.approx(damping, abs=1e-4)
    begin = 0.002 * shapes[:, slow] / shapes[4, slow]
    y = plant.y
    rest = y.vehicle_rad_s
    y.speed_rad_s[at.PROPELLER] = y.speed_rad_s[at.MAIN] = rest + begin[0].real
    y.wheels_rad_s, y.vehicle_rad_s = rest + begin[1].real, rest + begin[2].real
    y.twist_rad, y.tyre_rad = begin[3].real, begin[4].real
    run(truck, 200_000)
    after = begin * np.exp(values[slow] * 0.2)
    assert (y.twist_rad, y.tyre_rad) == pytest.approx((after[3].real, after[4].real), abs=2e-5)


def test_a_tyre_that_pulls_slips_by_its_torque_over_its_slip_stiffness() -> None:
    """Up a slope: kappa = F / C_kappa with C_kappa = k_x sigma, and F moves the truck."""
    fixed = {"vehicle.slope_percent": 2.0, "vehicle.mass_kg": 30_000.0}
    fixed |= {"engine.first_order": 0.0, "engine.main_order": 0.0}
    truck = world(nominal(Profile.TYPICAL) | fixed | CALM, start_gear=12)
    for now_us in range(0, 2_000_000, 50_000):
        before_m_s = truck.plant.road_speed_m_s
        truck.command_clutch(True, now_us)
        run(truck, now_us + 50_000)
    y, shafts, wheel_m = truck.plant.y, truck.plant.p.twisting, truck.plant.p.road.wheel_m
    stiffness_n_m = shafts.tyre_nm_rad / wheel_m**2
    force_n = truck.plant.resistance_nm() / wheel_m
    force_n += 30_000.0 * (truck.plant.road_speed_m_s - before_m_s) / 0.05
    slip = (y.wheels_rad_s - y.vehicle_rad_s) / y.vehicle_rad_s
    assert slip == pytest.approx(force_n / (stiffness_n_m * shafts.relaxation_m), rel=0.02)
    assert 0.001 < slip < 0.02


def test_the_pinions_drag_slows_a_free_propeller_shaft() -> None:
    truck = world(ALONE | DRIVELINE | {"drag.propeller_nm": 5.0}, start_gear=12)
    truck.plant.coast()
    before = truck.plant.main_rad_s
    run(truck, 10_000)
    lost = before - truck.plant.main_rad_s
    assert lost == pytest.approx(5.0 / gearbox_kgm2(truck) * 0.010, rel=1e-6)


@pytest.mark.parametrize(
    ("lash_deg", "step_us", "within_rad"),
    [
        (0.0, 2000, 2e-5),
        pytest.param(1.5, 2000, 1e-3, marks=pytest.mark.check),
        pytest.param(1.5, 500, 2e-4, marks=pytest.mark.check),
        (1.5, 50, 5e-6),
    ],
)
def test_an_independent_integrator_finds_the_same_motion(
    lash_deg: float, step_us: float, within_rad: float
) -> None:
    """`solve_ivp` on equations of its own: two compliances, backlash, oil between the flanks. The
    oil's torque bends within steps, so that with backlash the grid counts."""
    truck = swinging(step_us, backlash_deg=lash_deg)
    plant, shafts = truck.plant, truck.plant.p.twisting
    half, gearbox = math.radians(lash_deg) / 2.0, gearbox_kgm2(truck)
    plant.y.twist_rad, plant.y.tyre_rad = 0.04, -0.003
    begin = [plant.y.speed_rad_s[at.PROPELLER]] * 3 + [0.04, -0.003]
    stiff, sigma_m = (DRIVELINE[f"driveline.tyre_{name}"] for name in ("nm_rad", "relaxation_m"))

    def slope(_: float, y: np.ndarray) -> list[float]:
        propeller, wheels, vehicle, twist, tyre = y
        spring = DRIVELINE["driveline.stiffness_nm_rad"] * max(abs(twist) - half, 0.0)
        film = 1.0 if half == 0.0 else min(spring / FILM_NM, 1.0)
        damping = film * DRIVELINE["driveline.damping_nms"] * (propeller - wheels)
        torque = math.copysign(spring, twist) + damping
        if half > 0.0 and torque * twist <= 0.0:
            torque = 0.0
        # force and slip of the contact patch: T_t = d_s (creep - u'), d_s = k_t sigma / v
        contact = stiff * sigma_m / (abs(vehicle) * plant.p.road.wheel_m)
        carcass = DRIVELINE["driveline.tyre_nms"]
        traction = contact * (stiff * tyre + carcass * (wheels - vehicle)) / (contact + carcass)
        return [
            -torque / gearbox,
            (torque - traction) / DRIVELINE["driveline.wheels_kgm2"],
            traction / shafts.vehicle_kgm2,
            propeller - wheels,
            wheels - vehicle - traction / contact,
        ]

    found = solve_ivp(slope, (0.0, 0.4), begin, "DOP853", rtol=1e-10, atol=1e-12, max_step=1e-4)
    run(truck, 400_000)
    y = plant.y
    moved = (y.speed_rad_s[at.PROPELLER], y.wheels_rad_s, y.vehicle_rad_s)
    assert moved == pytest.approx(found.y[:3, -1].tolist(), abs=100.0 * within_rad)
    assert (y.twist_rad, y.tyre_rad) == pytest.approx(found.y[3:, -1].tolist(), abs=within_rad)


def test_nothing_but_the_road_changes_the_momentum_of_driveline_and_vehicle() -> None:
    truck = swinging()
    plant, shafts = truck.plant, truck.plant.p.twisting
    plant.y.twist_rad = 0.05

    def momentum() -> float:
        y = plant.y
        moved = gearbox_kgm2(truck) * y.speed_rad_s[at.PROPELLER]
        return moved + shafts.wheels_kgm2 * y.wheels_rad_s + shafts.vehicle_kgm2 * y.vehicle_rad_s

    before = momentum()
    run(truck, 500_000)
    assert momentum() == pytest.approx(before, rel=1e-12)


def drawn_modes_hz(seed: int, profile: Profile, gear: int | None) -> tuple[float, ...]:
    """Natural frequencies of a drawn driveline in a gear with the clutch closed, or in neutral."""
    truck = world({}, seed=seed, profile=profile, start_gear=gear or 12)
    if gear is None:
        truck.plant.coast()
    found = modes_rad_s(truck.plant.p.twisting, gearbox_kgm2(truck))
    return tuple(omega / (2.0 * math.pi) for omega in found)


@pytest.mark.parametrize("profile", [Profile.TYPICAL, Profile.HARSH])
def test_every_drawn_driveline_has_its_modes_where_trucks_have_them(profile: Profile) -> None:
    """Tyres and half-shafts, with engine and gearbox behind the gear: 2 to 8 Hz in gears 7 to 9.
    Freed from them the wheels swing on the tyres alone, and the gearbox's side with 10 to 40 Hz."""
    for seed in range(12):
        assert 2.0 < drawn_modes_hz(seed, profile, gear=7)[0] < 8.0
        assert 2.0 < drawn_modes_hz(seed, profile, gear=9)[0] < 8.0
        wheels_hz, gearbox_hz = drawn_modes_hz(seed, profile, gear=None)
        assert 6.0 < wheels_hz < 16.0 < gearbox_hz < 40.0


def swing_after_opening(ramped: bool) -> float:
    """How far the main shaft's speed swings (rad/s) in the 0.3 s after the clutch has begun to open
    under the torque of a slope; `ramped`: the engine's torque was taken down by TSC1 before."""
    fixed = {"vehicle.slope_percent": 2.0, "vehicle.mass_kg": 30_000.0}
    truck = world(nominal(Profile.TYPICAL) | fixed | CALM, start_gear=12)
    for now_us in range(0, 2_000_000, 10_000):
        run(truck, now_us)
        truck.command_clutch(True, now_us)
        if ramped and now_us >= 1_500_000:
            left = max(0.0, 1.0 - (now_us - 1_500_000) / 250_000)
            if left == 1.0:
                begin = truck.plant.y.engine_nm / truck.plant.p.engine.most_nm
            truck.command_engine(EngineRequest(None, begin * left), now_us)
    speeds = []
    for now_us in range(2_000_000, 2_300_000, 1_000):
        run(truck, now_us)
        if now_us % 10_000 == 0:
            truck.command_clutch(False, now_us)
            if ramped:
                truck.command_engine(EngineRequest(None, 0.0), now_us)
        speeds.append(truck.plant.main_rad_s)
    trend = np.polyval(np.polyfit(range(len(speeds)), speeds, 1), range(len(speeds)))
    return float(np.ptp(np.array(speeds) - trend))


def test_the_driveline_rings_less_where_the_engine_has_taken_its_torque_down() -> None:
    assert swing_after_opening(ramped=False) > 2.0 * swing_after_opening(ramped=True)
