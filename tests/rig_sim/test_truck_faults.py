"""Every fault that can be injected does what it says, and ends."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
from rig_bench import RigBench, upshift
from truck_bench import run, switch, world

from meshpoint.dbc.link import FrameVerdict, Received
from meshpoint.dbc.messages import (
    BenchFault,
    EdgesMainRise,
    EngagementEvent,
    GearboxSensors,
    RigFault,
    SleevesMain,
    ValveAction,
    ValveCommand,
)
from meshpoint.gearbox.gears import MainGear, Sleeve
from meshpoint.rig_sim import RigSettings
from meshpoint.rig_sim.orders import EngineRequest, FaultOrder, ScheduledFault
from meshpoint.rig_sim.parts.engine import SPEED_CONTROL
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.shared.sleeves import SleeveState
from meshpoint.rig_sim.shared.valve_drivers import Valve
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.faults import KINDS
from meshpoint.rig_sim.truck.scenario import ScenarioError, load_scenario
from meshpoint.rig_sim.truck.world import TruckWorld

MAIN_RISE = 4


def counted(truck: TruckWorld, from_us: int, to_us: int) -> int:
    run(truck, from_us)
    before = truck.plant.rig.captured.channels[MAIN_RISE].count
    run(truck, to_us)
    return truck.plant.rig.captured.channels[MAIN_RISE].count - before


def with_fault(
    kind: RigFault, target: int = 0, value: float = 0.0, at_us: int = 100_000, for_us: int = 100_000
) -> TruckWorld:
    order = FaultOrder(int(kind), target, value, for_us)
    return world({"hall.jitter_us": 0.0}, faults=(ScheduledFault(at_us, order),))


@pytest.mark.parametrize(
    ("kind", "value", "share"),
    [
        (RigFault.HALL_DROPOUT, 0.0, 0.0),
        (RigFault.HALL_DOUBLE_EDGE, 0.0, 2.0),
        (RigFault.HALL_NOISE_BURST, 3.0, 4.0),
    ],
)
def test_a_hall_channel_says_less_or_more_for_a_time(
    kind: RigFault, value: float, share: float
) -> None:
    truck = with_fault(kind, MAIN_RISE, value)
    usual = counted(truck, 10_000, 90_000)
    wrong = counted(truck, 110_000, 190_000)
    again = counted(truck, 210_000, 290_000)
    assert wrong == pytest.approx(share * usual, abs=4)
    assert again == pytest.approx(usual, abs=2)


@pytest.mark.parametrize("factor", [2.0, 0.5, 0.8])
@pytest.mark.parametrize("wheel", range(4))
def test_a_wheel_that_reads_wrong_gives_so_many_times_its_edges_on_both_channels(
    wheel: int, factor: float
) -> None:
    truck = with_fault(RigFault.WHEEL_FACTOR, wheel, factor)
    channels = truck.plant.rig.captured.channels
    reads = []
    for until_us in (10_000, 90_000, 110_000, 190_000, 210_000, 290_000):
        run(truck, until_us)
        reads.append([channel.count for channel in channels])
    usual, wrong, again = (
        [late - early for early, late in zip(reads[k], reads[k + 1], strict=True)]
        for k in (0, 2, 4)
    )
    for channel in range(8):
        share = factor if channel // 2 == wheel else 1.0
        assert wrong[channel] == pytest.approx(share * usual[channel], abs=4)
        assert again[channel] == pytest.approx(usual[channel], abs=2)


def test_a_missing_tooth_is_missing_once_a_turn() -> None:
    truck = with_fault(RigFault.HALL_MISSING_TOOTH, MAIN_RISE, 7.0, at_us=0, for_us=0)
    whole = world({"hall.jitter_us": 0.0})
    turns = 5
    until_us = int(turns * 60e6 / 644.0)
    lost = counted(whole, 0, until_us) - counted(truck, 0, until_us)
    assert lost == turns


def test_a_stuck_valve_does_not_follow_its_coil_and_a_slow_one_later() -> None:
    truck = with_fault(RigFault.VALVE_STUCK, int(Valve.BRAKE))
    switch(truck, Valve.BRAKE, True, 110_000.0)
    run(truck, 180_000)
    assert truck.plant.brake_gauge_pa < 1e3
    slow = with_fault(RigFault.VALVE_SLOW, int(Valve.BRAKE), value=30.0)
    switch(slow, Valve.BRAKE, True, 110_000.0)
    run(slow, 140_000)
    assert slow.plant.brake_gauge_pa < 1e3
    run(slow, 180_000)
    assert slow.plant.brake_gauge_pa > 1e5


@pytest.mark.parametrize("valve", [Valve.BRAKE, Valve.MAIN_THIRD])
def test_a_valve_that_is_slow_to_open_does_not_stay_open_after_a_pulse_that_is_shorter(
    valve: Valve,
) -> None:
    truck = with_fault(RigFault.VALVE_SLOW_ON, int(valve), value=20.0, for_us=0)
    switch(truck, valve, True, 110_000.0)
    switch(truck, valve, False, 120_000.0)
    run(truck, 400_000)
    assert truck.plant.brake_gauge_pa < 2e3
    assert not any(truck.truth.axis(Sleeve.CRAWL_THIRD, 400_000).spools)


def main_sleeve_m(truck: TruckWorld, until_us: int) -> float:
    run(truck, until_us)
    return truck.truth.axis(Sleeve.CRAWL_THIRD, until_us).position_m


def fired(kind: RigFault, target: int, value: float, for_us: int = 0) -> TruckWorld:
    """Third's valve is on from 110 to 150 ms; the sleeve stands in neutral before."""
    truck = with_fault(kind, target, value, at_us=50_000, for_us=for_us)
    switch(truck, Valve.MAIN_THIRD, True, 110_000.0)
    return truck


