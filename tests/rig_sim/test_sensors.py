"""What the edge, sleeve and reference frames say, against what is known of the motion."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
from rig_bench import SHEET, RigBench, edges_of, release_first, thesis_rig, upshift

from meshpoint.dbc.edges import EDGE_MESSAGES
from meshpoint.dbc.messages import (
    EEC1,
    EdgesInputRise,
    EdgesLayshaftFall,
    EdgesLayshaftRise,
    EdgesMainFall,
    EdgesMainRise,
    EdgesPropellerRise,
    EngagementEvent,
    GearboxSensors,
    ReferenceEncoder,
    ReferencePhase,
    SleevesAux,
    SleevesMain,
    ValveAction,
    ValveCommand,
    ValveStatus,
)
from meshpoint.rig_sim import RigCore
from meshpoint.units import RPM

ORDER = [
    "EEC1",
    *(message.__name__ for message in EDGE_MESSAGES),
    "GearboxSensors",
    "ValveStatus",
    "SleevesMain",
    "SleevesAux",
    "ReferenceEncoder",
    "ReferencePhase",
]


def test_every_10_ms_brings_all_frames_the_engine_s_first_and_the_truth_last() -> None:
    bench = RigBench()
    bench.run(100_000)
    names = [type(message).__name__ for message in bench.messages]
    assert names == ORDER * 11
    times = [message.sample_time_us for message in bench.of(GearboxSensors)]
    assert times == [bench.clock(time_us) for time_us in range(0, 100_001, 10_000)]


def test_the_edges_of_a_steady_shaft_are_those_of_its_wheel_to_the_microsecond() -> None:
    sheet = replace(
        SHEET, wheels=replace(SHEET.wheels, main=replace(SHEET.wheels.main, duty_share=0.3))
    )
    for seed in range(3):
        bench = RigBench(thesis_rig(seed=seed), sheet)
        bench.step(0)
        angle = bench.core.truth.angles[2][1]
        bench.run(3_000_000)
        pitch, omega = sheet.wheels.main.pitch_rad, 644.0 * RPM
        for kind, offset in ((EdgesMainRise, 0.0), (EdgesMainFall, 0.3)):
            edges = edges_of(bench.of(kind))
            first = math.floor(angle / pitch - offset) + 1
            start_us = bench.core.truth.clock_start_us
            for index, clock_us in edges.items():
                exact_us = ((first + index - 1 + offset) * pitch - angle) / omega * 1e6
                assert 0.0 <= exact_us - (clock_us - start_us) < 1.0 + 1e-6
            passed = math.floor((angle + 3.0 * omega) / pitch - offset) - first + 1
            assert len(edges) == max(edges) == passed


def test_no_edge_is_missing_when_every_second_frame_is() -> None:
    # 45 teeth at 1,400 rpm: 27 stamps reach back over 25 ms
    bench = RigBench(thesis_rig(seed=7))
    bench.run(1_200_000, upshift)
    for kind in (EdgesLayshaftRise, EdgesLayshaftFall, EdgesInputRise):
        frames = bench.of(kind)
        whole, thinned = edges_of(frames), edges_of(frames[::2])
        assert set(whole) == set(range(1, max(whole) + 1))
        assert thinned.items() <= whole.items()
        assert set(thinned) == set(range(1, max(thinned) + 1))


def test_the_sensor_clock_wraps_within_the_first_seconds_and_nothing_jumps() -> None:
    for seed in range(20):
        drawn_us = RigCore(SHEET, thesis_rig(seed=seed)).truth.clock_start_us
        assert (1 << 32) - 5_000_000 <= drawn_us < (1 << 32) - 500_000
    bench = RigBench(thesis_rig(seed=11, clock_start_us=(1 << 32) - 700_001))
    bench.run(1_500_000)
    reads = [frame.read_time_us for frame in bench.of(EdgesMainRise)]
    assert min(reads) < 10_000_000 < max(reads)
    edges = edges_of(bench.of(EdgesMainRise))
    gaps = {edges[index + 1] - edges[index] for index in range(1, max(edges))}
    period_us = 60e6 / 644.0 / SHEET.wheels.main.teeth
    assert gaps <= {math.floor(period_us), math.ceil(period_us)}


def test_a_stopped_shaft_says_so_and_a_slow_one_flags_its_long_intervals() -> None:
    bench = RigBench(thesis_rig(seed=4))

    def valves(now_us: int) -> ValveCommand:
        on = ValveAction.ON_NOW if now_us >= 400_000 else ValveAction.OFF_NOW
        return release_first(now_us)._replace(brake_action=on)

    bench.run(1_500_000, valves)
    frames = bench.of(EdgesLayshaftRise)
    speeds = [sample.speed_rad_s[0] for sample in bench.of(ReferenceEncoder)]
    assert not any(frame.stopped for frame, speed in zip(frames, speeds, strict=True) if speed > 20)
    assert frames[-1].stopped
    assert frames[-1].newest_index == frames[-20].newest_index
    assert not any(frame.stopped for frame in bench.of(EdgesMainRise))

    slow = RigBench(thesis_rig(seed=1, main_speed_rpm=644.0 / 1400.0 * 15.0))  # layshaft 15 rpm
    slow.run(1_500_000)
    last = slow.of(EdgesLayshaftRise)[-1]
    assert last.long_interval
    assert 0 < last.valid_stamps < 27


def test_a_standing_gearbox_has_no_edges() -> None:
    bench = RigBench(thesis_rig(seed=1, main_speed_rpm=0.0))
    bench.run(200_000)
    last = bench.of(EdgesLayshaftRise)[-1]
    assert (last.newest_index, last.valid_stamps, last.stopped) == (0, 0, True)
    assert not bench.of(EdgesLayshaftRise)[6].stopped  # 60 ms after power-up: not yet known


def moved(cut_us: list[int], seed: int = 9) -> RigBench:
    """The same shift and return, stepped in pieces of other lengths between the same commands."""
    bench = RigBench(thesis_rig(seed=seed))
    pieces = 0
    while bench.now_us < 2_500_000:
        if bench.now_us % 10_000 == 0:
            bench.send(upshift(bench.now_us))
            if bench.now_us == 1_200_000:
                bench.return_to_gear(7, 1, 700.0)
            bench.step(bench.now_us)
        end_us = bench.now_us + 10_000
        while bench.now_us < end_us:
            bench.step(min(bench.now_us + cut_us[pieces % len(cut_us)], end_us))
            pieces += 1
    return bench


def test_however_time_is_cut_up_the_frames_are_the_same_bytes() -> None:
    whole = moved([10_000])
    assert {record.event for record in whole.of(type(whole.events(EngagementEvent.READY)[0]))} >= {
        EngagementEvent.LOCKED,
        EngagementEvent.RELEASED,
        EngagementEvent.READY,
    }
    assert moved([3_000, 1, 7_777]).frames == whole.frames
    assert moved([1_137]).frames == whole.frames


def test_a_late_step_sends_every_read_with_its_own_content() -> None:
    prompt, late = RigBench(thesis_rig(seed=8)), RigBench(thesis_rig(seed=8))
    for now_us in range(0, 500_001, 10_000):
        prompt.step(now_us)
    for now_us in range(0, 500_001, 37_000):
        late.step(now_us)
    late.step(500_000)
    assert late.frames == prompt.frames


def test_the_seed_is_all_there_is_to_a_run() -> None:
    assert moved([10_000], seed=1).frames == moved([10_000], seed=1).frames
    angles = {moved_seed: RigBench(thesis_rig(seed=moved_seed)) for moved_seed in range(4)}
    for bench in angles.values():
        bench.step(0)
    starts = {bench.core.truth.angles for bench in angles.values()}
    assert len(starts) == 4
    clocks = {bench.core.truth.clock_start_us for bench in angles.values()}
    assert len(clocks) == 4


def test_the_reference_encoder_is_zero_where_tooth_0_rises() -> None:
    bench = RigBench(thesis_rig(seed=6))
    bench.run(500_000)
    start = bench.of(ReferenceEncoder)[0].angle_rad[0]
    pitch = SHEET.wheels.layshaft.pitch_rad
    edges = edges_of(bench.of(EdgesLayshaftRise))
    omega = 1400.0 * RPM
    for index, clock_us in edges.items():
        time_s = (clock_us - bench.core.truth.clock_start_us + 0.5) * 1e-6
        tooth = (start + omega * time_s) / pitch
        assert tooth == pytest.approx(math.floor(start / pitch) + index, abs=1e-3)
    for sample in bench.of(ReferenceEncoder):
        back = (sample.angle_rad[0] - sample.angle_rad[4]) % (512 * math.pi)
        assert back == pytest.approx(omega * 0.008, abs=1e-6)


def test_reference_phases_move_with_the_slip() -> None:
    bench = RigBench(thesis_rig(seed=6))
    bench.run(200_000)
    samples = bench.of(ReferencePhase)
    pitch = SHEET.dog.pitch_rad
    slip = 644.0 * RPM * (SHEET.main.third.ratio / SHEET.main.first.ratio - 1.0)
    for before, after in itertools.pairwise(samples):
        error = after.phase_third_rad - before.phase_third_rad - slip * 0.01
        assert math.remainder(error, pitch) == pytest.approx(0.0, abs=1e-6)
        assert abs(after.phase_first_rad) == pytest.approx(SHEET.dog.backlash_rad / 2, abs=1e-7)


def sleeve_path(messages: list[Any], field: str) -> list[float]:
    """All 1 ms samples of one sleeve, the oldest first."""
    path: list[float] = []
    for message in messages:
        path.extend(reversed(getattr(message, field)))
    return path


def test_the_sleeve_sensor_shows_the_way_to_neutral_to_contact_and_home() -> None:
    bench = RigBench(thesis_rig(seed=7))
    bench.run(1_200_000, upshift)
    path = sleeve_path(bench.of(SleevesMain), "sleeve_first_second_m")
    assert path[0] == pytest.approx(-0.012)  # FIRST, to which the sleeve moves backwards
    assert path[500] == 0.0
    assert path[-1] == pytest.approx(0.012)
    assert all(later >= earlier for earlier, later in itertools.pairwise(path))
    (contact,) = bench.events(EngagementEvent.TOOTH_CONTACT) or bench.events(
        EngagementEvent.GAP_CONTACT
    )
    contact_ms = ((contact.event_time_us - bench.clock(0)) % (1 << 32)) / 1e3
    before, after = math.floor(contact_ms) + 9, math.ceil(contact_ms) + 9
    assert path[before] <= 0.005 <= path[after] + 1e-9
    assert set(sleeve_path(bench.of(SleevesMain), "sleeve_crawl_third_m")) == {0.0}
    assert set(sleeve_path(bench.of(SleevesAux), "sleeve_range_m")) == {0.012}


def test_the_engine_turns_with_the_input_shaft_until_the_clutch_opens() -> None:
    bench = RigBench()
    bench.step(0)
    speed = bench.of(EEC1)[0].engine_speed_rad_s
    assert speed == pytest.approx(1400.0 * RPM / SHEET.splitter.high.ratio, abs=0.125 * RPM)
    bench.run(2_000_000)
    assert bench.of(EEC1)[-1].engine_speed_rad_s == pytest.approx(600.0 * RPM, rel=0.05)
    positions = [message.clutch_position_fraction for message in bench.of(GearboxSensors)]
    assert positions[0] == 1.0
    assert positions[-1] == 0.0


def test_the_propeller_follows_the_main_shaft_by_the_range() -> None:
    low = RigBench(thesis_rig(seed=2, start_gear=2))
    low.run(2_000_000)
    main = max(edges_of(low.of(EdgesMainRise)))
    propeller = max(edges_of(low.of(EdgesPropellerRise)))
    expected = main * SHEET.range_.low.ratio * SHEET.wheels.propeller.teeth / 45
    assert propeller == pytest.approx(expected, abs=1.5)


def test_the_valve_status_shows_what_is_driven_and_what_waits() -> None:
    bench = RigBench()

    def valves(now_us: int) -> ValveCommand:
        action = ValveAction.ON_AT if now_us >= 100_000 else ValveAction.OFF_NOW
        return ValveCommand(brake_action=action, brake_time_us=bench.clock(155_000))

    bench.run(200_000, valves)
    states = {
        (message.sample_time_us - bench.clock(0)) % (1 << 32): message
        for message in bench.of(ValveStatus)
    }
    assert not states[100_000].brake_pending
    assert states[110_000].brake_pending and not states[150_000].brake_energised
    assert states[160_000].brake_energised and not states[160_000].brake_pending
