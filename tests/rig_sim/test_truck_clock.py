"""Faults of the rig's own node and of its clock."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_bench import RigBench, edges_of, upshift

from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    EEC1,
    EdgesMainRise,
    GearboxSensors,
    ReferenceEncoder,
    RigFault,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.dbc.node import Node
from meshpoint.rig_sim import RigSettings
from meshpoint.rig_sim.orders import FaultOrder, ScheduledFault
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.shared.sensor_clock import SensorClock

LATEST_START_US = (1 << 32) - 1


def bench_with(
    kind: RigFault, value: float, at_us: int, for_us: int, start_us: int = 0
) -> RigBench:
    order = FaultOrder(int(kind), 0, value, for_us)
    return RigBench(
        RigSettings(
            seed=4,
            profile=Profile.CLEAN,
            clock_start_us=start_us,
            as_built={"hall.jitter_us": 0.0, "vehicle.constant_speed": 1.0},
            faults=(ScheduledFault(at_us, order),),
        )
    )


def healthy() -> RigBench:
    return bench_with(RigFault.NO_FAULT, 0.0, 0, 0)


@pytest.mark.parametrize("ppm", [200.0, -200.0])
def test_a_drifting_clock_stretches_every_stamp_alike(ppm: float) -> None:
    true, wrong = healthy(), bench_with(RigFault.CLOCK_DRIFT, ppm, 100_000, 0)
    for bench in (true, wrong):
        bench.run(1_100_000)
    there, here = edges_of(true.of(EdgesMainRise)), edges_of(wrong.of(EdgesMainRise))
    assert there.keys() == here.keys()
    for index, time_us in there.items():
        stretched = time_us + max(time_us - 100_000, 0) * ppm * 1e-6
        assert abs(here[index] - stretched) <= 1.0
    last = wrong.of(GearboxSensors)[-1]
    assert last.sample_time_us == 1_100_000 + round(1_000_000 * ppm * 1e-6)


@pytest.mark.parametrize("ahead_us", [30_000, -30_000])
def test_a_clock_that_steps_moves_what_comes_after_and_later_steps_back(ahead_us: int) -> None:
    bench = bench_with(RigFault.CLOCK_STEP, float(ahead_us), 205_000, 100_000, LATEST_START_US)
    bench.run(400_000)
    clocks = [
        (message.sample_time_us + 1 - 10_000 * i) % (1 << 32)
        for i, message in enumerate(bench.of(GearboxSensors))
    ]
    assert clocks == [0] * 21 + [ahead_us % (1 << 32)] * 10 + [0] * 10
    newest = bench.of(EdgesMainRise)[21]  # edges from before the step and from after it
    low = newest.timestamp_low_us[: newest.valid_stamps]
    jumps = [(b - a) % (1 << 16) for a, b in zip(low[1:], low, strict=False)]
    usual = jumps[-1]
    assert sum(abs(jump - usual) > 2_000 for jump in jumps) == 1
    assert any(abs((jump - ahead_us) % (1 << 16) - usual) <= 200 for jump in jumps)


def test_an_activation_is_switched_by_the_clock_as_it_has_become() -> None:
    bench = bench_with(RigFault.CLOCK_STEP, 20_000.0, 205_000, 0)
    at_us = 260_000  # by the clock, which then shows 20 ms more than has passed

    def valves(now_us: int) -> ValveCommand:
        if now_us < 180_000:
            return ValveCommand()
        return ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=at_us)

    bench.run(300_000, valves)
    driven = [status.brake_energised for status in bench.of(ValveStatus)]
    assert driven.index(True) == 24  # the read at 240 ms, when the clock shows 260


@pytest.mark.parametrize("ahead_us", [-1_000_000.0, -95_000.0, 95_000.0, 1_000_000.0])
def test_valves_are_off_100_ms_after_the_last_command_whatever_the_clock_does(
    ahead_us: float,
) -> None:
    """Commands stop at 200 ms; with the sensor clock as their time, valves stayed on until it had
    come to the expiry again."""
    bench = bench_with(RigFault.CLOCK_STEP, ahead_us, 205_000, 0)
    bench.run(200_000, lambda now_us: ValveCommand(brake_action=ValveAction.ON_NOW))
    assert bench.of(ValveStatus)[-1].brake_energised
    for now_us in range(201_000, 400_000, 1_000):
        bench.step(now_us)
    driven = [status.brake_energised for status in bench.of(ValveStatus)]
    last_command_us = 190_000
    assert driven[20:] == [10_000 * k < last_command_us + 100_000 for k in range(20, 40)]
    assert bench.of(ValveStatus)[-1].expired_count == 1


@pytest.mark.parametrize("ahead_us", [900_000.0, 2_000_000.0])
@pytest.mark.parametrize("at_us", [641_000, 648_500, 664_000, 680_000, 690_000])
def test_an_activation_that_the_clock_has_left_behind_is_switched_now_and_not_in_the_past(
    ahead_us: float, at_us: int
) -> None:
    """The gearbox went back in time for it: a sleeve stood on a tooth for -0.9 s, which no frame
    can say."""
    bench = bench_with(RigFault.CLOCK_STEP, ahead_us, at_us, 30_000)

    def valves(now_us: int) -> ValveCommand:
        command = upshift(now_us)
        if now_us < 630_000:
            return command
        return command._replace(
            main_second_action=ValveAction.ON_AT,
            main_second_time_us=700_000,
            brake_action=ValveAction.ON_AT,
            brake_time_us=695_000,
        )

    bench.run(900_000, valves)
    times_s = [float(line.split(" s ")[0]) for line in bench.lines]
    assert times_s == sorted(times_s)
    # The activation was 2 ms to 60 ms ahead when the clock jumped over it.
    status = bench.of(ValveStatus)[at_us // 10_000 + 1]
    assert status.main_second_energised
    assert bench.world.plant.time_us == 900_000.0


@settings(max_examples=50, deadline=None)
@given(
    changes=st.lists(
        st.tuples(st.floats(1.0, 1e6), st.integers(-50_000, 50_000), st.floats(-200.0, 200.0)),
        max_size=3,
    ),
    start_us=st.integers(0, LATEST_START_US),
    later_us=st.floats(0.0, 1e9),
)
def test_the_clock_gives_back_the_instant_that_it_showed(
    changes: list[tuple[float, int, float]], start_us: int, later_us: float
) -> None:
    clock = SensorClock(start_us)
    now_us = 0.0
    shown = [(now_us, clock.at(now_us))]
    for wait_us, ahead_us, ppm in changes:
        now_us += wait_us
        clock.step(now_us, ahead_us)
        clock.drift(now_us, ppm)
        shown.append((now_us, clock.at(now_us)))
    assert [clock.at(time_us) for time_us, _ in shown] == [value for _, value in shown]
    at_us = now_us + later_us
    assert 0.0 <= at_us - clock.when(clock.at(at_us)) <= 1.001


def test_a_restarted_node_comes_back_with_counters_clock_and_edges_from_zero() -> None:
    bench = bench_with(RigFault.NODE_RESTART, 0.0, 665_000, 100_000)
    bench.run(760_000, upshift)
    before = len(bench.frames)
    bench.ears = Receiver(Node.TRANSMISSION_CONTROL, Node.BENCH)  # the old ones would complain
    bench.run(1_000_000, upshift)
    first = {frame.can_id: frame.data for frame in reversed(bench.frames[before:])}
    sensors = CODECS[GearboxSensors.__name__].spec.can_id
    encoder = CODECS[ReferenceEncoder.__name__].spec.can_id
    assert (first[sensors][2], first[encoder][2]) == (0, 77)  # the read at 770 ms
    times = [message.sample_time_us for message in bench.of(GearboxSensors)]
    assert len(times) == 101 - 10
    assert times[66:69] == [660_000, 5_000, 15_000]
    edges = bench.of(EdgesMainRise)
    assert edges[66].newest_index > 200 > 10 > edges[67].newest_index
    assert len(bench.of(EEC1)) == len(bench.of(ReferenceEncoder)) == 101  # these go on
    # the sleeve was on its way; its valve is driven again once the sender is trusted
    driven = [status.main_second_energised for status in bench.of(ValveStatus)]
    assert driven[65:72] == [False, True, False, False, False, True, True]


def test_a_stalled_loop_says_everything_late_and_the_gearbox_has_gone_on() -> None:
    true, stalled = healthy(), bench_with(RigFault.NODE_STALLED, 0.0, 205_000, 60_000)
    for bench in (true, stalled):
        bench.run(260_000)
    quiet = [message.sample_time_us for message in stalled.of(GearboxSensors)]
    assert quiet[-1] == 210_000  # the step in which the fault began
    assert stalled.core.next_step_us == 265_000
    for bench in (true, stalled):
        bench.step(265_000)
        bench.run(400_000)
    assert [m.sample_time_us for m in stalled.of(GearboxSensors)] == [
        m.sample_time_us for m in true.of(GearboxSensors)
    ]
    assert edges_of(stalled.of(EdgesMainRise)) == edges_of(true.of(EdgesMainRise))


def test_a_valve_command_that_waited_in_a_stalled_loop_is_refused_as_late() -> None:
    bench = bench_with(RigFault.NODE_STALLED, 0.0, 205_000, 60_000)

    def valves(now_us: int) -> ValveCommand:
        if now_us < 220_000:
            return ValveCommand()
        return ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=240_000)

    bench.run(400_000, valves)
    assert bench.of(ValveStatus)[-1].refused_count == 1
    assert not any(status.brake_energised for status in bench.of(ValveStatus))
