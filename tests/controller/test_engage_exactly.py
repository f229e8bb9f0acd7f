"""From the firing to the gear in mesh, limit by limit: what a sleeve's way, its contact and
its rest on a tooth are taken for."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from test_synchronise_exactly import (
    EARLIEST_US,
    LIMITS,
    MS,
    NOW_US,
    SHEET,
    VALVE,
    Chosen,
    Step,
)

from meshpoint.controller.planning.strategist import Plan
from meshpoint.controller.shift import engage as module
from meshpoint.controller.shift.engage import engage, retract
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.valve_board import OFF, ValveName
from meshpoint.dbc.messages import ClutchAction, FaultCode, ShiftDecision, ShiftResult
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import MainGear, Sleeve
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN

GEAR, SIDE = MainGear.SECOND, SLEEVE_OF_MAIN[MainGear.SECOND]
SLEEVE, DOG = SHEET.sleeve, SHEET.dog
FIRE_US = NOW_US - 30 * MS
VALVE_US = round(1e6 * SLEEVE.valve_delay_s)


class Slips:
    """A gear whose slip at two times, 20 ms apart, is laid down."""

    def __init__(self, slip: float = 1.0, later: float = 0.9) -> None:
        self.said, self.asked = (slip, later), list[float]()

    def slip_rad_s(self, time_us: float) -> float:
        self.asked.append(time_us)
        return self.said[len(self.asked) - 1]


class Seen:
    """The measured gearbox: a sleeve so far past its gear's teeth."""

    def __init__(self) -> None:
        self.main_gear: MainGear | None = None
        self.entered_m = -1e-3
        self.contact: float | None = None
        self.mesh_us: int | None = NOW_US - 5 * MS
        self.brake_gauge_pa = 2.5e5

    def position_m(self, sleeve: Sleeve) -> float:
        assert sleeve is SIDE.sleeve
        return SIDE.direction * (SLEEVE.to_contact_m + self.entered_m)

    def contact_us(self, sleeve: Sleeve, direction: int) -> float | None:
        assert (sleeve, direction) == (SIDE.sleeve, SIDE.direction)
        return self.contact

    def engaged_us(self, sleeve: Sleeve, direction: int) -> int | None:
        assert (sleeve, direction) == (SIDE.sleeve, SIDE.direction)
        return self.mesh_us


class Aims(Chosen):
    """That says whether a sleeve is to go back."""

    goes_back = False

    def __init__(self) -> None:
        super().__init__()
        self.asked_back: list[tuple[int, int, int]] = []

    def is_to_go_back(self, _predictor: object, now: int, contact: int, earliest: int) -> bool:
        self.asked_back.append((now, contact, earliest))
        return self.goes_back


class Engaging(Step):
    """A sleeve that was fired for the gap 30 ms ago."""

    def __init__(self, fire_us: int = FIRE_US) -> None:
        super().__init__()
        self.planned(fire_us)
        self.predictor: Any = Slips()
        self.aims = Aims()
        context: Any = self.context
        context.strategist, context.predictor = self.aims, lambda *_: self.predictor
        context.state, self.shift.attempts = State.ENGAGING, 2
        self.locked: list[tuple[MainGear, float, bool]] = []
        self.delays: list[tuple[Any, ...]] = []
        self.drifts: list[tuple[Any, ...]] = []
        context.references.locked = lambda *given: self.locked.append(given)
        context.references.released = lambda: None
        context.delays = SimpleNamespace(learn=lambda *given: self.delays.append(given))
        context.drifts = SimpleNamespace(learn=lambda *given: self.drifts.append(given))
        self.seen = self.snapshot.view = Seen()

    def engage(self) -> Trigger | None:
        return engage(self.context, self.snapshot)

    def called_back(self) -> bool:
        """Whether this step has taken the firing back: it does not count as an attempt."""
        trigger, shift = self.engage(), self.shift
        done = (trigger, shift.attempts, shift.calls, self.command(VALVE) == OFF)
        if trigger is None:
            assert done == (None, 2, shift.calls, False)
            return False
        assert (trigger, shift.attempts) == (Trigger.BLOCKED, 1)
        assert self.command(VALVE) == OFF
        return True


@pytest.fixture(autouse=True)
def _free_brake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "brake_holds", lambda *_: False)


