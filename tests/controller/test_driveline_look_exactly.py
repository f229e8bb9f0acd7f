"""How many looks at a driveline say something, and which of them: numbers and limits, by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meshpoint.controller.shift import driveline_look
from meshpoint.controller.shift.driveline_look import DrivelineLook
from meshpoint.controller.shift.swing_fit import EngineCourse, Known, SwingFit
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import load_sheet

SHEET = load_sheet("truck12")
DRIVELINE, REFERENCE_NM = SHEET.driveline, SHEET.engine.reference_nm
LEAST, MOST = DRIVELINE.vehicle_kgm2
TICK_US, FIRST_US = 10_000, 3_000_000
BODIES: Any = SimpleNamespace(ratio=2.5, engine_kgm2=400.0)


class Looks:
    """Looks in gear 4, one a step, of speeds and torques that are laid down."""

    def __init__(self) -> None:
        self.look, self.now_us = DrivelineLook(SHEET), FIRST_US - TICK_US

    def step(
        self, speed: float = 100.0, share: float | None = 0.3, state: State = State.IN_GEAR,
        torque_step: float = 0.01,
    ) -> Looks:  # fmt: skip
        self.now_us += TICK_US
        snapshot: Any = SimpleNamespace(
            now_us=self.now_us, engine_rad_s=speed, engine_torque_share=share,
            engine_torque_step=torque_step,
            view=SimpleNamespace(gear_number=4, main_gear=None),
            speeds=SimpleNamespace(main=50.0),
        )  # fmt: skip
        self.look.look(state, snapshot)
        return self

    def many(self, count: int) -> Looks:
        """So many that count: the first finds the gear."""
        for _ in range(count + 1):
            self.step()
        return self


def test_before_anything_was_seen_the_sheet_tells_shafts_and_vehicle() -> None:
    look = DrivelineLook(SHEET)
    assert (look.pressed_nm, look.torque_step, look.engine_rad_s2) == (0.0, 0.01, 0.0)
    sd = (1.0 / LEAST - 1.0 / MOST) / math.sqrt(12.0)
    mean = 0.5 / LEAST + 0.5 / MOST
    share = DRIVELINE.stiffness_tolerance / math.sqrt(3.0)
    assert look.known == pytest.approx(Known(DRIVELINE.stiffness_nm_rad, share, mean, sd))
    assert look.learned == look.known
    one = replace(DRIVELINE, vehicle_most_kg=DRIVELINE.vehicle_least_kg)
    sure = DrivelineLook(replace(SHEET, driveline=one))
    assert sure.known.vehicle_sd == pytest.approx(1e-3 / LEAST / math.sqrt(12.0))


@pytest.mark.parametrize("rings", [True, False])
@pytest.mark.parametrize("stiffness", [0.0, 0.5, 16_000.0])
def test_a_driveline_twists_that_was_seen_to_and_whose_stiffness_the_sheet_says(
    rings: bool, stiffness: float
) -> None:
    """In Nm/rad: any that is not zero."""
    soft = replace(DRIVELINE, stiffness_nm_rad=stiffness)
    look = DrivelineLook(replace(SHEET, driveline=soft))
    look.rings.twists = rings
    assert look.twists is (rings and stiffness > 0.0)


@pytest.mark.parametrize(("count", "is_told"), [(5, False), (6, True)])
def test_the_engines_acceleration_takes_six_looks(count: int, is_told: bool) -> None:
    looks = Looks().step(0.0)
    for k in range(count):
        looks.step(100.0 + k)
    assert looks.look.engine_rad_s2 == (pytest.approx(100.0) if is_told else 0.0)
    looks.step(100.0 + 25.0)
    if is_told:
        assert looks.look.engine_rad_s2 == pytest.approx((125.0 - 101.0) / 0.05)


@pytest.mark.parametrize(("count", "is_told"), [(24, False), (25, True)])
def test_a_mean_torque_takes_twenty_five_looks(count: int, is_told: bool) -> None:
    looks = Looks().many(count)
    assert looks.look.mean_share(1e6) == (pytest.approx(0.3) if is_told else None)


def test_four_hundred_looks_are_kept() -> None:
    """The four hundred and first before the end is forgotten."""
    looks = Looks().step()
    looks.step(share=400.3)
    for _ in range(399):
        looks.step()
    assert looks.look.mean_share(1e9) == pytest.approx(0.3 + 1.0)
    looks.step()
    assert looks.look.mean_share(1e9) == pytest.approx(0.3)


class Fitted:
    """Stands for the fit: what it is asked, and what it says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, says: Known) -> None:
        self.asked: list[tuple[EngineCourse, float, float, Known]] = []

        def fit(seen: EngineCourse, ratio: float, engine: float, known: Known) -> SwingFit:
            self.asked.append((seen, ratio, engine, known))
            return SwingFit(says, 0.7)

        monkeypatch.setattr(driveline_look, "fit_swing", fit)


MIDDLE = Known(DRIVELINE.stiffness_nm_rad, 0.1, 0.5 / LEAST + 0.5 / MOST, 1e-5)


