"""Which flank a wheel lies at in its mesh, by what drives what; seen by the wheels' angles.

A wheel that is pulled lags by half the backlash, a wheel that pushes leads by it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from truck_bench import GEAR, SHEET, run, world

from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.rig_sim.orders import EngineRequest
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import linear
from meshpoint.rig_sim.truck.world import TruckWorld
from meshpoint.units import DEG, RPM

WIDE = 0.4
"""Backlash of the meshes, degrees, whole width."""
FREE = replace(SHEET, shafts=replace(SHEET.shafts, friction_nms=0.0))
"""Nothing but its mesh changes the layshaft's speed."""
VALUES = linear() | {
    "dog.free_play": 1.0,
    "lash.splitter_deg": WIDE,
    "lash.main_deg": WIDE,
    "lash.gear_inertia_kgm2": 0.05,
    "clutch.kiss": 0.4,
}


def neutral() -> TruckWorld:
    """No gear in, the clutch closed, the splitter in its high step."""
    truck = world(VALUES, FREE, start_gear=8)
    truck.plant.coast()
    return truck


def lead_rad(truck: TruckWorld) -> float:
    """How far the input shaft is ahead of where the layshaft's teeth have it, less a constant."""
    (turns, rest), (lay_turns, lay_rest) = truck.truth.angles[0], truck.truth.angles[1]
    mesh = SHEET.splitter.high  # layshaft speed over input speed
    input_rad = turns * math.tau + rest
    return input_rad - (lay_turns * math.tau + lay_rest) / mesh.ratio


def asked(truck: TruckWorld, begin_us: int, speed_rad_s: float, for_us: int = 300_000) -> float:
    """The lead while the engine is asked for a speed through the closed clutch."""
    for now_us in range(begin_us, begin_us + for_us, 10_000):
        run(truck, now_us)
        truck.command_clutch(True, now_us)
        truck.command_engine(EngineRequest(speed_rad_s, None), now_us)
    return lead_rad(truck)


def test_an_input_shaft_that_drives_the_layshaft_leads_and_one_that_is_driven_lags() -> None:
    truck = neutral()
    engine_rad_s = truck.plant.y.speed_rad_s[at.ENGINE]
    pulling = asked(truck, 0, engine_rad_s + 400.0 * RPM, 150_000)
    braking = asked(truck, 150_000, engine_rad_s - 400.0 * RPM)
    pulling_again = asked(truck, 450_000, engine_rad_s + 400.0 * RPM, 150_000)
    assert pulling - braking == pytest.approx(WIDE * DEG, rel=0.02)
    assert pulling_again - braking == pytest.approx(WIDE * DEG, rel=0.02)


def gear_lead_rad(truck: TruckWorld) -> float:
    """How far a loose gear's teeth are ahead of where layshaft and main shaft have them, less a
    constant."""
    (lay_turns, lay_rest), (main_turns, main_rest) = truck.truth.angles[1], truck.truth.angles[2]
    exact_rad = SHEET.main_mesh(GEAR).ratio * (lay_turns * math.tau + lay_rest)
    exact_rad -= main_turns * math.tau + main_rest
    return math.remainder(truck.truth.phase_rad(GEAR) - exact_rad, SHEET.dog.pitch_rad)


def test_a_loose_gear_lags_as_its_layshaft_speeds_up_and_leads_as_it_is_braked() -> None:
    faster, braked = neutral(), neutral()
    asked(faster, 0, faster.plant.y.speed_rad_s[at.ENGINE] + 400.0 * RPM, 150_000)
    braked.plant.chain.open(at.CLUTCH)
    braked.switch(Valve.BRAKE, True)
    run(braked, 150_000)
    lead_rad = math.remainder(gear_lead_rad(braked) - gear_lead_rad(faster), SHEET.dog.pitch_rad)
    assert lead_rad == pytest.approx(WIDE * DEG, rel=0.02)


@pytest.mark.parametrize("slope_percent", [4.0, -4.0])
def test_a_gear_in_mesh_lags_while_it_drives_and_leads_while_the_truck_drives_it(
    slope_percent: float,
) -> None:
    """Uphill the engine pulls, downhill it holds back; the tooth's flank says the same."""
    truck = world(VALUES | {"vehicle.slope_percent": slope_percent}, start_gear=8)
    for now_us in range(0, 1_500_000, 10_000):
        run(truck, now_us)
        truck.command_clutch(True, now_us)
    lock = truck.plant.shafts.lock
    assert lock is not None
    pulls = truck.plant.main_box_nm() > 0.0
    assert pulls is (slope_percent > 0.0)
    lash_rad = truck.plant.y.lash_rad[list(MAIN_GEARS).index(lock.gear)]
    assert lash_rad == pytest.approx(math.copysign(WIDE / 2.0 * DEG, -slope_percent), rel=0.02)
    assert lock.flank == (1 if pulls else -1)