def test_the_last_prediction_of_a_free_layshaft_is_kept_with_its_time() -> None:
    step, context = Engaging(), None
    context = step.context
    context.free_us = 3
    assert step.engage() is None
    assert context.free_predictor is step.predictor
    assert context.free_us == NOW_US
    kept, step.predictor, step.snapshot.now_us = step.predictor, None, NOW_US + 1
    step.engage()
    assert context.free_predictor is kept
    assert context.free_us == NOW_US


WAY_US = 1e6 * (SLEEVE.stroke_m - 1e-3 - SLEEVE.to_contact_m) / SLEEVE.speed_m_s
"""From contact to where a sleeve is seen in mesh, at the sheet's speed."""


@pytest.mark.parametrize(
    ("took", "straight"), [(1.29, True), (1.31, False), (None, False), ("unseen", False)]
)
def test_a_gear_in_mesh_ends_the_shift_and_is_watched_for_its_flank(
    took: float | str | None, straight: bool
) -> None:
    """A sleeve that took 1.3 times as long as its speed has it, or more, has rested on a tooth: the
    flank was struck up to 28 ms ago then, and else in the last free step."""
    step = Engaging()
    step.seen.main_gear = GEAR
    step.seen.mesh_us = None if took == "unseen" else NOW_US - 5 * MS
    if isinstance(took, float):
        step.shift.measured_contact_us = round(NOW_US - 5 * MS - took * WAY_US)
    elif took == "unseen":
        step.shift.measured_contact_us = NOW_US - 6 * MS
    step.context.free_us = NOW_US - 12 * MS
    slips, step.predictor = Slips(4.0, 3.9), None
    step.context.free_predictor = slips  # type: ignore[assignment]
    assert step.engage() is Trigger.ENGAGED
    assert step.locked == [(GEAR, 4.0, straight)]
    struck_us = NOW_US - (12 if straight else 28) * MS
    assert slips.asked == [struck_us, struck_us + 20 * MS]
    assert (step.shift.result, step.shift.fault) == (ShiftResult.ENGAGED, FaultCode.NONE)
    assert step.shift.end_us == (NOW_US if took == "unseen" else NOW_US - 5 * MS)
    assert step.context.finished is step.shift


CROSSES = math.sqrt(2.0 * DOG.backlash_rad * 5.0)
"""The slip that crosses a whole gap while it falls by 5 rad/s in a second."""


@pytest.mark.parametrize(
    ("slip", "later", "told"),
    [(-0.2, -0.3, -0.3), (0.0, -0.1, -0.1), (1.01 * CROSSES, 1.01 * CROSSES - 0.1, "slip"),
     (0.99 * CROSSES, 0.99 * CROSSES - 0.1, 0.0), (0.1, 0.1, "slip"), (0.1, 0.3, "slip")],
)  # fmt: skip
def test_a_slip_tells_the_flank_where_it_crosses_the_gap_before_it_turns_round(
    slip: float, later: float, told: float | str
) -> None:
    step = Engaging()
    step.seen.main_gear, step.predictor = GEAR, None
    step.context.free_predictor = Slips(slip, later)  # type: ignore[assignment]
    step.engage()
    ((_, found, _),) = step.locked
    assert found == (slip if told == "slip" else told)


def test_without_any_prediction_no_flank_is_told() -> None:
    step = Engaging()
    step.seen.main_gear, step.predictor = GEAR, None
    step.engage()
    assert step.locked == [(GEAR, 0.0, False)]


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(("off_m", "holds"), [(1e-6, True), (-1e-6, False)])
def test_the_clutch_closes_once_the_overlap_holds_the_sleeve_of_a_gear_that_is_known(
    off_m: float, holds: bool, known: bool
) -> None:
    step = Engaging()
    step.seen.entered_m, step.known = DOG.most_overlap_m + off_m, known
    closes = holds and known
    step.context.clutch = ClutchAction.OPEN if closes else ClutchAction.CLOSE
    assert step.engage() is None
    assert step.context.clutch is (ClutchAction.CLOSE if closes else ClutchAction.OPEN)


