"""Everything that can go wrong in a shift: it ends, in a declared and safe state, in bounded time.

Each line is a fault of the rig and the moment it strikes at, by the controller's state; what must
come of it by the controller's word and the rig's truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest
from loop_bench import Loop

from meshpoint.controller.core.core import ControllerCore
from meshpoint.dbc.messages import (
    ClutchAction,
    ClutchCommand,
    ControllerState,
    ControllerStatus,
    FaultCode,
    RigFault,
    ShiftResult,
    SleevesMain,
    ValveCommand,
)
from meshpoint.gearbox import Sleeve, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS, SLEEVE_OF_MAIN
from meshpoint.rig_sim.settings import Preset, Profile

TRUCK12 = load_sheet("truck12")
State, Fault, Code, Result = ControllerState, RigFault, FaultCode, ShiftResult
REQUEST_US = 300_000
PATIENCE_US = 6_000_000
"""No shift takes longer, whatever happens."""
STALE_US = 50_000


class Case(NamedTuple):
    """A fault and its outcome."""

    name: str
    shift: tuple[int, int]
    at: State
    fault: Fault
    target: int
    value: float
    for_ms: int
    result: Result
    code: Code
    rests_in: State


TABLE = """
clutch stuck closed        | 8-10 | in_gear        | clutch_stuck         | old clutch_stuck in_gear
clutch stuck open          | 10-8 | disengaging    | clutch_stuck         | neutral clutch_stuck neutral
clutch does not part       | 10-8 | speed_raising  | clutch_stuck         | neutral clutch_stuck neutral
engine deaf                | 10-8 | in_gear        | engine_deaf          | neutral engine_failed neutral
no brake                   | 8-10 | in_gear        | brake_fade           | in none in_gear
brake stuck on             | 8-10 | synchronising  | valve_stuck 0        | neutral synchronise_failed neutral
valve that pulls out stuck | 8-10 | in_gear        | valve_stuck 4        | old disengage_failed in_gear
valve that engages stuck   | 8-10 | coasting       | valve_stuck 4        | neutral engage_failed neutral
valve slow                 | 8-10 | coasting       | valve_slow 4 40      | in none in_gear
jammed in gear             | 8-10 | in_gear        | sleeve_jammed        | old disengage_failed in_gear
jammed in neutral          | 8-10 | coasting       | sleeve_jammed        | neutral engage_failed neutral
jammed for a while         | 8-10 | coasting       | sleeve_jammed 0 0 400 | in none in_gear
air lost in mid-shift      | 8-10 | synchronising  | supply_drop 0 4      | neutral low_supply neutral
splitter valve stuck       | 7-8  | in_gear        | valve_stuck 2        | old splitter_failed in_gear
splitter stuck, all move   | 6-7  | in_gear        | valve_stuck 1        | neutral splitter_failed neutral
splitter jammed            | 7-8  | in_gear        | sleeve_jammed 2      | old splitter_failed in_gear
range jammed               | 6-7  | in_gear        | sleeve_jammed 3      | neutral range_failed neutral
range valve stuck          | 6-7  | in_gear        | valve_stuck 8        | neutral range_failed neutral
layshaft sensor, braking   | 8-10 | synchronising  | hall_dropout 2       | neutral speed_stale neutral
layshaft sensor, falling   | 8-10 | coasting       | hall_dropout 2       | neutral speed_stale neutral
main sensor, braking       | 8-10 | synchronising  | hall_dropout 4       | neutral speed_stale neutral
layshaft sensor, raising   | 10-8 | speed_raising  | hall_dropout 2       | neutral speed_stale neutral
a tooth missing            | 8-10 | synchronising  | hall_missing_tooth 2 3 | in none in_gear
every edge twice           | 8-10 | synchronising  | hall_double_edge 2   | neutral speed_stale neutral
edge frames frozen         | 8-10 | synchronising  | frozen_payload 0     | neutral speed_stale neutral
slow sensors frozen        | 8-10 | in_gear        | frozen_payload 1     | old clutch_stuck in_gear
position frozen in gear    | 8-10 | in_gear        | position_frozen 0    | between position_stale faulted
position frozen in neutral | 8-10 | coasting       | position_frozen 0    | neutral engage_failed neutral
position lies by 3 mm      | 8-10 | clutch_opening | position_offset 0 3  | in none in_gear
the other position lies    | 8-10 | synchronising  | position_offset 1 3  | between disengage_failed faulted
"""  # noqa: E501
"""Name, shift, state struck in, fault with target, value and ms; result, fault code, last state."""
RESULTS = {
    "old": Result.ENDED_IN_OLD_GEAR,
    "neutral": Result.ENDED_IN_NEUTRAL,
    "in": Result.ENGAGED,
    "between": Result.ENDED_BETWEEN_GEARS,
}


def read(line: str) -> Case:
    """A line of the table."""
    name, shift, at, fault, outcome = (cell.strip() for cell in line.split("|"))
    from_, to = map(int, shift.split("-"))
    kind, *numbers = fault.split()
    target, value, for_ms = [*map(int, numbers), 0, 0, 0][:3]
    result, code, rests_in = outcome.split()
    return Case(
        name,
        (from_, to),
        State[at.upper()],
        Fault[kind.upper()],
        target,
        float(value),
        for_ms,
        RESULTS[result],
        Code[code.upper()],
        State[rests_in.upper()],
    )


CASES = [read(line) for line in TABLE.strip().splitlines()]


def struck(case: Case) -> Loop:
    """The shift with the fault at its moment; run until it rests, or for as long as it may take."""
    from_, to = case.shift
    loop = Loop(
        [(REQUEST_US, to)],
        sheet=TRUCK12,
        preset=Preset.TRUCK,
        start_gear=from_,
        toward=to,
        seed=3,
    )
    loop.run_to_state(case.at, PATIENCE_US)
    loop.fault(case.fault, case.target, case.value, case.for_ms * 1000)
    rested = loop.until(
        lambda: bool(loop.outcomes) and loop.seen(ControllerStatus, state=case.rests_in),
        PATIENCE_US,
    )
    assert rested, f"not at rest in {case.rests_in.name}:\n" + "\n".join(loop.events)
    return loop


TWINS = (
    "valve slow", "valve that pulls out stuck", "jammed in gear", "jammed for a while",
    "splitter stuck, all move", "splitter jammed", "range valve stuck", "layshaft sensor, falling",
    "main sensor, braking", "layshaft sensor, raising", "no brake",
)  # fmt: skip
"""Their kind of fault strikes in another line too; these by `make long`."""
QUICK = (
    "clutch stuck closed", "air lost in mid-shift", "splitter valve stuck", "every edge twice",
    "layshaft sensor, braking", "position frozen in gear",
)  # fmt: skip
"""One of each part of the gearbox; the others by `make check`."""


def lines() -> Iterator[Any]:
    for case in CASES:
        marks = [pytest.mark.long] * (case.name in TWINS) + [pytest.mark.check] * (
            case.name not in QUICK
        )
        yield pytest.param(case, id=case.name, marks=marks)


@pytest.mark.parametrize("case", list(lines()))
def test_a_shift_that_meets_a_fault_ends_declared_and_safe(case: Case) -> None:
    loop = struck(case)
    (outcome,) = loop.outcomes
    assert (outcome.result, outcome.fault) == (case.result, case.code), loop.events
    assert loop.violations == 0
    assert loop.last(ValveCommand) == ValveCommand()
    if case.result is not Result.ENGAGED:
        assert loop.status.active_fault is case.code
    if case.rests_in is State.FAULTED:
        assert loop.last(ClutchCommand).action is ClutchAction.OPEN
    loop.run(loop.time.now_us + 200_000)
    assert loop.status.state is case.rests_in  # it does not hunt
    assert len(loop.outcomes) == 1


@pytest.mark.check
@pytest.mark.parametrize("seed", [3, 4, 5])
@pytest.mark.parametrize("pair", [(8, 10), (10, 12), (10, 8), (1, 3), (5, 3), (6, 8)])
def test_a_frozen_sensor_throws_no_sleeve_onto_the_opposite_gear(
    pair: tuple[int, int], seed: int
) -> None:
    """Gearboxes of `harsh`, whose main shaft swings along with a gear that has come out unseen. Red
    before, all of them: pulled again, the sleeve went from neutral to the opposite gear."""
    loop = Loop(
        [(REQUEST_US, pair[1])], sheet=TRUCK12, preset=Preset.TRUCK, profile=Profile.HARSH,
        start_gear=pair[0], toward=pair[1], seed=seed,
    )  # fmt: skip
    loop.run_to_state(State.IN_GEAR, PATIENCE_US)
    sleeve = SLEEVE_OF_MAIN[DRIVE_GEARS[pair[0]].main].sleeve
    loop.fault(Fault.POSITION_FROZEN, [Sleeve.FIRST_SECOND, Sleeve.CRAWL_THIRD].index(sleeve))
    assert loop.until(lambda: bool(loop.outcomes), PATIENCE_US)
    assert loop.outcomes[0].fault is Code.POSITION_STALE
    assert loop.violations == 0


@pytest.mark.check
@pytest.mark.parametrize("stuck_mm", [10.5, 8.0])
@pytest.mark.parametrize("pair", [(8, 10), (10, 12), (3, 5)])
def test_a_sensor_that_freezes_as_a_gear_comes_out_throws_no_sleeve(
    pair: tuple[int, int], stuck_mm: float
) -> None:
    """Red before in four of six: pushed on from there by ever more, the sleeve went from neutral to
    the opposite gear."""
    loop = Loop(
        [(REQUEST_US, pair[1])], sheet=TRUCK12, preset=Preset.TRUCK, profile=Profile.HARSH,
        start_gear=pair[0], toward=pair[1], seed=4,
    )  # fmt: skip
    loop.run_to_state(State.DISENGAGING, PATIENCE_US)
    assert loop.until(
        lambda: 1e3 * abs(loop.last(SleevesMain).sleeve_first_second_m[0]) < stuck_mm, PATIENCE_US
    )
    loop.fault(Fault.POSITION_FROZEN, 0)
    assert loop.until(lambda: bool(loop.outcomes), PATIENCE_US)
    loop.run(loop.time.now_us + 3_000_000)
    assert loop.status.state is State.FAULTED
    assert loop.violations == 0


@pytest.mark.check
def test_once_a_frozen_sensor_moves_again_the_gearbox_shifts() -> None:
    """The clutch stays open as long as it shows a gear that turns against its sleeve."""
    case = next(case for case in CASES if case.name == "position frozen in gear")
    loop = struck(case._replace(for_ms=2_000))
    loop.run(2_000_000)
    assert loop.last(ClutchCommand).action is ClutchAction.OPEN
    loop.run(3_000_000)
    assert loop.status.state is State.NEUTRAL
    loop.operator.ask(case.shift[1], loop.time.now_us)
    assert loop.until(lambda: len(loop.outcomes) == 2, PATIENCE_US)
    assert loop.outcomes[1].result is Result.ENGAGED
    assert loop.violations == 0


@pytest.mark.check
def test_a_gear_that_all_wheels_deny_is_not_pulled() -> None:
    """Another controller finds a sensor that lies. Red before: it pulled, out of neutral."""
    loop = struck(next(case for case in CASES if case.name == "position frozen in gear"))
    loop.controller.core = ControllerCore(loop.header)
    loop.run(loop.time.now_us + 3_000_000)
    assert loop.status.state is State.IN_GEAR
    loop.operator.ask(10, loop.time.now_us)
    loop.run(loop.time.now_us + 1_000_000)
    assert loop.events[-1].endswith("refused: position_stale before it began")
    assert loop.status.active_fault is Code.POSITION_STALE
    assert loop.status.state is State.IN_GEAR


@pytest.mark.parametrize("channel", [2, 4])
@pytest.mark.parametrize(
    "strikes_ms", [0, *(pytest.param(ms, marks=pytest.mark.long) for ms in (9, 18, 36)), 27]
)
def test_a_dead_speed_sensor_is_noticed_within_50_ms(channel: int, strikes_ms: int) -> None:
    """At any moment of a shift, with the sensor's frames still coming: the first step that acts."""
    loop = Loop([(REQUEST_US, 10)], sheet=TRUCK12, preset=Preset.TRUCK, toward=10, seed=4)
    loop.run_to_state(State.SYNCHRONISING, PATIENCE_US)
    loop.run(loop.time.now_us + 1000 * strikes_ms)
    dead_us = loop.time.now_us
    loop.fault(Fault.HALL_DROPOUT, channel)
    assert loop.until(lambda: bool(loop.outcomes), PATIENCE_US)
    assert loop.outcomes[0].fault is Code.SPEED_STALE
    assert loop.time.now_us - dead_us <= STALE_US


