"""The bench's way back to a gear: asked again where a rig does not come there."""

from __future__ import annotations

import pytest

from meshpoint.bench.bench import BenchCore, plan_shifts
from meshpoint.bench.pauses import pauses_of
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver, Transmitter
from meshpoint.dbc.messages import BenchAction, BenchCommand, EngagementEvent, ReferenceEngagement
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Profile

SHEET = load_sheet("truck12")
SHIFTS = 3


def bench() -> BenchCore:
    plan = plan_shifts(SHEET, [(8, 10)], SHIFTS, 140.0)
    return BenchCore(plan, pauses_of(SHEET, Profile.CLEAN))


def asked(core: BenchCore, from_ms: int, until_ms: int) -> list[BenchCommand]:
    """What the rig is told in that time."""
    receiver, told = Receiver(Node.GEARBOX_IO), list[BenchCommand]()
    for now_ms in range(from_ms, until_ms, 10):
        for frame in core.step(1000 * now_ms).frames:
            message = receiver.receive(frame).message
            if isinstance(message, BenchCommand):
                told.append(message)
    return told


def ready_in(gear: int) -> Frame:
    sent = ReferenceEngagement(event=EngagementEvent.READY, drive_gear=gear)
    return Transmitter(Node.REFERENCE).encode(sent)


def test_a_rig_that_stays_away_from_its_gear_is_asked_anew_every_two_seconds() -> None:
    """A tooth may stand on a tooth, which a way back begun anew leaves. Each shift of a plan that
    never gets so far asks anew too."""
    core = bench()
    told = asked(core, 0, 8_000)
    assert all(each.action is BenchAction.RETURN_TO_GEAR for each in told)
    assert len({each.sequence for each in told}) == 4
    later = asked(core, 8_000, 30_000)
    sequences = [each.sequence for each in told + later]
    assert sequences == sorted(sequences)
    assert core.gave_up == [0, 1, 2]


def test_a_rig_that_has_come_to_its_gear_is_asked_no_more() -> None:
    """Whatever the controller says of it, or does not say."""
    core = bench()
    first = asked(core, 0, 500)
    core.receive(ready_in(8))
    assert {each.sequence for each in asked(core, 500, 7_500)} == {first[0].sequence}


@pytest.mark.parametrize("gear", [0, 8])
def test_the_bench_waits_for_both_nodes_before_it_asks_for_a_gear(gear: int) -> None:
    core = bench()
    asked(core, 0, 500)
    core.receive(ready_in(gear))
    asked(core, 500, 1_500)
    assert not core.is_asking
