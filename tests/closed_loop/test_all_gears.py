"""Up and down by main box, splitter and range, in the gearbox that misbehaves like one."""

from __future__ import annotations

import pytest
from loop_bench import Loop

from meshpoint.bench.schedules import MAIN_BOX, MIXED
from meshpoint.bench.simulate import Setup, simulate
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.messages import (
    TSC1,
    ControllerEstimates,
    ControllerState,
    ControllerStatus,
    FaultCode,
    PhaseReference,
    ReferencePhase,
    ShiftResult,
    SleevesAux,
    TscOverrideMode,
)
from meshpoint.gearbox import load_sheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.units import DEG

TRUCK12, THESIS = load_sheet("truck12"), load_sheet("thesis")
State = ControllerState
CHANGING = (State.STEPS_CHANGING, State.SPLITTER_CHANGING)
PLAIN_SENSORS = {
    "lash.splitter_deg": 0.0,
    "lash.main_deg": 0.0,
    "hall.pitch_error_deg": 0.0,
    "hall.runout_mm": 0.0,
    "hall.duty_percent": 0.0,
    "hall.jitter_us": 0.0,
    "hall.threshold_share": 0.0,
    "hall.weaker_per_mm": 0.0,
    "hall.weaker_per_k": 0.0,
    "hall.first_wrong_edges": 0.0,
    "dog.free_play": 0.0,
}
"""Sensors without errors, and teeth that stay at their flank: what is asked is whether counts are
kept, not how well a flank is known."""


@pytest.fixture(scope="session")
def mixed() -> Loop:
    """The whole mixed schedule, with the rig withdrawn in between; the thesis's sheet."""
    return Loop(
        shifts=len(MIXED), pairs=MIXED, sheet=THESIS, preset=Preset.TRUCK, seed=5, start_gear=8
    ).run(90_000_000)


def test_every_shift_of_the_mixed_schedule_ends_in_its_gear(mixed: Loop) -> None:
    assert [(o.from_gear, o.to_gear) for o in mixed.outcomes] == list(MIXED)
    assert [o.result for o in mixed.outcomes] == [ShiftResult.ENGAGED] * len(MIXED)
    assert {o.fault for o in mixed.outcomes} == {FaultCode.NONE}


def test_nothing_forbidden_was_wanted_or_done(mixed: Loop) -> None:
    assert mixed.violations == 0
    assert mixed.status.guard_blocks == 0
    assert mixed.valves_driven == ()


def test_the_engine_is_asked_on_the_way_down_and_let_go_again(mixed: Loop) -> None:
    """Each request ends with a frame that says so; a speed is one that the engine can have."""
    requests = mixed.of(TSC1)
    top = THESIS.limits.input_max_rad_s
    asked = [r for r in requests if r.override_control_mode is TscOverrideMode.SPEED_CONTROL]
    assert len(asked) > 100
    assert all(0.0 < r.requested_speed_rad_s <= top for r in asked)
    requests = [r._replace(message_counter=15, message_checksum=15) for r in requests]
    assert requests[-1] == TSC1()
    ends = sum(r == TSC1() for r in requests)
    downs = sum(to < from_ for from_, to in MIXED)
    assert ends >= len(MIXED) + downs - 4  # after the raise, and after the clutch has closed


def test_no_gear_is_predicted_while_splitter_or_range_is_on_its_way(mixed: Loop) -> None:
    """From the read that shows a sleeve away from both its ends to the read that shows it in."""
    judged, away = 0, 0
    state = State.STARTING
    for _, message in mixed.messages:
        if isinstance(message, SleevesAux):
            between = (message.sleeve_splitter_m, message.sleeve_range_m)
            away = away + 1 if min(abs(m) for at in between for m in at) < 0.010 else 0
        elif isinstance(message, ControllerStatus):
            state = message.state
        elif isinstance(message, ControllerEstimates) and away >= 2 and state in CHANGING:
            judged += 1
            assert not message.model_valid
    assert judged >= 10


@pytest.mark.long
def test_every_change_of_the_main_box_is_made() -> None:
    """All 36, up and down, in both halves of the range."""
    setup = Setup(
        TRUCK12,
        ControllerSettings(),
        preset=Preset.TRUCK,
        profile=Profile.CLEAN,
        seed=11,
        shifts=len(MAIN_BOX),
        pairs=MAIN_BOX,
    )
    rows = simulate(setup).rows
    assert [(row.from_, row.to) for row in rows] == list(MAIN_BOX)
    assert {(row.result, row.fault) for row in rows} == {("engaged", "none")}


def test_a_phase_reference_survives_neutral_splitter_and_range() -> None:
    """Learned in second gear; then by way of third, low split and the high range back to second:
    the wheels have counted on, and what the controller says of the phase is the truth."""
    loop = Loop(
        [(300_000, 4), (2_300_000, 3), (3_600_000, 6), (5_600_000, 9)],
        sheet=TRUCK12,
        preset=Preset.TRUCK,
        profile=Profile.CLEAN,
        as_built=PLAIN_SENSORS,
        start_gear=2,
        toward=3,
        seed=2,  # whose flank in second can be determined
    ).run(8_000_000)
    assert [o.result for o in loop.outcomes] == [ShiftResult.ENGAGED] * 4, loop.events
    learned, *_, back = loop.outcomes
    assert learned.to_gear == 4
    assert back.to_gear == 9
    assert learned.reference is PhaseReference.UNKNOWN
    assert back.reference is PhaseReference.KNOWN
    truth = loop.last(ReferencePhase).phase_second_rad
    reported = loop.last(ControllerEstimates)
    assert reported.phase_known
    assert abs(reported.phase_rad - truth) < 0.1 * DEG


def test_the_rig_agrees_that_the_gear_is_in() -> None:
    """By the rig's own account, after a downshift and a change of all three boxes."""
    loop = Loop(
        [(300_000, 6)], sheet=TRUCK12, preset=Preset.TRUCK, start_gear=7, toward=6, seed=2
    ).run(2_500_000)
    rig = loop.rig_core
    assert loop.status.current_gear == 6
    input_, layshaft, main, propeller = rig.truth.speeds_rad_s
    assert input_ * 35 / 37 == pytest.approx(layshaft, rel=1e-3)
    assert layshaft * 37 / 35 == pytest.approx(main, rel=1e-3)
    assert main * 24 / 90 == pytest.approx(propeller, rel=1e-3)


def test_a_road_uphill_takes_speed_and_the_row_says_how_much() -> None:
    """4 %: 0.39 m/s2, and what rolling and air take beside it (thesis 1.2)."""
    setup = Setup(
        TRUCK12,
        ControllerSettings(),
        preset=Preset.TRUCK,
        profile=Profile.CLEAN,
        shifts=2,
        pairs=((8, 10), (10, 8)),
        as_built={"vehicle.slope_percent": 4.0, "vehicle.rolling_resistance": 0.006},
    )
    for row in simulate(setup).rows:
        lost = 3.6 * 9.81 * (0.04 + 0.006) * row.duration_ms / 1000
        assert row.speed_lost_kmh == pytest.approx(lost, rel=0.25)
    (row,) = simulate(Setup(THESIS, ControllerSettings(), Preset.THESIS, shifts=1)).rows
    assert row.speed_lost_kmh is None