def test_without_air_a_shift_is_not_begun() -> None:
    loop = Loop([(REQUEST_US, 10)], sheet=TRUCK12, preset=Preset.TRUCK, toward=10)
    loop.run(100_000)
    loop.fault(Fault.SUPPLY_DROP, 0, 4.0)
    loop.run(REQUEST_US + 100_000)
    (outcome,) = loop.outcomes
    assert (outcome.result, outcome.fault) == (Result.REFUSED, Code.LOW_SUPPLY)
    assert State.CLUTCH_OPENING not in loop.states


@pytest.mark.check
def test_a_faulted_box_goes_on_when_its_sensor_does() -> None:
    """Clutch open while nobody knows the gear; closed again, and a shift made, once it is known."""
    case = next(case for case in CASES if case.name == "the other position lies")
    loop = struck(case._replace(for_ms=2_500))
    loop.run(loop.time.now_us + 3_000_000)
    assert loop.status.state in (State.NEUTRAL, State.IN_GEAR), loop.events
    assert loop.last(ClutchCommand).action is ClutchAction.CLOSE


@pytest.mark.parametrize("state", [State.SYNCHRONISING, State.COASTING, State.ENGAGING])
def test_an_estimate_that_is_not_a_number_reaches_no_command(state: State) -> None:
    """The filter breaks in mid-shift: the controller steps on, every frame of it can be sent, and
    the shift ends."""
    loop = Loop([(REQUEST_US, 10)])
    loop.run_to_state(state, PATIENCE_US)
    core: Any = loop.core
    core.observer.layshaft._filter.x[:] = math.nan
    before = loop.time.now_us
    loop.run(before + 1_000_000)
    steps = [status.step_number for status in loop.of(ControllerStatus)]
    assert steps == list(range(len(steps)))
    assert loop.time.now_us - before > 900_000
    assert loop.outcomes[0].fault in (Code.SPEED_STALE, Code.NONE)
    assert loop.valves_driven == ()
    assert loop.violations == 0
