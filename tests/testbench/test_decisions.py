"""Where two trajectories of one shift part, by the commands of their steps."""

from __future__ import annotations

import pytest

from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.controller.shift.table import ShiftRecord
from meshpoint.dbc.messages import (
    TSC1,
    ClutchAction,
    ClutchCommand,
    ControllerState,
    ShiftDecision,
    ShiftOutcome,
    ShiftPrediction,
    ShiftResult,
    Strategy,
    ValveAction,
    ValveCommand,
)
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.report.judged import Judged, judge
from meshpoint.report.trajectory import Said, Trajectory
from meshpoint.units import DEG

REQUEST_US = (1 << 32) - 50_000
"""The clock wraps in mid-shift."""
STEP_US = 7_000_000
CLOSED, OPEN = ClutchCommand(action=ClutchAction.CLOSE), ClutchCommand(action=ClutchAction.OPEN)


def sensor_us(at_ms: float) -> int:
    return (REQUEST_US + round(at_ms * 1000)) % (1 << 32)


def brake(on_ms: float, off_ms: float | None, at_ms: float) -> ValveCommand:
    """The brake's command as it stands at a step."""
    if off_ms is not None and at_ms >= off_ms - 40.0:
        return ValveCommand(brake_action=ValveAction.OFF_AT, brake_time_us=sensor_us(off_ms))
    return ValveCommand(brake_action=ValveAction.ON_AT, brake_time_us=sensor_us(on_ms))


def predicted(decision: ShiftDecision, fire_ms: float) -> ShiftPrediction:
    return ShiftPrediction(
        decision=decision,
        fire_time_us=sensor_us(fire_ms),
        contact_time_us=sensor_us(fire_ms + 45.0),
        phase_rad=0.5 * DEG,
        phase_sd_rad=0.2 * DEG,
    )


def trajectory(
    off_ms: float,
    *,
    clutch: ClutchCommand = OPEN,
    engine: TSC1 | None = None,
    fire_ms: float | None = None,
    committed_ms: float | None = None,
) -> Trajectory:
    """Steps of 10 ms to 300 ms: the brake on at 20 ms, off at `off_ms`; a firing planned from
    100 ms on, and committed; clutch and engine as given from 60 ms on."""
    made = Trajectory()
    for at_ms in range(0, 300, 10):
        prediction = None
        if fire_ms is not None and at_ms >= 100:
            decision = ShiftDecision.FIRE
            if committed_ms is not None and at_ms >= committed_ms:
                decision = ShiftDecision.COMMITTED
            if committed_ms is None or at_ms <= committed_ms:
                prediction = predicted(decision, fire_ms)
        late = at_ms >= 60
        made.take(
            Said(
                STEP_US + 1000 * at_ms,
                brake(20.0, off_ms, at_ms),
                clutch if late else OPEN,
                engine if late else None,
                prediction,
                None,
            )
        )
    return made


def judged(recorded: Trajectory, replayed: Trajectory) -> Judged:
    outcome = ShiftOutcome(
        from_gear=8, to_gear=10, result=ShiftResult.ENGAGED, request_time_us=REQUEST_US
    )
    settings = ControllerSettings()
    return judge(outcome, STEP_US, recorded, replayed, None, settings, known=0, strayed=None)


def test_commands_part_when_they_are_sent_and_trajectories_when_a_valve_is_driven() -> None:
    shift = judged(trajectory(200.0), trajectory(215.0))
    assert shift.parted is not None
    assert (shift.parted.at_ms, shift.parted.differ) == (160.0, ("brake",))
    assert shift.trajectory_parted_ms == pytest.approx(200.0)
    assert shift.driven["brake"] == [pytest.approx((20.0, 215.0))]


def test_the_same_commands_never_part() -> None:
    shift = judged(trajectory(200.0), trajectory(200.0))
    assert (shift.parted, shift.trajectory_parted_ms) == (None, None)
    assert "recorded ones" in shift.contact_why


