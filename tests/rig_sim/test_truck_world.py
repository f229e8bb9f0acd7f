"""The truck as a world: same seed same gearbox, however it is asked; engine, clutch, steps."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rig_bench import CYCLE_US, RigBench, upshift
from truck_bench import SHEET, run, switch, world

from meshpoint.dbc.messages import EngagementEvent, ReferenceEngagement
from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.wheels import Mesh
from meshpoint.rig_sim import RigSettings
from meshpoint.rig_sim.orders import EngineRequest
from meshpoint.rig_sim.settings import DEFAULT_PROFILE, Profile, SettingsError
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import (
    AsBuiltError,
    draw_as_built,
    linear,
    load_as_built,
    nominal,
    parameters,
    read_as_built,
)
from meshpoint.rig_sim.truck.world import TruckWorld
from meshpoint.units import RPM

TRUCK = RigSettings(seed=5, profile=Profile.CLEAN)
SCRIPT = """
from meshpoint.bus.light_can import load_can
load_can()
import json, sys
from truck_bench import run, switch, world
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.gearbox.gears import MainGear
from meshpoint.gearbox.wheels import Mesh
BRAKE, SECOND = Valve.BRAKE, Valve.MAIN_SECOND
truck = world({"vehicle.slope_percent": 0.0}, seed=11)
truth, now_us = truck.truth, 0
def go_on_until(met):
    global now_us
    while not met():
        now_us += 2_000
        truck.command_clutch(False, now_us)
        run(truck, now_us)
        assert now_us < 9_000_000
