"""Splitter and range on their way: which valves are driven and for how long, and when the shafts
turn together again, by views and speeds that are laid down."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from test_synchronise_exactly import EARLIEST_US, LIMITS, MS, NOW_US, Step

from meshpoint.controller.shift.group_change import change_splitter, change_steps
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.valve_board import OFF, ValveName
from meshpoint.dbc.messages import FaultCode, ShiftResult
from meshpoint.gearbox import DriveGear, MainGear, Range, Split

UNLOADED_US = EARLIEST_US + 6 * MS
LOW, HIGH = Split.LOW, Split.HIGH
SPLIT_LOW, SPLIT_HIGH = ValveName.SPLIT_LOW, ValveName.SPLIT_HIGH
RANGE_LOW, RANGE_HIGH = ValveName.RANGE_LOW, ValveName.RANGE_HIGH


class Steps(Step):
    """A shift to splitter high and range low, from where the view says."""

    def __init__(
        self, split: Split | None = LOW, range_: Range | None = Range.HIGH,
        main: MainGear = MainGear.NEUTRAL,
    ) -> None:  # fmt: skip
        super().__init__()
        self.shift.target = DriveGear(9, MainGear.SECOND, HIGH, Range.LOW)
        self.view = self.snapshot.view
        self.view.split, self.view.range_, self.view.main_gear = split, range_, main
        self.together: set[Split | Range] = set()
        self.speeds = self.snapshot.speeds = SimpleNamespace(
            layshaft=100.0, main=60.0, split_turns_together=lambda each: each in self.together,
            range_turns_together=lambda each: each in self.together,
        )  # fmt: skip
        self.layshaft: float | None = 100.0
        self.snapshot.main = SimpleNamespace(omega_rad_s=60.0)
        self.snapshot.layshaft = SimpleNamespace(at=self._at)
        self.unloaded_us: int | None = UNLOADED_US
        context: Any = self.context
        context.step_unloaded_us = lambda _: self.unloaded_us

    def _at(self, time_us: int) -> Any:
        assert time_us == NOW_US
        return None if self.layshaft is None else SimpleNamespace(omega_rad_s=self.layshaft)

    def go(self, alone: bool = False) -> Trigger | None:
        return (change_splitter if alone else change_steps)(self.context, self.snapshot)

    def arrive(self, *steps: Split | Range) -> Steps:
        """Steps that are in mesh now and turn together."""
        for each in steps:
            if isinstance(each, Split):
                self.view.split = each
            else:
                self.view.range_ = each
            self.together.add(each)
        return self

    @property
    def on(self) -> set[ValveName]:
        return {valve for valve in ValveName if self.context.board.command(valve).on}


def test_what_differs_from_the_new_gear_is_pushed_as_the_plates_part() -> None:
    step = Steps()
    assert step.go() is None
    assert step.on == {SPLIT_HIGH, RANGE_LOW}
    for valve in step.on:
        assert step.command(valve) == (UNLOADED_US, True, False)


@pytest.mark.parametrize(
    ("split", "range_", "on"),
    [(HIGH, Range.HIGH, {RANGE_LOW}), (LOW, Range.LOW, {SPLIT_HIGH}), (HIGH, Range.LOW, set()),
     (None, Range.LOW, {SPLIT_HIGH}), (HIGH, None, {RANGE_LOW})],
)  # fmt: skip
def test_what_stands_as_it_should_is_left_alone(
    split: Split | None, range_: Range | None, on: set[ValveName]
) -> None:
    step = Steps(split, range_)
    assert step.go() is (None if on else Trigger.STEPS_IN)
    assert step.on == on


def test_the_range_is_not_touched_while_a_gear_is_in_mesh() -> None:
    step = Steps(main=MainGear.SECOND)
    assert step.go(alone=True) is None
    assert step.on == {SPLIT_HIGH}


def test_steps_are_in_when_all_are_in_mesh_and_turn_together() -> None:
    """Their valves go off as each is in mesh; both are asked about although they stand by then."""
    step = Steps()
    step.go()
    step.arrive(HIGH)
    assert step.go() is None
    assert step.on == {RANGE_LOW}
    step.view.range_ = Range.LOW
    assert step.go() is None, "in mesh, but not together yet"
    assert step.on == set()
    assert step.arrive(Range.LOW).go() is Trigger.STEPS_IN
    step.together.remove(HIGH)
    assert step.go() is None


def test_a_splitter_between_its_steps_by_a_layshaft_that_rests_goes_to_the_high_one() -> None:
    """The low one is forbidden then, whatever the new gear wants."""
    step = Steps(split=None, range_=Range.LOW)
    step.shift.target = DriveGear(8, MainGear.SECOND, LOW, Range.LOW)
    step.speeds.layshaft = None
    step.go()
    assert step.on == {SPLIT_HIGH}
    turning = Steps(split=None, range_=Range.LOW)
    turning.shift.target = step.shift.target
    turning.go()
    assert turning.on == {SPLIT_LOW}
    stood = Steps(split=HIGH, range_=Range.LOW)
    stood.shift.target, stood.speeds.layshaft = step.shift.target, None
    stood.go()
    assert stood.on == {SPLIT_LOW}, "one that stood in a step has left nothing to itself"
    stood.view.split = None
    stood.go()
    assert SPLIT_LOW in stood.on


@pytest.mark.parametrize(
    ("split_in", "range_in", "fault"),
    [(False, False, FaultCode.SPLITTER_FAILED), (True, False, FaultCode.RANGE_FAILED),
     (False, True, FaultCode.SPLITTER_FAILED), (True, True, FaultCode.SPEED_STALE)],
)  # fmt: skip
@pytest.mark.parametrize("late_us", [0, 1])
def test_what_is_not_done_in_time_is_the_fault(
    late_us: int, split_in: bool, range_in: bool, fault: FaultCode
) -> None:
    """The first of them; where all are in but the estimates do not follow, these."""
    step = Steps()
    step.layshaft = None
    step.go()
    step.context.since_us = NOW_US - LIMITS.steps_ms * MS - late_us
    step.arrive(*[HIGH] * split_in, *[Range.LOW] * range_in)
    assert step.go() is (Trigger.GAVE_UP if late_us else None)
    assert step.shift.fault is (fault if late_us else FaultCode.NONE)


@pytest.mark.parametrize(
    ("layshaft", "main", "seen", "agree"),
    [(100.0, 60.0, (100.0, 60.0), True), (104.9, 60.0, (100.0, 60.0), True),
     (105.1, 60.0, (100.0, 60.0), False), (94.9, 60.0, (100.0, 60.0), False),
     (100.0, 63.1, (100.0, 60.0), False), (100.0, 62.9, (100.0, 60.0), True),
     (None, 60.0, (100.0, 60.0), False), (100.0, None, (100.0, 60.0), False),
     (100.0, 60.0, (None, 60.0), False), (100.0, 60.0, (100.0, None), False),
     (0.0, 60.0, (0.0, 60.0), True)],
)  # fmt: skip
def test_estimates_are_believed_again_within_five_per_cent_of_what_is_measured(
    layshaft: float | None, main: float | None, seen: tuple[float | None, ...], agree: bool
) -> None:
    step = Steps(HIGH, Range.LOW)
    step.layshaft = layshaft
    step.snapshot.main = None if main is None else SimpleNamespace(omega_rad_s=main)
    step.speeds.layshaft, step.speeds.main = seen
    assert step.go() is (Trigger.STEPS_IN if agree else None)


def test_a_shift_by_the_splitter_alone_ends_as_it_turns_together() -> None:
    step = Steps(range_=Range.LOW, main=MainGear.SECOND)
    assert step.go(alone=True) is None
    step.layshaft = None
    assert step.arrive(HIGH).go(alone=True) is Trigger.ENGAGED, "no estimate is waited for"
    assert (step.shift.result, step.shift.fault) == (ShiftResult.ENGAGED, FaultCode.NONE)


@pytest.mark.parametrize("late_us", [0, 1])
def test_a_splitter_that_does_not_come_ends_the_shift(late_us: int) -> None:
    step = Steps(range_=Range.LOW, main=MainGear.SECOND)
    step.context.since_us = NOW_US - LIMITS.steps_ms * MS - late_us
    assert step.go(alone=True) is (Trigger.GAVE_UP if late_us else None)
    if late_us:
        assert step.shift.fault is FaultCode.SPLITTER_FAILED


@pytest.mark.parametrize(
    ("at_us", "expected"),
    [(EARLIEST_US + 1, (UNLOADED_US, True, False)), (EARLIEST_US, (EARLIEST_US, True, False)),
     (NOW_US - 400 * MS, (NOW_US - 400 * MS, True, False)), (NOW_US - 400 * MS - 1, OFF)],
)  # fmt: skip
def test_a_push_follows_the_clutch_stays_and_is_let_go_after_400_ms(
    at_us: int, expected: tuple[int, bool, bool]
) -> None:
    """To be pushed again in the next step."""
    step = Steps(range_=Range.LOW)
    step.context.board.schedule(SPLIT_HIGH, True, at_us, min(at_us, NOW_US) - MS)
    step.go()
    assert step.command(SPLIT_HIGH) == expected
    if expected == OFF:
        step.go()
        assert step.command(SPLIT_HIGH) == (UNLOADED_US, True, False)


def test_a_clutch_that_comes_back_takes_the_push_back() -> None:
    step = Steps()
    step.go()
    step.unloaded_us = None
    step.go()
    assert step.on == set()
