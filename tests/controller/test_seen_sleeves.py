"""When a sleeve is at its gear's teeth and in mesh, as measured by sensors with an offset."""

from __future__ import annotations

import pytest

from meshpoint.controller.measure.gearbox_view import GearboxView
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
    return view


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


def test_the_oldest_of_the_sleeves_samples_is_reported_and_a_sensor_that_says_so_is_faulty() -> (
    None
):
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
