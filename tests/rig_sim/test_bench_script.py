"""The bench brings the rig back to a gear without a jump in any angle."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from rig_bench import SHEET, RigBench, edges_of, thesis_rig, upshift

from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
    EngagementEvent,
    ReferenceEncoder,
    SleevesAux,
    ValveAction,
    ValveCommand,
)
from meshpoint.gearbox.gears import DRIVE_GEARS, MainGear
from meshpoint.rig_sim.shared.script import ScriptStage
from meshpoint.units import RPM

BACKLASH = SHEET.dog.backlash_rad


def shifting_from(start_us: int) -> Callable[[int], ValveCommand]:
    """The open-loop shift, begun at another time."""
    return lambda now_us: upshift(now_us - start_us)


def test_after_a_shift_the_rig_stands_in_the_old_gear_again() -> None:
    bench = RigBench(thesis_rig(seed=3))
    for sequence in range(1, 3):
        start_us = bench.now_us
        bench.run(start_us + 1_200_000, shifting_from(start_us))
        assert bench.core.truth.locked_gear is MainGear.SECOND
        bench.return_to_gear(8, sequence)
        bench.run(start_us + 2_000_000)
        truth = bench.core.truth
        assert truth.locked_gear is MainGear.FIRST
        assert truth.speeds_rad_s[1] == pytest.approx(1400.0 * RPM)
        ready = bench.events(EngagementEvent.READY)
        assert len(ready) == sequence
        assert ready[-1].drive_gear == 8
        assert abs(ready[-1].phase_rad) == pytest.approx(BACKLASH / 2, abs=1e-7)
    assert bench.core.truth.violations == {}


def test_the_ramp_changes_speeds_smoothly_and_edges_come_evenly() -> None:
    bench = RigBench(thesis_rig(seed=3))
    bench.run(1_200_000, upshift)
    ramp_from = len(bench.of(ReferenceEncoder))
    kinds = (EdgesLayshaftRise, EdgesInputRise, EdgesMainRise, EdgesPropellerRise)
    newest = {kind: bench.of(kind)[-1].newest_index for kind in kinds}
    bench.return_to_gear(8, 1, main_rpm=600.0)
    bench.run(2_200_000)
    for kind in kinds:
        edges = edges_of(bench.of(kind))
        assert set(edges) == set(range(1, max(edges) + 1))
        gaps = [edges[index + 1] - edges[index] for index in range(newest[kind], max(edges))]
        # the greatest change from one interval to the next is the impact of the locking gear, whose
        # slip of 20 rpm is 3.3 % of 600 rpm
        assert all(
            abs(after - before) < 0.036 * before for before, after in itertools.pairwise(gaps)
        )
    speeds = [sample.speed_rad_s[0] for sample in bench.of(ReferenceEncoder)[ramp_from:]]
    steps = [later - earlier for earlier, later in itertools.pairwise(speeds)]
    assert max(abs(step) for step in steps) < 60.0 * RPM
    assert bench.core.truth.speeds_rad_s[2] == pytest.approx(600.0 * RPM)


@settings(max_examples=8, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(
    seed=st.integers(0, 1000),
    start=st.sampled_from(sorted(DRIVE_GEARS)),
    target=st.sampled_from(sorted(DRIVE_GEARS)),
    main_rpm=st.floats(50.0, 700.0),
)
def test_any_gear_can_be_returned_to_at_any_speed(
    seed: int, start: int, target: int, main_rpm: float
) -> None:
    bench = RigBench(thesis_rig(seed=seed, start_gear=start, main_speed_rpm=300.0))
    bench.run(50_000)
    bench.return_to_gear(target, 1, main_rpm)
    bench.run(800_000)
    gear = DRIVE_GEARS[target]
    (ready,) = bench.events(EngagementEvent.READY)
    assert ready.drive_gear == target
    truth = bench.core.truth
    assert truth.locked_gear is gear.main
    main = main_rpm * RPM
    layshaft = main / SHEET.main_mesh(gear.main).ratio
    assert truth.speeds_rad_s == pytest.approx(
        (
            layshaft / SHEET.split_mesh(gear.split).ratio,
            layshaft,
            main,
            main * SHEET.range_mesh(gear.range_).ratio,
        ),
        rel=1e-6,  # the wire carries the speed to 0.0001 rpm
    )
    assert bench.of(SleevesAux)[-1].sleeve_splitter_m[0] == pytest.approx(
        0.012 if gear.split else -0.012
    )


def test_a_repeated_sequence_number_does_nothing() -> None:
    bench = RigBench(thesis_rig(seed=3))
    for _ in range(100):
        bench.return_to_gear(8, 5)
        bench.run(bench.now_us + 10_000)
    assert len(bench.events(EngagementEvent.READY)) == 1
    bench.return_to_gear(8, 6)
    bench.run(bench.now_us + 10_000)
    assert bench.core.truth.script is ScriptStage.RELEASE


def test_neutral_can_be_asked_for() -> None:
    bench = RigBench(thesis_rig(seed=3))
    bench.run(50_000)
    bench.return_to_gear(0, 1)
    bench.run(600_000)
    assert bench.core.truth.locked_gear is MainGear.NEUTRAL
    (ready,) = bench.events(EngagementEvent.READY)
    assert ready.drive_gear == 0


def test_valves_do_not_move_sleeves_while_the_script_does() -> None:
    bench = RigBench(thesis_rig(seed=3))
    bench.run(50_000)
    bench.return_to_gear(8, 1)
    on = ValveCommand(main_third_action=ValveAction.ON_NOW)
    bench.run(800_000, lambda now_us: on)
    assert bench.core.truth.locked_gear is MainGear.FIRST
    assert any("MAIN_THIRD ignored" in line for line in bench.lines)


def test_a_new_command_in_the_middle_of_a_ramp_starts_over() -> None:
    for interrupt_us in range(60_000, 600_000, 85_000):
        bench = RigBench(thesis_rig(seed=3))
        bench.run(50_000)
        bench.return_to_gear(7, 1, 500.0)
        bench.run(interrupt_us)
        bench.return_to_gear(10, 2, 400.0)
        bench.run(interrupt_us + 800_000)
        assert bench.core.truth.locked_gear is MainGear.SECOND
        assert bench.events(EngagementEvent.READY)[-1].drive_gear == 10
        assert math.isclose(bench.core.truth.speeds_rad_s[2], 400.0 * RPM, rel_tol=1e-6)
