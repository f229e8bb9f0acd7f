"""A splitter with dog teeth: its sleeve between the two gears of the input shaft, by the same laws
as the main sleeves, on an input shaft that is far lighter than what it meets."""

from __future__ import annotations

import math

import pytest
from truck_bench import run, switch, world

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import Sleeve, SplitGear
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.rig_sim.presets import build_world
from meshpoint.rig_sim.settings import Preset, Profile, RigSettings, SettingsError
from meshpoint.rig_sim.shared.engagement import Engaged, Violation
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck.world import TruckWorld
from meshpoint.units import RPM

DOG = load_sheet("truck12-dog")
LOW, HIGH = SplitGear.LOW_SPLIT, SplitGear.HIGH_SPLIT


def opened(**fixed: float) -> TruckWorld:
    """In gear 12, its clutch open, its splitter pulled out of the high step at 200 ms."""
    values = {name.replace("__", "."): value for name, value in fixed.items()}
    truck = world(values, DOG, start_gear=12, main_speed_rpm=1000.0)
    hold_open(truck, 0, 200)
    switch(truck, Valve.SPLIT_LOW, True, 200_000.0)
    switch(truck, Valve.SPLIT_LOW, False, 217_000.0)
    hold_open(truck, 200, 300)
    return truck


def hold_open(truck: TruckWorld, from_ms: int, until_ms: int) -> None:
    for at_ms in range(from_ms, until_ms, 50):
        truck.command_clutch(False, 1000 * at_ms)
        run(truck, 1000 * min(at_ms + 50, until_ms))


def fire(truck: TruckWorld, valve: Valve, at_ms: int, for_ms: int = 250) -> list[Engaged]:
    """What sleeve and gear do, the valve on for so long."""
    truck.take_engaged()
    switch(truck, valve, True, 1000.0 * at_ms)
    hold_open(truck, at_ms, at_ms + for_ms)
    return truck.take_engaged()


def test_without_a_step_the_input_shaft_turns_alone() -> None:
    """Thesis 4.6, 4.11: its own drag on its own inertia, whatever layshaft and vehicle do."""
    truck = opened(clutch__drag_nm=0.0)
    p, begun = truck.plant.p, truck.plant.input_rad_s
    hold_open(truck, 300, 800)
    expected = begun * math.exp(-p.drag_input_nms / p.inertia_kgm2[1] * 0.5)
    assert truck.plant.input_rad_s == pytest.approx(expected, rel=1e-3)
    held = 1000.0 * RPM / truck.plant.ratio(truck.truth.locked_gear)
    assert truck.plant.layshaft_rad_s > 0.98 * held


def test_the_phase_goes_with_the_slip() -> None:
    """Gear less sleeve, as in the main box: d phase/dt = i w_LS - w_IS."""
    truck = opened()
    before, at_us = truck.truth.phase_rad(LOW), truck.plant.time_us
    slip = truck.truth.slip_rad_s(LOW)
    assert slip == pytest.approx(
        truck.plant.layshaft_rad_s * 43 / 33 - truck.plant.input_rad_s, rel=1e-12
    )
    hold_open(truck, 300, 301)
    turned = slip * (truck.plant.time_us - at_us) * 1e-6
    pitch = DOG.teeth_of(Sleeve.SPLITTER).pitch_rad
    gone = truck.truth.phase_rad(LOW) - before - turned
    assert math.remainder(gone, pitch) == pytest.approx(0.0, abs=2e-3)


def test_a_strike_takes_what_the_two_inertias_give() -> None:
    """J_eq dw^2 (1 - e^2) / 2, where the layshaft with the vehicle behind it is as good as a wall:
    J_eq is that of the input shaft but for 2 %."""
    truck = opened(dog__restitution=0.3, dog__face_friction=0.0)
    hold_open(truck, 300, 400)
    locked = [e for e in fire(truck, Valve.SPLIT_HIGH, 400) if e.event is EngagementEvent.LOCKED]
    (first,) = locked[:1]
    j_kgm2 = truck.plant.p.inertia_kgm2[1]
    expected = 0.5 * j_kgm2 * first.slip_rad_s**2 * (1.0 - 0.3**2)
    assert first.gear is HIGH
    assert 10.0 * RPM < first.slip_rad_s < 120.0 * RPM
    assert 0.9 * expected < first.tally.impact_j <= 1.001 * expected


