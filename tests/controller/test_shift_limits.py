"""The promises of a shift that hold for every gear, speed and angle, on the gearbox of
test_shift_states.py: its states end in the time that the settings give them, its sleeve is fired no
more than its attempts, nothing stays on after it, and a request that is refused says why."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shift_box import OIL_NM, PITCH, SHEET, STROKE_M, TICK_US, Box

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import Sleeve
from meshpoint.gearbox.gears import DRIVE_GEARS

RESTS = (State.IN_GEAR, State.NEUTRAL, State.FAULTED)
ENDED = {
    ShiftResult.ENGAGED: (FaultCode.NONE,),
    ShiftResult.ENDED_IN_NEUTRAL: tuple(set(FaultCode) - {FaultCode.NONE}),
    ShiftResult.ENDED_IN_OLD_GEAR: tuple(set(FaultCode) - {FaultCode.NONE}),
}


def limits(**values: int) -> ControllerSettings:
    usual = ControllerSettings()
    return replace(usual, limits=replace(usual.limits, **values))


def stuck(*sleeves: Sleeve) -> Callable[[Box], None]:
    return lambda box: box.stuck.update(sleeves)


def silent_clutch(box: Box) -> None:
    box.stuck_clutch = True


def weak(box: Box) -> None:
    box.weak_engine = True


def without_air(box: Box) -> None:
    box.refused.add(ValveName.BRAKE)


UP, OTHER_SLEEVE = (7, 150.0, 9), (7, 150.0, 11)
TIMED = [
    ("clutch_ms", State.CLUTCH_OPENING, UP, silent_clutch, FaultCode.CLUTCH_STUCK),
    ("steps_ms", State.SPLITTER_CHANGING, (7, 150.0, 8), stuck(Sleeve.SPLITTER),
     FaultCode.SPLITTER_FAILED),
    ("steps_ms", State.STEPS_CHANGING, (6, 110.0, 7), stuck(Sleeve.RANGE), FaultCode.RANGE_FAILED),
    ("synchronise_ms", State.SYNCHRONISING, OTHER_SLEEVE, without_air,
     FaultCode.SYNCHRONISE_FAILED),
    ("raise_ms", State.SPEED_RAISING, (9, 110.0, 7), weak, FaultCode.ENGINE_FAILED),
]  # fmt: skip


@pytest.mark.parametrize(("name", "state", "way", "breaks", "fault"), TIMED)
@pytest.mark.parametrize("ms", [300, 700])
def test_a_state_lasts_no_longer_than_its_limit_and_ends_with_its_name(
    name: str, state: State, way: tuple[int, float, int], breaks: Callable[[Box], None],
    fault: FaultCode, ms: int,
) -> None:  # fmt: skip
    chosen = limits(**{name: ms})
    box = Box(way[0], way[1], chosen, phase_rad=0.01).ready()
    breaks(box)
    box.ask(way[2])
    while box.running():
        box.step()
    lasted_us = TICK_US * sum(seen is state for _, seen in box.seen)
    assert 1_000 * ms <= lasted_us <= 1_000 * ms + 2 * TICK_US
    assert box.records[0].fault is fault


def pause_us(box: Box) -> float:
    """After a pull in vain: 140 ms, and as long as drag takes to turn a gear by half of 7.5 and 1.5
    degrees."""
    gear = DRIVE_GEARS[UP[0]]
    turned_rad = math.radians(4.5) / SHEET.main_mesh(gear.main).ratio
    drag_rad_s2 = box.drag_nm / SHEET.inertia_kgm2(gear.split)
    return 140_000 + 1e6 * math.sqrt(2.0 * turned_rad / drag_rad_s2)


@pytest.mark.parametrize("ms", [700, 1200])
def test_a_gear_that_stays_in_is_pulled_for_its_limit_by_pulses_that_grow(ms: int) -> None:
    """A pull that has begun is finished, and its valve rests until a gear that is out would be seen
    to turn."""
    box = Box(*UP[:2], limits(disengage_ms=ms), phase_rad=0.01).ready()
    box.stuck.add(Sleeve.FIRST_SECOND)
    box.drag_nm = OIL_NM
    box.ask(UP[2])
    pulls: dict[int, int] = {}
    while box.running():
        box.step()
        command = box.board.command(ValveName.MAIN_SECOND)
        if command.on and command.time_us <= box.now_us:
            pulls[command.time_us] = command.until_us - command.time_us
    lengths_us = list(pulls.values())
    assert len(lengths_us) >= box.settings.limits.attempts
    assert lengths_us == sorted(lengths_us)
    assert all(b - a <= 4_000 for a, b in itertools.pairwise(lengths_us))
    assert lengths_us[-1] == lengths_us[0] + 4_000 * (len(lengths_us) - 1)
    starts_us = list(pulls)
    for (on_us, next_us), long_us in zip(itertools.pairwise(starts_us), lengths_us, strict=False):
        assert 0.0 <= next_us - on_us - long_us - pause_us(box) <= 2 * TICK_US
    lasted_us = TICK_US * sum(seen is State.DISENGAGING for _, seen in box.seen)
    assert 1_000 * ms <= lasted_us <= 1_000 * ms + lengths_us[-1] + pause_us(box) + 3 * TICK_US
    assert box.records[0].fault is FaultCode.DISENGAGE_FAILED


@pytest.mark.parametrize("blocks", [0, 1, 2])
def test_a_pull_that_the_guard_blocks_makes_the_next_one_no_longer(blocks: int) -> None:
    """The sleeve has not been pulled yet: a longer pulse would throw it through neutral."""
    box = Box(*UP[:2], phase_rad=0.01).ready()
    box.ask(UP[2])
    box.until(State.DISENGAGING)
    for _ in range(blocks):
        box.sequence.blocked(10, box.snapshot())
        while not box.board.command(ValveName.MAIN_SECOND).on:
            box.step()
    pull = box.board.command(ValveName.MAIN_SECOND)
    assert pull.until_us - pull.time_us < 30_000
    box.until(State.IN_GEAR)
    assert box.records[0].result is ShiftResult.ENGAGED


@pytest.mark.parametrize("ms", [300, 700])
def test_a_sleeve_that_does_not_reach_its_gear_is_taken_back_after_its_limit(ms: int) -> None:
    box = Box(*OTHER_SLEEVE[:2], limits(engage_ms=ms, attempts=1), phase_rad=0.01).ready()
    box.stuck.add(Sleeve.CRAWL_THIRD)
    box.ask(OTHER_SLEEVE[2])
    while box.running():
        box.step()
    engaging = [at_us for at_us, state in box.seen if state is State.ENGAGING]
    assert engaging[-1] - engaging[0] == pytest.approx(1_000 * ms, abs=2 * TICK_US)
    assert (box.records[0].fault, box.records[0].attempts) == (FaultCode.ENGAGE_FAILED, 1)


@pytest.mark.parametrize("attempts", [1, 2, 4])
def test_a_sleeve_is_fired_no_more_than_its_attempts(attempts: int) -> None:
    """Each firing is one that the valve was driven for; it never gets past its teeth. One that is
    aborted is none."""
    box = Box(*OTHER_SLEEVE[:2], limits(attempts=attempts, engage_ms=150), phase_rad=0.01).ready()
    box.stuck.add(Sleeve.CRAWL_THIRD)
    box.ask(OTHER_SLEEVE[2])
    while box.running():
        box.step()
    record = box.records[0]
    assert box.trajectory.count(State.ENGAGING) == attempts + record.aborts
    assert record.attempts == attempts
    assert record.result is ShiftResult.ENDED_IN_NEUTRAL


@pytest.mark.check
@settings(max_examples=40)
@given(
    gear=st.sampled_from(sorted(DRIVE_GEARS)),
    number=st.sampled_from(sorted(DRIVE_GEARS)),
    input_rad_s=st.floats(90.0, 210.0),
    phase=st.none() | st.floats(0.0, PITCH),
    teeth=st.floats(0.0, 0.8),
    broken=st.sampled_from((None, silent_clutch, weak, without_air, *map(stuck, Sleeve))),
)
def test_however_a_shift_goes_it_ends_by_name_with_nothing_left_on(
    gear: int, number: int, input_rad_s: float, phase: float | None, teeth: float,
    broken: Callable[[Box], None] | None,
) -> None:  # fmt: skip
    """Any gear from any gear, at any speed and angle, with teeth in the way and parts that do not
    move: it comes to rest, in the gear asked for or with a fault, and asks for nothing then."""
    assume(gear != number)
    box = Box(gear, input_rad_s, phase_rad=phase)
    box.face = lambda at: abs(at) > (1.0 - teeth) * 0.5 * PITCH
    box.ready()
    if broken is not None:
        broken(box)
    if box.ask(number) is not None:
        assert not box.records
        return
    while box.running():
        box.step()
    (record,) = box.records
    assert record.fault in ENDED.get(record.result, (FaultCode.POSITION_STALE,))
    assert record.attempts <= box.settings.limits.attempts
    assert record.raises <= box.settings.limits.raises
    assert not any(box.board.command(valve).on for valve in ValveName)
    assert box.sequence.engine_share is None
    if record.result is ShiftResult.ENGAGED:
        assert box.view.gear_number == number
    if broken is not silent_clutch:
        box.until(*RESTS)
        assert box.sequence.engine_rad_s is None


def between_gears(box: Box) -> None:
    box.position_m[Sleeve.FIRST_SECOND] = 0.4 * STROKE_M
    box.step()


def without_supply(box: Box) -> None:
    box.supply_pa = box.settings.limits.supply_low_pa - 1.0


def lost(code: FaultCode) -> Callable[[Box], None]:
    def lose(box: Box) -> None:
        box.lost = code

    return lose


def nothing(box: Box) -> None:
    del box


REFUSALS = [
    (0, nothing, FaultCode.REQUEST_IMPOSSIBLE, "gears are 1 to 14"),
    (15, nothing, FaultCode.REQUEST_IMPOSSIBLE, "gears are 1 to 14"),
    (1, nothing, FaultCode.INPUT_OVERSPEED, "rpm"),
    (9, without_supply, FaultCode.LOW_SUPPLY, "supply at"),
    (9, between_gears, FaultCode.REQUEST_IMPOSSIBLE, "stands between two gears"),
    (9, lost(FaultCode.SPEED_STALE), FaultCode.SPEED_STALE, "speed_stale"),
    (9, lost(FaultCode.POSITION_STALE), FaultCode.POSITION_STALE, "position_stale"),
    (9, lost(FaultCode.VALVE_LINK_LOST), FaultCode.VALVE_LINK_LOST, "valve_link_lost"),
    (9, lost(FaultCode.WHEELS_DISAGREE), FaultCode.WHEELS_DISAGREE, "wheels_disagree"),
]


@pytest.mark.parametrize(("number", "happens", "fault", "says"), REFUSALS)
def test_a_request_that_is_refused_is_answered_with_its_reason_and_moves_nothing(
    number: int, happens: Callable[[Box], None], fault: FaultCode, says: str
) -> None:
    box = Box(*UP[:2], phase_rad=0.01).ready()
    happens(box)
    state = box.state
    assert says in str(box.ask(number))
    answer = box.sequence.finished
    assert answer is not None
    assert (answer.result, answer.fault) == (ShiftResult.REFUSED, fault)
    assert answer.end_us == answer.request_us == box.now_us
    assert box.state is state
    assert not any(box.board.command(valve).on for valve in ValveName)
    assert box.clutch > 0.9


def engine(**values: float) -> ControllerSettings:
    usual = ControllerSettings()
    return replace(usual, engine=replace(usual.engine, **values))


@pytest.mark.parametrize("pull", [0.2, 0.6])
def test_the_clutch_waits_for_the_engine_s_torque_to_fall_or_opens_at_once_where_no_ramp_is_set(
    pull: float,
) -> None:
    for ramp_ms, waits in ((250, True), (0, False)):
        chosen = engine(ramp_ms=ramp_ms, swing_ramp_ms=0)
        box = Box(*UP[:2], chosen, phase_rad=0.01, pull=pull).ready()
        box.ask(UP[2])
        begun_us = box.now_us
        while box.sequence.clutch is not ClutchAction.OPEN:
            box.step()
        waited_us = box.now_us - begun_us
        assert (waited_us > 3 * TICK_US) is waits
        assert waited_us <= 1_000 * ramp_ms + 2 * TICK_US


@pytest.mark.parametrize("raises", [0, 1, 2])
def test_the_engine_is_asked_to_raise_the_gear_no_more_often_than_is_set(raises: int) -> None:
    """A gear that is too slow at each contact is raised again and again, and then given up."""
    box = Box(9, 110.0, limits(raises=raises), phase_rad=0.01).ready()
    box.ask(7)
    while box.running():
        box.step()
        if box.state is State.COASTING:
            box.layshaft *= 0.8  # somebody brakes it
    record = box.records[0]
    assert record.raises == raises
    assert record.result is ShiftResult.ENDED_IN_NEUTRAL
    assert box.trajectory.count(State.SPEED_RAISING) == raises


def test_after_the_engine_has_raised_the_gear_the_brake_may_be_used_as_often_again() -> None:
    """The gear comes down from above once more, here with the vehicle slowing on a hill."""
    box = Box(7, 190.0, limits(pulses=1), phase_rad=0.01).ready()
    box.ask(9)
    while box.running():
        box.step()
        if box.state is State.COASTING and box.sequence.running.raises == 0:
            box.layshaft *= 0.8  # somebody brakes it
        if box.trajectory[-2:] == [State.CLUTCH_PARTING, State.COASTING]:
            box.propeller *= 0.97
    record = box.records[0]
    assert (record.result, record.raises, record.pulses) == (ShiftResult.ENGAGED, 1, 1)