switch(truck, SECOND, True, float(now_us))
go_on_until(lambda: truth.locked_gear is MainGear.NEUTRAL)
switch(truck, SECOND, False, float(now_us))
switch(truck, BRAKE, True, float(now_us))
go_on_until(lambda: truth.slip_rad_s(MainGear.SECOND) < 12.0)
switch(truck, BRAKE, False, float(now_us))
switch(truck, SECOND, True, float(now_us))
go_on_until(lambda: truth.locked_gear is MainGear.SECOND)
switch(truck, SECOND, False, float(now_us))
truck.return_to_gear(8, 60.0, now_us)
go_on_until(lambda: truth.locked_gear is MainGear.FIRST)
lines = [(time_us, text) for time_us, text in truck.engagement.lines]
assert sum("LOCKED" in text for _, text in lines) >= 2
channels = truck.plant.rig.captured.channels
ring = [channel.times_us[:] for channel in channels]
pointers = [(channel.tooth, channel.lap, channel.count) for channel in channels]
json.dump([lines, ring, pointers, truck.plant.y.vector.tolist()], sys.stdout)
"""


def bench_of(settings: RigSettings, step_us: int = CYCLE_US) -> RigBench:
    bench = RigBench(settings)
    bench.run(1_000_000, upshift, step_us)
    return bench


def test_the_same_seed_says_the_same_bytes_and_another_does_not() -> None:
    first, again = bench_of(TRUCK), bench_of(TRUCK)
    assert first.frames == again.frames
    assert first.lines == again.lines
    other = bench_of(RigSettings(seed=6, profile=Profile.CLEAN))
    assert other.frames != first.frames


def test_it_does_not_matter_how_often_anybody_asks() -> None:
    truck, asked = world(seed=4), world(seed=4)
    rng = np.random.default_rng(1)
    for plant in (truck, asked):
        plant.command_clutch(False, 0)
        switch(plant, Valve.MAIN_SECOND, True, 30_000.0)
        switch(plant, Valve.BRAKE, True, 90_000.0)
    run(truck, 400_000)
    now_us = 0
    while now_us < 400_000:
        now_us = min(now_us + int(rng.integers(1, 3_000)), 400_000)
        run(asked, now_us)
    assert truck.plant.rig.moving() == asked.plant.rig.moving()
    assert truck.engagement.lines == asked.engagement.lines


@pytest.mark.long
def test_without_the_compiler_it_is_the_same_gearbox() -> None:
    folder = str(Path(__file__).parent)
    root = str(Path(__file__).parents[2])
    results = []
    for off in ("0", "1"):
        environment = os.environ | {
            "NUMBA_DISABLE_JIT": off, "PYTHONPATH": os.pathsep.join([root, folder])
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env=environment,
            capture_output=True,
            check=True,
            text=True,
        )
        results.append(json.loads(done.stdout))
    (lines, ring, pointers, y), (plain_lines, plain_ring, plain_pointers, plain_y) = results
    assert [text for _, text in lines] == [text for _, text in plain_lines]
    for (a, _), (b, _) in zip(lines, plain_lines, strict=True):
        assert a == pytest.approx(b, abs=1e-3)  # a nanosecond
    assert pointers == plain_pointers
    assert ring == plain_ring
    assert y == pytest.approx(plain_y, rel=1e-9, abs=1e-9)


def test_a_finer_grid_moves_no_event_by_a_tenth_of_a_microsecond() -> None:
    times = []
    for step_us in (2000.0, 250.0):
        truck = world({"numerics.step_us": step_us}, seed=9)
        truck.command_clutch(False, 0)
        switch(truck, Valve.MAIN_SECOND, True, 20_000.0)
        switch(truck, Valve.BRAKE, True, 150_000.0)
        switch(truck, Valve.BRAKE, False, 250_000.0)
        run(truck, 400_000)
        ring = np.array([channel.times_us[:] for channel in truck.plant.rig.captured.channels])
        times.append((truck.plant.y, ring))
    (coarse, ring), (fine, fine_ring) = times
    apart = coarse.angle_rad[at.LAYSHAFT] - fine.angle_rad[at.LAYSHAFT]
    assert abs(apart) / fine.speed_rad_s[at.LAYSHAFT] < 1e-7
    assert np.abs(ring - fine_ring).max() <= 1


def test_as_built_is_drawn_within_its_ranges_and_a_file_fixes_it(tmp_path: Path) -> None:
    drawn = [draw_as_built(seed, profile=Profile.CLEAN) for seed in range(40)]
    for name, parameter in parameters().items():
        values = [built[name] for built in drawn]
        assert all(parameter.low <= value <= parameter.high for value in values)
        spread = parameter.deviation * (1.0 + 1e-4) + 1e-5 * abs(parameter.default)
        assert all(abs(value - parameter.default) <= spread for value in values)
        assert (len(set(values)) > 1) is (parameter.deviation > 0.0)
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"as_built": drawn[3].to_json()}))
    assert draw_as_built(99, load_as_built(path).fixed, Profile.CLEAN) == drawn[3]
    path = tmp_path / "some.toml"
    path.write_text("[disc]\nheat_j_k = 5000\n")
    fixed = draw_as_built(3, load_as_built(path).fixed, Profile.CLEAN)
    assert fixed["disc.heat_j_k"] == 5000.0
    assert fixed["oil.temperature_c"] == drawn[3]["oil.temperature_c"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[disc]\nheat = 1", ["disc.heat", "rig --describe"]),
        ("[disc]\nheat_j_k = nan", ["disc.heat_j_k", "nan", "100..100000"]),
        ("[disc]\nheat_j_k = true", ["disc.heat_j_k", "True"]),
        ("disc = 1", ["disc", "table"]),
        ("x", ["TOML"]),
        ("[turbo]", ["turbo", "disc", "teeth"]),
        ("[turbo.inner]", ["turbo"]),
    ],
)
def test_a_wrong_as_built_file_is_reported(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(AsBuiltError) as error:
        load_as_built(path)
    assert all(word in str(error.value) for word in [*words, "wrong.toml"])


def test_the_linear_file_names_parameters_that_exist() -> None:
    assert set(linear()) <= set(parameters())


def opened(fixed: dict[str, float]) -> TruckWorld:
    """Clutch closed, no gear: input shaft and layshaft turn with the engine."""
    truck = world(nominal() | fixed, seed=2)
    truck.plant.coast()
    return truck


def test_the_engine_brings_the_layshaft_to_the_speed_asked_for_with_lag() -> None:
    truck = opened({"vehicle.slope_percent": 0.0})
    target = 1900.0 * RPM
    for now_us in range(0, 1_500_000, 10_000):
        run(truck, now_us)
        truck.command_clutch(True, now_us)
        truck.command_engine(EngineRequest(target, None), now_us)
        if now_us == 20_000:
            early = truck.plant.y.speed_rad_s[at.ENGINE]
    assert early < target - 20.0 * RPM
    reached = truck.plant.y.speed_rad_s[at.ENGINE]
    assert reached == pytest.approx(target, rel=0.05)
    split = SHEET.splitter.high.ratio
    assert truck.plant.layshaft_rad_s == pytest.approx(reached * split, rel=1e-9)


def test_an_open_clutch_leaves_the_engine_to_its_idle_speed() -> None:
    truck = opened({})
    for now_us in range(0, 4_000_000, 50_000):
        run(truck, now_us)
        truck.command_clutch(False, now_us)
    assert truck.plant.y.speed_rad_s[at.ENGINE] == pytest.approx(600.0 * RPM, rel=0.02)
    assert truck.sensors(4_000_000).clutch == 0.0


def test_the_splitter_s_valve_changes_the_step_through_its_cone() -> None:
    truck = opened({"clutch.kiss": 1.0})
    before = truck.plant.layshaft_rad_s
    switch(truck, Valve.SPLIT_LOW, True, 1000.0)
    run(truck, 600_000)
    speed = truck.plant.y.speed_rad_s
    low = SHEET.splitter.low.ratio
    assert speed[at.LAYSHAFT] / speed[at.INPUT] == pytest.approx(low, rel=1e-9)
    assert truck.plant.energy.rubbing > 1.0
    assert truck.plant.layshaft_rad_s < before


def test_a_splitter_sleeve_is_baulked_until_its_cones_hold() -> None:
    """Its position sensor must not say that the step is in while the speeds still differ."""
    truck = opened({"clutch.kiss": 1.0, "synchro.splitter_nm": 40.0})
    switch(truck, Valve.SPLIT_LOW, True, 1000.0)
    low, differed = SHEET.splitter.low.ratio, 0
    for now_us in range(0, 800_000, 5_000):
        run(truck, now_us)
        speed = truck.plant.y.speed_rad_s
        apart = abs(low * speed[at.INPUT] - speed[at.LAYSHAFT]) > 1.0 * RPM
        position_m = truck.script.splitter.position_m(now_us)
        if apart and position_m < 0.0:
            differed += 1
            assert position_m >= -SHEET.sleeve.to_contact_m
    assert differed > 10
    assert truck.script.splitter.position_m(800_000) == -SHEET.sleeve.stroke_m


def splitter_driven(*spans_ms: tuple[Valve, float, float]) -> TruckWorld:
    """Clutch closed in neutral; the splitter's valves are driven for these spans alone."""
    truck = opened({"clutch.kiss": 1.0, "synchro.splitter_nm": 40.0})
    for valve, from_ms, to_ms in spans_ms:
        switch(truck, valve, True, 1e3 * from_ms)
        switch(truck, valve, False, 1e3 * to_ms)
    return truck