@pytest.mark.parametrize(
    ("rested_us", "entered_m", "blocked"),
    [(0, 0.59e-3, False), (1, 0.59e-3, True), (1, 0.61e-3, False), (1, -1e-3, True)],
)
def test_a_sleeve_that_has_not_entered_so_long_after_contact_rests_on_a_tooth(
    rested_us: int, entered_m: float, blocked: bool
) -> None:
    """Six tenths of a millimetre past it."""
    step = Engaging()
    step.seen.entered_m = entered_m
    step.shift.measured_contact_us = NOW_US - LIMITS.face_ms * MS - rested_us
    assert step.engage() is (Trigger.BLOCKED if blocked else None)
    assert (step.command(VALVE) == OFF) is blocked
    assert (step.shift.attempts, step.shift.calls) == (2, 0)


@pytest.mark.parametrize(("late_us", "blocked"), [(0, False), (1, True)])
def test_a_sleeve_that_never_arrives_is_blocked(late_us: int, blocked: bool) -> None:
    step = Engaging()
    step.context.since_us = NOW_US - LIMITS.engage_ms * MS - late_us
    assert step.engage() is (Trigger.BLOCKED if blocked else None)
    assert (step.command(VALVE) == OFF) is blocked
    assert step.shift.calls == 0


LAST_FIRE_US = NOW_US + 2 * MS - VALVE_US
"""Of a sleeve that can just be called back: off must arrive before its valve's delay is over."""


@pytest.mark.parametrize(
    ("change", "is_asked"),
    [("none", True), ("too late", False), ("six calls", False), ("five calls", True),
     ("does not aim", False), ("unknown", False), ("no plan", False), ("no prediction", False)],
)  # fmt: skip
@pytest.mark.parametrize("goes_back", [True, False])
def test_a_sleeve_that_has_not_moved_yet_may_be_called_back(
    change: str, is_asked: bool, goes_back: bool
) -> None:
    """And is fired anew 20 ms after what could be commanded now, at the soonest."""
    fire_us = LAST_FIRE_US - (change == "too late")
    step = Engaging(fire_us)
    step.aims.goes_back = goes_back
    step.shift.calls = {"six calls": 6, "five calls": 5}.get(change, 0)
    step.shift.aimed, step.known = change != "does not aim", change != "unknown"
    calls = step.shift.calls
    if change == "no plan":
        step.shift.plan = None
    if change == "no prediction":
        step.predictor = None
    assert step.called_back() is (is_asked and goes_back)
    assert step.shift.calls == calls + (is_asked and goes_back)
    asked = [(NOW_US, fire_us + 45 * MS, EARLIEST_US + 20 * MS)] if is_asked else []
    assert step.aims.asked_back == asked
    assert step.aims.known == ({True} if is_asked else set())


def test_a_sleeve_is_called_back_from_a_brake_that_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    step, asked = Engaging(LAST_FIRE_US), list[Any]()

    def holds(*given: object) -> bool:
        asked.append(given)
        return True

    monkeypatch.setattr(module, "brake_holds", holds)
    assert step.called_back()
    assert asked == [(SHEET, step.predictor, 2.5e5)]
    assert step.aims.asked_back == []


@pytest.mark.parametrize(
    ("change", "is_refused"),
    [("none", True), ("driven", False), ("just now", False), ("six calls", False),
     ("five calls", True), ("has arrived", False), ("no plan", False)],
)  # fmt: skip
def test_a_firing_that_the_valve_side_has_not_taken_in_40_ms_is_called_back(
    change: str, is_refused: bool
) -> None:
    step = Engaging(NOW_US - 40 * MS - (change != "just now"))
    driven = change == "driven"
    step.snapshot.driven = tuple(
        driven if valve is VALVE else not driven for valve in ValveName
    )  # fmt: skip
    step.shift.calls = {"six calls": 6, "five calls": 5}.get(change, 0)
    if change == "has arrived":
        step.shift.measured_contact_us = NOW_US - MS
    if change == "no plan":
        step.shift.plan = None
    assert step.called_back() is is_refused


def contact(step: Engaging, at_us: float = NOW_US - 7_000.4) -> None:
    step.seen.contact = at_us
    assert step.engage() is None


