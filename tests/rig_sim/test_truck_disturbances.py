"""What shakes and scatters: chance, orders, judder, delays, pressures, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import welch
from truck_bench import run, switch, world

from meshpoint.rig_sim.parts.disturbance import SOURCES
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.shared.engagement import GEAR_OF_VALVE
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import (
    LATER,
    draw_as_built,
    linear,
    nominal,
    parameters,
)
from meshpoint.rig_sim.truck.delays import VALVE_LIMIT_SDS
from meshpoint.rig_sim.truck.sleeve_valves import SleeveValves
from meshpoint.rig_sim.truck.world import TruckWorld

SHAKEN = {
    "disturbance.engine_nm": 10.0,
    "disturbance.input_nm": 0.5,
    "disturbance.layshaft_nm": 2.0,
    "disturbance.main_nm": 1.0,
    "disturbance.propeller_nm": 3.0,
    "disturbance.correlation_ms": 30.0,
}
STILL = {"vehicle.constant_speed": 1.0, "dog.free_play": 0.0, "clutch.kiss": 1.0}


def samples(truck: TruckWorld, seconds: float) -> np.ndarray:
    """Torques of chance at each sample of 2 ms, one column a source."""
    found = []
    begin_us = int(truck.plant.time_us)
    for k in range(round(seconds * 500)):
        run(truck, begin_us + 2_000 * (k + 1))
        found.append(truck.plant.rig.shaking.now_nm[:])
    return np.array(found)


@pytest.fixture(scope="module")
def chance() -> np.ndarray:
    return samples(world(linear() | STILL | SHAKEN, seed=4), 60.0)


def test_chance_has_the_spread_and_the_correlation_that_were_built_in(chance: np.ndarray) -> None:
    for k, name in enumerate(("engine", "input", "layshaft", "main", "propeller")):
        x, sd = chance[:, k], SHAKEN[f"disturbance.{name}_nm"]
        # 60 s of 30 ms: some 1,000 independent values; three standard errors of their spread
        assert x.std() == pytest.approx(sd, rel=3.0 / math.sqrt(2.0 * 1000.0))
        later = float(np.mean(x[15:] * x[:-15])) / sd**2
        assert later == pytest.approx(math.exp(-1.0), abs=0.1)


def test_chance_of_two_bodies_has_nothing_in_common(chance: np.ndarray) -> None:
    together = np.corrcoef(chance[:, : SOURCES - 1].T)
    assert np.abs(together - np.eye(SOURCES - 1)).max() < 3.5 / math.sqrt(1000.0)


def test_the_spectrum_of_chance_is_that_of_an_ornstein_uhlenbeck_torque(chance: np.ndarray) -> None:
    sd, tau, rate_hz = 2.0, 0.03, 500.0
    hertz, density = welch(chance[:, at.LAYSHAFT], rate_hz, nperseg=1024)
    for low, high in ((1.0, 3.0), (5.0, 10.0), (20.0, 40.0)):
        band = (hertz > low) & (hertz < high)
        expected = 4.0 * sd**2 * tau / (1.0 + (2.0 * math.pi * hertz[band] * tau) ** 2)
        assert density[band].mean() == pytest.approx(expected.mean(), rel=0.2)


def test_how_often_the_rig_is_looked_at_changes_nothing() -> None:
    often, seldom = (world(seed=6, profile=Profile.HARSH) for _ in range(2))
    for now_us in range(0, 400_001, 700):
        run(often, now_us)
        often.plant.main_box_nm()
    run(often, 400_000)
    run(seldom, 400_000)
    assert often.plant.y.vector.tolist() == seldom.plant.y.vector.tolist()
    assert often.plant.rig.shaking.raw() == seldom.plant.rig.shaking.raw()


def test_a_shaft_at_rest_stays_at_rest() -> None:
    values = linear() | SHAKEN | {"clutch.kiss": 1.0, "drag.constant_nm": 1.0}
    truck = world(values, main_speed_rpm=0.0)
    truck.plant.coast()
    run(truck, 500_000)
    assert truck.plant.layshaft_rad_s == 0.0


def test_a_copy_without_chance_goes_on_as_is_expected() -> None:
    """The torque of the moment dies out with its correlation; nothing new comes."""
    truck = world(linear() | STILL | SHAKEN, seed=4)
    run(truck, 100_000)
    now_nm = truck.plant.rig.shaking.chance_nm[at.LAYSHAFT]
    truck.plant.without_chance()
    run(truck, 160_000)
    left = truck.plant.rig.shaking.chance_nm[at.LAYSHAFT] / now_nm
    assert left == pytest.approx(math.exp(-2.0), rel=1e-6)


def test_engine_orders_are_one_and_three_a_turn() -> None:
    values = {"engine.first_order": 0.05, "engine.main_order": 0.3, "clutch.kiss": 1.0}
    plant = world(linear() | values).plant
    shares = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 721)[:-1]:
        plant.y.angle_rad[at.ENGINE], plant.y.engine_nm = angle, 1000.0
        plant.find_torques()
        shares.append(plant.rig.torques.body_nm[at.ENGINE] / 1000.0 - 1.0)
    found = np.fft.rfft(shares) / 360.0
    amplitude = np.abs(found)
    assert amplitude[[1, 3]] == pytest.approx([0.05, 0.3], abs=2e-3)
    assert np.delete(amplitude, [1, 3]).max() < 2e-3


def test_open_plates_drag_the_input_shaft_towards_the_engine() -> None:
    values = linear() | {"clutch.kiss": 0.35, "clutch.drag_nm": 3.0}
    truck = world(values, main_speed_rpm=0.0)
    truck.plant.coast()
    truck.command_clutch(False, 0)
    run(truck, 200_000)
    before = truck.plant.layshaft_rad_s
    run(truck, 300_000)
    plant = truck.plant
    rates = plant.chain.rates(plant.chain.group(at.INPUT), at.INPUT)
    kgm2 = sum(plant.p.inertia_kgm2[k] * rate**2 for k, rate in rates.items())
    gained = (plant.layshaft_rad_s - before) / rates[at.LAYSHAFT]
    friction_nm = plant.p.drag_nms * before * rates[at.LAYSHAFT]
    assert gained * kgm2 / 0.1 == pytest.approx(3.0 - friction_nm, rel=0.05)


def test_the_brake_judders_once_and_twice_a_turn() -> None:
    values = STILL | {"disc.judder_once": 0.05, "disc.judder_twice": 0.03}
    truck = world(linear() | values)
    truck.plant.coast()
    switch(truck, Valve.BRAKE, True, 0.0)
    run(truck, 300_000)
    angles, torques = [], []
    for now_us in range(301_000, 420_000, 1_000):
        run(truck, now_us)
        truck.plant.find_torques()
        angles.append(truck.plant.y.angle_rad[at.LAYSHAFT])
        torques.append(truck.plant.rig.torques.hold_nm / truck.plant.brake_gauge_pa)
    columns = [np.ones(len(angles))]
    columns += [f(n * np.array(angles)) for n in (1, 2) for f in (np.sin, np.cos)]
    fit = np.linalg.lstsq(np.array(columns).T, np.array(torques), rcond=None)[0]
    assert math.hypot(fit[1], fit[2]) / fit[0] == pytest.approx(0.05, rel=1e-3)
    assert math.hypot(fit[3], fit[4]) / fit[0] == pytest.approx(0.03, rel=1e-3)


def test_the_brake_valve_scatters_from_stroke_to_stroke() -> None:
    truck = world(nominal() | {"air.valve_scatter_ms": 1.0})
    mean_s = truck.sheet.brake.valve_delay_s
    drawn_ms = [1e3 * (truck.delays.brake_valve_s() - mean_s) for _ in range(4000)]
    assert np.mean(drawn_ms) == pytest.approx(0.0, abs=0.06)
    assert np.std(drawn_ms) == pytest.approx(0.9545, abs=0.04)  # of a normal cut at 2.5
    assert max(map(abs, drawn_ms)) <= VALVE_LIMIT_SDS


def valves(**changed: float) -> SleeveValves:
    values = {f"sleeve.{name}": value for name, value in changed.items()}
    truck = world(nominal() | {"sleeve.noise_sd_ms": 2.0, "sleeve.noise_limit_ms": 8.0} | values)
    return SleeveValves(truck.delays, truck.sheet, truck.built)


def test_a_valves_strokes_go_together_as_built() -> None:
    law = valves(correlation=0.5)
    mean_s = law.mean_s(Valve.MAIN_FIRST, True)
    drawn = np.array([law.draw_s(Valve.MAIN_FIRST, True, 0.0) for _ in range(6000)])
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(0.5, abs=0.04)
    assert drawn.std() == pytest.approx(2e-3, rel=0.05)
    expected_s, sd_s = law.expected_s(Valve.MAIN_FIRST, 0.0)
    assert sd_s == pytest.approx(2e-3 * math.sqrt(0.75), rel=1e-9)
    assert expected_s - mean_s == pytest.approx(0.5 * (drawn[-1] - mean_s), rel=1e-6)
    off = np.array([law.draw_s(Valve.MAIN_FIRST, False, 0.0) for _ in range(6000)])
    assert abs(np.corrcoef(off[1:], off[:-1])[0, 1]) < 0.05
    assert off.std() == pytest.approx(2e-3, rel=0.05)


def test_a_valve_that_has_rested_sticks() -> None:
    law = valves(noise_sd_ms=0.0, stiction_ms=3.0, stiction_s=10.0)
    mean_s = law.mean_s(Valve.MAIN_FIRST, True)
    assert law.draw_s(Valve.MAIN_FIRST, True, 0.0) - mean_s == pytest.approx(3e-3, rel=1e-6)
    off_s = law.mean_s(Valve.MAIN_FIRST, False)
    assert law.draw_s(Valve.MAIN_FIRST, False, 0.0) == pytest.approx(off_s, abs=1e-9)
    rested_s = law.draw_s(Valve.MAIN_FIRST, True, 10e6) - mean_s
    assert rested_s == pytest.approx(3e-3 * (1.0 - math.exp(-1.0)), rel=1e-6)


def test_each_valve_has_delays_of_its_own_about_the_sheets() -> None:
    law = valves(valve_on_ms=1.5, valve_off_ms=1.5)
    off_by_ms = [
        1e3 * (law.mean_s(valve, on) - 0.012) for valve in GEAR_OF_VALVE for on in (True, False)
    ]
    assert len(set(off_by_ms)) == 8
    assert max(map(abs, off_by_ms)) <= 1.5


def test_the_pressure_sensor_lags_is_off_and_counts_in_steps() -> None:
    values = {
        "pressure.lag_ms": 8.0,
        "pressure.brake_offset_bar": 0.2,
        "pressure.brake_gain": 1.02,
        "pressure.step_bar": 0.05,
    }
    truck = world(linear() | STILL | values)
    truck.plant.coast()
    atmosphere_pa = truck.sheet.air.atmosphere_pa
    truck.plant.y.brake_pa = atmosphere_pa + 4e5
    truck.plant.p.air.rate = 0.0  # the pressure stands
    run(truck, 10_000)
    felt_pa = 4e5 * (1.0 - math.exp(-10.0 / 8.0))
    assert truck.plant.y.felt_pa - atmosphere_pa == pytest.approx(felt_pa, rel=1e-3)
    said_pa = truck.sensors(10_000).brake_pa
    assert said_pa == pytest.approx(1.02 * felt_pa + 0.2e5 + atmosphere_pa, abs=0.025e5)
    assert said_pa / 0.05e5 == pytest.approx(round(said_pa / 0.05e5), abs=1e-6)


def test_noise_of_the_pressure_sensors_is_as_built() -> None:
    truck = world(linear() | {"pressure.noise_bar": 0.03})
    both = np.array([truck.sensors(10_000 * k)[:2] for k in range(2000)])
    assert both.std(axis=0) == pytest.approx([3e3, 3e3], rel=0.06)
    assert abs(np.corrcoef(both.T)[0, 1]) < 0.08


def test_load_moves_the_edges_of_a_wheel_once_a_turn() -> None:
    truck = world(linear() | {"hall.load_runout_mm": 0.06, "hall.wheel_radius_mm": 60.0})
    drift = np.array(truck.plant.rig.hall[2].drift_rad[: truck.plant.rig.hall[2].teeth])
    spectrum = np.abs(np.fft.rfft(drift)) / (len(drift) / 2.0)
    assert spectrum[1] == pytest.approx(1e-3, rel=1e-6)
    assert np.delete(spectrum, 1).max() < 1e-9


@pytest.mark.check
def test_the_layshafts_residual_drag_is_near_that_of_the_thesis() -> None:
    """About 7 Nm at 1,400 rpm and 80 degC."""
    for profile, most in ((Profile.TYPICAL, 9.0), (Profile.HARSH, 14.0)):
        at_rest = {"oil.temperature_c": 80.0}
        drags = []
        for seed in range(40):
            p = world(at_rest, seed=seed, profile=profile).plant.p
            drags.append(p.drag_nm + p.drag_nms * 1400.0 * math.pi / 30.0)
        assert np.mean(drags) == pytest.approx(7.0, abs=2.0)
        assert max(drags) < most


@pytest.mark.parametrize("profile", Profile)
def test_everything_is_drawn_evenly_from_the_ranges_of_its_profile(profile: Profile) -> None:
    drawn = [draw_as_built(seed, profile=profile).values for seed in range(400)]
    for name, (_, default, deviation, low, high, _) in parameters(profile).items():
        values = np.array([values[name] for values in drawn])
        least, most = max(default - deviation, low), min(default + deviation, high)
        assert least - 1e-5 * abs(least) <= values.min()
        assert values.max() <= most + 1e-5 * abs(most)
        if default - deviation >= low and default + deviation <= high:
            # three and a half standard errors of the mean of 400 even draws
            error = 3.5 * deviation / math.sqrt(3.0 * 400.0)
            assert values.mean() == pytest.approx(default, abs=error + 1e-5 * abs(default))


def test_a_clean_gearbox_is_the_one_it_was_before_there_were_profiles() -> None:
    built = draw_as_built(7, profile=Profile.CLEAN)
    before = {
        "sheet.layshaft_inertia_factor": 1.03906,
        "sleeve.back_taper_deg": 2.50147,
        "driveline.damping_nms": 19.662,
    }
    assert {name: built[name] for name in before} == before
    assert built.teeth_seed == 1564509734
    added = [name for names in LATER[1:3] for name in built.values if name.startswith(names)]
    assert added
    off = nominal()
    assert {name: built[name] for name in added} == {name: off[name] for name in added}