def test_a_sleeve_whose_valve_goes_off_at_its_cones_stays_there_and_they_rub_no_longer() -> None:
    """A cylinder without air presses on nothing: the speeds stay apart, and the step stays out."""
    truck, cut = splitter_driven((Valve.SPLIT_LOW, 1.0, 50.0)), []
    for now_us in range(0, 1_000_000, 5_000):
        run(truck, now_us)
        if now_us in (200_000, 995_000):
            speed, low = truck.plant.y.speed_rad_s, SHEET.splitter.low.ratio
            cut.append((truck.plant.energy.rubbing, truck.script.splitter.position_m(now_us)))
            assert abs(low * speed[at.INPUT] - speed[at.LAYSHAFT]) > 10.0 * RPM
    assert cut[0] == cut[1]
    assert cut[0][0] > 0.0
    assert 0.0 > cut[0][1] >= -SHEET.sleeve.to_contact_m


@pytest.mark.parametrize(
    ("valve", "side", "mesh"),
    [(Valve.SPLIT_LOW, -1, SHEET.splitter.low), (Valve.SPLIT_HIGH, 1, SHEET.splitter.high)],
)
def test_a_sleeve_left_at_its_cones_goes_on_or_back_by_the_valve_that_is_driven_next(
    valve: Valve, side: int, mesh: Mesh
) -> None:
    truck = splitter_driven((Valve.SPLIT_LOW, 1.0, 50.0), (valve, 400.0, 1400.0))
    run(truck, 1_500_000)
    speed = truck.plant.y.speed_rad_s
    assert truck.script.splitter.position_m(1_500_000) == side * SHEET.sleeve.stroke_m
    assert speed[at.LAYSHAFT] / speed[at.INPUT] == pytest.approx(mesh.ratio, rel=1e-9)


def test_a_step_valve_driven_for_too_short_a_time_leaves_the_step_as_it_was() -> None:
    """The detent draws the sleeve back before its teeth have left their old side."""
    truck = splitter_driven((Valve.SPLIT_LOW, 1.0, 6.0))
    run(truck, 300_000)
    speed = truck.plant.y.speed_rad_s
    assert truck.script.splitter.position_m(300_000) == SHEET.sleeve.stroke_m
    high = SHEET.splitter.high.ratio
    assert speed[at.LAYSHAFT] / speed[at.INPUT] == pytest.approx(high, rel=1e-9)


