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
from meshpoint.rig_sim.truck.as_built import draw_as_built, linear, nominal
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
CALM = {k: 0.0 for k in nominal() if k.startswith("disturbance.") and not k.endswith("_ms")}
"""No torque of chance."""


def gearbox_kgm2(truck: TruckWorld) -> float:
    """Inertia of what is linked to the propeller shaft, felt there."""
    plant = truck.plant
    members = plant.chain.rates(plant.chain.group(at.PROPELLER), at.PROPELLER)
    return sum(plant.p.inertia_kgm2[k] * rate**2 for k, rate in members.items())


def swinging(step_us: float = 2000.0, **changed: float) -> TruckWorld:
    """In neutral, nothing but the driveline at work."""
    values = {f"driveline.{name}": value for name, value in changed.items()}
    values["numerics.step_us"] = step_us
    truck = world(ALONE | DRIVELINE | values, start_gear=12)
    truck.plant.coast()
    return truck


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
    truck = swinging(damping_nms=0.0, tyre_nms=0.0, backlash_deg=0.0)
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
    ("lash_deg", "step_us", "within_rad"), [(0.0, 2000, 2e-5), (1.5, 2000, 2e-4), (1.5, 50, 5e-6)]
)
def test_an_independent_integrator_finds_the_same_motion(
    lash_deg: float, step_us: float, within_rad: float
) -> None:
    """`solve_ivp` on equations of its own: two compliances, backlash, oil between the flanks. The
    oil's torque bends within steps, so that with backlash the grid counts."""
    truck = swinging(step_us, backlash_deg=lash_deg)
    plant, shafts = truck.plant, truck.plant.p.twisting
    half, gearbox = math.radians(lash_deg) / 2.0, gearbox_kgm2(truck)
    plant.y.twist_rad, plant.y.tyre_rad = 0.04, -0.01
    begin = [plant.y.speed_rad_s[at.PROPELLER]] * 3 + [0.04, -0.01]

    def slope(_: float, y: np.ndarray) -> list[float]:
        propeller, wheels, vehicle, twist, tyre = y
        spring = DRIVELINE["driveline.stiffness_nm_rad"] * max(abs(twist) - half, 0.0)
        film = 1.0 if half == 0.0 else min(spring / FILM_NM, 1.0)
        damping = film * DRIVELINE["driveline.damping_nms"] * (propeller - wheels)
        torque = math.copysign(spring, twist) + damping
        if half > 0.0 and torque * twist <= 0.0:
            torque = 0.0
        traction = DRIVELINE["driveline.tyre_nm_rad"] * tyre
        traction += DRIVELINE["driveline.tyre_nms"] * (wheels - vehicle)
        return [
            -torque / gearbox,
            (torque - traction) / DRIVELINE["driveline.wheels_kgm2"],
            traction / shafts.vehicle_kgm2,
            propeller - wheels,
            wheels - vehicle,
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


@pytest.mark.parametrize("profile", [Profile.TYPICAL, Profile.HARSH])
def test_every_drawn_driveline_has_its_modes_where_trucks_have_them(profile: Profile) -> None:
    """In neutral, high range: tyres and half-shafts 2 to 8 Hz, the gearbox's side 10 to 40 Hz."""
    for seed in range(300):
        built = draw_as_built(seed, profile=profile)
        values = {k: v for k, v in built.values.items() if k.startswith("driveline.")}
        truck_kgm2 = built["vehicle.mass_kg"]
        truck_kgm2 *= (built["vehicle.wheel_radius_m"] / built["vehicle.axle_ratio"]) ** 2
        gearbox = built["vehicle.main_inertia_kgm2"] + built["vehicle.propeller_inertia_kgm2"]
        k, t = values["driveline.stiffness_nm_rad"], values["driveline.tyre_nm_rad"]
        springs = np.array([[k, -k, 0.0], [-k, k + t, -t], [0.0, -t, t]])
        masses = np.array([gearbox, values["driveline.wheels_kgm2"], truck_kgm2])
        squares = np.sort(np.linalg.eigvals(springs / masses[:, None]).real)
        slow_hz, fast_hz = np.sqrt(squares[1:]) / (2.0 * math.pi)
        assert 2.0 < slow_hz < 8.0 < 10.0 < fast_hz < 40.0


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
