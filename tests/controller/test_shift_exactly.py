"""Small statements about a shift's parts that no longer run would make by accident: where sleeve,
clutch and torque are by the laws that they go by."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from test_reference import TEETH, Gearbox
from test_strategy import predictor_at

from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.controller.planning.phase_drift import PhaseDrifts
from meshpoint.controller.planning.strategies.base import ReleasePlan
from meshpoint.controller.planning.strategies.own import OwnStrategy
from meshpoint.controller.report.messages import clip
from meshpoint.controller.sensing.clutch_track import ClutchTrack
from meshpoint.controller.sensing.gearbox_view import SleeveTrack
from meshpoint.controller.sensing.sensor_clock import SensorClockEstimate
from meshpoint.controller.settings import ControllerSettings
from meshpoint.controller.shift import engage, speed_up
from meshpoint.controller.shift.brake_ahead import (
    CLEAR_M,
    MAIN_SLEEVES,
    _is_wanted,
    _teeth_out_us,
)
from meshpoint.controller.shift.context import ShiftContext
from meshpoint.controller.shift.kiss_point import MOST_SEEN, SEEN_SD, KissPoint
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.controller.shift.swing_fit import Known
from meshpoint.controller.shift.table import Trigger
from meshpoint.controller.shift.torque_ramp import ramp_down
from meshpoint.controller.shift.unloading import SHAPES, Unloading, geared_bodies
from meshpoint.controller.shift.valve_board import ValveName, energised
from meshpoint.controller.strategy_file import StrategyFile
from meshpoint.dbc.messages import ClutchAction, ValveStatus
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS

SHEET, THESIS = load_sheet("truck12"), load_sheet("thesis")
MS_US = 1_000


def test_stamps_that_come_late_in_a_row_are_one_delay() -> None:
    """As often as frames begin to wait, not as often as they come late."""
    clock = SensorClockEstimate()
    clock.stamp(1_000_000, 1_000_500)
    for number in range(1, 4):
        clock.stamp(1_000_000 + 10_000 * number, 2_000_000 + 10_000 * number)
    assert (clock.late, clock.jumps) == (1, 0)
    clock.stamp(2_100_000, 2_100_500)
    clock.stamp(2_110_000, 3_000_000)
    assert (clock.late, clock.jumps) == (2, 0), "one that was on time, then one a second late"


def test_a_clock_that_was_set_back_has_jumped_once() -> None:
    clock = SensorClockEstimate()
    clock.stamp(1_000_000, 5_000_000)
    assert clock.set_back(999_000, 5_010_000) == 999_000
    assert clock.jumps == 1
    assert clock.now_us(5_010_000) == 999_000


@pytest.mark.parametrize(("ahead_ms", "is_told"), [(50, True), (99, True), (101, False)])
def test_where_the_clutch_will_be_is_told_for_a_tenth_of_a_second(
    ahead_ms: int, is_told: bool
) -> None:
    """It opens by 0.02 in 10 ms, and passes a level that it reaches in so long."""
    track = ClutchTrack()
    track.take(1_000_000, 0.92)
    track.take(1_010_000, 0.90)
    found = track.falls_to_us(0.90 - 0.002 * ahead_ms)
    assert (found is not None) is is_told
    if found is not None:
        assert found == pytest.approx(1_010_000 + ahead_ms * MS_US)


def touch(kiss: KissPoint, at_us: int, share: float) -> None:
    """A clutch closes by 0.05 in 10 ms; its plates touch at `share`, and from then on the engine's
    acceleration grows by 1,000 rad/s2 in a second of its travel."""
    track, first = ClutchTrack(), share - 0.075
    for k in range(-1, 6):
        time_us, closed = at_us + 10 * MS_US * k, first + 0.05 * k
        since_s = max(0.0, (closed - share) / 5.0)
        track.take(time_us, closed)
        kiss.look(track, 100.0 + 4_000.0 * since_s**2 / 2.0)
    kiss.look(track, None)


def test_the_touch_is_learned_as_independent_observations_of_20_thousandths_are() -> None:
    """The mean of what was known before and all observations, by their variances, until those of
    before weigh as ten."""
    kiss = KissPoint(SHEET)
    known, sd = kiss.share, kiss.sd
    for count in range(1, 4):
        touch(kiss, 1_000_000 * count, known + 0.02)
        weight = count * SEEN_SD**-2
        expected = (known * sd**-2 + (known + 0.02) * weight) / (sd**-2 + weight)
        assert kiss.share == pytest.approx(expected, abs=6e-3)
        assert kiss.sd == pytest.approx(max((sd**-2 + weight) ** -0.5, SEEN_SD / MOST_SEEN**0.5))
    assert SEEN_SD == 4.0 / 200.0, "4 ms of a clutch that closes in 200 ms"
    for count in range(4, 30):
        touch(kiss, 1_000_000 * count, known + 0.02)
    assert kiss.sd == pytest.approx(SEEN_SD / math.sqrt(MOST_SEEN))


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("since_ms", [8, 11, 14])
def test_teeth_are_out_when_a_sleeve_under_a_constant_force_has_come_so_far(
    side: int, since_ms: int
) -> None:
    sleeve, out_ms = SHEET.sleeve, 20.0
    way_m = sleeve.stroke_m - sleeve.to_contact_m + CLEAR_M

    def position_m(at_ms: float) -> float:
        return side * (sleeve.stroke_m - way_m * (max(at_ms, 0.0) / out_ms) ** 2)

    samples = tuple(position_m(since_ms - back) for back in range(10))
    still = SleeveTrack(5_000_000, (0.0,) * 10)
    track = SleeveTrack(1_000_000 + since_ms * MS_US, samples)
    snapshot: Any = SimpleNamespace(
        view=SimpleNamespace(tracks={MAIN_SLEEVES[0]: still, MAIN_SLEEVES[1]: track})
    )
    context: Any = SimpleNamespace(sheet=SHEET)
    assert _teeth_out_us(context, snapshot) == pytest.approx(1_000_000 + out_ms * MS_US, abs=250)


@pytest.mark.parametrize(("left", "may"), [(0.05, True), (-0.05, True), (0.0501, False)])
def test_the_clutch_may_set_off_with_as_much_torque_left_as_is_allowed(
    left: float, may: bool
) -> None:
    engine = SimpleNamespace(ramp_ms=300, torque_left_share=0.05)
    context: Any = SimpleNamespace(
        settings=SimpleNamespace(engine=engine),
        engine_carries=lambda _: True,
        sheet=SHEET,
        kiss=SimpleNamespace(share=0.35),
        torque=SimpleNamespace(left_in=lambda _: left),
        running=SimpleNamespace(unloading=None),
        driveline=None,
        clutch_opens=True,
        since_us=1_000_000,
        engine_share=None,
    )
    for now_us, expected in ((1_000_000, may), (1_299_999, may), (1_300_000, True)):
        assert ramp_down(context, SimpleNamespace(now_us=now_us)) is expected  # type: ignore[arg-type]
    assert context.engine_share == 0.0


def test_a_ramp_is_over_half_a_period_a_step_later_and_when_the_engine_has_followed() -> None:
    known = Known(60_000.0, 0.1, 1.0 / 400.0, 1e-4)
    bodies = geared_bodies(SHEET, DRIVE_GEARS[8], known)
    for shares in SHAPES:
        for taken in range(1, len(shares) + 1):
            ramp = Unloading(bodies, 900.0, 20.0, shares, 70_000.0, taken, 0, 400_000.0)
            waits = (len(shares) - taken) * bodies.half_period_us
            assert ramp.over_us == pytest.approx(400_000.0 + waits + 70_000.0)
            last = taken == len(shares)
            due = math.inf if last else 400_000.0 + bodies.half_period_us
            assert ramp.next_us == due
            assert ramp.torque_nm == pytest.approx(
                20.0 + (900.0 - 20.0) * (1.0 - sum(shares[:taken]))
            )


@pytest.mark.parametrize("amid_looks", [2, 5])
def test_a_tooth_that_came_from_amid_its_gap_lies_at_the_flank_after_160_ms(
    amid_looks: int,
) -> None:
    """Sooner it may have come to rest between the flanks, to turn round."""
    box, references = Gearbox(*TEETH[MainGear.SECOND], 0.1, 0.2, 0.3), PhaseReferences(THESIS)
    references.locked(MainGear.SECOND, 0.5)
    half_gap = THESIS.dog.backlash_rad / 2.0
    learned = []
    for share in [0.2] * amid_looks + [-1.0] * 20:
        at = box.layshaft_at_phase(share * half_gap, 5.0, 3)
        learned.append(references.watch(MainGear.SECOND, at, 5.0))
    assert learned.index(True) == amid_looks + 16 - 1
    error = references.phase_rad(MainGear.SECOND, 1.0, 2.0) - box.phase(1.0, 2.0)
    assert abs(math.remainder(error, THESIS.dog.pitch_rad)) < 1e-9


@pytest.mark.parametrize(("passed_us", "teaches"), [(20_000.0, True), (19_999.0, False)])
def test_a_contact_20_ms_after_its_firing_tells_of_a_drift(passed_us: float, teaches: bool) -> None:
    fired, drifts = predictor_at(18.0), PhaseDrifts(THESIS, 0.5)
    contact_us = fired.main.time_us + passed_us
    state = fired.layshaft_at(contact_us, None)
    moved = state._replace(theta_rad=state.theta_rad + 0.001 / fired.i_gear)
    drifts.learn(fired, replace(fired, layshaft=moved), contact_us)
    assert (drifts.rad_s(fired.gear) > 0.0) is teaches


@pytest.mark.parametrize("gear", list(MainGear))
@pytest.mark.parametrize("closed", [None, 0.0, 0.34, 0.35, 0.36, 1.0])
def test_the_engine_s_torque_reaches_a_gear_through_plates_that_touch(
    gear: MainGear, closed: float | None
) -> None:
    context: Any = SimpleNamespace(kiss=SimpleNamespace(share=0.35))
    snapshot: Any = SimpleNamespace(view=SimpleNamespace(main_gear=gear, clutch_closed=closed))
    expected = closed in (0.36, 1.0) and gear is not MainGear.NEUTRAL
    assert ShiftContext.engine_carries(context, snapshot) is expected


@pytest.mark.parametrize(
    ("value", "sent"),
    [(-3.0, -2.0), (-2.0, -2.0), (0.5, 0.5), (4.0, 4.0), (4.1, 4.0), (math.inf, 4.0),
     (-math.inf, -2.0), (math.nan, 4.0)],
)  # fmt: skip
def test_what_a_signal_cannot_say_is_said_by_the_end_of_its_range(
    value: float, sent: float
) -> None:
    assert clip(value, 4.0, -2.0) == sent


def test_nothing_is_pulled_out_before_both_plates_and_teeth_are_known_to_part() -> None:
    """The later of: the sleeve moves as the plates part; its teeth are out once they surely
    have."""
    falls = {"parted": 1_050_000.0, "surely": 1_080_000.0}
    clutch = SimpleNamespace(falls_to_us=lambda _: falls["parted"])
    sleeve = SHEET.sleeve
    context: Any = SimpleNamespace(
        sheet=SHEET,
        kiss=SimpleNamespace(parted_share=0.3),
        _surely_parted_us=lambda _: falls["surely"],
    )
    snapshot: Any = SimpleNamespace(view=SimpleNamespace(clutch=clutch), earliest_us=0)
    found = ShiftContext.unloaded_us(context, snapshot)
    assert found == max(
        round(1_050_000.0 - 1e6 * sleeve.valve_delay_s),
        round(1_080_000.0 - 1e6 * sleeve.least_pull_s),
    )
    snapshot.earliest_us = 2_000_000
    assert ShiftContext.unloaded_us(context, snapshot) == 2_000_000
    for unknown in falls:
        kept, falls[unknown] = falls[unknown], None  # type: ignore[assignment]
        assert ShiftContext.unloaded_us(context, snapshot) is None
        falls[unknown] = kept


@pytest.mark.parametrize(("ramp_ms", "carries"), [(0, True), (0, False), (300, False)])
def test_without_a_ramp_or_without_torque_in_the_clutch_it_may_set_off_at_once(
    ramp_ms: int, carries: bool
) -> None:
    """And the engine is asked for nothing."""
    context: Any = SimpleNamespace(
        settings=SimpleNamespace(engine=SimpleNamespace(ramp_ms=ramp_ms)),
        engine_carries=lambda _: carries,
    )
    assert ramp_down(context, SimpleNamespace(now_us=0)) is True  # type: ignore[arg-type]
    assert not hasattr(context, "engine_share")


def test_the_valves_whose_coils_are_driven_are_named() -> None:
    names = [name for name in ValveStatus._fields if name.endswith("_energised")]
    assert len(names) == len(ValveName)
    for name, valve in zip(names, ValveName, strict=True):
        assert energised(ValveStatus()._replace(**{name: True})) == [valve]
    assert energised(ValveStatus()) == []


@pytest.mark.parametrize("parted", [True, False])
def test_the_engine_holds_its_speed_until_the_plates_are_apart(
    parted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speed_up, "_raised_slip", lambda *_: 0.0)
    off: list[ValveName] = []
    context: Any = SimpleNamespace(
        running=SimpleNamespace(target=None),
        settings=ControllerSettings(),
        board=SimpleNamespace(off=off.append),
        engine_rad_s=None,
        late=lambda *_: False,
    )
    context.ask_engine = lambda *_: setattr(context, "engine_rad_s", 150.0)
    snapshot: Any = SimpleNamespace(view=SimpleNamespace(clutch_parted=parted))
    trigger = speed_up.part_clutch(context, snapshot)
    assert trigger is (Trigger.CLUTCH_OPEN if parted else None)
    assert context.engine_rad_s == (None if parted else 150.0)
    assert off == ([ValveName.BRAKE] if parted else [])


@pytest.mark.parametrize(
    ("gear", "since_us", "trigger"),
    [(MainGear.SECOND, 10_000, None), (MainGear.NEUTRAL, 0, None),
     (MainGear.NEUTRAL, 10_000, Trigger.RETRACTED)],
)  # fmt: skip
def test_a_sleeve_is_back_in_a_later_step_than_the_one_that_took_its_valve_off(
    gear: MainGear, since_us: int, trigger: Trigger | None
) -> None:
    context: Any = SimpleNamespace(
        running=SimpleNamespace(target=SimpleNamespace(main=MainGear.SECOND), plan=1, attempts=1),
        settings=ControllerSettings(),
        board=SimpleNamespace(off=lambda _: None),
        since_us=1_000_000,
        late=lambda *_: False,
    )
    snapshot: Any = SimpleNamespace(
        now_us=1_000_000 + since_us, view=SimpleNamespace(main_gear=gear)
    )
    assert engage.retract(context, snapshot) is trigger
    assert context.running.plan is None
    assert context.clutch is ClutchAction.OPEN


OWN = b"""
class Late:
    aims, fire_slip_rad_s = True, 0.0
    def __init__(self, sheet, settings): pass
    def release(self, predictor, now_us, earliest_us):
        return earliest_us + 5_000, earliest_us + 9_000
    def contact(self, predictor, now_us, earliest_us): return None
