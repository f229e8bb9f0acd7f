"""Strategies that do not aim, their common times, and the search for a time, by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from meshpoint.controller.planning.gear_predictor import _falling_root
from meshpoint.controller.planning.strategies.base import (
    last_look,
    release_for_slip,
    settle_time_us,
    told_until_called_back_us,
)
from meshpoint.controller.planning.strategies.speed_window import SpeedWindow
from meshpoint.controller.planning.strategies.speed_window_anticipating import (
    SpeedWindowAnticipating,
)
from meshpoint.controller.planning.strategist import Strategist
from meshpoint.controller.settings import ControllerSettings, Timing, Window
from meshpoint.dbc.messages import ShiftDecision
from meshpoint.gearbox import GearboxSheet, MainGear, load_sheet
from meshpoint.units import RPM

SHEET = load_sheet("truck12")
WINDOW = Window(
    fire_slip_rad_s=48.0 * RPM, release_slip_rad_s=24.0 * RPM, anticipate_slip_rad_s=20.0 * RPM,
    anticipate_release_rad_s=9.0 * RPM, settle_time_constants=2.0,
)  # fmt: skip
SETTINGS = replace(ControllerSettings(), window=WINDOW)
SETTLE_US = 12_000 + 2 * 45_000
"""The brake's valve and two of its time constants."""


class Predictor:
    """One that notes what it is asked."""

    delay_us = 45_000

    def __init__(self, slip_rpm: float = 0.0) -> None:
        self.slip, self.asked = slip_rpm * RPM, list[Any]()

    def slip_rad_s(self, time_us: float) -> float:
        self.asked.append(time_us)
        return self.slip

    def release_time_us(self, *asked: float) -> int:
        self.asked.append(asked)
        return 321_000

    def slip_falls_to_us(self, *asked: float) -> int:
        self.asked.append(asked)
        return 654_000


@pytest.mark.parametrize(
    ("made", "left_rpm"), [(SpeedWindow, 24.0), (SpeedWindowAnticipating, 9.0)]
)
def test_the_brake_is_released_so_that_its_slip_is_left_when_it_has_faded(
    made: Any, left_rpm: float
) -> None:
    """Within a second from the earliest on; the contact is expected when it has."""
    strategy, predictor = made(SHEET, SETTINGS), Predictor()
    plan = strategy.release(predictor, 10_000, 28_000)
    assert predictor.asked == [(28_000, 1_028_000, pytest.approx(left_rpm * RPM), SETTLE_US)]
    assert plan == (321_000, 321_000 + SETTLE_US)
    assert strategy.aims is False
    assert strategy.is_to_go_back(predictor, 1, 2, 3) is False


@pytest.mark.parametrize(("slip_rpm", "fires"), [(47.9, True), (48.0, True), (48.1, False)])
def test_in_its_window_a_sleeve_is_fired_at_once(slip_rpm: float, fires: bool) -> None:
    strategy, predictor = SpeedWindow(SHEET, SETTINGS), Predictor(slip_rpm)
    any_predictor: Any = predictor
    contact_us = strategy.contact(any_predictor, 10_000, 28_000)
    assert contact_us == (28_000 + 45_000 if fires else None)
    assert predictor.asked == ([10_000] if fires else [10_000, 73_000])
    assert strategy.fire_slip_rad_s == pytest.approx(48.0 * RPM)


@pytest.mark.parametrize(("at_contact_rpm", "fires"), [(0.1, False), (0.0, True), (-30.0, True)])
def test_above_its_window_a_sleeve_is_fired_where_a_later_one_would_come_too_late(
    at_contact_rpm: float, fires: bool
) -> None:
    """Strong drag takes the whole window while a sleeve is on its way."""
    strategy, predictor = SpeedWindow(SHEET, SETTINGS), Predictor()
    slips = {10_000: 60.0 * RPM, 73_000: at_contact_rpm * RPM}
    any_predictor: Any = predictor
    any_predictor.slip_rad_s = slips.__getitem__
    assert strategy.contact(any_predictor, 10_000, 28_000) == (73_000 if fires else None)


def test_ahead_of_its_slip_a_sleeve_is_fired_up_to_three_tenths_of_a_second_before() -> None:
    strategy, predictor = SpeedWindowAnticipating(SHEET, SETTINGS), Predictor()
    any_predictor: Any = predictor
    assert strategy.contact(any_predictor, 10_000, 28_000) == 654_000
    assert predictor.asked == [(pytest.approx(20.0 * RPM), 73_000, 373_000)]
    assert strategy.fire_slip_rad_s == pytest.approx(20.0 * RPM)


