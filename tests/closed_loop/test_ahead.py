"""Commands that go out before their event: at the right moment, withdrawn if it stays away."""

from __future__ import annotations

from typing import Any

from loop_bench import Loop

from meshpoint.controller.settings.settings import ControllerSettings, EngineRequests
from meshpoint.dbc.messages import (
    ControllerState,
    EngagementEvent,
    FaultCode,
    ReferenceEngagement,
    RigFault,
    ShiftResult,
    SleevesMain,
    ValveAction,
    ValveCommand,
)
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset
from meshpoint.rig_sim.shared.sleeves import NEVER_US

TRUCK12, SETTINGS = load_sheet("truck12"), ControllerSettings()
E = EngagementEvent
DRIVEN = (ValveAction.ON_NOW, ValveAction.ON_AT)


def truck(requests: list[tuple[int, int]], **changes: Any) -> Loop:
    return Loop(requests, sheet=TRUCK12, preset=Preset.TRUCK, seed=6, **changes)


def reported(loop: Loop) -> dict[EngagementEvent, int]:
    """When each thing first happened after the last request, as the rig reports, us."""
    outcome = loop.outcomes[-1]
    found: dict[EngagementEvent, int] = {}
    for message in loop.of(ReferenceEngagement):
        after_us = (message.event_time_us - outcome.request_time_us) % (1 << 32)
        if after_us < 1 << 31:
            found.setdefault(message.event, after_us)
    return found


TEACH = 4
LAST_US = 1_500_000 + 4_000_000 * TEACH
"""When the last shift is asked for: the first ones teach how the sleeve moves."""


def teeth_seen_out_us(loop: Loop) -> int:
    """Bus time of the first read that then shows first gear's teeth out by a millimetre."""
    clear_m = TRUCK12.sleeve.to_contact_m - 1e-3
    return next(
        time_us
        for time_us, message in loop.messages
        if isinstance(message, SleevesMain)
        and time_us > LAST_US
        and abs(message.sleeve_first_second_m[0]) < clear_m
    )


def first_braked(loop: Loop) -> tuple[int, ValveCommand]:
    """The first command that then drives the brake, and its bus time."""
    return next(
        (time_us, message)
        for time_us, message in loop.messages
        if isinstance(message, ValveCommand)
        and time_us > LAST_US
        and message.brake_action in DRIVEN
    )


def test_each_thing_happens_as_the_one_before_is_over() -> None:
    """The brake's air is let in by the step that first sees the old teeth out: a pull is a pulse
    that is over by then, so sooner nobody can say that the sleeve goes on."""
    before = [(1_500_000 + 4_000_000 * k, (10, 8)[k % 2]) for k in range(TEACH)]
    loop = truck([*before, (LAST_US, 10)]).run(LAST_US + 3_000_000)
    outcome = loop.outcomes[-1]
    assert [each.result for each in loop.outcomes] == [ShiftResult.ENGAGED] * (TEACH + 1)
    assert loop.violations == 0
    at = reported(loop)
    assert 0 < at[E.RELEASED] - at[E.PLATES_PARTED] < 35_000
    seen_us, (sent_us, command) = teeth_seen_out_us(loop), first_braked(loop)
    assert 0 < sent_us - seen_us < 1_000 * SETTINGS.timing.tick_ms
    on_us = (command.brake_time_us - outcome.request_time_us) % (1 << 32)
    assert at[E.RELEASED] < on_us < at[E.BRAKE_FILLS]
    assert at[E.BRAKE_FILLS] - on_us < 1e6 * TRUCK12.brake.greatest_valve_delay_s
    assert 0 < at[E.PLATES_MET] - at[E.LOCKED] < 100_000


def torque_at_parting(ramp_ms: int) -> tuple[float, float]:
    """Engine torque (Nm) at the request and as the plates part."""
    settings = ControllerSettings(engine=EngineRequests(ramp_ms=ramp_ms))
    loop = truck([(1_500_000, 10)], settings=settings, as_built={"vehicle.slope_percent": 3.0})
    plant = loop.world.plant
    loop.run_to_state(ControllerState.CLUTCH_OPENING, 3_000_000)
    before: float = plant.y.engine_nm
    opens = lambda: any(m.event is E.PLATES_PARTED for m in loop.of(ReferenceEngagement))  # noqa: E731
    assert loop.until(opens, 3_000_000)
    return before, plant.y.engine_nm


def test_the_torque_is_gone_before_the_plates_part_and_without_ramp_it_is_not() -> None:
    pulled, left = torque_at_parting(250)
    assert pulled > 500.0
    assert abs(left) < 0.07 * 2500.0
    pulled, left = torque_at_parting(0)
    assert left > 0.25 * pulled


def stop_the_clutch(loop: Loop) -> None:
    """Where it is, for good."""
    world = loop.world
    world.plant.g.clutch_rate = 0.0
    world.clutch._kiss_us = world.clutch._end_us = NEVER_US
    world.clutch.stuck = True
    world._due_us = world._next_due()


def test_a_clutch_that_stops_half_way_takes_the_pull_back() -> None:
    """The pull goes out for a parting that does not come: off again before the teeth are out."""
    loop = truck([(1_500_000, 10)])

    def is_pulled() -> bool:
        return any(command.main_second_action in DRIVEN for command in loop.of(ValveCommand))

    loop.run_to_state(ControllerState.CLUTCH_OPENING, 3_000_000)
    assert loop.until(is_pulled, 3_000_000)
    stop_the_clutch(loop)
    loop.run(loop.time.now_us + 1_500_000)
    (outcome,) = loop.outcomes
    assert outcome.result is ShiftResult.ENDED_IN_OLD_GEAR
    assert outcome.fault in (FaultCode.CLUTCH_STUCK, FaultCode.DISENGAGE_FAILED)
    assert E.RELEASED not in reported(loop)
    assert loop.valves_driven == ()
    assert loop.violations == 0


def test_a_jammed_sleeve_lets_no_air_into_the_brake() -> None:
    loop = truck([(1_500_000, 10)])
    loop.run_to_state(ControllerState.CLUTCH_OPENING, 3_000_000)
    loop.fault(RigFault.SLEEVE_JAMMED)
    loop.run(loop.time.now_us + 3_000_000)
    (outcome,) = loop.outcomes
    assert outcome.result is ShiftResult.ENDED_IN_OLD_GEAR
    assert E.BRAKE_FILLS not in reported(loop)
    assert not any(command.brake_action in DRIVEN for command in loop.of(ValveCommand))