@pytest.mark.parametrize(("since_us", "is_told"), [(0, True), (-1, True), (1, False)])
def test_a_swing_takes_twenty_five_looks_since_a_time(
    since_us: int, is_told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The look at that time counts, and the torque is that of the first that does."""
    fitted, looks = Fitted(monkeypatch, MIDDLE), Looks().many(3)
    looks.step(90.0, share=0.5)
    for _ in range(24):
        looks.step(95.0)
    first_us = looks.now_us - 24 * TICK_US
    found = looks.look.fit(BODIES, first_us + since_us)
    assert (found is not None) is is_told
    if found is None:
        return
    assert found[0] == SwingFit(MIDDLE, 0.7)
    assert found[1] == pytest.approx(0.5 * REFERENCE_NM)
    ((seen, ratio, engine, known),) = fitted.asked
    assert (ratio, engine, known) == (2.5, 400.0, looks.look.known)
    assert seen.time_s == pytest.approx(1e-6 * (first_us + TICK_US * np.arange(25)))
    assert seen.omega_rad_s == pytest.approx(np.array([90.0] + [95.0] * 24) / 2.5)
    torque_nm = np.array([0.5] + [0.3] * 24) * REFERENCE_NM
    assert seen.torque_nm == pytest.approx(torque_nm * 2.5)


@pytest.mark.parametrize(
    ("inverse", "kept"),
    [(0.99 / MOST, 1.0 / MOST), (1.1 / MOST, 1.1 / MOST), (0.9 / LEAST, 0.9 / LEAST),
     (1.01 / LEAST, 1.0 / LEAST)],
)  # fmt: skip
@pytest.mark.parametrize(("stiff", "held"), [(0.1, -1.0), (0.95, 0.0), (1.05, 0.0), (5.0, 1.0)])
def test_what_is_found_stays_within_what_the_sheet_says(
    inverse: float, kept: float, stiff: float, held: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    mean = DRIVELINE.stiffness_nm_rad
    Fitted(monkeypatch, Known(stiff * mean, 0.1, inverse, 1e-5))
    found = Looks().many(30).look.fit(BODIES, 0.0)
    assert found is not None
    expected = stiff * mean if held == 0.0 else (1.0 + held * DRIVELINE.stiffness_tolerance) * mean
    assert found[0].known == pytest.approx(Known(expected, 0.1, kept, 1e-5))


def test_a_load_taken_up_may_change_the_vehicle_by_half_of_what_the_sheet_leaves_open() -> None:
    look = DrivelineLook(SHEET)
    sd = (1.0 / LEAST - 1.0 / MOST) / math.sqrt(12.0)
    look.learned = Known(15_000.0, 0.03, 1.0 / 900.0, 0.0)
    look.loaded()
    stiffness_sd = min(math.hypot(0.03, 0.05), DRIVELINE.stiffness_tolerance / math.sqrt(3.0))
    assert look.known == pytest.approx(Known(15_000.0, stiffness_sd, 1.0 / 900.0, 0.5 * sd))
    assert look.learned == look.known, "until a ramp has told more"


@pytest.mark.parametrize(
    ("pulled", "left"), [(200.0, 0.0), (-200.0, 0.0), (201.0, 1.0), (-201.0, -1.0)]
)
def test_a_flank_is_told_by_more_than_twice_the_torques_error(pulled: float, left: float) -> None:
    look = DrivelineLook(SHEET)
    look.press(pulled, 100.0, 30.0)
    assert look.pressed_nm == pytest.approx(left * math.hypot(100.0, 30.0))


def test_what_presses_a_flank_is_forgotten_in_gear_and_no_sooner() -> None:
    looks = Looks()
    looks.look.pressed_nm = 70.0
    for state in (State.CLUTCH_OPENING, State.DISENGAGING, State.COASTING):
        assert looks.step(state=state).look.pressed_nm == 70.0
    assert looks.step().look.pressed_nm == 0.0


def test_the_engine_says_in_which_steps_it_tells_its_torque() -> None:
    looks = Looks().step(torque_step=0.00125)
    assert looks.look.torque_step == 0.00125
    looks.step(share=None, torque_step=0.01)
    assert looks.look.torque_step == 0.00125, "only beside a torque"


def test_an_engine_without_torque_is_looked_at_as_one() -> None:
    """Told to be none: that is a torque; not told at all is none to look at."""
    looks = Looks()
    for _ in range(30):
        looks.step(share=None)
    assert looks.look.mean_share(1e9) is None
    for _ in range(30):
        looks.step(share=0.0)
    assert looks.look.mean_share(1e9) == 0.0


def test_what_was_asked_for_in_one_ramp_is_not_followed_in_the_next() -> None:
    """A torque told as 30 % is 30 % again once the clutch is open."""
    looks = Looks().many(3)
    looks.look.ask(0.0)
    looks.step(state=State.CLUTCH_OPENING)
    assert looks.look._looks[-1][2] == pytest.approx(0.295)
    looks.step()
    looks.step(state=State.CLUTCH_OPENING)
    assert looks.look._looks[-1][2] == pytest.approx(0.3)


def test_the_rings_of_a_driveline_are_looked_at_in_every_step() -> None:
    looks, seen = Looks(), list[State]()
    rings: Any = looks.look.rings
    rings.look = lambda state, _: seen.append(state)
    for state in (State.IN_GEAR, State.COASTING, State.NEUTRAL):
        looks.step(state=state)
    assert seen == [State.IN_GEAR, State.COASTING, State.NEUTRAL]