SOUND = (RigFault.NO_FAULT, 0, 0.0)


@pytest.mark.parametrize(
    ("kind", "target", "value"),
    [
        (RigFault.VALVE_SLOW, Valve.MAIN_THIRD, 10.0),
        (RigFault.VALVE_SLOW_ON, Valve.MAIN_THIRD, 10.0),
        (RigFault.SLEEVE_STIFF, Sleeve.CRAWL_THIRD, 200.0),
        (RigFault.SLEEVE_HEAVY, Sleeve.CRAWL_THIRD, 500.0),
    ],
)
def test_a_sleeve_with_a_slow_valve_or_stiff_or_heavy_is_behind_a_sound_one_until_it_ends(
    kind: RigFault, target: int, value: float
) -> None:
    sound_m = abs(main_sleeve_m(fired(*SOUND), 145_000))
    assert abs(main_sleeve_m(fired(kind, target, value), 145_000)) < sound_m - 0.2e-3
    mended_m = abs(main_sleeve_m(fired(kind, target, value, for_us=40_000), 145_000))
    assert mended_m == pytest.approx(sound_m, abs=1e-9)


def test_a_valve_slow_to_close_opens_in_time_and_closes_late() -> None:
    truck = fired(RigFault.VALVE_SLOW_OFF, Valve.MAIN_THIRD, 30.0)
    assert main_sleeve_m(truck, 140_000) == main_sleeve_m(fired(*SOUND), 140_000)
    switch(truck, Valve.MAIN_THIRD, False, 141_000.0)
    run(truck, 165_000)
    assert any(truck.truth.axis(Sleeve.CRAWL_THIRD, 165_000).spools)
    run(truck, 190_000)
    assert not any(truck.truth.axis(Sleeve.CRAWL_THIRD, 190_000).spools)


def test_a_leaking_valve_raises_its_chamber_with_its_coil_off_until_it_ends() -> None:
    truck = with_fault(RigFault.VALVE_LEAKS, int(Valve.MAIN_THIRD), 20.0)
    run(truck, 90_000)
    vented_pa = max(truck.truth.axis(Sleeve.CRAWL_THIRD, 90_000).pressures_pa)
    run(truck, 190_000)
    leaking = truck.truth.axis(Sleeve.CRAWL_THIRD, 190_000)
    assert max(leaking.pressures_pa) > vented_pa + 1e4
    assert not any(leaking.spools)
    run(truck, 500_000)
    after_pa = max(truck.truth.axis(Sleeve.CRAWL_THIRD, 500_000).pressures_pa)
    assert after_pa == pytest.approx(vented_pa, abs=1e3)


def test_only_a_main_valve_leaks() -> None:
    truck = with_fault(RigFault.VALVE_LEAKS, int(Valve.BRAKE), 20.0)
    run(truck, 110_000)
    assert not truck.faults.active


@pytest.mark.parametrize("on", [True, False])
def test_a_valve_that_was_stuck_is_as_its_coil_is_when_the_fault_ends(on: bool) -> None:
    truck = with_fault(RigFault.VALVE_STUCK, int(Valve.BRAKE), for_us=150_000)
    for k, now_us in enumerate((50_000.0, 110_000.0, 120_000.0, 130_000.0)):
        coil = on if k % 2 else not on  # the coil is as at the beginning after two changes
        switch(truck, Valve.BRAKE, coil, now_us)
    run(truck, 240_000)
    stuck_pa = truck.plant.brake_gauge_pa
    assert stuck_pa < 1e3 if on else stuck_pa > 1e5
    run(truck, 600_000)
    freed_pa = truck.plant.brake_gauge_pa
    assert freed_pa > 1e5 if on else freed_pa < 1e4


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_sleeve_that_too_little_air_leaves_on_a_tooth_goes_in_when_the_air_is_back(
    seed: int,
) -> None:
    """Its cylinder has the pressure of the tank, not that of the moment its valve was switched."""
    order = FaultOrder(int(RigFault.SUPPLY_DROP), 0, 2.2, 900_000)
    truck = world(seed=seed, faults=(ScheduledFault(100_000, order),))
    run(truck, 150_000)
    truck.return_to_gear(8, 60.0, 150_000)
    run(truck, 950_000)
    assert truck.truth.locked_gear is not MainGear.FIRST
    run(truck, 3_000_000)
    assert truck.truth.locked_gear is MainGear.FIRST


