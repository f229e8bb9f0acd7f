"""What a step between neutral and the firing decides, limit by limit: brake, release and firing, of
gears whose slip falls straight and of strategies that say a time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.planning.strategist import Plan
from meshpoint.controller.settings import ControllerSettings, ValveTiming
from meshpoint.controller.shift import synchronise as module
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.synchronise import coast, synchronise
from meshpoint.controller.shift.table import ShiftRecord, Trigger
from meshpoint.controller.shift.valve_board import NONE_DRIVEN, OFF, ValveBoard, ValveName
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.dbc.messages import FaultCode, ReferenceSource, ShiftDecision, ShiftResult, Strategy
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET, SETTINGS = load_sheet("truck12"), ControllerSettings()
LIMITS, WINDOW = SETTINGS.limits, SETTINGS.window
MS = 1_000
NOW_US = 5_000_000
EARLIEST_US = NOW_US + 4 * MS
SINCE_US = NOW_US - 20 * MS
DELAY_US = 45 * MS
TARGET = next(each for each in DRIVE_GEARS.values() if each.main is MainGear.SECOND)
VALVE, BRAKE = ValveName.MAIN_SECOND, ValveName.BRAKE
FAST_RAD_S, FALL_RAD_S2 = 40.0, 5.0


class Gear:
    """A predictor of a gear whose slip falls straight."""

    gear, delay_us = TARGET.main, DELAY_US

    def __init__(self, slip: float = FAST_RAD_S, fall: float = FALL_RAD_S2) -> None:
        self.slip, self.fall = slip, fall
        self.asked: list[tuple[float, float | None]] = []

    def steady_slip_rad_s(self, time_us: float, release_us: float | None = None) -> float:
        assert release_us is None
        return self.slip - self.fall * (time_us - NOW_US) * 1e-6

    def slip_rad_s(self, time_us: float, release_us: float | None = None) -> float:
        self.asked.append((time_us, release_us))
        return 3.25


class Chosen:
    """A strategy and its strategist: they say what they are told to."""

    aims, fire_slip_rad_s = True, 2.0

    def __init__(self) -> None:
        self.release_at: tuple[int, int] = (EARLIEST_US + 30 * MS, EARLIEST_US + 80 * MS)
        self.contact_at: int | None = NOW_US + 20 * MS + DELAY_US
        self.contact_slip, self.misses = 1.0, False
        self.released: list[tuple[int, int]] = []
        self.known: set[bool] = set()

    def release(self, _predictor: object, now_us: int, earliest_us: int) -> tuple[int, int]:
        self.released.append((now_us, earliest_us))
        return self.release_at

    def contact(self, _predictor: object, now_us: int, earliest_us: int) -> int | None:
        assert (now_us, earliest_us) == (NOW_US, EARLIEST_US)
        return self.contact_at

    def acting(self, reference_known: bool) -> Chosen:
        self.known.add(reference_known)
        return self

    def wire(self, _acting: object) -> Strategy:
        return Strategy.SPEED_WINDOW_ANTICIPATING

    def plan_at(self, _predictor: object, contact_us: int, decision: ShiftDecision) -> Plan:
        fire_us = contact_us - DELAY_US
        return Plan(decision, fire_us, contact_us, 0.01, 0.002, self.contact_slip, self.misses)


class Step:
    """One step: the context as it stands, and what is seen."""

    def __init__(self, gear: Gear | None = None, settings: ControllerSettings = SETTINGS) -> None:
        self.gear, self.chosen = gear or Gear(), Chosen()
        self.known = True
        references: Any = SimpleNamespace(
            known=lambda _: self.known, source=lambda _: ReferenceSource.RESTORED
        )
        board = ValveBoard(ValveTiming(settings.valve_timing))
        self.context = ShiftContext(SHEET, settings, board, BrakeInput(12 * MS), references)
        self.context.strategist = self.chosen  # type: ignore[assignment]
        give: Any = lambda *_: self.gear  # noqa: E731
        self.context.predictor = give  # type: ignore[method-assign]
        self.context.since_us = SINCE_US
        self.context.state = State.SYNCHRONISING
        self.shift = ShiftRecord(5, 7, TARGET, 0, Strategy.TARGET_PHASE)
        self.context.shift = self.shift
        self.snapshot: Any = SimpleNamespace(
            now_us=NOW_US,
            earliest_us=EARLIEST_US,
            view=SimpleNamespace(main_gear=MainGear.NEUTRAL, brake_gauge_pa=1.5e5),
            driven=tuple(True for _ in ValveName),
        )

    def braking(self, since_us: int = NOW_US - 50 * MS) -> Step:
        """With the brake on for so long."""
        self.context.switch_brake(True, since_us, SimpleNamespace(now_us=since_us))  # type: ignore[arg-type]
        self.shift.pulses = 1
        return self

    def planned(self, fire_us: int, misses: bool = False) -> Step:
        plan = Plan(ShiftDecision.FIRE, fire_us, fire_us + DELAY_US, 0.01, 0.002, 1.0, misses)
        self.shift.plan, self.shift.aimed = plan, True
        self.context.board.schedule(VALVE, True, fire_us, NOW_US - 10 * MS)
        return self

    def run(self, coasts: bool = False) -> Trigger | None:
        return (coast if coasts else synchronise)(self.context, self.snapshot)

    def command(self, valve: ValveName = BRAKE) -> tuple[int, bool, bool]:
        time_us, on, before = self.context.board.command(valve)
        return time_us, on, before


@pytest.fixture(autouse=True)
def _free_brake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "brake_holds", lambda *_: False)


BOTH = pytest.mark.parametrize("coasts", [False, True])


@BOTH
def test_who_takes_longer_than_allowed_gives_up(coasts: bool) -> None:
    for late_us, trigger in ((0, None), (1, Trigger.GAVE_UP)):
        step = Step().braking()
        step.context.since_us = NOW_US - LIMITS.synchronise_ms * MS - late_us
        if coasts:
            step.shift.release_us = NOW_US
        assert step.run(coasts) is trigger
        if trigger is not None:
            assert step.shift.result is ShiftResult.ENDED_IN_NEUTRAL
            assert step.shift.fault is FaultCode.SYNCHRONISE_FAILED
            assert step.command() == OFF


@BOTH
def test_while_a_speed_is_missing_nothing_is_decided(coasts: bool) -> None:
    step = Step()
    step.gear = None  # type: ignore[assignment]
    assert step.run(coasts) is None
    assert step.command() == step.command(VALVE) == OFF
    assert step.context.decision is None


def test_a_gear_that_is_too_fast_is_braked_from_the_earliest_time_on() -> None:
    step = Step()
    assert step.run() is None
    assert step.command() == (EARLIEST_US, True, False)
    assert step.context.brake.switches == [(EARLIEST_US, True)]
    assert (step.shift.pulses, step.shift.release_us) == (1, None)
    assert step.chosen.released == [(NOW_US, EARLIEST_US)]
    release_us, contact_us = step.chosen.release_at
    assert step.gear.asked == [(contact_us, release_us)]
    assert step.context.decision == Plan(ShiftDecision.BRAKE, 0, contact_us, 0.0, 0.0, 3.25)
    assert step.command(VALVE) == OFF, "no firing before there is a release"


def test_a_brake_that_is_on_is_not_switched_on_again() -> None:
    step = Step().braking()
    before = step.command()
    step.chosen.release_at = (NOW_US + 91 * MS, NOW_US + 150 * MS)
    assert step.run() is None
    assert step.command() == before
    assert step.shift.pulses == 1


def test_a_release_still_to_come_is_no_new_use_of_the_brake() -> None:
    """Its command says off, and on until then."""
    step = Step().braking()
    step.context.switch_brake(False, NOW_US + 40 * MS, step.snapshot)
    step.shift.release_us = NOW_US + 40 * MS
    step.chosen.release_at = (NOW_US + 30 * MS, NOW_US + 90 * MS)
    assert step.run() is None
    assert step.shift.pulses == 1
    assert step.command() == (NOW_US + 30 * MS, False, True)
    assert step.shift.release_us == NOW_US + 30 * MS
    assert step.context.brake.switches[-1] == (NOW_US + 30 * MS, False)


@pytest.mark.parametrize(("driven", "since_ms", "again"), [
    (False, 41, True), (False, 40, False), (True, 41, False),
])  # fmt: skip
def test_a_brake_that_the_valve_side_has_not_taken_in_40_ms_is_sent_again(
    driven: bool, since_ms: int, again: bool
) -> None:
    """And counts as not having been on."""
    step = Step().braking(NOW_US - since_ms * MS)
    step.snapshot.driven = tuple(driven and valve is BRAKE for valve in ValveName)
    step.chosen.release_at = (NOW_US + 91 * MS, NOW_US + 150 * MS)
    step.run()
    on_us = EARLIEST_US if again else NOW_US - since_ms * MS
    assert step.command()[:2] == (on_us, True)
    switches = [(NOW_US - since_ms * MS, True)]
    if again:
        switches += [(NOW_US, False), (EARLIEST_US, True)]
    assert step.context.brake.switches == switches
    assert step.shift.pulses == 1


@pytest.mark.parametrize(("slip_off", "trigger"), [(-1e-6, Trigger.TOO_SLOW), (0.0, None)])
def test_a_gear_slower_than_a_contact_may_be_needs_the_engine(
    slip_off: float, trigger: Trigger | None
) -> None:
    """At the limit it does not: there drag has brought it far enough, and nothing is braked."""
    step = Step(Gear(WINDOW.contact_low_rad_s + slip_off))
    expected = trigger or Trigger.BRAKE_RELEASED
    assert step.run() is expected
    assert step.shift.raises == (trigger is not None)
    assert step.command() == OFF
    assert step.shift.release_us == (None if trigger else NOW_US)


@pytest.mark.parametrize(("over", "brakes"), [(1.001, True), (0.999, False)])
def test_the_brake_helps_where_drag_would_take_too_long(over: float, brakes: bool) -> None:
    """From the slip now to the one to fire at, at the rate at which drag takes it."""
    fall = FALL_RAD_S2 * LIMITS.coast_ms * 1e-3
    step = Step(Gear(Chosen.fire_slip_rad_s + over * fall))
    assert step.run() is (None if brakes else Trigger.BRAKE_RELEASED)
    assert step.command()[1] is brakes
    assert step.shift.release_us == (None if brakes else NOW_US)


@pytest.mark.parametrize(("used", "brakes"), [(-1, True), (0, False)])
def test_the_brake_is_used_so_often_in_a_shift_and_no_more(used: int, brakes: bool) -> None:
    step = Step()
    step.shift.pulses = LIMITS.pulses + used
    assert step.run() is (None if brakes else Trigger.BRAKE_RELEASED)
    assert step.shift.pulses == LIMITS.pulses
    assert step.command()[1] is brakes


@pytest.mark.parametrize(("off_us", "is_over"), [(0, True), (1, False), (-1, True)])
def test_a_release_that_can_no_longer_be_changed_is_done(off_us: int, is_over: bool) -> None:
    step = Step().braking()
    step.context.switch_brake(False, EARLIEST_US + off_us, step.snapshot)
    step.shift.release_us = EARLIEST_US + off_us
    assert step.run() is (Trigger.BRAKE_RELEASED if is_over else None)
    assert bool(step.chosen.released) is not is_over


@pytest.mark.parametrize(("ahead_us", "is_sent"), [(90_000, True), (90_001, False)])
def test_a_release_is_sent_when_it_is_no_further_ahead_than_90_ms(
    ahead_us: int, is_sent: bool
) -> None:
    step = Step().braking()
    step.chosen.release_at = (NOW_US + ahead_us, NOW_US + 200 * MS)
    step.run()
    assert (step.command() == (NOW_US + ahead_us, False, True)) is is_sent
    assert step.shift.release_us == (NOW_US + ahead_us if is_sent else None)
    decision = step.context.decision
    assert decision is not None
    if not is_sent:
        assert decision == Plan(ShiftDecision.BRAKE, 0, NOW_US + 200 * MS, 0.0, 0.0, 3.25)


def test_the_release_is_what_is_decided_where_no_firing_is_planned_yet() -> None:
    step = Step().braking()
    step.chosen.aims = False
    step.run()
    contact_us = step.chosen.release_at[1]
    assert step.context.decision == Plan(ShiftDecision.RELEASE, 0, contact_us, 0.0, 0.0, 3.25)
    assert step.shift.plan is None
    assert step.command(VALVE) == OFF


def test_a_release_that_was_sent_is_put_off_to_90_ms_but_not_withdrawn() -> None:
    step = Step().braking()
    step.context.switch_brake(False, NOW_US + 40 * MS, step.snapshot)
    step.shift.release_us = NOW_US + 40 * MS
    step.chosen.release_at = (NOW_US + 120 * MS, NOW_US + 200 * MS)
    step.run()
    assert step.shift.release_us == NOW_US + 90 * MS
    assert step.command() == (NOW_US + 90 * MS, False, True)
    assert step.gear.asked == [(NOW_US + 200 * MS, NOW_US + 90 * MS)]


@pytest.mark.parametrize(("on_in_us", "is_sent"), [(0, True), (1, False), (30_000, False)])
def test_a_brake_is_not_released_before_it_is_on(on_in_us: int, is_sent: bool) -> None:
    """Nor does a strategy plan that."""
    step = Step().braking(NOW_US + on_in_us)
    step.run()
    assert step.chosen.released == [(NOW_US, max(EARLIEST_US, NOW_US + on_in_us))]
    assert (step.shift.release_us is not None) is is_sent


def test_with_a_release_goes_a_firing_of_a_strategy_that_aims() -> None:
    """The sleeve takes longer than the brake to fade."""
    step = Step().braking()
    step.run()
    fire_us = NOW_US + 20 * MS
    assert step.command(VALVE) == (fire_us, True, False)
    expected = Plan(ShiftDecision.FIRE, fire_us, fire_us + DELAY_US, 0.01, 0.002, 1.0)
    assert step.shift.plan == step.context.decision == expected
    assert step.shift.strategy is Strategy.SPEED_WINDOW_ANTICIPATING
    assert step.shift.aimed is True
    assert step.chosen.known == {True}


def coasting(gear: Gear | None = None) -> Step:
    step = Step(gear or Gear(Chosen.fire_slip_rad_s + 0.1))
    step.shift.release_us = NOW_US - 10 * MS
    return step


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("attempts", [0, 1])
def test_what_was_known_of_the_phase_is_noted_up_to_the_first_attempt(
    known: bool, attempts: int
) -> None:
    step = coasting()
    step.known, step.shift.attempts, step.shift.reference_known = known, attempts, not known
    assert step.run(coasts=True) is None
    assert step.shift.reference_known is (known if attempts == 0 else not known)
    noted = ReferenceSource.RESTORED if attempts == 0 else ReferenceSource.NONE
    assert step.shift.reference_source is noted
    assert step.chosen.known == {known}


def waits(step: Step, decision: ShiftDecision = ShiftDecision.WAIT_FOR_GAP) -> bool:
    """Whether nothing is fired, and that is said; else the firing is."""
    assert step.run(coasts=True) is None
    found = step.context.decision
    assert found is not None
    if step.shift.plan is None:
        assert step.command(VALVE) == OFF
        slip, misses = step.chosen.contact_slip, step.chosen.misses
        assert found == Plan(decision, 0, 0, 0.01, 0.002, slip, misses)
        return True
    assert step.command(VALVE)[:2] == (step.shift.plan.fire_us, True)
    assert found == step.shift.plan
    return False


def test_a_sleeve_waits_while_the_strategy_says_no_contact() -> None:
    for aims, decision in (
        (True, ShiftDecision.WAIT_FOR_GAP),
        (False, ShiftDecision.WAIT_FOR_SLIP),
    ):
        step = coasting().planned(NOW_US + 60 * MS)
        step.chosen.contact_at, step.chosen.aims = None, aims
        assert waits(step, decision)
        assert step.shift.aimed is aims


@pytest.mark.parametrize(("off", "is_fired"), [(0.0, True), (-1e-6, False)])
def test_no_sleeve_is_fired_for_a_contact_that_is_too_slow(off: float, is_fired: bool) -> None:
    step = coasting()
    step.chosen.contact_slip = WINDOW.least_rad_s + off
    assert waits(step) is not is_fired


@pytest.mark.parametrize(("ahead_us", "is_fired"), [(90_000, True), (90_001, False)])
def test_no_sleeve_is_fired_further_ahead_than_90_ms(ahead_us: int, is_fired: bool) -> None:
    step = coasting()
    step.chosen.contact_at = NOW_US + ahead_us + DELAY_US
    assert waits(step) is not is_fired


def test_no_sleeve_is_fired_while_the_brake_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    step, asked = coasting(), list[Any]()

    def holds(*given: object) -> bool:
        asked.append(given)
        return True

    monkeypatch.setattr(module, "brake_holds", holds)
    assert waits(step)
    assert asked == [(SHEET, step.gear, 1.5e5)]


@pytest.mark.parametrize(("off", "trigger"), [(0.0, None), (-1e-6, Trigger.TOO_SLOW)])
def test_who_coasts_below_the_least_slip_needs_the_engine(
    off: float, trigger: Trigger | None
) -> None:
    step = coasting(Gear(WINDOW.least_rad_s + off))
    assert step.run(coasts=True) is trigger
    assert step.shift.raises == (trigger is not None)


SETTLES_US = round(1e6 * (SHEET.brake.valve_delay_s + 4.0 * SHEET.brake.time_constant_s))


@pytest.mark.parametrize(
    ("released_us", "brakes"),
    [(-SETTLES_US - 1, True), (-SETTLES_US + 1, False), (0, False), (None, True)],
)
def test_who_coasts_too_fast_is_braked_once_more_when_the_last_pressure_is_gone(
    released_us: int | None, brakes: bool
) -> None:
    """Four time constants after the valve has closed."""
    step = coasting(Gear()).planned(NOW_US + 60 * MS)
    step.shift.release_us = None if released_us is None else NOW_US + released_us
    step.context.brake.schedule(0, True, -1)
    assert step.run(coasts=True) is (Trigger.TOO_FAST if brakes else None)
    if brakes:
        assert step.shift.plan is None
        assert step.shift.release_us is None
        assert step.command(VALVE) == OFF
        assert step.context.brake.switches[-1] == (NOW_US, False)
    else:
        assert step.shift.plan is not None


@BOTH
@pytest.mark.parametrize(("ahead_us", "is_fired"), [(6_000, False), (5_999, True)])
def test_a_firing_that_can_no_longer_be_changed_is_done(
    ahead_us: int, is_fired: bool, coasts: bool
) -> None:
    """Nearer than 6 ms to the earliest that could be sent."""
    step = coasting() if coasts else Step().braking()
    step.planned(EARLIEST_US + ahead_us)
    step.shift.measured_contact_us, step.shift.attempts = 7, 1
    context: Any = step.context
    context.free_predictor = step.gear
    plan: Any = step.shift.plan
    assert step.run(coasts) is (Trigger.FIRED if is_fired else None)
    assert step.shift.attempts == (2 if is_fired else 1)
    seen: Any = step.shift.measured_contact_us
    assert seen == (None if is_fired else 7)
    if is_fired:
        assert context.free_predictor is None
        assert context.firing_predictor is step.gear
        assert context.decision == plan._replace(decision=ShiftDecision.COMMITTED)
        assert step.command(VALVE) == (plan.fire_us, True, False)
    else:
        assert context.firing_predictor is None


@pytest.mark.parametrize(
    ("change", "is_withdrawn"),
    [("none", True), ("still hits", False), ("missed before", False), ("too near", False),
     ("just in time", True), ("does not aim", False), ("unknown", False)],
)  # fmt: skip
def test_a_firing_that_would_now_meet_a_tooth_is_withdrawn_while_there_is_time(
    change: str, is_withdrawn: bool
) -> None:
    """Up to 4 ms before; only one that was planned for a gap, by a strategy that knows it."""
    near_us = {"too near": 3_999, "just in time": 4_000}.get(change, 6_000)
    step = coasting().planned(NOW_US + near_us, misses=change == "missed before")
    step.chosen.misses = change != "still hits"
    step.shift.aimed = change != "does not aim"
    step.known = change != "unknown"
    step.chosen.contact_at = None
    assert step.run(coasts=True) is (None if is_withdrawn else Trigger.FIRED)
    assert step.shift.attempts == (0 if is_withdrawn else 1)
    if is_withdrawn:
        assert step.shift.plan is None
        assert step.command(VALVE) == OFF
    else:
        assert step.command(VALVE)[1] is True


def test_a_firing_that_is_withdrawn_while_braking_is_off_at_once() -> None:
    """Even where no other is planned in that step."""
    step = Step().braking().planned(NOW_US + 5_000)
    step.chosen.misses = True
    step.chosen.release_at = (NOW_US + 95 * MS, NOW_US + 150 * MS)
    assert step.run() is None
    assert step.command(VALVE) == OFF
    assert step.shift.plan is None


def test_without_a_use_of_the_brake_left_a_gear_that_is_too_fast_coasts_on() -> None:
    settings = replace(SETTINGS, limits=replace(LIMITS, pulses=1))
    step = Step(settings=settings)
    step.shift.pulses = 1
    assert step.run(coasts=True) is None
    assert step.shift.plan is not None
    assert NONE_DRIVEN == (False,) * 9
