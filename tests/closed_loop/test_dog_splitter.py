"""A splitter with dog teeth in the closed loop: each way of changing it, nothing harmful, and what
the guard forbids a controller that would do harm."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import pytest
from loop_bench import Loop

from meshpoint.dbc.messages import (
    ControllerState,
    Engagement,
    EngagementEvent,
    FaultCode,
    RigFault,
    ShiftResult,
    Strategy,
)
from meshpoint.gearbox import Sleeve, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SplitGear
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.rig_sim.shared.engagement import Engaged
from meshpoint.units import RPM

DOG = load_sheet("truck12-dog")
CONTACTS = (EngagementEvent.GAP_CONTACT, EngagementEvent.TOOTH_CONTACT)
State = ControllerState
ACROSS = ((10, 11), (11, 10), (6, 7), (7, 6), (13, 2), (2, 13))
ALONE = ((12, 11), (11, 12), (1, 2), (2, 1), (13, 14), (14, 13))


class Watched:
    """A loop whose rig's events are kept."""

    def __init__(self, loop: Loop) -> None:
        self.loop, self.events = loop, list[Engaged]()
        take = loop.world.take_engaged

        def kept() -> list[Engaged]:
            found: list[Engaged] = take()
            self.events += found
            return found

        loop.world.take_engaged = kept

    @property
    def split_contacts(self) -> list[Engaged]:
        return [e for e in self.events if isinstance(e.gear, SplitGear) and e.event in CONTACTS]


def ready(from_: int, to: int, seed: int = 1, profile: Profile = Profile.CLEAN) -> Watched:
    loop = Loop(
        [(600_000, to)], sheet=DOG, preset=Preset.TRUCK, start_gear=from_, toward=to, seed=seed,
        profile=profile,
    )  # fmt: skip
    return Watched(loop)


@functools.cache
def shift(from_: int, to: int) -> Watched:
    watched = ready(from_, to)
    watched.loop.run(7_000_000)
    return watched


@pytest.mark.parametrize(("from_", "to"), ALONE + ACROSS)
def test_each_change_ends_in_its_gear_and_harms_nothing(from_: int, to: int) -> None:
    watched = shift(from_, to)
    (outcome,) = watched.loop.outcomes
    assert (outcome.result, outcome.fault) == (ShiftResult.ENGAGED, FaultCode.NONE)
    assert outcome.to_gear == to
    assert watched.loop.violations == 0
    assert watched.loop.status.guard_blocks == 0
    lock = watched.loop.world.plant.shafts.split_lock
    assert lock is not None
    assert lock.gear.split is DRIVE_GEARS[to].split


@pytest.mark.parametrize(("from_", "to"), ALONE + ACROSS)
def test_its_sleeve_comes_from_above_within_the_guards_window(from_: int, to: int) -> None:
    """The sleeve turns faster than its gear, by `window.fire_slip_rpm` or more at the first
    contact."""
    contacts = shift(from_, to).split_contacts
    assert contacts
    assert 30.0 * RPM < -contacts[0].slip_rad_s < 115.0 * RPM
    assert all(-60.0 * RPM < -contact.slip_rad_s < 120.0 * RPM for contact in contacts)


@pytest.mark.parametrize(("from_", "to"), ALONE + ACROSS)
def test_the_outcome_says_whose_teeth_it_reports_and_counts_their_firings_alone(
    from_: int, to: int
) -> None:
    """Where the splitter had changed before the main gear, one firing of each was said to be two
    of the main gear."""
    (outcome,) = shift(from_, to).loop.outcomes
    if (from_, to) in ALONE:
        assert outcome.engagement is Engagement.SPLITTER
        assert outcome.strategy is Strategy.SPEED_WINDOW
    else:
        assert outcome.engagement is Engagement.MAIN_GEAR
    assert outcome.attempts == 1
    taken_us = (outcome.fire_time_us - outcome.request_time_us) % 2**32
    assert 0 < taken_us < 4_000_000


@pytest.mark.parametrize(("from_", "to"), ACROSS)
def test_across_the_main_box_the_input_shaft_stays_in_the_high_step_between(
    from_: int, to: int
) -> None:
    """Into the high step first, out of it last: while the main box is out the splitter is in it."""
    watched = shift(from_, to)
    inputs = [e for e in watched.events if isinstance(e.gear, SplitGear)]
    mains = [e for e in watched.events if e.gear and not isinstance(e.gear, SplitGear)]
    split_us = next(e.time_us for e in inputs if e.event is EngagementEvent.LOCKED)
    main_us = next(
        e.time_us for e in mains if (e.event, e.gear) == (
            EngagementEvent.LOCKED, DRIVE_GEARS[to].main
        )
    )  # fmt: skip
    is_up = DRIVE_GEARS[to].split == 1
    assert (split_us < main_us) == is_up


def test_a_blocked_command_of_the_splitter_leaves_the_outcome_its_main_gears_firing() -> None:
    """Said to be fired at 0 and predicted to meet at 0 +- 0 degrees."""
    watched = ready(8, 9)
    watched.loop.run_to_state(State.SPLITTER_CHANGING, 7_000_000)
    core = watched.loop.core
    assert core.snapshot is not None
    core.sequence.blocked(3, core.snapshot)
    watched.loop.run(9_000_000)
    (outcome,) = watched.loop.outcomes
    assert (outcome.result, outcome.to_gear) == (ShiftResult.ENGAGED, 9)
    taken_us = outcome.predicted_contact_time_us - outcome.fire_time_us
    assert 20_000 < taken_us < 80_000