def test_the_supply_drops_and_comes_back() -> None:
    truck = with_fault(RigFault.SUPPLY_DROP, value=4.0)
    run(truck, 150_000)
    assert truck.sensors(150_000).supply_pa == pytest.approx(4e5, rel=0.01)
    run(truck, 30_000_000)
    assert truck.sensors(30_000_000).supply_pa > 8e5


def test_a_jammed_sleeve_stays_in_its_gear() -> None:
    truck = with_fault(RigFault.SLEEVE_JAMMED, int(Sleeve.FIRST_SECOND), for_us=0)
    switch(truck, Valve.MAIN_SECOND, True, 150_000.0)
    run(truck, 400_000)
    assert truck.truth.sleeve_state(Sleeve.FIRST_SECOND) is SleeveState.LOCKED


@pytest.mark.parametrize(
    ("name", "valves"),
    [
        (Sleeve.SPLITTER, (Valve.SPLIT_LOW, Valve.SPLIT_HIGH)),
        (Sleeve.RANGE, (Valve.RANGE_LOW, Valve.RANGE_HIGH)),
    ],
)
def test_a_jammed_splitter_or_range_stays_at_its_side_for_as_long(
    name: Sleeve, valves: tuple[Valve, Valve]
) -> None:
    """Asked to the side where it does not stand; reported again after the fault, it goes there."""
    truck = with_fault(RigFault.SLEEVE_JAMMED, int(name), for_us=200_000)
    sleeve = truck.script.step_sleeve(name)
    assert sleeve is not None
    side = sleeve.side
    other = valves[0] if side > 0 else valves[1]
    truck.plant.chain.open(at.CLUTCH)
    switch(truck, other, True, 150_000.0)
    run(truck, 290_000)
    assert sleeve.side == side
    switch(truck, other, True, 350_000.0)
    run(truck, 360_000)
    assert sleeve.side == -side


def test_a_position_sensor_lies_and_another_repeats_itself() -> None:
    truck = with_fault(RigFault.POSITION_OFFSET, int(Sleeve.CRAWL_THIRD), value=2.0)
    run(truck, 50_000)
    before = truck.sleeve_samples_m(Sleeve.CRAWL_THIRD, 50_000)[0]
    run(truck, 150_000)
    after = truck.sleeve_samples_m(Sleeve.CRAWL_THIRD, 150_000)[0]
    assert after - before == pytest.approx(2e-3, abs=3e-4)
    frozen = with_fault(RigFault.POSITION_FROZEN, int(Sleeve.CRAWL_THIRD))
    run(frozen, 90_000)
    frozen.sleeve_samples_m(Sleeve.CRAWL_THIRD, 90_000)
    run(frozen, 150_000)
    read = {frozen.sleeve_samples_m(Sleeve.CRAWL_THIRD, now) for now in (130_000, 140_000)}
    assert len(read) == 1


def test_old_content_comes_under_a_live_counter() -> None:
    order = FaultOrder(int(RigFault.FROZEN_PAYLOAD), 0, 0.0, 0)
    settings = RigSettings(profile=Profile.CLEAN, faults=(ScheduledFault(200_000, order),))
    bench = RigBench(settings)
    bench.run(400_000)
    edges = bench.of(EdgesMainRise)
    assert len(edges) == 41  # each passed its counter check
    assert len({frame.newest_index for frame in edges[22:]}) == 1
    assert len({frame.newest_index for frame in edges[:20]}) == 20


def test_a_faded_brake_brakes_less() -> None:
    speeds = []
    for share in (100.0, 30.0):
        truck = with_fault(RigFault.BRAKE_FADE, value=share, at_us=0, for_us=0)
        truck.plant.coast()
        truck.plant.chain.open(at.CLUTCH)
        truck.plant.set_brake(1.0)
        before = truck.plant.layshaft_rad_s
        run(truck, 200_000)
        speeds.append(before - truck.plant.layshaft_rad_s)
    assert speeds[1] < 0.6 * speeds[0]


