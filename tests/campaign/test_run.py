"""One run: how long the bench rests, and that strategies do not see each other."""

from __future__ import annotations

from dataclasses import replace

import pytest
from campaigns import small_spec

from meshpoint.campaigns.columns import Shifts
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import LOCKED_US, UNREAD, ClosedLoop
from meshpoint.campaigns.record import JudgedShift
from meshpoint.campaigns.run import run_one
from meshpoint.campaigns.sequential import estimate, parse_goal
from meshpoint.campaigns.spec import Job
from meshpoint.controller.settings.settings import ControllerSettings, Prices
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    TC1,
    ControllerState,
    ControllerStatus,
    EngagementEvent,
    ReferenceEngagement,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile

TICK_US = 10_000
IN_GEAR = ControllerState.IN_GEAR


def records_of(*strategies: str) -> list[JudgedShift]:
    spec = small_spec(strategies=strategies, true_state=False, learn=1, judged=1)
    result = run_one(spec, Job(7))
    assert result.error is None
    return list(result.records)


def test_what_a_strategy_does_depends_on_no_other() -> None:
    both = records_of("speed_window", "target_phase")
    assert len(both) == 2
    for strategy in ("speed_window", "target_phase"):
        alone = records_of(strategy)
        assert len(alone) == 1
        assert alone == [record for record in both if record.strategy == strategy]


def test_a_tooth_at_the_edge_of_its_gap_does_not_go_in_and_out_for_ever() -> None:
    """With a slip of 0.08 rpm: the backlash of its mesh turned over with the friction on its face,
    and the rig stood still in time at one instant."""
    settings = ControllerSettings(prices=Prices(energy_s_per_j=0.4))
    sheet, pairs = load_sheet("truck12"), upshifts()
    drawn = draw(4_000_003, sheet, Preset.TRUCK, pairs, 14, {}, Profile.CLEAN)
    loop = ClosedLoop(sheet, settings, Preset.TRUCK, drawn)
    for _ in range(4):
        row = loop.shift()
        assert row is not None
        assert row.result == "engaged"


@pytest.mark.parametrize("preset", list(Preset))
def test_a_gear_is_asked_for_when_the_old_one_has_been_locked_for_the_pause(preset: Preset) -> None:
    spec = small_spec(preset)
    drawn = draw(5, spec.sheet, spec.preset, spec.pairs, 2, {}, Profile.CLEAN)
    loop = ClosedLoop(spec.sheet, spec.settings, spec.preset, drawn, log=[])
    loop.shift()
    loop.shift()
    assert loop.log is not None
    receiver, ready_us, rested_us = Receiver(*Node), 0, []
    for time_us, frame in loop.log:
        message = receiver.receive(frame).message
        if isinstance(message, ReferenceEngagement) and message.event is EngagementEvent.READY:
            ready_us = time_us
        elif frame.can_id == CODECS[TC1.__name__].spec.can_id and ready_us:
            rested_us.append(time_us - ready_us)
            ready_us = 0
    assert len(rested_us) == 2
    assert min(rested_us) >= LOCKED_US
    # The thesis's clutch is closed at once: there is nothing more to wait for.
    if preset is Preset.THESIS:
        assert max(rested_us) <= LOCKED_US + 4 * TICK_US


@pytest.mark.parametrize("rest_ms", [0, 150, 700])
def test_a_rest_is_counted_from_the_clutch_s_closing_in_the_old_gear(rest_ms: int) -> None:
    """Whatever the driveline would need to settle."""
    spec = small_spec(Preset.TRUCK)
    drawn = draw(5, spec.sheet, spec.preset, spec.pairs, 2, {}, Profile.TYPICAL)
    rest_us = 1000 * rest_ms
    loop = ClosedLoop(spec.sheet, spec.settings, spec.preset, drawn, log=[], rest_us=rest_us)
    loop.shift()
    loop.shift()
    assert loop.log is not None
    receiver, in_gear_us, rested_us = Receiver(*Node), 0, []
    for time_us, frame in loop.log:
        message = receiver.receive(frame).message
        if isinstance(message, ControllerStatus):
            is_in = (message.state, message.current_gear) == (IN_GEAR, drawn.plan[0].from_)
            in_gear_us = (in_gear_us or time_us) if is_in else 0
        elif isinstance(message, TC1) and in_gear_us:
            rested_us.append(time_us - in_gear_us)
            in_gear_us = 0
    assert len(rested_us) >= 2
    for rested in rested_us[:1] + rested_us[-1:]:
        assert rest_us - TICK_US <= rested <= rest_us + 5 * TICK_US


def test_a_blind_strategy_may_be_judged_once_a_run_and_until_says_the_same() -> None:
    """Its gap rate is a number of the gearbox, whatever the shift; what others do is as before."""
    spec = small_spec(true_state=False, learn=0, judged=2)
    every, once = (
        run_one(replace(spec, judged_blind=judged_blind), Job(7)) for judged_blind in (None, 1)
    )
    assert (every.error, once.error) == (None, None)
    assert (every.shifts, once.shifts) == (4, 3)
    dropped = [r for r in every.records if r.strategy == "speed_window" and r.shift == 1]
    assert len(dropped) == 1
    assert once.records == [r for r in every.records if r not in dropped]
    goal = parse_goal("first_contact_gap difference +-1%")
    said = []
    for records in (every.records, once.records):
        runs = [replace(r, seed=seed) for seed in (7, 8) for r in records]
        said.append(estimate(goal, Shifts.of(runs), "target_phase", "speed_window").value)
    assert said[0] == pytest.approx(said[1], rel=1e-12)


@pytest.mark.parametrize(
    ("preset", "profile"),
    [
        (Preset.TRUCK, Profile.TYPICAL),
        pytest.param(Preset.TRUCK, Profile.CLEAN, marks=pytest.mark.long),
        pytest.param(Preset.THESIS, Profile.TYPICAL, marks=pytest.mark.long),
    ],
)
def test_what_nobody_reads_changes_nothing(preset: Preset, profile: Profile) -> None:
    """Without a log the frames that are for logs are empty: shifts and bus are the same."""
    spec, made = small_spec(preset), []
    for log in (None, []):
        drawn = draw(11, spec.sheet, spec.preset, spec.pairs, 3, {}, profile)
        loop = ClosedLoop(spec.sheet, spec.settings, spec.preset, drawn, log=log)
        rows = [loop.shift() for _ in range(2)]
        fork = loop.fork()
        fork.use(spec.engagement("target_phase"), knows_all=True)
        made.append((rows, fork.shift(), loop.shift(), loop.simulated_s, loop.bus_load))
    assert made[0] == made[1]
    assert all(row is not None and row.result == "engaged" for row in made[0][0])


def test_an_empty_frame_is_one_of_its_message() -> None:
    """Who listens to it at all takes it as heard, not as wrong."""
    for kind in UNREAD:
        codec = CODECS[kind.__name__]
        if codec.spec.receivers - {Node.BENCH}:
            assert codec.decode(bytes(codec.spec.length)) is not None
            assert codec.spec.data_id is None