def test_a_contact_that_is_seen_is_learned_from() -> None:
    """The sleeve's delay from its firing on, the gear's drift between the two predictions, and the
    phase that it had by the last."""
    step = Engaging()
    fired: Any = object()
    step.context.firing_predictor = fired
    aims: Any = step.aims
    own = aims.plan_at

    def plan_at(predictor: object, contact_us: int, decision: ShiftDecision) -> Plan:
        assert (predictor, contact_us) == (step.predictor, NOW_US - 7_000)
        assert decision is ShiftDecision.NONE
        plan: Plan = own(predictor, contact_us, decision)
        return plan

    aims.plan_at = plan_at
    contact(step)
    assert step.shift.measured_contact_us == NOW_US - 7_000
    assert step.delays == [(GEAR, NOW_US - 7_000 - FIRE_US)]
    assert step.drifts == [(fired, step.predictor, NOW_US - 7_000.4)]
    assert step.shift.estimated_phase_rad == 0.01
    contact(step, NOW_US - 1_000.0)
    assert len(step.delays) == 1, "a contact is learned once"
    assert step.shift.measured_contact_us == NOW_US - 7_000


@pytest.mark.parametrize("missing", ["aim", "fired", "free", "reference", "plan", "contact"])
def test_a_contact_teaches_no_more_than_is_known_of_it(missing: str) -> None:
    step = Engaging()
    fired: Any = None if missing == "fired" else object()
    step.context.firing_predictor = fired
    step.shift.aimed, step.known = missing != "aim", missing != "reference"
    if missing == "free":
        step.predictor = None
    if missing == "plan":
        step.shift.plan = None
    if missing == "contact":
        assert step.engage() is None
        assert step.shift.measured_contact_us is None
    else:
        contact(step)
        assert step.shift.measured_contact_us is not None
    assert bool(step.delays) is (missing not in ("plan", "contact"))
    assert bool(step.drifts) is (missing not in ("aim", "fired", "free", "contact"))
    known = missing not in ("free", "reference", "contact")
    assert step.shift.estimated_phase_rad == (0.01 if known else 0.0)


PULLS = ValveName.MAIN_FIRST
"""The valve that pulls the second gear out pushes toward the first."""


class Retracting(Engaging):
    """A sleeve on its way back, for so long, from a gear."""

    def __init__(self, since_us: int = 10 * MS, gear: MainGear = GEAR) -> None:
        super().__init__()
        self.seen.main_gear = gear
        self.context.since_us = NOW_US - since_us
        self.context.clutch = ClutchAction.CLOSE
        self.unloaded_us = EARLIEST_US + 3 * MS
        context: Any = self.context
        context.unloaded_us = lambda _: self.unloaded_us

    def retract(self) -> Trigger | None:
        trigger = retract(self.context, self.snapshot)
        assert self.command(VALVE) == OFF
        assert self.shift.plan is None
        assert self.context.clutch is ClutchAction.OPEN
        return trigger


@pytest.mark.parametrize(("since_us", "pulls"), [(120_000, False), (120_001, True)])
def test_a_sleeve_that_is_not_back_after_120_ms_is_pulled(since_us: int, pulls: bool) -> None:
    step = Retracting(since_us)
    assert step.retract() is None
    assert step.command(PULLS) == ((step.unloaded_us, True, False) if pulls else OFF)


@pytest.mark.parametrize(("late_us", "trigger"), [(0, None), (1, Trigger.GAVE_UP)])
def test_a_sleeve_that_cannot_be_pulled_back_ends_the_shift(
    late_us: int, trigger: Trigger | None
) -> None:
    step = Retracting(LIMITS.disengage_ms * MS + late_us)
    assert step.retract() is trigger
    if trigger is not None:
        assert step.shift.fault is FaultCode.ENGAGE_FAILED


@pytest.mark.parametrize(("left", "trigger"), [(1, Trigger.RETRACTED), (0, Trigger.GAVE_UP)])
def test_a_sleeve_that_is_back_is_fired_again_while_an_attempt_is_left(
    left: int, trigger: Trigger
) -> None:
    step = Retracting(gear=MainGear.NEUTRAL)
    step.shift.attempts = LIMITS.attempts - left
    step.context.board.schedule(PULLS, True, NOW_US - 5 * MS, NOW_US - 9 * MS)
    assert step.retract() is trigger
    assert step.command(PULLS) == OFF
    if not left:
        assert step.shift.fault is FaultCode.ENGAGE_FAILED
        assert step.shift.result is ShiftResult.ENDED_IN_NEUTRAL


def test_the_step_that_takes_the_valve_off_fires_nothing() -> None:
    step = Retracting(0, MainGear.NEUTRAL)
    assert step.retract() is None
    assert Retracting(1, MainGear.NEUTRAL).retract() is Trigger.RETRACTED
