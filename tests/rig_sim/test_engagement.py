"""Tooth and gap: the contact rule, the way to the flank, and what must not happen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from rig_bench import SHEET, RigBench, release_first, thesis_rig, upshift

from meshpoint.dbc.messages import EngagementEvent, ValveAction, ValveCommand
from meshpoint.gearbox.gears import MainGear, Sleeve
from meshpoint.rig_sim.shared.engagement import Engaged, Violation
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.shared.valve_drivers import Order, Valve
from meshpoint.rig_sim.thesis.world import World
from meshpoint.units import RPM

PITCH = SHEET.dog.pitch_rad
BACKLASH = SHEET.dog.backlash_rad
SLIP = 20.0 * RPM  # the slip the bench script engages with, kept constant


def run_world(world: World, until_us: int) -> None:
    while world.run_to(until_us):
        pass


@pytest.fixture(scope="module")
def engagements() -> list[dict[EngagementEvent, Engaged]]:
    """Scripted engagements of SECOND, whose phase no seed ties to that of the start gear."""
    runs = []
    for seed in range(250):
        world = World(SHEET, thesis_rig(seed=seed))
        run_world(world, 10_000)
        world.return_to_gear(10, 644.0 * RPM, 10_000)
        run_world(world, 520_000)
        runs.append({engaged.event: engaged for engaged in world.engagement.engaged})
    return runs


def test_tooth_meets_tooth_as_often_as_the_gap_is_narrow(
    engagements: list[dict[EngagementEvent, Engaged]],
) -> None:
    teeth = sum(EngagementEvent.TOOTH_CONTACT in run for run in engagements)
    expected = 1.0 - BACKLASH / PITCH
    spread = math.sqrt(expected * (1.0 - expected) / len(engagements))
    assert teeth / len(engagements) == pytest.approx(expected, abs=3.0 * spread)


def test_contact_is_in_the_gap_exactly_where_the_phase_says_so(
    engagements: list[dict[EngagementEvent, Engaged]],
) -> None:
    for run in engagements:
        tooth, gap = run.get(EngagementEvent.TOOTH_CONTACT), run.get(EngagementEvent.GAP_CONTACT)
        assert (tooth is None) != (gap is None)
        if gap is not None:
            assert abs(gap.phase_rad) < BACKLASH / 2
        if tooth is not None:
            assert BACKLASH / 2 <= abs(tooth.phase_rad) <= PITCH / 2


def test_the_slide_to_the_gap_and_on_to_the_flank_takes_the_slips_time(
    engagements: list[dict[EngagementEvent, Engaged]],
) -> None:
    slides = []
    for run in engagements:
        locked = run[EngagementEvent.LOCKED]
        entered = run.get(EngagementEvent.GAP_CONTACT)
        if (tooth := run.get(EngagementEvent.TOOTH_CONTACT)) is not None:
            entered = run[EngagementEvent.TOOTH_PASSED]
            phase = tooth.phase_rad % PITCH
            slide_s = (entered.time_us - tooth.time_us) * 1e-6
            assert slide_s == pytest.approx((PITCH - BACKLASH / 2 - phase) / SLIP, abs=1e-9)
            assert entered.phase_rad == pytest.approx(-BACKLASH / 2, abs=1e-12)
            slides.append(slide_s)
        way_s = (locked.time_us - entered.time_us) * 1e-6
        assert way_s == pytest.approx((BACKLASH / 2 - entered.phase_rad) / SLIP, abs=1e-9)
        assert locked.phase_rad == BACKLASH / 2
        assert locked.slip_rad_s == pytest.approx(SLIP)
    mean_s = (PITCH - BACKLASH) / (2.0 * SLIP)
    spread_s = 2.0 * mean_s / math.sqrt(12.0 * len(slides))
    assert np.mean(slides) == pytest.approx(mean_s, abs=3.0 * spread_s)


def test_delays_are_normal_and_cut_at_their_limit() -> None:
    delays = []
    for seed in range(300):
        world = World(SHEET, thesis_rig(seed=seed))
        delays += [world.engagement._delays.draw_s() for _ in range(10)]
    assert max(abs(delay - 0.045) for delay in delays) <= 0.005
    assert np.mean(delays) == pytest.approx(0.045, abs=3 * 0.0025 / math.sqrt(len(delays)))
    # a normal cut at two standard deviations has 0.8796 of its spread
    assert np.std(delays) == pytest.approx(0.8796 * 0.0025, rel=0.05)


def test_a_shift_by_valves_ends_locked_at_a_flank_of_the_new_gear() -> None:
    for seed in range(5):
        bench = RigBench(thesis_rig(seed=seed))
        bench.run(1_000_000, upshift)
        truth = bench.core.truth
        assert truth.locked_gear is MainGear.SECOND
        assert truth.speeds_rad_s[1] * SHEET.main.second.ratio == pytest.approx(644.0 * RPM)
        (locked,) = bench.events(EngagementEvent.LOCKED)
        assert truth.phase_rad(MainGear.SECOND) == math.copysign(BACKLASH / 2, locked.slip_rad_s)
        assert truth.violations == {}


def test_contact_comes_a_delay_after_the_activations_microsecond() -> None:
    sheet = replace(SHEET, sleeve=replace(SHEET.sleeve, delay_sd_s=0.0))
    bench = RigBench(thesis_rig(seed=1), sheet)

    def valves(now_us: int) -> ValveCommand:
        if 700_000 <= now_us < 800_000:
            return ValveCommand(
                main_third_action=ValveAction.ON_AT, main_third_time_us=bench.clock(712_345)
            )
        return release_first(now_us)

    bench.run(900_000, valves)
    contacts = bench.events(EngagementEvent.TOOTH_CONTACT)
    contacts += bench.events(EngagementEvent.GAP_CONTACT)
    assert contacts[0].event_time_us == bench.clock(712_345 + 45_000)


def coasting_world(seed: int, omega_rad_s: float) -> World:
    """A world in neutral, its layshaft coasting at a speed."""
    world = World(SHEET, thesis_rig(seed=seed))
    run_world(world, 10_000)
    world.return_to_gear(0, 644.0 * RPM, 10_000)
    run_world(world, 400_000)
    world.plant.script_layshaft(0.0)
    world.plant._layshaft.record.speed_rad_s = omega_rad_s
    world.plant.coast()
    world.engagement.engaged.clear()
    return world


def only(valve: Valve) -> tuple[Order, ...]:
    return tuple(
        Order(ValveAction.ON_NOW if each is valve else ValveAction.OFF_NOW) for each in Valve
    )


def test_a_slip_that_dies_on_the_tooth_carries_it_out_at_the_other_side() -> None:
    """Friction takes the slip through zero while the sleeve rests on the tooth."""
    synchronous = 644.0 * RPM / SHEET.main.second.ratio
    turned_round = 0
    for seed in range(12):
        world = coasting_world(seed, synchronous * 1.015)
        now_us = 400_000
        while now_us < 1_200_000:
            world.command_valves(only(Valve.MAIN_SECOND), now_us)
            now_us += 50_000
            run_world(world, now_us)
        records = {record.event: record for record in world.engagement.engaged}
        contact = records.get(EngagementEvent.TOOTH_CONTACT)
        locked = records[EngagementEvent.LOCKED]
        assert locked.phase_rad == math.copysign(BACKLASH / 2, locked.slip_rad_s)
        if contact is None or contact.slip_rad_s < 0.0:
            continue
        passed = records[EngagementEvent.TOOTH_PASSED]
        if passed.slip_rad_s < 0.0:
            turned_round += 1
            assert passed.phase_rad == BACKLASH / 2
            assert contact.phase_rad % PITCH > BACKLASH / 2
    assert turned_round > 0


def test_a_sleeve_whose_valve_goes_off_on_the_tooth_falls_back() -> None:
    for seed in range(30):
        world = coasting_world(seed, 100.0)
        world.command_valves(only(Valve.MAIN_THIRD), 400_000)
        run_world(world, 446_000)
        sleeve = world.engagement.sleeves[Sleeve.CRAWL_THIRD]
        if sleeve.state is SleeveState.FACE:
            world.command_valves(only(Valve.BRAKE), 446_000)
            assert sleeve.state is SleeveState.RETRACT
            run_world(world, 460_000)
            assert sleeve.state is SleeveState.NEUTRAL
            assert sleeve.position_m(460_000) == 0.0
            return
    pytest.fail("no seed rests on a tooth")


def test_a_locked_gear_stays_when_its_valve_goes_off() -> None:
    bench = RigBench(thesis_rig(seed=2))
    bench.run(1_500_000, upshift)
    assert bench.core.truth.sleeve_state(Sleeve.FIRST_SECOND) is SleeveState.LOCKED


@pytest.mark.parametrize("on_ms", [10, 14, 25])
def test_a_gear_that_is_pulled_stays_in_until_its_sleeve_moves_and_then_comes_out(
    on_ms: int,
) -> None:
    """A sleeve that moves does not turn round because its air is cut off."""
    world = World(SHEET, thesis_rig(seed=2))
    run_world(world, 10_000)
    sleeve = world.engagement.sleeves[Sleeve.FIRST_SECOND]
    assert sleeve.state is SleeveState.LOCKED
    off_us = 10_000 + 1_000 * on_ms
    world.command_valves(only(Valve.MAIN_SECOND), 10_000)
    run_world(world, off_us)
    world.command_valves(tuple(Order(ValveAction.OFF_NOW) for _ in Valve), off_us)
    run_world(world, 70_000)
    moves = 1e-3 * on_ms > SHEET.sleeve.valve_delay_s
    assert sleeve.state is (SleeveState.NEUTRAL if moves else SleeveState.LOCKED)
    assert sleeve.position_m(70_000) == (0.0 if moves else -SHEET.sleeve.stroke_m)


def test_a_second_gear_is_a_counted_violation_and_the_first_stays() -> None:
    bench = RigBench(thesis_rig(seed=5))
    on = ValveCommand(main_third_action=ValveAction.ON_NOW)
    bench.run(1_000_000, lambda now_us: on)
    truth = bench.core.truth
    assert truth.violations == {Violation.TWO_GEARS: 1, Violation.SLIP_AT_CONTACT: 1}
    assert truth.locked_gear is MainGear.FIRST
    assert truth.sleeve_state(Sleeve.CRAWL_THIRD) is SleeveState.FACE


def test_braking_in_gear_moves_nothing_and_is_counted() -> None:
    bench = RigBench(thesis_rig(seed=5))
    on = ValveCommand(brake_action=ValveAction.ON_NOW)
    bench.run(500_000, lambda now_us: on)
    assert bench.core.truth.violations == {Violation.BRAKE_IN_GEAR: 1}
    assert bench.core.truth.speeds_rad_s[1] == pytest.approx(1400.0 * RPM)
    assert bench.core.truth.brake_gauge_pa > 7e5


@pytest.mark.parametrize(("lasts_ms", "counted"), [(30, 0), (60, 1)])
def test_a_short_pulse_of_the_brake_that_begins_on_a_tooth_is_none_in_gear(
    lasts_ms: int, counted: int
) -> None:
    """The gap comes by some milliseconds after the sleeve has met its gear, at once."""
    bench = RigBench(thesis_rig(seed=0))
    truth, second = bench.core.truth, ValveCommand(main_second_action=ValveAction.ON_NOW)
    both = second._replace(brake_action=ValveAction.ON_NOW)
    bench.run(150_000, lambda now_us: second)
    bench.run(200_000, lambda now_us: ValveCommand())
    while truth.sleeve_state(Sleeve.FIRST_SECOND) is not SleeveState.FACE:
        bench.send(second)
        bench.step(bench.now_us + 100)
    ends_us = bench.now_us + 1_000 * lasts_ms
    while bench.now_us < ends_us + 50_000:
        bench.send(both if bench.now_us < ends_us else second)
        bench.step(bench.now_us + 100)
    assert truth.locked_gear is MainGear.SECOND
    assert truth.violations.get(Violation.BRAKE_IN_GEAR, 0) == counted


def test_the_brake_in_one_gear_is_counted_though_another_sleeve_stands_on_a_tooth() -> None:
    bench = RigBench(thesis_rig(seed=5))
    pushed = ValveCommand(main_third_action=ValveAction.ON_NOW)
    bench.run(500_000, lambda now_us: pushed)
    assert bench.core.truth.sleeve_state(Sleeve.CRAWL_THIRD) is SleeveState.FACE
    both = pushed._replace(brake_action=ValveAction.ON_NOW)
    bench.run(520_000, lambda now_us: both)
    assert bench.core.truth.violations[Violation.BRAKE_IN_GEAR] == 1


def test_both_valves_of_a_sleeve_move_nothing_and_are_counted() -> None:
    bench = RigBench(thesis_rig(seed=5))
    on = ValveCommand(main_crawl_action=ValveAction.ON_NOW, main_third_action=ValveAction.ON_NOW)
    bench.run(500_000, lambda now_us: on)
    assert bench.core.truth.violations == {Violation.BOTH_VALVES: 1}
    assert bench.core.truth.sleeve_state(Sleeve.CRAWL_THIRD) is SleeveState.NEUTRAL


def test_splitter_and_range_valves_are_ignored_and_said_so() -> None:
    bench = RigBench(thesis_rig(seed=5))
    on = ValveCommand(split_low_action=ValveAction.ON_NOW)
    bench.run(500_000, lambda now_us: on)
    assert any("SPLIT_LOW ignored" in line for line in bench.lines)
    assert bench.core.truth.speeds_rad_s[0] == pytest.approx(
        1400.0 * RPM / SHEET.splitter.high.ratio
    )
