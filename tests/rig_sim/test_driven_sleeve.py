"""A main sleeve of the truck driven by its two valves: broken off, fired again, pulled out."""

from __future__ import annotations

import copy
import math
from typing import Final

import pytest
from truck_bench import run, switch, world

from meshpoint.dbc.messages import EngagementEvent
from meshpoint.gearbox.gears import MainGear, Sleeve
from meshpoint.gearbox.sheet import load_sheet
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.shared.engagement import Violation
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck.as_built import linear
from meshpoint.rig_sim.truck.world import TruckWorld

NAME: Final = Sleeve.FIRST_SECOND
SHEET: Final = load_sheet("truck12")
FACE_M, FULL_M = SHEET.sleeve.to_contact_m, SHEET.sleeve.stroke_m
STEADY: Final = {"sleeve.noise_sd_ms": 0.0, "sleeve.stiction_ms": 0.0}
CONTACTS: Final = (EngagementEvent.TOOTH_CONTACT, EngagementEvent.GAP_CONTACT)


def in_neutral(seed: int = 1, profile: Profile = Profile.CLEAN) -> TruckWorld:
    """A truck without chance in its valves, its first/second sleeve in neutral after 100 ms."""
    truck = world(STEADY, SHEET, seed, profile=profile)
    truck.engagement.reset_sleeve(NAME)
    truck.plant.coast()
    run(truck, 100_000)
    return truck


def position_m(truck: TruckWorld) -> float:
    return truck.engagement.axis(NAME, truck.plant.time_us).position_m


def contact_us(truck: TruckWorld) -> float | None:
    found = [each.time_us for each in truck.engagement.engaged if each.event in CONTACTS]
    return found[0] if found else None


def broken_off(seed: int, before_us: float = 20_000.0, for_us: float = 10_000.0) -> TruckWorld:
    """Second gear fired, and broken off so long before its contact would have come: its coil off
    and the opposite one on, for a while."""
    truck = in_neutral(seed)
    due_us, _ = truck.truth.expected_contact_us(MainGear.SECOND, 100_000.0)
    switch(truck, Valve.MAIN_SECOND, True, 100_000.0)
    switch(truck, Valve.MAIN_SECOND, False, due_us - before_us)
    switch(truck, Valve.MAIN_FIRST, True, due_us - before_us)
    switch(truck, Valve.MAIN_FIRST, False, due_us - before_us + for_us)
    run(truck, 400_000)
    return truck


