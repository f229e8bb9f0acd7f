"""No two runs of a campaign have the same gearbox, and none depends on the worker that makes it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import pytest
from campaigns import small_spec

from benchmarks.swarm.draw import draw_world
from meshpoint.campaigns.draw import draw
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.campaigns.spec import CampaignSpec, Job
from meshpoint.rig_sim.settings import Preset, Profile

RUNS = 6


def bench_of(spec: CampaignSpec, job: Job) -> ClosedLoop:
    shifts = spec.learn + spec.judged
    drawn = draw(job.seed, spec.sheet, spec.preset, spec.pairs, shifts, spec.as_built, spec.profile)
    return ClosedLoop(spec.sheet, spec.settings, spec.preset, drawn)


def figures(as_built: Mapping[str, Any]) -> dict[str, float]:
    """Every figure that was drawn, by group and name."""
    return {
        f"{group}.{name}": value
        for group, values in as_built.items()
        if isinstance(values, dict)
        for name, value in values.items()
    }


@pytest.mark.parametrize("profile", list(Profile))
def test_the_gearboxes_of_any_two_runs_differ_in_most_of_what_is_drawn(profile: Profile) -> None:
    spec = small_spec(Preset.TRUCK, profile=profile)
    jobs = [*spec.jobs(RUNS), *small_spec(Preset.TRUCK, profile=profile, seed=2).jobs(RUNS)]
    boxes = [figures(bench_of(spec, job).as_built) for job in jobs]
    drawn = [name for name in boxes[0] if len({box[name] for box in boxes}) > 1]
    assert len(drawn) > 20
    for one, other in itertools.combinations(boxes, 2):
        same = [name for name in drawn if one[name] == other[name]]
        assert len(same) < 0.25 * len(drawn), same


@pytest.mark.parametrize("preset", list(Preset))
def test_the_shafts_of_any_two_runs_start_at_other_angles(preset: Preset) -> None:
    spec = small_spec(preset)
    starts = [bench_of(spec, job).rig_truth.angles for job in spec.jobs(RUNS)]
    wheels = [[rest for _, rest in start] for start in starts]
    for one, other in itertools.combinations(wheels, 2):
        assert all(a != b for a, b in zip(one, other, strict=True))


def test_any_two_runs_are_asked_for_shifts_at_other_speeds() -> None:
    spec = small_spec(Preset.TRUCK)
    speeds = []
    for job in spec.jobs(RUNS):
        drawn = draw(job.seed, spec.sheet, spec.preset, spec.pairs, 3, {}, spec.profile)
        speeds.append(tuple(shift.main_rad_s for shift in drawn.plan))
    assert len(set(itertools.chain.from_iterable(speeds))) == 3 * RUNS


def test_any_two_worlds_of_a_swarm_differ() -> None:
    worlds = [draw_world(seed) for seed in range(50)]
    trajectories = {(world.start_gear, world.layshaft_rpm, world.events) for world in worlds}
    assert len(trajectories) == len(worlds)
