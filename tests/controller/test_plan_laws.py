"""Laws that every plan of a firing keeps, whatever the gearbox does: hypothesis looks for a case in
which one of them is broken. What a plan predicts is held against the equations of motion in
test_strategy.py."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_strategy import (
    DELAY_US,
    EARLIEST_US,
    NOW_US,
    PITCH,
    SHEET,
    VALVE_US,
    learned,
    predictor_at,
)

from meshpoint.controller.models.layshaft import BrakeInput
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.strategist import make_strategy
from meshpoint.controller.plan.strategy import LATEST_RELEASE_US, ReleasePlan
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.units import RPM

FIRST_US = EARLIEST_US + DELAY_US
"""No sleeve can be at its gear sooner."""
LONGEST_US = 600_000
"""No contact is planned further ahead of that."""
GRID_US = 2_000
"""Contacts are compared in steps of at most this."""
UNAIMED = st.sampled_from(("speed_window", "speed_window_anticipating"))
NAMES = st.sampled_from(("speed_window", "speed_window_anticipating", "target_phase"))
SLIPS_RPM, PRESSURES_PA, ANGLES = st.floats(-20.0, 90.0), st.floats(0.0, 2e5), st.floats(0.0, PITCH)


def contact(
    name: str, predictor: GearPredictor, now_us: int = NOW_US, earliest_us: int = EARLIEST_US
) -> int | None:
    chosen = ControllerSettings().with_strategy(name)
    return make_strategy(SHEET, chosen).contact(predictor, now_us, earliest_us)


def release(name: str, predictor: GearPredictor, later_us: int = 0) -> ReleasePlan:
    chosen = ControllerSettings().with_strategy(name)
    strategy = make_strategy(SHEET, chosen)
    return strategy.release(predictor, NOW_US + later_us, EARLIEST_US + later_us)


def braking(slip_rpm: float, at_zero: float, later_us: int = 0) -> GearPredictor:
    """The brake is on, and all of it happens so much later."""
    brake = BrakeInput(VALVE_US)
    brake.schedule(later_us, True, later_us - 1)
    return moved(predictor_at(slip_rpm, 7e5, brake, learned(at_zero)), later_us)


def moved(predictor: GearPredictor, later_us: int) -> GearPredictor:
    """The same estimates, so much later."""
    layshaft, main = predictor.layshaft, predictor.main
    return dataclasses.replace(
        predictor,
        layshaft=layshaft._replace(time_us=layshaft.time_us + later_us),
        main=main._replace(time_us=main.time_us + later_us),
    )


@settings(max_examples=60)
@given(name=NAMES, slip_rpm=SLIPS_RPM, pressure_pa=PRESSURES_PA, at_zero=ANGLES)
def test_a_firing_lies_between_the_earliest_and_the_look_ahead(
    name: str, slip_rpm: float, pressure_pa: float, at_zero: float
) -> None:
    found = contact(name, predictor_at(slip_rpm, pressure_pa, references=learned(at_zero)))
    assert found is None or FIRST_US <= found <= FIRST_US + LONGEST_US


@settings(max_examples=60)
@given(name=NAMES, slip_rpm=SLIPS_RPM, at_zero=ANGLES, later_us=st.integers(0, 60_000))
def test_a_sleeve_that_may_be_fired_later_only_never_meets_its_gear_sooner(
    name: str, slip_rpm: float, at_zero: float, later_us: int
) -> None:
    """Of the contacts that are left the best one is the same, or a later one."""
    predictor = predictor_at(slip_rpm, references=learned(at_zero))
    soon = contact(name, predictor)
    late = contact(name, predictor, earliest_us=EARLIEST_US + later_us)
    if soon is not None and late is not None:
        assert late >= soon - GRID_US
        assert late >= FIRST_US + later_us


@settings(max_examples=40)
@given(name=NAMES, slip_rpm=SLIPS_RPM, at_zero=ANGLES, later_us=st.integers(1, 3_600_000_000))
def test_a_plan_depends_on_no_clock(
    name: str, slip_rpm: float, at_zero: float, later_us: int
) -> None:
    """The same gearbox an hour later is fired the same time after now."""
    predictor = predictor_at(slip_rpm, references=learned(at_zero))
    now = contact(name, predictor)
    later = contact(name, moved(predictor, later_us), NOW_US + later_us, EARLIEST_US + later_us)
    assert (now is None) is (later is None)
    if now is not None and later is not None:
        assert later - later_us == pytest.approx(now, abs=2)


@settings(max_examples=40)
@given(slip_rpm=st.floats(5.0, 40.0), at_zero=ANGLES, pitches=st.integers(-3, 3))
def test_one_tooth_is_as_good_as_the_next(slip_rpm: float, at_zero: float, pitches: int) -> None:
    now = contact("target_phase", predictor_at(slip_rpm, references=learned(at_zero)))
    other = contact(
        "target_phase", predictor_at(slip_rpm, references=learned(at_zero + pitches * PITCH))
    )
    assert now == pytest.approx(other, abs=2)


@settings(max_examples=40)
@given(slip_rpm=st.floats(8.0, 40.0), at_zero=ANGLES, share=st.floats(0.05, 0.95))
def test_a_reference_that_is_off_moves_the_tooth_at_contact_by_as_much(
    slip_rpm: float, at_zero: float, share: float
) -> None:
    """A controller that takes the phase for this much more than it is plans for that phase: at its
    contact the true one is as much less."""
    true = predictor_at(slip_rpm, references=learned(at_zero))
    off = predictor_at(slip_rpm, references=learned(at_zero + share * PITCH))
    found = contact("target_phase", off)
    if found is not None:
        believed, really = off.phase_and_slip(found)[0], true.phase_and_slip(found)[0]
        assert math.remainder(believed - really - share * PITCH, PITCH) == pytest.approx(
            0.0, abs=1e-9
        )


@settings(max_examples=40)
@given(
    name=st.sampled_from(("speed_window", "speed_window_anticipating")),
    slip_rpm=SLIPS_RPM,
    slower_us=st.integers(-10_000, 40_000),
)
def test_a_slower_sleeve_is_fired_as_much_sooner_for_the_same_contact(
    name: str, slip_rpm: float, slower_us: int
) -> None:
    """Where it may be fired as much sooner."""
    usual = predictor_at(slip_rpm)
    slower = dataclasses.replace(usual, delay_us=usual.delay_us + slower_us)
    assert contact(name, usual) == contact(name, slower, earliest_us=EARLIEST_US - slower_us)


@settings(max_examples=20)
@given(name=NAMES, slip_rpm=st.floats(150.0, 450.0), at_zero=ANGLES)
def test_a_release_comes_before_its_contact_and_both_in_their_time(
    name: str, slip_rpm: float, at_zero: float
) -> None:
    plan = release(name, braking(slip_rpm, at_zero))
    assert EARLIEST_US <= plan.release_us <= EARLIEST_US + LATEST_RELEASE_US
    assert plan.contact_us > plan.release_us or plan.contact_us >= FIRST_US


@pytest.mark.parametrize(
    ("slip_rpm", "delay_us"), [(90.0, 45_000), (260.0, 45_000), (300.0, 20_000), (340.0, 20_000)]
)
def test_where_time_alone_costs_a_gear_is_met_as_soon_as_it_may_be(
    slip_rpm: float, delay_us: int
) -> None:
    """By a sleeve that is fired at the earliest, or 10 ms after the brake's release where that is
    later: every slip is allowed here, and no tooth has a price."""
    known = ControllerSettings().with_strategy("target_phase")
    free = dict.fromkeys(("miss_s", "block_s", "energy_s_per_j", "aim_s"), 0.0)
    window = dataclasses.replace(
        known.window,
        contact_high_rad_s=200.0 * RPM,
        contact_low_rad_s=-50.0 * RPM,
        aim_slip_rad_s=150.0 * RPM,
        aim_time_constants=0.0,
    )
    prices = dataclasses.replace(known.prices, **free)
    strategy = make_strategy(SHEET, dataclasses.replace(known, prices=prices, window=window))
    predictor = dataclasses.replace(braking(slip_rpm, 0.0), delay_us=delay_us)
    plan = strategy.release(predictor, NOW_US, EARLIEST_US)
    soonest_us = max(EARLIEST_US + delay_us, plan.release_us + 10_000)
    assert plan.contact_us == soonest_us
    assert (plan.release_us + 10_000 > EARLIEST_US + delay_us) is (slip_rpm == 340.0)


@settings(max_examples=20)
@given(name=UNAIMED, slower_rpm=st.floats(150.0, 300.0), more_rpm=st.floats(1.0, 150.0))
def test_a_gear_that_is_faster_is_braked_for_longer(
    name: str, slower_rpm: float, more_rpm: float
) -> None:
    """One that aims may take the gap before, and release sooner for it."""
    less, more = (
        release(name, braking(slip, 0.0)).release_us for slip in (slower_rpm, slower_rpm + more_rpm)
    )
    assert less <= more