@pytest.mark.parametrize(
    ("command", "other"),
    [("clutch", trajectory(200.0, clutch=CLOSED)), ("engine", trajectory(200.0, engine=TSC1()))],
)
def test_clutch_and_engine_part_a_trajectory_too(command: str, other: Trajectory) -> None:
    shift = judged(trajectory(200.0), other)
    assert shift.parted is not None
    assert shift.parted.differ == (command,)
    assert shift.parted.at_ms == shift.trajectory_parted_ms == 60.0


def test_what_is_decided_after_the_recorded_contact_does_not_count() -> None:
    """Recorded: fired at 150 ms, so in contact at 195; the other one decides to at 250 only."""
    recorded = trajectory(120.0, fire_ms=150.0, committed_ms=140)
    shift = judged(recorded, trajectory(140.0, fire_ms=280.0, committed_ms=250))
    assert shift.judged_to_ms == pytest.approx(195.0)
    assert max(decision.at_ms for decision in shift.decisions) == 190.0
    assert all(end_ms <= 195.0 for spans in shift.driven.values() for _, end_ms in spans)
    assert shift.trajectory_parted_ms == pytest.approx(120.0)
    assert [d.decision for d in shift.predictions] == ["fire"] * 10
    own = shift.last_on_own_trajectory
    assert own is not None
    assert own.at_ms == 110.0
    assert own.fired_ms == pytest.approx(280.0)
    assert own.predicted_phase_deg == pytest.approx(0.5)


def aborted(made: Trajectory, halted_ms: int, again_ms: float) -> Trajectory:
    """The same, but its sleeve is stopped at one step and fired anew two steps later."""
    found = Trajectory()
    for k, step in enumerate(made.steps):
        state = ControllerState.ENGAGING
        if halted_ms <= 10 * k < halted_ms + 20:
            state = ControllerState.HALTED
        elif 10 * k == halted_ms + 20:
            step = step._replace(prediction=predicted(ShiftDecision.COMMITTED, again_ms))
        found.take(step._replace(state=state))
    return found


def fired(fire_ms: float) -> Trajectory:
    return trajectory(120.0, fire_ms=fire_ms, committed_ms=140)


def test_a_recorded_firing_that_was_aborted_met_nothing() -> None:
    """Fired at 150 ms and stopped at 170, fired again at 210: in contact at 255."""
    shift = judged(aborted(fired(150.0), 170, 210.0), fired(165.0))
    assert shift.judged_to_ms == pytest.approx(255.0)
    assert shift.recorded is not None
    assert shift.recorded.fired_ms == pytest.approx(210.0)


def test_a_firing_that_met_a_tooth_is_the_recorded_one_though_a_later_one_was_aborted() -> None:
    second = fired(150.0)
    k = next(k for k, step in enumerate(second.steps) if step.time_us == STEP_US + 210_000)
    second.steps[k] = second.steps[k]._replace(
        prediction=predicted(ShiftDecision.COMMITTED, fire_ms=220.0)
    )
    shift = judged(aborted(second, 230, 260.0), fired(165.0))
    assert shift.judged_to_ms == pytest.approx(195.0)


def test_the_other_controller_s_aborts_count_on_its_own_trajectory_alone() -> None:
    """Its frames answer to it up to 120 ms, where it brakes on, or all the time."""
    same = aborted(fired(150.0), 170, 210.0)
    assert shift_of(same, same) == ([170.0], 210.0)
    braked_on = aborted(trajectory(140.0, fire_ms=150.0, committed_ms=140), 170, 210.0)
    assert shift_of(same, braked_on) == ([], 150.0)


def shift_of(recorded: Trajectory, replayed: Trajectory) -> tuple[list[float], float | None]:
    """When the other controller aborts its sleeve, and the firing that it stays with."""
    outcome = ShiftOutcome(to_gear=10, result=ShiftResult.ENGAGED, request_time_us=REQUEST_US)
    record = ShiftRecord(8, 10, DRIVE_GEARS[10], REQUEST_US, Strategy.TARGET_PHASE)
    found = judge(
        outcome, STEP_US, recorded, replayed, record, ControllerSettings(), known=0, strayed=None
    )
    values = found.to_json()
    assert values["aborted_ms"] == found.aborted_ms
    return found.aborted_ms, found.fired_ms
