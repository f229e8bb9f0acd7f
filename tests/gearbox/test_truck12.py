"""The sheet of a 12+2-speed truck box, against what is published of one."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest

from meshpoint.gearbox import MainGear, Range, Split, load_sheet
from meshpoint.gearbox.derived import sheet_figures
from meshpoint.gearbox.gears import DRIVE_GEARS, MAIN_GEARS
from meshpoint.gearbox.sheet import SHEET_NAMES

SHEET = load_sheet("truck12")
TOLERANCE = 0.003
PUBLISHED = {
    "C1": 16.38, "C2": 13.28, "1": 11.27, "2": 9.14, "3": 7.17, "4": 5.81, "5": 4.62, "6": 3.75,
    "7": 3.01, "8": 2.44, "9": 1.91, "10": 1.55, "11": 1.28, "12": 1.00,
}  # fmt: skip
"""Scania's list for the GRS900."""
SUSPECT, READ_AS = "11", 1.23
"""The published 1.28 breaks the splitter's step, 1.23 to 1.24 in every other pair of the list."""


def test_all_fourteen_ratios_are_near_the_published_ones() -> None:
    """Within 0.3 %, with the one that breaks its own list's step read as 1.23."""
    assert len(DRIVE_GEARS) == len(PUBLISHED) == 14
    for gear in DRIVE_GEARS.values():
        wanted = READ_AS if gear.name == SUSPECT else PUBLISHED[gear.name]
        assert SHEET.overall_ratio(gear) == pytest.approx(wanted, rel=TOLERANCE), gear.name


def test_the_published_list_keeps_the_splitter_step_but_for_the_suspect() -> None:
    pairs = [("C1", "C2"), *((str(n), str(n + 1)) for n in range(1, 12, 2))]
    steps = {low: PUBLISHED[low] / PUBLISHED[high] for low, high in pairs}
    assert all(1.23 < step < 1.24 for low, step in steps.items() if low != SUSPECT)
    assert steps[SUSPECT] == pytest.approx(1.28)


def test_the_highest_gear_is_direct() -> None:
    """Splitter high and third are the same wheels: exactly 1, without rounding."""
    high, third = SHEET.split_mesh(Split.HIGH), SHEET.main_mesh(MainGear.THIRD)
    assert (third.driving, third.driven) == (high.driven, high.driving)
    assert high.exact * third.exact * SHEET.range_mesh(Range.HIGH).exact == 1


def test_all_pairs_on_the_layshaft_are_coprime_and_the_range_is_not() -> None:
    meshes = [SHEET.split_mesh(split) for split in Split]
    meshes += [SHEET.main_mesh(gear) for gear in MAIN_GEARS]
    assert all(math.gcd(mesh.driving, mesh.driven) == 1 for mesh in meshes)
    assert sheet_figures(SHEET).shared_factors == {"range low": 6}


def test_the_range_can_be_assembled() -> None:
    """A planetary gear: ring less sun even, sun plus ring a multiple of the number of planets."""
    low = SHEET.range_mesh(Range.LOW)
    sun, ring = low.driving, low.driven - low.driving
    assert (sun, ring) == (24, 66)
    assert (ring - sun) % 2 == 0
    assert (sun + ring) % 5 == 0


def test_wheels_on_one_pair_of_shafts_fit_one_centre_distance() -> None:
    """Sums of teeth within 6 % of their mean: modules and helix angles make up for the rest."""
    sums = [
        mesh.driving + mesh.driven
        for mesh in (
            *(SHEET.split_mesh(split) for split in Split),
            *(SHEET.main_mesh(gear) for gear in MAIN_GEARS),
        )
    ]
    mean = sum(sums) / len(sums)
    assert all(abs(each / mean - 1) < 0.06 for each in sums)


@pytest.mark.parametrize("name", SHEET_NAMES)
def test_derived_figures_are_those_worked_out_by_hand(name: str) -> None:
    sheet = load_sheet(name)
    figures = sheet_figures(sheet)
    ratios = [one.ratio for one in figures.gears]
    assert ratios == sorted(ratios, reverse=True)
    assert figures.gears[0].step is None
    steps = [one.step or 1.0 for one in figures.gears]
    assert math.prod(steps) == pytest.approx(figures.spread)
    assert math.degrees(figures.gap_rad) == pytest.approx(1.5)
    assert figures.gap_m == pytest.approx(2 * math.pi * 0.075 / 48 / 5)
    # 1.5 degrees in 10 ms are 150 degrees a second, 25 turns a minute.
    assert figures.to_json()["delay_slip_rpm"] == pytest.approx(25.0)


def test_the_inertia_and_the_braking_of_the_truck_box_in_high_split() -> None:
    """J = 0.24 + 0.11 (37/35)^2; 100 Nm on it."""
    inertia = 0.24 + 0.11 * (37 / 35) ** 2
    figures = sheet_figures(SHEET)
    assert figures.inertia_kgm2[1] == pytest.approx(inertia)
    assert figures.to_json()["braking_rpm_s"]["high"] == pytest.approx(
        100 / inertia * 60 / (2 * math.pi)
    )


def test_the_step_within_a_splitter_pair_is_that_of_its_wheels() -> None:
    step = Fraction(35, 37) / Fraction(33, 43)
    figures = {one.gear.name: one for one in sheet_figures(SHEET).gears}
    for name in ("C2", "2", "4", "6", "8", "10", "12"):
        assert figures[name].step == pytest.approx(float(step))