def sleeve_valve(valve_ms: float) -> GearboxSheet:
    return replace(SHEET, sleeve=replace(SHEET.sleeve, valve_delay_s=1e-3 * valve_ms))


@pytest.mark.parametrize(
    ("lead_ms", "valve_ms", "tick_ms", "told_us"),
    [
        (4, 12.0, 10, 10_000),  # 14 ms: one whole tick
        (4, 7.9, 10, 0),
        (4, 8.0, 10, 10_000),
        (12, 12.0, 10, 20_000),
        (4, 12.0, 7, 14_000),
        (1, 0.5, 10, 0),
        (1, 2.0, 1, 1_000),
        (1, 0.5, 1, 0),
    ],
)
def test_a_sleeve_can_be_called_back_for_lead_and_valve_less_the_bus_in_whole_ticks(
    lead_ms: int, valve_ms: float, tick_ms: int, told_us: int
) -> None:
    """2 ms are the bus's and the node's own."""
    timing = Timing(lead_ms=lead_ms, tick_ms=tick_ms)
    assert told_until_called_back_us(sleeve_valve(valve_ms), timing) == told_us


@pytest.mark.parametrize(
    ("delay_us", "before_us"), [(45_000, 36_000), (12_000, 3_000), (9_000, 3_000)]
)
def test_the_last_look_is_the_way_and_the_bus_and_a_late_step_before_the_contact(
    delay_us: int, before_us: int
) -> None:
    assert last_look(sleeve_valve(12.0), Timing(tick_ms=8), delay_us) == (before_us, 8_000)


def test_a_release_has_settled_after_the_valve_and_so_many_time_constants() -> None:
    assert settle_time_us(SHEET, 0.0) == pytest.approx(12_000.0)
    assert settle_time_us(SHEET, 0.9) == pytest.approx(52_500.0)
    predictor: Any = Predictor()
    assert release_for_slip(predictor, 5, 2.5, 7.0) == 321_000
    assert predictor.asked == [(5, 1_000_005, 2.5, 7.0)]


@pytest.mark.parametrize(
    ("phase", "misses"), [(0.999, False), (1.001, True), (-0.999, False), (-1.001, True)]
)
@pytest.mark.parametrize("turns", [0, 3])
def test_a_plan_misses_where_its_phase_is_outside_half_the_gap(
    phase: float, misses: bool, turns: int
) -> None:
    dog = SHEET.dog
    raw = phase * dog.backlash_rad / 2.0 + turns * dog.pitch_rad
    predictor: Any = SimpleNamespace(
        gear=MainGear.SECOND, delay_us=45_000, references=SimpleNamespace(known=lambda _: True),
        phase_and_slip=lambda _time: (raw, 2.0), phase_sd_rad=lambda _time: 0.003,
    )  # fmt: skip
    plan = Strategist(SHEET, SETTINGS).plan_at(predictor, 100_000, ShiftDecision.FIRE)
    assert (plan.fire_us, plan.contact_us, plan.decision) == (55_000, 100_000, ShiftDecision.FIRE)
    assert plan.phase_rad == pytest.approx(phase * dog.backlash_rad / 2.0)
    assert (plan.phase_sd_rad, plan.slip_rad_s) == (0.003, 2.0)
    assert plan.misses is misses


def steps_to(root: float, bend: float, first: int = 0, last: int = 1_000_000) -> tuple[int, int]:
    """The time found of a falling function that is bent, and in how many looks."""
    looks: list[int] = []

    def over(time_us: int) -> float:
        looks.append(time_us)
        return 1e2 * (math.exp(-bend * time_us / 1e6) - math.exp(-bend * root / 1e6))

    return _falling_root(over, first, last), len(looks)


@pytest.mark.parametrize("root", [3_000.0, 123_456.0, 500_000.0, 998_000.0])
@pytest.mark.parametrize("bend", [0.1, 1.0, 12.0, 40.0])
def test_a_falling_function_s_root_is_found_in_few_looks_however_it_is_bent(
    root: float, bend: float
) -> None:
    """To where it is 1e-4, or to a microsecond."""
    found, looks = steps_to(root, bend)
    slope = 1e2 * bend / 1e6 * math.exp(-bend * root / 1e6)
    assert found == pytest.approx(root, abs=1.0 + 1.01e-4 / slope)
    assert looks <= 22


def test_a_root_outside_is_the_nearer_end() -> None:
    assert steps_to(-1.0, 1.0)[0] == 0
    assert steps_to(0.0, 1.0) == (0, 2)
    assert steps_to(1e6, 1.0) == (1_000_000, 2)
    assert steps_to(2e6, 1.0)[0] == 1_000_000
    assert steps_to(300.0, 1.0, 100, 200)[0] == 200
