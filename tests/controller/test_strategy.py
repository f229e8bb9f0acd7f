"""Plans of a shift, each checked by solving the equations of motion up to the planned contact."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from controller.brake_input import BrakeInput
from controller.kernels import time_at_speed
from controller.outlook import Outlook
from controller.predictor import LayshaftState, layshaft_model
from controller.reference import PhaseReferences
from controller.settings import Aim, ControllerSettings
from controller.shafts import ShaftState
from controller.strategy import HORIZON_US, Strategist
from dbc.messages import ShiftDecision
from gearbox import MainGear, Split, load_sheet

SHEET = load_sheet("thesis")
MODEL = layshaft_model(SHEET, Split.HIGH)
RPM = math.pi / 30.0
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
    references.locked(GEAR, 1.0)
    theta_main = phase_at_zero - HALF_GAP
    while not references.watch(GEAR, 0.0, theta_main):
        pass
    return references


def outlook_at(
    slip_rpm: float,
    pressure_pa: float = 0.0,
    brake: BrakeInput | None = None,
    references: PhaseReferences | None = None,
) -> Outlook:
    omega = (MAIN.omega_rad_s + slip_rpm * RPM) / RATIO
    layshaft = LayshaftState(0.0, 1.0, omega, pressure_pa, 1e-3, 0.05, 1e3)
    brake = brake or BrakeInput(VALVE_US)
    sleeve = SHEET.sleeve
    delay_us = round(sleeve.delay_s * 1e6)
    return Outlook(
        GEAR, RATIO, layshaft, MAIN, brake, MODEL, references or learned(0.0), delay_us,
        sleeve.delay_sd_s,
    )  # fmt: skip


def truth(
    outlook: Outlook, time_us: np.ndarray, u_of_us: tuple[float, float] = (math.inf, math.inf)
) -> tuple[np.ndarray, np.ndarray]:
    """Phase (with 0 at zero angles) and slip at rising times; pressure is fed between two times."""
    a, b, g, supply = MODEL
    ls = outlook.layshaft
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


@settings(deadline=None, max_examples=40)
@given(
    slip_rpm=st.floats(-5.0, 80.0),
    pressure_pa=st.floats(0.0, 2e5),
    at_zero=st.floats(0.0, PITCH),
    share=st.floats(-0.9, 0.9),
)
def test_a_planned_contact_is_on_target_inside_the_window_or_there_is_none(
    slip_rpm: float, pressure_pa: float, at_zero: float, share: float
) -> None:
    """A free layshaft, its brake dying away, at any slip and any angle."""
    chosen = ControllerSettings(aim=Aim(share))
    window = chosen.window
    outlook = outlook_at(slip_rpm, pressure_pa, references=learned(at_zero))
    plan = Strategist(SHEET, chosen).target_phase(outlook, EARLIEST_US)
    if plan is not None:
        (phase,), (slip,) = truth(outlook, np.array([float(plan.contact_us)]))
        # A microsecond at 25 rpm is 1.5e-4 degrees.
        assert abs(math.remainder(phase + at_zero - share * HALF_GAP, PITCH)) < 1.5e-4
        assert abs(math.remainder(plan.phase_rad - share * HALF_GAP, PITCH)) < 1.5e-4
        assert plan.slip_rad_s == pytest.approx(slip, abs=1e-5)
        assert window.contact_low_rad_s - 1e-5 <= slip <= window.contact_high_rad_s + 1e-5
        assert plan.contact_us - plan.fire_us == DELAY_US
        assert plan.fire_us >= EARLIEST_US
        assert plan.decision is ShiftDecision.FIRE
        assert plan.phase_sd_rad >= slip * SHEET.sleeve.delay_sd_s
        return
    start_us = EARLIEST_US + DELAY_US
    times = np.arange(start_us, start_us + HORIZON_US - 2_000, 500.0)
    phases, slips = truth(outlook, times)
    sure = (slips > window.contact_low_rad_s + 0.05) & (slips < window.contact_high_rad_s - 0.05)
    teeth = np.floor((phases + at_zero - share * HALF_GAP) / PITCH)
    passed = np.diff(teeth) > 0
    assert not np.any(passed & sure[1:] & sure[:-1])


def test_the_earliest_gap_is_taken() -> None:
    """Between the earliest contact and the planned one the target passed at no slip allowed: it
    may pass while the slip is still above its window."""
    planned = 0
    for at_zero in np.linspace(0.0, PITCH, 9):
        outlook = outlook_at(44.0, references=learned(float(at_zero)))
        plan = Strategist(SHEET, ControllerSettings()).target_phase(outlook, EARLIEST_US)
        if plan is None:
            continue
        planned += 1
        times = np.arange(EARLIEST_US + DELAY_US, plan.contact_us - 100.0, 100.0)
        phases, slips = truth(outlook, times)
        allowed = slips[1:] < ControllerSettings().window.contact_high_rad_s - 0.05
        passed = np.diff(np.floor((phases + at_zero) / PITCH)) > 0
        assert not np.any(passed & allowed)
    assert planned >= 3


def test_an_unknown_phase_cannot_be_aimed_at() -> None:
    outlook = outlook_at(15.0, references=PhaseReferences(SHEET))
    strategist = Strategist(SHEET, ControllerSettings())
    with pytest.raises(KeyError):
        strategist.target_phase(outlook, EARLIEST_US)
    plan = strategist.plan_at(outlook, 100_000, ShiftDecision.FIRE)
    assert plan.phase_rad == plan.phase_sd_rad == 0.0
    _, (slip,) = truth(outlook, np.array([1e5]))
    assert plan.slip_rad_s == pytest.approx(slip, abs=1e-6)


@pytest.mark.parametrize(("slip_rpm", "fires"), [(70.0, False), (51.5, False), (49.0, True)])
def test_speed_window_fires_at_once_when_the_slip_is_small_enough(
    slip_rpm: float, fires: bool
) -> None:
    """50 rpm, whatever the phase."""
    outlook = outlook_at(slip_rpm, references=PhaseReferences(SHEET))
    plan = Strategist(SHEET, ControllerSettings()).speed_window(outlook, 0, EARLIEST_US)
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
    outlook = outlook_at(slip_rpm, brake=brake)
    release_us = outlook.release_time_us(EARLIEST_US, 1_000_000, left_rpm * RPM, settle_us)
    assert EARLIEST_US < release_us < 1_000_000
    fed = (VALVE_US, release_us + VALVE_US)
    _, (slip,) = truth(outlook, np.array([release_us + settle_us]), fed)
    assert slip == pytest.approx(left_rpm * RPM, abs=1e-3)


def test_a_release_that_is_late_already_is_made_at_once() -> None:
    brake = BrakeInput(VALVE_US)
    brake.schedule(0, True, -1)
    outlook = outlook_at(20.0, pressure_pa=8e5, brake=brake)
    assert outlook.release_time_us(EARLIEST_US, 10**6, 5.0, 1e5) == EARLIEST_US


@settings(deadline=None, max_examples=25)
@given(slip_rpm=st.floats(330.0, 460.0), at_zero=st.floats(0.0, PITCH))
def test_release_and_contact_planned_together_leave_no_waiting(
    slip_rpm: float, at_zero: float
) -> None:
    """Braked by this plan and by nothing else, the target meets the tooth at the planned contact,
    with the slip inside its window."""
    brake, chosen = BrakeInput(VALVE_US), ControllerSettings()
    brake.schedule(0, True, -1)
    outlook = outlook_at(slip_rpm, brake=brake, references=learned(at_zero))
    release_us, contact_us = Strategist(SHEET, chosen).release(outlook, EARLIEST_US, aimed=True)
    assert release_us >= EARLIEST_US
    assert contact_us - DELAY_US >= EARLIEST_US
    fed = (VALVE_US, release_us + VALVE_US)
    (phase,), (slip,) = truth(outlook, np.array([float(contact_us)]), fed)
    # Release and contact are whole microseconds; half of one of release moves 5e-6 of a turn.
    assert abs(math.remainder(phase + at_zero, PITCH)) < 3e-4
    assert chosen.window.contact_low_rad_s <= slip <= chosen.window.contact_high_rad_s


@settings(deadline=None, max_examples=25)
@given(omega=st.floats(60.0, 110.0), on_us=st.integers(0, 50_000), held_us=st.integers(1, 90_000))
def test_the_time_at_a_speed_is_when_the_solver_gets_there(
    omega: float, on_us: int, held_us: int
) -> None:
    a, b, g, supply = MODEL
    switch_us = np.array([float(on_us), float(on_us + held_us)])
    x = np.array([0.0, 120.0, 0.0])
    found_us = time_at_speed(x, 0.0, omega, switch_us, np.array([1.0, 0.0]), MODEL)

    def reached(_t: float, y: np.ndarray) -> float:
        return float(y[1]) - omega

    reached.terminal = True  # type: ignore[attr-defined]
    at_s, y = 0.0, np.array([0.0, 120.0, 0.0])
    for end_s, u in ((switch_us[0] * 1e-6, 0.0), (switch_us[1] * 1e-6, 1.0), (12.0, 0.0)):
        if at_s == end_s:
            continue
        solution = solve_ivp(
            lambda _t, y, u=u: [y[1], -a * y[1] - g * y[2], b * (supply * u - y[2])],
            (at_s, end_s),
            y,
            events=reached,
            rtol=1e-9,
            atol=1e-9,
        )
        at_s, y = float(solution.t[-1]), solution.y[:, -1]
        if solution.status == 1:
            break
    if math.isinf(found_us):
        assert at_s < switch_us[1] * 1e-6 or at_s > 9.0
    else:
        assert found_us * 1e-6 == pytest.approx(at_s, abs=2e-6)
        assert x[0] == pytest.approx(y[0], abs=1e-3)
        assert x[1] == pytest.approx(omega, abs=1e-6)