"""


def test_a_strategy_s_own_release_and_contact_are_what_it_said() -> None:
    file = StrategyFile("C:/box/own.py:Late", "", True, OWN)
    assert (file.path, file.class_name) == ("C:/box/own.py", "Late")
    own = OwnStrategy(file, THESIS, ControllerSettings())
    predictor = predictor_at(18.0)
    assert own.release(predictor, 0, 1_000) == ReleasePlan(6_000, 10_000)
    assert own.contact(predictor, 0, 1_000) is None


@pytest.mark.parametrize("number", [3, 8])
@pytest.mark.parametrize("friction_nms", [0.04, 0.13])
def test_a_gear_is_raised_by_what_drag_takes_until_its_plates_are_seen_apart(
    number: int, friction_nms: float
) -> None:
    """J w' = -c w at the layshaft, from the plates' parting on until the clutch is surely open, and
    until that is seen; c as it was learned, whatever the sheet says."""
    gear, clutch, omega = DRIVE_GEARS[number], SHEET.clutch, 150.0
    context: Any = SimpleNamespace(
        sheet=SHEET,
        running=SimpleNamespace(target=gear),
        kiss=SimpleNamespace(share=0.4),
        settings=ControllerSettings(),
    )
    snapshot: Any = SimpleNamespace(
        speeds=SimpleNamespace(layshaft=omega),
        layshaft=SimpleNamespace(drag_nm=lambda speed: friction_nms * speed),
    )
    opens_s = (0.4 - clutch.surely_open_share) * clutch.open_delay_s
    fall_s = opens_s + speed_up.SEEN_LATE_US * 1e-6
    left = omega * math.exp(-friction_nms / SHEET.inertia_kgm2(gear.split) * fall_s)
    lost = SHEET.main_mesh(gear.main).ratio * (omega - left)
    raised = speed_up._raised_slip(context, snapshot)
    assert raised - context.settings.window.raised_rad_s == pytest.approx(lost, rel=0.02)
    assert lost > 0.015


@pytest.mark.parametrize(("drag_nm", "is_wanted"), [(4.0, True), (40.0, False)])
def test_air_is_put_in_the_brake_early_where_the_drag_as_learned_would_take_too_long(
    drag_nm: float, is_wanted: bool
) -> None:
    """In `limits.coast_ms` the gear falls by drag over inertia, as its ratio says; its slip is to
    fall by what lies half way between the two drags."""
    gear, settings = DRIVE_GEARS[8], ControllerSettings()
    coast_s = 1e-3 * settings.limits.coast_ms
    ratio, inertia = SHEET.main_mesh(gear.main).ratio, SHEET.inertia_kgm2(gear.split)
    slip = settings.window.fire_slip_rad_s + ratio * 20.0 / inertia * coast_s
    context: Any = SimpleNamespace(
        sheet=SHEET, settings=settings, running=SimpleNamespace(target=gear, pulses=0, blocks=0)
    )
    snapshot: Any = SimpleNamespace(
        view=SimpleNamespace(split=gear.split, range_=gear.range_),
        speeds=SimpleNamespace(layshaft=150.0, slip_rad_s=lambda _: slip),
        layshaft=SimpleNamespace(drag_nm=lambda _: drag_nm),
    )
    assert _is_wanted(context, snapshot) is is_wanted


def test_after_a_shift_requests_rest_until_the_clutch_could_have_opened_and_closed_again() -> None:
    """Not where a restarted sensor clock lies behind the shift's end: nobody knows how long ago it
    was; nor before any shift."""
    clutch = SHEET.clutch
    rest_us = round((clutch.open_delay_s + clutch.close_delay_s) * 1e6)
    for since_us, rests in ((-1, False), (0, True), (rest_us - 1, True), (rest_us + 1, False)):
        context: Any = SimpleNamespace(ended_us=5_000_000, sheet=SHEET)
        snapshot: Any = SimpleNamespace(now_us=5_000_000 + since_us)
        assert ShiftSequence._rests(context, snapshot) is rests
        context.ended_us = None
        assert ShiftSequence._rests(context, snapshot) is False