def test_a_stuck_clutch_stays_and_a_deaf_engine_does_not_follow() -> None:
    truck = with_fault(RigFault.CLUTCH_STUCK, at_us=0, for_us=0)
    for now_us in range(10_000, 400_000, 10_000):
        run(truck, now_us)
        truck.command_clutch(False, now_us)
    assert truck.sensors(400_000).clutch == 1.0
    deaf = with_fault(RigFault.ENGINE_DEAF, at_us=0, for_us=0)
    run(deaf, 10_000)
    deaf.command_engine(EngineRequest(200.0, None), 10_000)
    run(deaf, 30_000)
    assert deaf.plant.g.engine_mode != SPEED_CONTROL


def test_the_bench_injects_over_the_bus_and_ends_everything() -> None:
    bench = RigBench(RigSettings(profile=Profile.CLEAN))
    bench.run(50_000)
    bench.send(BenchFault(fault=RigFault.HALL_DROPOUT, target=4, sequence=1))
    bench.run(200_000)
    silent = {frame.newest_index for frame in bench.of(EdgesMainRise)[-12:]}
    assert len(silent) == 1
    bench.send(BenchFault(fault=RigFault.NO_FAULT, sequence=2))
    bench.run(400_000)
    assert bench.of(EdgesMainRise)[-1].newest_index > max(silent) + 50
    text = "\n".join(bench.lines)
    assert "HALL_DROPOUT at 4 begins" in text
    assert "HALL_DROPOUT at 4 ends" in text


def test_the_thesis_says_that_it_has_no_faults() -> None:
    bench = RigBench()
    bench.send(BenchFault(fault=RigFault.HALL_DROPOUT, sequence=1))
    bench.run(50_000)
    assert any("fault 1 ignored" in line for line in bench.lines)


def test_a_scenario_file_says_what_when_and_how_long(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(
        '[[fault]]\nkind = "valve_slow"\ntarget = 3\nat_ms = 900.5\nvalue = 20\n'
        '[[fault]]\nkind = "hall_dropout"\ntarget = 2\nat_ms = 100\nfor_ms = 50\n'
    )
    first, second = load_scenario(path)
    assert first == ScheduledFault(100_000, FaultOrder(int(RigFault.HALL_DROPOUT), 2, 0.0, 50_000))
    assert second == ScheduledFault(900_500, FaultOrder(int(RigFault.VALVE_SLOW), 3, 20.0, 0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[fault]]\nkind = "flood"', ["flood", "hall_dropout"]),
        ('[[fault]]\nkind = "valve_stuck"\ntarget = 9', ["target", "0..8"]),
        ('[[fault]]\nkind = "hall_dropout"\nat_ms = nan', ["at_ms", "nan"]),
        ('[[fault]]\nkind = "hall_dropout"\nwhen = 1', ["when", "at_ms"]),
        ("fault = 3", ["[[fault]]"]),
        ("[other]", ["other"]),
    ],
)
def test_a_wrong_scenario_is_reported(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as error:
        load_scenario(path)
    assert all(word in str(error.value) for word in [*words, "faults.toml"])


def test_every_fault_is_described() -> None:
    assert set(KINDS) == set(RigFault)


def test_a_shift_goes_on_in_spite_of_a_bad_order_from_the_bench() -> None:
    bench = RigBench(RigSettings(profile=Profile.CLEAN))
    bench.run(100_000)
    bench.send(BenchFault(fault=RigFault.VALVE_STUCK, target=200, sequence=9))

    def valves(now_us: int) -> ValveCommand:
        command = upshift(now_us)
        return command if command else ValveCommand(brake_action=ValveAction.OFF_NOW)

    bench.run(900_000, valves)
    assert any("refused" in line for line in bench.lines)
    assert bench.events(EngagementEvent.RELEASED)
    assert bench.of(GearboxSensors)
    assert bench.of(SleevesMain)


@pytest.mark.parametrize("kind", [kind for kind in RigFault if kind is not RigFault.NO_FAULT])
def test_a_copy_of_a_faulty_truck_goes_on_as_the_truck_does_and_leaves_it_alone(
    kind: RigFault,
) -> None:
    bench = RigBench(RigSettings(profile=Profile.CLEAN, seed=3))
    bench.run(50_000)
    target = max(KINDS[kind].first, 1)
    order = BenchFault(fault=kind, target=target, value=3.0, duration_us=60_000, sequence=1)
    bench.send(order)
    bench.run(80_000)
    copied = copy.deepcopy(bench)
    copied.ears.receive = bench.ears.receive = lambda frame: Received(FrameVerdict.OK, None)  # type: ignore[method-assign,assignment]
    copied.run(300_000, upshift)
    after_us = bench.core.truth.time_us
    bench.run(300_000, upshift)
    assert after_us < 100_000.0
    assert copied.frames == bench.frames
    assert copied.lines == bench.lines
    assert any(f"{kind.name} at {target} ends" in line for line in bench.lines)
