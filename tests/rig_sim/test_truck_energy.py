"""What goes in comes out: the truck's energy balance over random scenarios."""

from __future__ import annotations

import math

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from truck_bench import run, switch, world

from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.rig_sim.orders import EngineRequest
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.energy import Energy
from meshpoint.rig_sim.truck.world import TruckWorld

MAIN_VALVES = (Valve.MAIN_FIRST, Valve.MAIN_SECOND, Valve.MAIN_CRAWL, Valve.MAIN_THIRD)


def imbalance(energy: Energy) -> float:
    """Put in less lost less stored, relative to all that has moved."""
    residue = energy.put_in - energy.lost - energy.climbed - energy.kinetic
    moved = abs(energy.put_in) + energy.lost + abs(energy.climbed) + abs(energy.kinetic)
    return abs(residue) / moved


acts = st.lists(
    st.tuples(
        st.integers(1_000, 150_000),
        st.sampled_from(["brake", "sleeve", "split", "clutch", "engine", "script"]),
        st.integers(0, 3),
        st.booleans(),
    ),
    min_size=4,
    max_size=14,
)


def act(truck: TruckWorld, now_us: int, what: str, which: int, on: bool) -> None:
    if what == "brake":
        switch(truck, Valve.BRAKE, on, float(now_us))
    elif what == "sleeve":
        switch(truck, MAIN_VALVES[which], on, float(now_us))
    elif what == "split":
        valve = (Valve.SPLIT_LOW, Valve.SPLIT_HIGH, Valve.RANGE_LOW, Valve.RANGE_HIGH)[which]
        switch(truck, valve, True, float(now_us))
    elif what == "clutch":
        truck.command_clutch(on, now_us)
    elif what == "engine":
        truck.command_engine(EngineRequest(100.0 + 20.0 * which if on else None, None), now_us)
    else:
        truck.return_to_gear(8 + which, 50.0, now_us)


@settings(max_examples=20, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(
    seed=st.integers(0, 10_000),
    scenario=acts,
    profile=st.sampled_from(Profile),
    stiff=st.sampled_from([None, 0.0, 5e3, 5e4]),
    gearbox=st.sampled_from(["thesis", "thesis-dog"]),
)
def test_work_put_in_is_lost_or_stored(
    seed: int,
    scenario: list[tuple[int, str, int, bool]],
    profile: Profile,
    stiff: float | None,
    gearbox: str,
) -> None:
    fixed = {} if stiff is None else {"driveline.stiffness_nm_rad": stiff}
    truck = world(fixed, load_sheet(gearbox), seed=seed, profile=profile)
    now_us = 0
    for wait_us, what, which, on in scenario:
        now_us += wait_us
        run(truck, now_us)
        act(truck, now_us, what, which, on)
    run(truck, now_us + 500_000)
    assert imbalance(truck.plant.energy) < 1e-6


def test_a_braked_layshaft_heats_the_disc_by_what_it_loses() -> None:
    truck = world({"disc.cooling_w_k": 0.0, "dog.free_play": 0, "clutch.kiss": 1.0})
    truck.plant.coast()
    before = truck.plant.energy
    warm_k = truck.plant.y.disc_k
    switch(truck, Valve.BRAKE, True, 0.0)
    run(truck, 1_500_000)
    after = truck.plant.energy
    assert truck.plant.layshaft_rad_s == pytest.approx(0.0, abs=1e-9)
    heat_j = after.brake - before.brake
    assert heat_j > 1000.0
    risen_k = truck.plant.y.disc_k - warm_k
    assert risen_k * truck.built["disc.heat_j_k"] == pytest.approx(heat_j, rel=1e-6)


def test_a_gearbox_swings_against_its_vehicle_with_the_frequency_of_two_masses_and_a_spring() -> (
    None
):
    values = {"clutch.kiss": 1.0, "driveline.stiffness_nm_rad": 2e4, "driveline.damping_nms": 0.0}
    truck = world(values | {"dog.free_play": 0.0}, start_gear=12)
    plant = truck.plant
    plant.y.twist_rad += 0.02
    twists = []
    for now_us in range(1_000, 1_000_000, 1_000):
        run(truck, now_us)
        twists.append(plant.y.twist_rad)
    middle = 0.5 * (max(twists) + min(twists))
    rising = [i for i in range(1, len(twists)) if twists[i - 1] < middle <= twists[i]]
    found_hz = (len(rising) - 1) / ((rising[-1] - rising[0]) * 1e-3)
    members = plant.chain.rates(plant.chain.group(at.PROPELLER), at.PROPELLER)
    gearbox_kgm2 = sum(plant.p.inertia_kgm2[k] * rate**2 for k, rate in members.items())
    per_kgm2 = 1.0 / gearbox_kgm2 + 1.0 / plant.p.twisting.vehicle_kgm2
    assert found_hz == pytest.approx(math.sqrt(2e4 * per_kgm2) / (2.0 * math.pi), rel=0.01)
    assert max(twists) - min(twists) > 0.035  # nothing damps it but drag


def test_a_rolling_truck_loses_speed_to_road_and_slope_as_newton_says() -> None:
    truck = world({"vehicle.slope_percent": 2.0, "clutch.kiss": 1.0}, start_gear=12)
    truck.plant.coast()
    built, plant = truck.built, truck.plant
    speed = (
        plant.y.speed_rad_s[at.PROPELLER]
        * built["vehicle.wheel_radius_m"]
        / built["vehicle.axle_ratio"]
    )
    run(truck, 100_000)
    after = (
        plant.y.speed_rad_s[at.PROPELLER]
        * built["vehicle.wheel_radius_m"]
        / built["vehicle.axle_ratio"]
    )
    slope = math.atan(0.02)
    force = (
        built["vehicle.mass_kg"]
        * 9.81
        * (built["vehicle.rolling_resistance"] * math.cos(slope) + math.sin(slope))
        + 0.6 * built["vehicle.drag_area_m2"] * speed**2
    )
    expected = -force / built["vehicle.mass_kg"] * 0.1
    assert after - speed == pytest.approx(expected, rel=0.02)  # the shafts turn along
    assert plant.shafts.lock is None or plant.shafts.lock.gear is not MainGear.CRAWL
