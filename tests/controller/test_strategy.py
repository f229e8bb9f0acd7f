"""Plans of a shift, each checked by solving the equations of motion up to the planned contact."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from meshpoint.controller.estimate.reference import PhaseReferences
from meshpoint.controller.models.layshaft import (
    BrakeInput,
    LayshaftState,
    first_order_law,
    free_motion,
)
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.models.thesis import layshaft_model
from meshpoint.controller.plan.gear_predictor import GearPredictor, LastMeasurement
from meshpoint.controller.plan.strategist import STRATEGIES, Plan, Strategist, make_strategy
from meshpoint.controller.settings.settings import (
    STRATEGY_NAMES,
    Aim,
    ControllerSettings,
    Timing,
    Window,
)
from meshpoint.dbc.messages import ReferenceSource, ShiftDecision
from meshpoint.gearbox import MainGear, Split, load_sheet
from meshpoint.units import RPM

SHEET = load_sheet("thesis")
MODEL = layshaft_model(SHEET, Split.HIGH)
LAW = first_order_law(1.0 / SHEET.brake.time_constant_s, SHEET.air.supply_gauge_pa)
MOTION = free_motion(SHEET, Split.HIGH, LAW, ControllerSettings().crossing_filter)
PITCH = 2.0 * math.pi / 48.0
HALF_GAP = 0.1 * PITCH
DELAY_US = 45_000
VALVE_US = 12_000
GEAR, RATIO = MainGear.SECOND, 31 / 40
MAIN = ShaftState(0.0, 3.0, 64.0, 1e-3, 0.05)
NOW_US = 20_000
EARLIEST_US = NOW_US + 18_000


def learned(phase_at_zero: float) -> PhaseReferences:
    """References such that phase = i theta_LS - theta_MS + `phase_at_zero`."""
    references = PhaseReferences(SHEET)
    references.adopt(GEAR, -phase_at_zero, ReferenceSource.RESTORED)
    return references


def predictor_at(
    slip_rpm: float,
    pressure_pa: float = 0.0,
    brake: BrakeInput | None = None,
    references: PhaseReferences | None = None,
) -> GearPredictor:
    omega = (MAIN.omega_rad_s + slip_rpm * RPM) / RATIO
    layshaft = LayshaftState(0.0, 1.0, omega, pressure_pa, 1e-3, 0.05, 1e3)
    brake = brake or BrakeInput(VALVE_US)
    sleeve = SHEET.sleeve
    delay_us = round(sleeve.delay_s * 1e6)
    return GearPredictor(
        GEAR, RATIO, layshaft, MAIN, brake, MOTION, references or learned(0.0), delay_us,
        sleeve.delay_sd_s, delay_us - round(1e6 * sleeve.valve_delay_s), 0.3,
    )  # fmt: skip


def truth(
    predictor: GearPredictor,
    time_us: np.ndarray,
    u_of_us: tuple[float, float] = (math.inf, math.inf),
) -> tuple[np.ndarray, np.ndarray]:
    """Phase (with 0 at zero angles) and slip at rising times; pressure is fed between two times."""
    a, b, g, supply = MODEL
    ls = predictor.layshaft
    on, off = u_of_us
    cuts = sorted({0.0, float(time_us[-1]), *[t for t in u_of_us if 0.0 < t < time_us[-1]]})
    y, phases, slips = np.array([ls.theta_rad, ls.omega_rad_s, ls.pressure_pa]), [], []
    for start, end in itertools.pairwise(cuts):
        u = float(on <= start < off)
        inside = time_us[(time_us > start) & (time_us <= end)]
        solution = solve_ivp(
            lambda _t, y, u=u: [y[1], -a * y[1] - g * y[2], b * (supply * u - y[2])],
            (start * 1e-6, end * 1e-6),
            y,
            rtol=1e-9,
            atol=1e-9,
            dense_output=True,
        )
        y = solution.y[:, -1]
        if not inside.size:
            continue
        states = solution.sol(inside * 1e-6)
        phases += (RATIO * states[0] - MAIN.theta_rad - MAIN.omega_rad_s * inside * 1e-6).tolist()
        slips += (RATIO * states[1] - MAIN.omega_rad_s).tolist()
    return np.array(phases), np.array(slips)


def planned(
    name: str, chosen: ControllerSettings, predictor: GearPredictor, now_us: int = NOW_US
) -> Plan | None:
    """What a strategy chooses, and what is expected of that contact."""
    chosen = chosen.with_strategy(name)
    contact_us = make_strategy(SHEET, chosen).contact(predictor, now_us, EARLIEST_US)
    if contact_us is None:
        return None
    return Strategist(SHEET, chosen).plan_at(predictor, contact_us, ShiftDecision.FIRE)


def test_every_strategy_that_the_bus_can_name_is_made_and_named_on_it() -> None:
    assert set(STRATEGIES) == set(STRATEGY_NAMES)
    for name, made in STRATEGIES.items():
        strategist = Strategist(SHEET, ControllerSettings(strategy_name=name))
        acting = strategist.acting(reference_known=True)
        assert type(acting) is made
        assert strategist.wire(acting) is STRATEGY_NAMES[name]
        unaimed = strategist.acting(reference_known=False)
        assert not unaimed.aims
        assert (unaimed is acting) is not acting.aims


@settings(deadline=None, max_examples=40)
@given(
    slip_rpm=st.floats(-5.0, 60.0),
    pressure_pa=st.floats(0.0, 2e5),
    at_zero=st.floats(0.0, PITCH),
    share=st.floats(-0.5, 0.5),
)
def test_what_is_planned_of_a_contact_is_what_the_equations_of_motion_give(
    slip_rpm: float, pressure_pa: float, at_zero: float, share: float
) -> None:
    """A free layshaft, its brake dying away, at any slip and any angle."""
    chosen = ControllerSettings(aim=Aim(share))
    predictor = predictor_at(slip_rpm, pressure_pa, references=learned(at_zero))
    plan = planned("target_phase", chosen, predictor)
    assert plan is not None
    (phase,), (slip,) = truth(predictor, np.array([float(plan.contact_us)]))
    # A microsecond at 60 rpm is 4e-4 degrees.
    assert abs(math.remainder(phase + at_zero - plan.phase_rad, PITCH)) < 1e-5
    assert plan.slip_rad_s == pytest.approx(slip, abs=1e-5)
    assert plan.contact_us - plan.fire_us == DELAY_US
    assert plan.fire_us >= EARLIEST_US
    assert plan.phase_sd_rad >= abs(slip) * SHEET.sleeve.delay_sd_s


def test_a_gap_that_comes_by_with_a_slip_allowed_is_met() -> None:
    """From 30 rpm the slip falls through zero, and from most angles a gap comes by before."""
    window, met = ControllerSettings().window, 0
    for at_zero in np.linspace(0.0, PITCH, 8, endpoint=False):
        predictor = predictor_at(30.0, references=learned(float(at_zero)))
        plan = planned("target_phase", ControllerSettings(), predictor)
        assert plan is not None
        met += abs(plan.phase_rad) < 0.8 * HALF_GAP
        assert window.contact_low_rad_s <= plan.slip_rad_s <= window.contact_high_rad_s
    assert met >= 6


@pytest.mark.parametrize("slip_rpm", [200.0, 400.0, 900.0])
def test_no_sleeve_is_fired_while_its_gear_is_too_fast_in_every_contact_in_sight(
    slip_rpm: float,
) -> None:
    """Drag brings the slip down; until a contact within the window is in sight nothing is fired."""
    chosen = ControllerSettings()
    high = chosen.window.contact_high_rad_s
    far_us = EARLIEST_US + DELAY_US + 600_000.0
    slips = truth(predictor_at(slip_rpm), np.linspace(NOW_US, far_us, 50))[1]
    plan = planned("target_phase", chosen, predictor_at(slip_rpm))
    if slips.min() > high:
        assert plan is None
    else:
        assert plan is not None
        assert plan.slip_rad_s <= high


class ReportedSoon(GearPredictor):
    """By which the phase is known to 0.1 degrees in this many microseconds, and until then to 2."""

    reported_us: float

    def variances(
        self, first_us: float, step_us: float, count: int, release_us: float | None = None
    ) -> np.ndarray:
        del first_us, release_us
        degrees = np.where(step_us * np.arange(count) < self.reported_us - 1e-6, 2.0, 0.1)
        return np.asarray(np.radians(degrees) ** 2)


@pytest.mark.parametrize(
    ("reported_ms", "stops_ms", "is_fired"),
    [(20, 12, True), (30, 12, False), (30, 22, True), (20, 1, False)],
)
def test_a_sleeve_is_fired_at_once_if_what_can_stop_it_is_reported_in_time(
    reported_ms: int, stops_ms: int, is_fired: bool
) -> None:
    """The earliest contact is in the middle of a gap, with 20 rpm. It is fired in 18 ms, and can be
    stopped short of the teeth for 12 ms from then on: the step after 20 ms can still stop it, one
    that can be stopped for 22 ms the step after 30 ms. If the phase is known later, a later gap is
    better."""
    assert is_fired_at_once(reported_ms, stops_ms) is is_fired


def is_fired_at_once(reported_ms: int, stops_ms: int, tick_ms: int = 10) -> bool:
    first_us = EARLIEST_US + DELAY_US
    at_zero, _ = predictor_at(20.0, references=learned(0.0)).phase_and_slip(first_us)
    usual = predictor_at(20.0, references=learned(-at_zero))
    values = {field.name: getattr(usual, field.name) for field in dataclasses.fields(usual)}
    predictor = ReportedSoon(**values | {"stop_us": DELAY_US - 1000 * stops_ms})
    object.__setattr__(predictor, "reported_us", 1000.0 * reported_ms)
    chosen = ControllerSettings(timing=Timing(tick_ms=tick_ms)).with_strategy("target_phase")
    contact_us = make_strategy(SHEET, chosen).contact(predictor, NOW_US, EARLIEST_US)
    assert contact_us is not None
    return contact_us - first_us < 3_000


@pytest.mark.parametrize("tick_ms", [5, 10, 20])
@pytest.mark.parametrize(("reported_ms", "is_fired"), [(20, True), (25, False)])
def test_of_any_tick_only_a_step_with_a_new_read_knows_more(
    tick_ms: int, reported_ms: int, is_fired: bool
) -> None:
    """What is known after 25 ms comes too late for the read after 20 ms. Red before: a tick of 5 ms
    has a step after 25, but that one has no read."""
    assert is_fired_at_once(reported_ms, 12, tick_ms) is is_fired


@given(ticks=st.integers(0, 8), share=st.floats(0.0, 0.999))
def test_a_contact_is_as_uncertain_as_at_the_last_look_before_it(ticks: int, share: float) -> None:
    """Measurements come every 10 ms, the last one 36 to 46 ms before a contact; what they show
    besides is nothing here, so only the time from measurement to contact counts."""
    predictor, measurement = predictor_at(20.0), LastMeasurement(36_000.0, 10_000)
    contact_us = NOW_US + measurement.before_us + 10_000.0 * (ticks + share)
    found = predictor.known_variances(contact_us, 1.0, 1, NOW_US, measurement)
    ahead_us = measurement.before_us + 10_000.0 * share
    assert found[0] == pytest.approx(predictor.estimate_variance(NOW_US + ahead_us), rel=0.01)


def test_a_plan_misses_where_its_phase_is_outside_half_the_gap() -> None:
    strategist, times = Strategist(SHEET, ControllerSettings()), range(50_000, 450_000, 1_000)
    plans = [strategist.plan_at(predictor_at(18.0), at, ShiftDecision.FIRE) for at in times]
    assert {plan.misses for plan in plans} == {True, False}
    for plan in plans:
        assert plan.misses is (abs(plan.phase_rad) > HALF_GAP)


def test_an_unknown_phase_cannot_be_aimed_at() -> None:
    predictor = predictor_at(15.0, references=PhaseReferences(SHEET))
    with pytest.raises(KeyError):
        planned("target_phase", ControllerSettings(), predictor)
    plan = Strategist(SHEET, ControllerSettings()).plan_at(predictor, 100_000, ShiftDecision.FIRE)
    assert plan.phase_rad == plan.phase_sd_rad == 0.0
    _, (slip,) = truth(predictor, np.array([1e5]))
    assert plan.slip_rad_s == pytest.approx(slip, abs=1e-6)


@pytest.mark.parametrize(("slip_rpm", "fires"), [(70.0, False), (51.5, False), (49.0, True)])
def test_speed_window_fires_at_once_when_the_slip_is_small_enough(
    slip_rpm: float, fires: bool
) -> None:
    """50 rpm, whatever the phase."""
    predictor = predictor_at(slip_rpm, references=PhaseReferences(SHEET))
    plan = planned("speed_window", ControllerSettings(), predictor, 0)
    assert (plan is not None) is fires
    if plan is not None:
        assert plan.fire_us == EARLIEST_US


@settings(deadline=None, max_examples=25)
@given(
    slip_rpm=st.floats(330.0, 460.0),
    left_rpm=st.floats(5.0, 60.0),
    settle_us=st.floats(50_000.0, 200_000.0),
    planned=st.booleans(),
)
def test_the_release_leaves_the_slip_asked_for(
    slip_rpm: float, left_rpm: float, settle_us: float, planned: bool
) -> None:
    """The brake has just been switched on; with or without a release planned before."""
    brake = BrakeInput(VALVE_US)
    brake.schedule(0, True, -1)
    if planned:
        brake.schedule(80_000, False, 1)
    predictor = predictor_at(slip_rpm, brake=brake)
    release_us = predictor.release_time_us(EARLIEST_US, 1_000_000, left_rpm * RPM, settle_us)
    assert EARLIEST_US < release_us < 1_000_000
    fed = (VALVE_US, release_us + VALVE_US)
    _, (slip,) = truth(predictor, np.array([release_us + settle_us]), fed)
    assert slip == pytest.approx(left_rpm * RPM, abs=1e-3)


def test_a_release_that_is_late_already_is_made_at_once() -> None:
    brake = BrakeInput(VALVE_US)
    brake.schedule(0, True, -1)
    predictor = predictor_at(20.0, pressure_pa=8e5, brake=brake)
    assert predictor.release_time_us(EARLIEST_US, 10**6, 5.0, 1e5) == EARLIEST_US


@settings(deadline=None, max_examples=25)
@given(slip_rpm=st.floats(240.0, 280.0), at_zero=st.floats(0.0, PITCH))
def test_release_and_contact_planned_together_meet_the_gap(slip_rpm: float, at_zero: float) -> None:
    """Braked by this plan and by nothing else, the tooth is in the gap at the planned contact,
    with the slip inside its window."""
    brake, chosen = BrakeInput(VALVE_US), ControllerSettings()
    brake.schedule(0, True, -1)
    predictor = predictor_at(slip_rpm, 7e5, brake=brake, references=learned(at_zero))
    aimed = make_strategy(SHEET, chosen.with_strategy("target_phase"))
    release_us, contact_us = aimed.release(predictor, NOW_US, EARLIEST_US)
    assert release_us >= EARLIEST_US
    assert contact_us - DELAY_US >= EARLIEST_US
    (phase,), (slip,) = truth(
        predictor, np.array([float(contact_us)]), (VALVE_US, release_us + VALVE_US)
    )
    if release_us < EARLIEST_US + 50_000:
        assert abs(math.remainder(phase + at_zero, PITCH)) < HALF_GAP
        assert chosen.window.contact_low_rad_s <= slip <= chosen.window.contact_high_rad_s


@settings(deadline=None, max_examples=25)
@given(slip_rpm=st.floats(45.0, 90.0), contact_rpm=st.floats(5.0, 35.0))
def test_anticipating_meets_the_gear_at_the_slip_asked_for(
    slip_rpm: float, contact_rpm: float
) -> None:
    """The brake dying away, whatever the phase; a slip already too small is met at once."""
    chosen = ControllerSettings(window=Window(anticipate_slip_rad_s=contact_rpm * RPM))
    predictor = predictor_at(slip_rpm, 2e5, references=PhaseReferences(SHEET))
    plan = planned("speed_window_anticipating", chosen, predictor)
    assert plan is not None
    first_us = EARLIEST_US + DELAY_US
    assert plan.fire_us == plan.contact_us - DELAY_US >= EARLIEST_US
    _, (at_first, at_contact) = truth(
        predictor, np.array([float(first_us), float(plan.contact_us)])
    )
    if at_first < contact_rpm * RPM:
        assert plan.contact_us == first_us
    else:
        last_us = first_us + 300_000
        assert plan.contact_us == last_us or at_contact == pytest.approx(
            contact_rpm * RPM, abs=2e-3
        )


def sleeve_on_its_way(phase_deg: float, slip_rpm: float) -> tuple[GearPredictor, int]:
    """A sleeve that meets its gear in 40 ms at this phase, and the time of that contact."""
    contact_us = NOW_US + 40_000
    at_zero, _ = predictor_at(slip_rpm, references=learned(0.0)).phase_and_slip(contact_us)
    return predictor_at(slip_rpm, references=learned(math.radians(phase_deg) - at_zero)), contact_us


@pytest.mark.parametrize("phase_deg", [-0.2, 0.0, 0.2])
def test_a_sleeve_that_will_meet_the_gap_is_not_recalled(phase_deg: float) -> None:
    predictor, contact_us = sleeve_on_its_way(phase_deg, 20.0)
    phase, _ = predictor.phase_and_slip(contact_us)
    assert math.degrees(phase) == pytest.approx(phase_deg, abs=1e-9)
    strategy = make_strategy(SHEET, ControllerSettings().with_strategy("target_phase"))
    assert not strategy.is_to_go_back(predictor, NOW_US, contact_us, EARLIEST_US + 20_000)


@pytest.mark.parametrize("phase_deg", [-2.0, 1.5, 3.5])
def test_a_sleeve_that_will_meet_a_tooth_is_recalled_for_a_gap_within_reach(
    phase_deg: float,
) -> None:
    predictor, contact_us = sleeve_on_its_way(phase_deg, 20.0)
    strategy = make_strategy(SHEET, ControllerSettings().with_strategy("target_phase"))
    assert strategy.is_to_go_back(predictor, NOW_US, contact_us, EARLIEST_US + 20_000)


def test_a_sleeve_that_will_meet_a_tooth_goes_on_where_every_later_contact_is_worse() -> None:
    """The gear is 190 rpm too slow already and gets slower: no later contact is at a better
    slip."""
    predictor, contact_us = sleeve_on_its_way(1.5, -190.0)
    strategy = make_strategy(SHEET, ControllerSettings().with_strategy("target_phase"))
    assert not strategy.is_to_go_back(predictor, NOW_US, contact_us, EARLIEST_US + 20_000)


def test_a_strategy_that_does_not_aim_calls_no_sleeve_back() -> None:
    predictor, contact_us = sleeve_on_its_way(3.0, 20.0)
    for name in ("speed_window", "speed_window_anticipating"):
        strategy = make_strategy(SHEET, ControllerSettings().with_strategy(name))
        assert not strategy.is_to_go_back(predictor, NOW_US, contact_us, EARLIEST_US)
