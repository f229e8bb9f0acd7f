"""With every non-linearity off the truck is the thesis's gearbox, integrated instead of solved."""

from __future__ import annotations

import pytest
from rig_bench import RigBench, edges_of, release_first, thesis_rig, upshift

from meshpoint.dbc.edges import EDGE_MESSAGES
from meshpoint.dbc.messages import (
    GearboxSensors,
    MainGear,
    ReferenceEncoder,
    ReferenceEngagement,
    SleevesMain,
    ValveAction,
    ValveCommand,
)
from meshpoint.rig_sim import RigSettings
from meshpoint.rig_sim.settings import Profile
from meshpoint.rig_sim.truck.as_built import linear


def braked_to_rest(now_us: int) -> ValveCommand:
    brake = ValveAction.ON_NOW if now_us >= 400_000 else ValveAction.OFF_NOW
    return release_first(now_us)._replace(brake_action=brake)


def pair(
    seed: int, valves: object, until_us: int, profile: Profile = Profile.CLEAN
) -> tuple[RigBench, RigBench]:
    benches = (
        RigBench(thesis_rig(seed=seed)),
        RigBench(RigSettings(seed=seed, as_built=linear(), profile=profile)),
    )
    for bench in benches:
        bench.run(until_us, valves)  # type: ignore[arg-type]
    return benches


def of_sleeves(bench: RigBench) -> list[ReferenceEngagement]:
    """What happens to the sleeves; the clutch of the preset thesis has no plates that part."""
    return [e for e in bench.of(ReferenceEngagement) if e.gear is not MainGear.NEUTRAL]


@pytest.mark.parametrize(
    ("seed", "profile"), [(1, Profile.CLEAN), (2, Profile.TYPICAL), (7, Profile.HARSH)]
)
@pytest.mark.parametrize("valves", [upshift, braked_to_rest])
def test_every_edge_and_event_is_the_thesis_s_to_a_microsecond(
    seed: int, profile: Profile, valves: object
) -> None:
    """Whatever the profile: with every non-linearity off there is nothing left of it."""
    thesis, truck = pair(seed, valves, 1_200_000, profile)
    for kind in EDGE_MESSAGES:
        exact, integrated = edges_of(thesis.of(kind)), edges_of(truck.of(kind))
        assert exact.keys() == integrated.keys()
        assert max(abs(exact[i] - integrated[i]) for i in exact) <= 1
    for a, b in zip(of_sleeves(thesis), of_sleeves(truck), strict=True):
        assert (a.event, a.gear) == (b.event, b.gear)
        assert abs(a.event_time_us - b.event_time_us) <= 1
        assert b.slip_rad_s == pytest.approx(a.slip_rad_s, abs=1e-4)
    for a, b in zip(thesis.of(GearboxSensors), truck.of(GearboxSensors), strict=True):
        assert b == pytest.approx(a, abs=21.0)  # a step of the pressure signal
    for a, b in zip(thesis.of(SleevesMain), truck.of(SleevesMain), strict=True):
        assert b.sleeve_first_second_m == pytest.approx(a.sleeve_first_second_m, abs=1.1e-6)


def test_the_reference_encoder_sees_the_same_motion() -> None:
    thesis, truck = pair(3, upshift, 900_000)
    for a, b in zip(thesis.of(ReferenceEncoder)[1:], truck.of(ReferenceEncoder)[1:], strict=True):
        assert b.angle_rad == pytest.approx(a.angle_rad, abs=1e-6)
        if all(speed > 0.0 for speed in a.speed_rad_s):
            # at an event the two may be a sample to either side of the jump
            close = [abs(x - y) < 1e-3 for x, y in zip(a.speed_rad_s, b.speed_rad_s, strict=True)]
            assert sum(close) >= 4