def test_a_jammed_splitter_ends_the_shift_in_its_old_gear() -> None:
    watched = ready(12, 11)
    watched.loop.fault(RigFault.SLEEVE_JAMMED, int(Sleeve.SPLITTER))
    watched.loop.run(16_000_000)
    (outcome,) = watched.loop.outcomes
    assert outcome.result is ShiftResult.ENDED_IN_OLD_GEAR
    assert outcome.fault is FaultCode.SPLITTER_FAILED
    assert outcome.engagement is Engagement.SPLITTER
    # It was pulled for 5.5 s, each time for longer: loose again it ran into the other step.
    assert (outcome.end_time_us - outcome.request_time_us) % 2**32 < 2_000_000
    assert watched.loop.violations == 0


@pytest.mark.parametrize("after_ms", [20, 278])
def test_a_splitter_that_jams_between_its_steps_is_told(after_ms: int) -> None:
    """Not yet in neutral, and there: that the guard forbade what followed was all that was said."""
    loop = ready(8, 7, seed=2).loop
    loop.until(lambda: loop.world.plant.shafts.split_lock is None, 3_000_000)
    loop.run(loop.time.now_us + 1_000 * after_ms)
    loop.fault(RigFault.SLEEVE_JAMMED, int(Sleeve.SPLITTER))
    loop.until(lambda: bool(loop.outcomes), 14_000_000)
    (outcome,) = loop.outcomes
    assert (outcome.fault, outcome.engagement) == (
        FaultCode.SPLITTER_FAILED, Engagement.SPLITTER,
    )  # fmt: skip
    assert loop.violations == 0


def test_a_splitter_that_a_fault_left_in_neutral_is_brought_in_by_the_next_request() -> None:
    """In gear, so that something turns the layshaft."""
    watched = ready(12, 11)
    loop = watched.loop
    loop.run_to_state(State.SPLITTER_CHANGING, 2_000_000)
    loop.until(lambda: abs(loop.core._sequence.shift.splitter.drives) > 0, 3_000_000)
    loop.fault(RigFault.ENGINE_DEAF, for_us=9_000_000)
    loop.run(12_000_000)
    assert loop.outcomes[-1].fault is FaultCode.SPLITTER_FAILED
    loop.operator.ask(11, 14_000_000)
    loop.run(20_000_000)
    assert loop.outcomes[-1].result is ShiftResult.ENGAGED
    assert loop.violations == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_typical_gearbox_changes_it_too(seed: int) -> None:
    pairs: Sequence[tuple[int, int]] = ((11, 12), (12, 11), (10, 11))
    watched = ready(*pairs[seed], seed=20 + seed, profile=Profile.TYPICAL)
    watched.loop.run(8_000_000)
    assert watched.loop.outcomes[-1].result is ShiftResult.ENGAGED
    assert watched.loop.violations == 0


@pytest.mark.parametrize("seed", [501, 508, 509])
def test_in_the_lowest_gears_a_driveline_that_swings_far_brings_no_contact_outside(
    seed: int,
) -> None:
    """The layshaft swings by up to 400 rpm at the input shaft, from end to end."""
    watched = ready(14, 13, seed=seed, profile=Profile.TYPICAL)
    watched.loop.until(lambda: bool(watched.loop.outcomes), 14_000_000)
    assert watched.loop.outcomes[-1].result is ShiftResult.ENGAGED
    assert watched.loop.violations == 0
    assert all(-60.0 * RPM < -each.slip_rad_s < 120.0 * RPM for each in watched.split_contacts)


def test_where_the_layshaft_swings_to_is_known_while_the_splitter_is_out() -> None:
    """60 ms ahead, about when a sleeve that is fired comes to its gear, far better than by the
    speed it has."""
    loop = ready(14, 13, seed=500, profile=Profile.TYPICAL).loop
    found, true = [], dict[int, float]()

    def look() -> bool:
        snapshot = loop.core.snapshot
        if snapshot is None or loop.core.running_shift is None:
            return bool(loop.outcomes)
        now_us, omega = round(snapshot.now_us, -4), loop.world.plant.layshaft_rad_s
        if now_us in true or snapshot.view.split is not None or snapshot.loaded is None:
            return bool(loop.outcomes)
        true[now_us] = omega
        held = snapshot.loaded.layshaft(snapshot.now_us + 60_000)
        found.append((now_us + 60_000, omega, held))
        return bool(loop.outcomes)

    loop.until(look, 14_000_000)
    told = [(held, omega, true[at]) for at, omega, held in found if at in true and held is not None]
    assert len(told) > 20
    by_held = math.fsum((held.omega_rad_s - then) ** 2 for held, _, then in told)
    by_speed = math.fsum((omega - then) ** 2 for _, omega, then in told)
    assert by_held < 0.4 * by_speed


def test_a_strike_of_the_input_shaft_alone_costs_little() -> None:
    """J_IS dw^2 / 2 at 80 rpm is 3.9 J."""
    locked = [e for e in shift(11, 12).events if e.event is EngagementEvent.LOCKED]
    most = 0.5 * DOG.shafts.input_inertia_kgm2 * (80.0 * RPM) ** 2
    spent = sum(e.tally.impact_j for e in locked if isinstance(e.gear, SplitGear))
    assert 0.0 < spent < most
    assert math.isfinite(spent)