SEEDS: Final = range(1, 9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_sleeve_broken_off_in_flight_stands_before_the_teeth(seed: int) -> None:
    truck = broken_off(seed)
    assert contact_us(truck) is None
    assert 2.5e-3 < abs(position_m(truck)) < FACE_M - 0.05e-3
    assert truck.truth.sleeve_state(NAME) is SleeveState.NEUTRAL
    there_m = position_m(truck)
    assert truck.engagement.next_us == math.inf  # a rest costs nothing
    run(truck, 3_000_000)
    assert position_m(truck) == there_m


@pytest.mark.parametrize("seed", SEEDS)
def test_a_coil_that_is_off_again_within_18_ms_leaves_the_sleeve_in_its_detent(seed: int) -> None:
    truck = in_neutral(seed)
    switch(truck, Valve.MAIN_SECOND, True, 100_000.0)
    switch(truck, Valve.MAIN_SECOND, False, 118_000.0)
    run(truck, 400_000)
    assert contact_us(truck) is None
    assert abs(position_m(truck)) < 0.3e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_fired_again_from_there_it_meets_the_gear_sooner_and_when_expected(seed: int) -> None:
    truck = broken_off(seed)
    expected_us, sd_us = truck.truth.expected_contact_us(MainGear.SECOND, 450_000.0)
    switch(truck, Valve.MAIN_SECOND, True, 450_000.0)
    run(truck, 600_000)
    met_us = contact_us(truck)
    assert met_us == pytest.approx(expected_us, abs=3.0)  # the tank fills a little until then
    assert sd_us == 0.0
    assert met_us is not None
    assert met_us - 450_000.0 < 36_000.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_single_stroke_is_expected_when_it_comes(seed: int) -> None:
    truck = in_neutral(seed)
    expected_us, _ = truck.truth.expected_contact_us(MainGear.FIRST, 120_000.0)
    switch(truck, Valve.MAIN_FIRST, True, 120_000.0)
    run(truck, 300_000)
    assert contact_us(truck) == pytest.approx(expected_us, abs=1.0)
    assert expected_us - 120_000.0 == pytest.approx(45_000.0, abs=5_000.0)


def test_of_a_sleeve_under_way_the_expected_contact_knows_its_valves() -> None:
    truck = in_neutral()
    switch(truck, Valve.MAIN_SECOND, True, 100_000.0)
    run(truck, 130_000)
    # switched on once more it goes on as it is: it is driven already
    expected_us, _ = truck.truth.expected_contact_us(MainGear.SECOND, 130_000.0)
    run(truck, 300_000)
    assert contact_us(truck) == pytest.approx(expected_us, abs=1.0)


def test_what_is_expected_knows_no_chance_of_a_valve_that_is_switched_already() -> None:
    truck = world({"sleeve.noise_sd_ms": 3.0, "sleeve.noise_limit_ms": 8.0}, SHEET, 2)
    truck.engagement.reset_sleeve(NAME)
    truck.plant.coast()
    run(truck, 100_000)
    before_us, sd_us = truck.truth.expected_contact_us(MainGear.SECOND, 100_000.0)
    assert sd_us == pytest.approx(3_000.0)
    switch(truck, Valve.MAIN_SECOND, True, 100_000.0)
    run(truck, 102_000)
    after_us, _ = truck.truth.expected_contact_us(MainGear.SECOND, 102_000.0)
    run(truck, 300_000)
    met_us = contact_us(truck)
    assert met_us is not None
    assert after_us == pytest.approx(before_us, abs=1.0)
    assert abs(met_us - before_us) > 100.0


def test_a_return_to_a_gear_asked_for_again_on_its_way_ends_in_that_gear() -> None:
    truck = world(STEADY, SHEET)
    for at_us in (100_000, 130_000, 250_000, 520_000):
        run(truck, at_us)
        truck.return_to_gear(8, 60.0, at_us)
    run(truck, 550_000)
    truck.change_conditions({"oil.temperature_c": 40.0})  # while the bench moves the sleeves
    run(truck, 2_000_000)
    assert truck.truth.locked_gear is MainGear.FIRST
    assert abs(position_m(truck)) == FULL_M


def pulled_out(for_us: float, seed: int) -> TruckWorld:
    """First gear, unloaded, with the opposite valve on for so long."""
    truck = world(STEADY, SHEET, seed, start_gear=7)
    truck.command_clutch(False, 0)
    switch(truck, Valve.MAIN_SECOND, True, 300_000.0)
    switch(truck, Valve.MAIN_SECOND, False, 300_000.0 + for_us)
    run(truck, 700_000)
    return truck


@pytest.mark.parametrize("seed", SEEDS)
def test_a_short_pulse_pulls_a_gear_into_neutral_and_a_long_one_beyond(seed: int) -> None:
    short, long = pulled_out(20_000.0, seed), pulled_out(200_000.0, seed)
    away = [each.event for each in short.engagement.engaged]
    assert EngagementEvent.RELEASED in away
    assert not set(CONTACTS) & set(away)
    assert abs(position_m(short)) < FACE_M
    assert contact_us(long) is not None  # of the gear on the other side


def test_a_valve_acts_on_a_sleeve_wherever_it_is() -> None:
    """Nothing is lost because the sleeve does not stand."""
    truck = in_neutral()
    switch(truck, Valve.MAIN_SECOND, True, 100_000.0)
    switch(truck, Valve.MAIN_SECOND, False, 125_000.0)
    switch(truck, Valve.MAIN_FIRST, True, 125_000.0)
    run(truck, 300_000)
    first = [each for each in truck.engagement.engaged if each.event in CONTACTS]
    assert first[-1].gear is MainGear.FIRST


def test_both_valves_fill_both_chambers_and_are_counted() -> None:
    truck = in_neutral()
    for valve in (Valve.MAIN_FIRST, Valve.MAIN_SECOND):
        switch(truck, valve, True, 150_000.0)
    run(truck, 600_000)
    axis = truck.truth.axis(NAME, 600_000.0)
    supply_pa = truck.plant.y.supply_pa
    assert axis.pressures_pa == pytest.approx((supply_pa, supply_pa), rel=1e-2)
    assert axis.coils == axis.spools == (True, True)
    assert truck.truth.violations[Violation.BOTH_VALVES] == 1


def test_a_spool_follows_its_coil_on_and_off_late() -> None:
    truck = in_neutral()
    switch(truck, Valve.MAIN_SECOND, True, 150_000.0)
    switch(truck, Valve.MAIN_SECOND, False, 160_000.0)
    found = {}
    for now_us in range(150_000, 200_000, 500):
        run(truck, now_us)
        found[now_us] = any(truck.truth.axis(NAME, truck.plant.time_us).spools)
    on_us = [now_us for now_us, on in found.items() if on]
    assert 160_000 < min(on_us) < 164_000  # 12 ms, and at most 1.5 ms of the valve's own
    assert 170_000 < max(on_us) < 174_000


def test_a_pulse_shorter_than_its_valve_can_follow_does_not_leave_it_on() -> None:
    truck = in_neutral()
    switch(truck, Valve.MAIN_SECOND, True, 150_000.0)
    switch(truck, Valve.MAIN_SECOND, False, 150_010.0)
    run(truck, 500_000)
    assert not any(truck.truth.axis(NAME, 500_000.0).spools)
    assert position_m(truck) == pytest.approx(0.0, abs=1e-4)


def test_a_gear_in_mesh_stays_with_all_valves_off() -> None:
    truck = world(STEADY, SHEET)
    run(truck, 2_000_000)
    assert abs(truck.engagement.sleeves[NAME].position_m(2e6)) in (0.0, FULL_M)
    assert truck.truth.locked_gear is not MainGear.NEUTRAL


def test_the_same_seed_and_valves_give_the_same_stroke_however_often_one_looks() -> None:
    looked, alone = in_neutral(3), in_neutral(3)
    for truck in (looked, alone):
        switch(truck, Valve.MAIN_FIRST, True, 150_000.0)
    for now_us in range(100_000, 300_000, 700):
        run(looked, now_us)
        looked.truth.axis(NAME, looked.plant.time_us)
    run(looked, 300_000)
    run(alone, 300_000)
    assert contact_us(looked) == contact_us(alone)
    assert looked.plant.snapshot().moving == alone.plant.snapshot().moving


def test_a_copied_truck_goes_on_alike() -> None:
    truck = in_neutral(4)
    switch(truck, Valve.MAIN_FIRST, True, 150_000.0)
    run(truck, 180_000)
    twin = copy.deepcopy(truck)
    run(truck, 400_000)
    run(twin, 400_000)
    assert contact_us(twin) == contact_us(truck)
    assert position_m(twin) == position_m(truck)


def test_a_pure_delay_has_no_chambers() -> None:
    truck = world(linear(), SHEET)
    with pytest.raises(ValueError, match="pure delay"):
        truck.truth.axis(NAME, 0.0)


def test_a_sleeve_pulled_through_onto_the_other_gear_brings_no_impact_of_the_old_one() -> None:
    """Nobody has fired it: what it strikes there is not what it struck when the old gear locked."""
    truck = world(STEADY, SHEET)
    run(truck, 100_000)
    truck.return_to_gear(8, 60.0, 100_000)
    run(truck, 2_000_000)
    struck = [e for e in truck.engagement.engaged if e.event is EngagementEvent.LOCKED]
    assert struck[-1].gear is MainGear.FIRST
    assert struck[-1].tally.impact_j > 1.0
    truck.command_clutch(False, 2_000_000)
    switch(truck, Valve.MAIN_SECOND, True, 2_300_000.0)
    switch(truck, Valve.MAIN_SECOND, False, 2_400_000.0)
    switch(truck, Valve.MAIN_FIRST, True, 2_400_000.0)  # before it locks: off the teeth again
    run(truck, 3_000_000)
    beyond = [e for e in truck.engagement.engaged if e.gear is MainGear.SECOND]
    assert {e.event for e in beyond} & set(CONTACTS)
    before_lock = [e for e in beyond if e.event is not EngagementEvent.LOCKED]
    assert [e.tally.impact_j for e in before_lock] == [0.0] * len(before_lock)
    assert EngagementEvent.GIVEN_UP in {e.event for e in before_lock}
