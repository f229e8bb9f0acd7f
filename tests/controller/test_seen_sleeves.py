"""When a sleeve comes to its gear's teeth and is in mesh, as measured by sensors with an offset;
what is learned of its delay; and the clock of its sensors."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.planning.sleeve_delay import (
    MOST_SAMPLES,
    PRIOR_SAMPLES,
    PRIOR_SCATTER_SAMPLES,
    SHARE_OF_SCATTER,
    SleeveDelays,
)
from meshpoint.controller.sensing.gearbox_view import GearboxView
from meshpoint.controller.sensing.sensor_clock import SensorClockEstimate, unwrap, wrap
from meshpoint.dbc.messages import SleevesAux, SleevesMain
from meshpoint.gearbox import MainGear, Sleeve, load_sheet

SHEET = load_sheet("truck12")
SLEEVE = SHEET.sleeve
WRAP_US = 1 << 32


def moved(
    offset_m: float, direction: int, until_ms: int, begins_ms: float = 2_400.3
) -> GearboxView:
    """A sleeve that stands in neutral, and from a time on goes to its gear at the sheet's speed;
    its sensor reads so much too much."""
    view = GearboxView(SHEET)
    for newest_ms in range(10, until_ms + 1, 10):
        times = [newest_ms - back for back in range(10)]
        way = [min(SLEEVE.stroke_m, max(0.0, 1e-3 * SLEEVE.speed_m_s * (t - begins_ms)))
               for t in times]  # fmt: skip
        samples = tuple(direction * at + offset_m for at in way)
        view.sleeves_main(SleevesMain(sleeve_first_second_m=samples), 1_000 * newest_ms)
        view.sleeves_aux(SleevesAux(), 1_000 * newest_ms)
        view.work_out()
        if view.contact_us(Sleeve.FIRST_SECOND, direction) is not None:
            break
    return view


@pytest.mark.parametrize("offset_mm", [-0.4, 0.0, 0.4])
@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("begins_ms", [2_400.3, 2_405.9, 2_409.5])
def test_a_contact_is_when_the_sleeve_is_at_the_teeth_whatever_its_sensor_s_offset(
    offset_mm: float, direction: int, begins_ms: float
) -> None:
    view = moved(1e-3 * offset_mm, direction, 2_500, begins_ms)
    contact_us = view.contact_us(Sleeve.FIRST_SECOND, direction)
    expected_us = 1e3 * (begins_ms + 1e3 * SLEEVE.to_contact_m / SLEEVE.speed_m_s)
    assert contact_us == pytest.approx(expected_us, abs=40.0)
    assert view.contact_us(Sleeve.FIRST_SECOND, -direction) is None
    assert view.contact_us(Sleeve.CRAWL_THIRD, direction) is None


@pytest.mark.parametrize("direction", [-1, 1])
def test_a_sleeve_is_in_mesh_from_a_millimetre_before_its_stroke_on(direction: int) -> None:
    view = GearboxView(SHEET)
    for newest_mm, passed in ((11.5, True), (10.9, False)):
        samples = tuple(direction * 1e-3 * (newest_mm - 0.2 * back) for back in range(10))
        view.sleeves_main(SleevesMain(sleeve_first_second_m=samples), 50_000)
        seen = view.engaged_us(Sleeve.FIRST_SECOND, direction)
        assert (seen is not None) is passed
        if seen is not None:
            assert seen == pytest.approx(50_000 - 1_000 * (newest_mm - 11.0) / 0.2, abs=1.0)
        assert view.side(Sleeve.FIRST_SECOND) == (direction if passed else 0)


@pytest.mark.parametrize("offset_mm", [-0.5, 0.0, 0.5])
def test_the_main_box_is_free_until_a_sleeve_might_rub_on_teeth(offset_mm: float) -> None:
    """By where it stands from its rest."""
    for at_mm, free in ((4.5, True), (4.65, False), (-4.5, True), (-4.65, False)):
        view = moved(1e-3 * offset_mm, 1, 2_400)
        samples = (1e-3 * (at_mm + offset_mm),) * 10
        still = SleevesMain(
            sleeve_first_second_m=(1e-3 * offset_mm,) * 10, sleeve_crawl_third_m=(0.0,) * 10
        )
        view.sleeves_main(still._replace(sleeve_first_second_m=samples), 2_410_000)
        assert view.main_box_free is free
        other = (1e-3 * at_mm,) * 10
        view.sleeves_main(still._replace(sleeve_crawl_third_m=other), 2_420_000)
        assert view.main_box_free is free


def test_the_oldest_of_the_sleeves_samples_is_told_and_a_sensor_that_says_so_is_faulty() -> None:
    view = GearboxView(SHEET)
    assert view.oldest_us == 0
    assert not view.complete
    view.sleeves_main(SleevesMain(), 30_000)
    view.sleeves_aux(SleevesAux(), 20_000)
    view.clutch.take(20_000, 1.0)
    assert view.complete
    assert view.oldest_us == 20_000
    view.work_out()
    assert view.main_gear is MainGear.NEUTRAL
    for kind, take in ((SleevesMain, view.sleeves_main), (SleevesAux, view.sleeves_aux)):
        take(kind()._replace(sensor_fault=1), 40_000)
        view.work_out()
        assert not view.complete
        assert (view.main_gear, view.split, view.range_) == (None, None, None)
        assert view.gear_number == -1
        take(kind(), 50_000)
        view.work_out()
        assert view.complete


def scatter(errors_us: list[float]) -> tuple[SleeveDelays, float, float, float]:
    """Delays after these contacts; mean, scatter and their weights by the laws of the normal-gamma
    distribution."""
    delays = SleeveDelays(SHEET)
    sheet_us = 1e6 * SLEEVE.delay_s
    for error in errors_us:
        delays.learn(MainGear.SECOND, sheet_us + error)
    n, seen = len(errors_us), PRIOR_SAMPLES + len(errors_us)
    mean = sum(errors_us) / seen
    own = SHARE_OF_SCATTER * 1e6 * SLEEVE.delay_sd_s
    squares = PRIOR_SCATTER_SAMPLES * own**2
    squares += sum((error - mean) ** 2 for error in errors_us) + PRIOR_SAMPLES * mean**2
    variance = squares / (PRIOR_SCATTER_SAMPLES + n)
    return delays, sheet_us + mean, variance, seen


@pytest.mark.parametrize("errors", [[], [4_000.0], [1_000.0, -2_000.0, 500.0], [3_000.0] * 12])
def test_mean_and_scatter_of_a_delay_are_those_of_all_contacts_and_the_sheet_s(
    errors: list[float],
) -> None:
    delays, mean_us, variance_us2, weight = scatter(errors)
    assert delays.delay_us(MainGear.SECOND) == pytest.approx(mean_us, abs=1.0)
    next_sd_us = math.sqrt(variance_us2 * (1.0 + 1.0 / weight))
    assert 1e6 * delays.delay_sd_s(MainGear.SECOND) == pytest.approx(next_sd_us, rel=1e-9)
    assert delays.scatter_samples(MainGear.SECOND) == PRIOR_SCATTER_SAMPLES + len(errors)
    assert delays.samples(MainGear.SECOND) == len(errors)


def test_old_contacts_are_forgotten_so_that_a_slow_drift_is_followed() -> None:
    """What is known weighs no more than so many contacts; its scatter neither grows nor falls with
    their number."""
    delays, sheet_us = SleeveDelays(SHEET), 1e6 * SLEEVE.delay_s
    for k in range(300):
        delays.learn(MainGear.SECOND, sheet_us + 1_000.0 * (-1.0) ** k)
    assert delays.samples(MainGear.SECOND) == round(MOST_SAMPLES - PRIOR_SAMPLES)
    assert delays.scatter_samples(MainGear.SECOND) <= MOST_SAMPLES + PRIOR_SCATTER_SAMPLES
    sd_us = 1e6 * delays.delay_sd_s(MainGear.SECOND)
    assert sd_us == pytest.approx(1_000.0, rel=0.05)
    for _ in range(60):
        delays.learn(MainGear.SECOND, sheet_us + 6_000.0)
    assert delays.delay_us(MainGear.SECOND) > sheet_us + 3_500.0


def test_a_stamp_is_the_time_nearest_to_what_is_expected() -> None:
    for near in (5, WRAP_US - 5, WRAP_US + 7, 3 * WRAP_US):
        for off in (-1_000_000, -1, 0, 1, 1_000_000):
            if near + off >= 0:
                assert unwrap(wrap(near + off), near) == near + off


def test_the_clock_is_by_the_frame_that_waited_least_of_the_last_ones() -> None:
    """Delays of a bus make frames late, never early; a drift of the clocks is followed."""
    clock = SensorClockEstimate()
    assert clock.now_us(1_000) == 0
    delays = [900, 400, 2_000, 300, 700]
    for k, delay in enumerate(delays):
        clock.stamp(1_000_000 + 10_000 * k, 2_000_000 + 10_000 * k + delay)
        assert clock.now_us(3_000_000) == 2_000_000 - min(delays[: k + 1])
    assert clock.latest_us == 1_040_000
    assert (clock.jumps, clock.late) == (0, 0)
    drifting = SensorClockEstimate()
    for k in range(5_000):
        drifting.stamp(1_000_000 + 10_000 * k, 2_000_000 + 10_001 * k + 300)
    newest = 1_000_000 + 10_000 * 4_999
    assert drifting.now_us(2_000_000 + 10_001 * 4_999 + 300) == pytest.approx(newest, abs=6_500)
    restarted = SensorClockEstimate()
    restarted.stamp(1_000_000, 2_000_000)
    restarted.restart()
    assert restarted.jumps == 1
    assert restarted.stamp(500, 2_010_000) == 500