def test_gap_or_tooth_by_the_phase_at_contact() -> None:
    """The contact rule of the main box."""
    met = set()
    for at_ms in range(330, 420, 6):
        truck = opened()
        hold_open(truck, 300, at_ms)
        contact = next(
            e
            for e in fire(truck, Valve.SPLIT_HIGH, at_ms)
            if e.event in (EngagementEvent.GAP_CONTACT, EngagementEvent.TOOTH_CONTACT)
        )
        half = truck.sheet.dog.backlash_rad / 2.0
        chamfer = truck.built["dog.chamfer_mm"] * 1e-3 / truck.sheet.dog.radius_m
        is_gap = contact.event is EngagementEvent.GAP_CONTACT
        assert (
            (abs(contact.phase_rad) < half + chamfer)
            if is_gap
            else (abs(contact.phase_rad) >= half)
        )
        met.add(is_gap)
        assert not truck.truth.violations
        if is_gap:
            assert truck.engagement.sleeves[Sleeve.SPLITTER].state is SleeveState.LOCKED
    assert met == {True, False}


def test_a_sleeve_at_a_step_of_another_speed_grinds() -> None:
    """Run through to the low step, 23 % off: counted, as of a main gear. Its teeth bounce off until
    friction on their faces has brought the light input shaft along."""
    truck = opened()
    events = fire(truck, Valve.SPLIT_LOW, 300)
    locked = next(e for e in events if e.event is EngagementEvent.LOCKED)
    assert truck.truth.violations[Violation.SLIP_AT_CONTACT] > 0
    assert locked.tally.ratchets > 0
    assert abs(locked.slip_rad_s) < abs(events[0].slip_rad_s)


def test_the_bench_changes_the_step_on_its_way_back() -> None:
    """Locked in the step of the gear, at full stroke, and the input shaft turns with it."""
    truck = world({}, DOG, start_gear=12, main_speed_rpm=900.0)
    for number in (11, 8, 12, 3):
        since_us = round(truck.plant.time_us)
        truck.return_to_gear(number, 90.0, since_us)
        run(truck, since_us + 1_500_000)
        ready = [e for e in truck.take_engaged() if e.event is EngagementEvent.READY]
        assert [e.drive_gear for e in ready] == [number]
        wanted = HIGH if number % 2 == 0 else LOW
        assert truck.plant.shafts.split_lock is not None
        assert truck.plant.shafts.split_lock.gear is wanted
        assert abs(truck.truth.slip_rad_s(wanted)) < 30.0 * RPM


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("main_rad_s", [60.0, 15.0])
def test_the_bench_comes_to_each_step_whatever_its_teeth_meet(seed: int, main_rad_s: float) -> None:
    """No tooth bounces for ever between two shafts that the bench drives, in crawl neither, where
    the main gear's slip is four times that at the splitter."""
    truck = world({}, DOG, seed=seed, start_gear=1, main_speed_rpm=100.0, profile=Profile.TYPICAL)
    asked = (3, 1, 4, 5, 2, 7, 8, 1, 14, 13)
    for number in asked:
        truck.return_to_gear(number, main_rad_s, round(truck.plant.time_us))
        run(truck, round(truck.plant.time_us) + 900_000)
    ready = [e for e in truck.take_engaged() if e.event is EngagementEvent.READY]
    assert [e.drive_gear for e in ready] == list(asked)


def test_only_preset_truck_has_one() -> None:
    with pytest.raises(SettingsError, match=r'splitter\.engagement = "dog", allowed is "cones"'):
        build_world(DOG, RigSettings(preset=Preset.THESIS))
    with pytest.raises(SettingsError, match=r"sleeve\.model = 0"):
        world({"sleeve.model": 0.0}, DOG)


def test_a_seed_gives_the_gearbox_that_it_gives_with_cones() -> None:
    """But for the splitter's own draws."""
    dog, cones = world({}, DOG, seed=5), world({}, load_sheet("truck12"), seed=5)
    assert dog.as_built == cones.as_built
    assert dog.truth.angles[1:] == cones.truth.angles[1:]
    assert dog.plant.shafts.phases_rad() == cones.plant.shafts.phases_rad()