def test_the_bench_takes_a_sleeve_along_that_was_left_at_its_cones() -> None:
    truck = splitter_driven((Valve.SPLIT_LOW, 1.0, 50.0))
    run(truck, 300_000)
    truck.return_to_gear(9, 644.0 * RPM, 300_000)
    run(truck, 1_200_000)
    assert truck.script.splitter.position_m(1_200_000) == -SHEET.sleeve.stroke_m
    assert truck.truth.locked_gear is MainGear.SECOND


def test_a_loaded_sleeve_stays_until_the_torque_goes() -> None:
    truck = world(nominal() | {"vehicle.slope_percent": 8.0, "sleeve.back_taper_deg": 5.0}, seed=2)
    for now_us in range(0, 900_000, 10_000):
        run(truck, now_us)
        truck.command_clutch(now_us < 500_000, now_us)
        if now_us < 500_000:
            truck.command_engine(EngineRequest(None, 0.8), now_us)
        if now_us == 200_000:
            switch(truck, Valve.MAIN_SECOND, True, 2e5)
        if now_us == 490_000:
            assert truck.truth.locked_gear is MainGear.FIRST
    assert truck.truth.locked_gear is MainGear.NEUTRAL


def test_outcomes_of_an_engagement_are_on_the_bus() -> None:
    bench = bench_of(TRUCK)
    events = [message.event for message in bench.of(ReferenceEngagement)]
    assert EngagementEvent.RELEASED in events
    locked = bench.events(EngagementEvent.LOCKED)
    assert all(message.impact_energy_j >= 0.0 for message in locked)


@pytest.mark.parametrize("profile", Profile)
def test_a_profile_is_chosen_by_name_by_a_file_and_by_a_runs_json(
    profile: Profile, tmp_path: Path
) -> None:
    assert read_as_built(Path(profile)) == (profile, {})
    own = tmp_path / "own.toml"
    own.write_text(f'profile = "{profile}"\n[driveline]\nbacklash_deg = 0.5\n')
    assert read_as_built(own) == (profile, {"driveline.backlash_deg": 0.5})
    built = draw_as_built(4, profile=profile)
    run_json = tmp_path / "run.json"
    run_json.write_text(json.dumps({"as_built": built.to_json()}))
    chosen = read_as_built(run_json)
    assert draw_as_built(5, chosen.fixed, chosen.profile) == built


def test_a_file_without_a_profile_and_one_that_nobody_knows(tmp_path: Path) -> None:
    """A run's JSON without one was written before there were any: it is a clean gearbox."""
    old = tmp_path / "old.json"
    old.write_text(json.dumps({"as_built": {"oil": {"temperature_c": 60.0}}}))
    assert read_as_built(old) == (Profile.CLEAN, {"oil.temperature_c": 60.0})
    own = tmp_path / "own.toml"
    own.write_text("[oil]\ntemperature_c = 60.0\n")
    assert read_as_built(own).profile is DEFAULT_PROFILE
    own.write_text('profile = "rough"\n')
    with pytest.raises(AsBuiltError, match=r"rough.*clean, typical, harsh"):
        read_as_built(own)
    with pytest.raises(AsBuiltError, match=r"rough: no such file.*clean, typical, harsh"):
        read_as_built(Path("rough"))


def test_other_conditions_of_work_are_the_benches_work_and_keep_the_balance() -> None:
    truck = world({}, seed=3, profile=Profile.TYPICAL)
    run(truck, 200_000)
    truck.change_conditions({"vehicle.mass_kg": 12_000.0, "oil.temperature_c": 50.0})
    run(truck, 700_000)
    assert truck.plant.p.oil_k == pytest.approx(323.15)
    assert truck.built["vehicle.mass_kg"] == 12_000.0
    radius_m = truck.plant.p.road.wheel_m
    assert truck.plant.p.twisting.vehicle_kgm2 == pytest.approx(12_000.0 * radius_m**2)
    energy = truck.plant.energy
    residue = energy.put_in - energy.lost - energy.climbed - energy.kinetic
    assert abs(residue) < 1e-6 * (abs(energy.put_in) + energy.lost)
    with pytest.raises(SettingsError, match=r"dog\.overlap_mm"):
        truck.change_conditions({"dog.overlap_mm": 1.0})
