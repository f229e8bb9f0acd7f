"""What contacts tell of the time from a sleeve's valve to its contact."""

from __future__ import annotations

import math

import numpy as np
import pytest

from meshpoint.controller.planning.sleeve_delay import (
    FAR_S,
    PRESSURE_EXPONENT,
    PRIOR_SAMPLES,
    SleeveDelays,
)
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS

SHEET = load_sheet("truck12")
SHEET_US = 1e6 * SHEET.sleeve.delay_s
VALVE_US = 1e6 * SHEET.sleeve.valve_delay_s


def test_a_contact_moves_the_delay_by_its_weight_beside_the_sheet() -> None:
    """Only its own gear's; of the others the data sheet goes on to be believed."""
    delays = SleeveDelays(SHEET)
    delays.learn(MainGear.SECOND, SHEET_US + 4_000.0)
    expected_us = SHEET_US + 4_000.0 / (PRIOR_SAMPLES + 1.0)
    assert delays.delay_us(MainGear.SECOND) == pytest.approx(expected_us, abs=1.0)
    assert delays.delay_us(MainGear.THIRD) == pytest.approx(SHEET_US, abs=1.0)
    assert delays.samples(MainGear.SECOND) == 1
    assert delays.samples(MainGear.THIRD) == 0


def test_a_contact_that_cannot_be_of_this_sleeve_teaches_nothing() -> None:
    delays = SleeveDelays(SHEET)
    delays.learn(MainGear.FIRST, SHEET_US + 1.01e6 * FAR_S)
    assert delays.delay_us(MainGear.FIRST) == pytest.approx(SHEET_US, abs=1.0)
    assert delays.samples(MainGear.FIRST) == 0


def test_less_air_makes_the_way_longer_but_not_the_valve() -> None:
    """What was learned with four fifths of the pressure holds at that, and says of the full one;
    without any air heard of, the sheet's is taken."""
    delays = SleeveDelays(SHEET)
    full_pa = SHEET.air.supply_gauge_pa
    assert delays.supply_pa == full_pa
    delays.supply_pa = 0.8 * full_pa
    slower = 0.8**-PRESSURE_EXPONENT
    assert delays.delay_us(MainGear.SECOND) == pytest.approx(
        VALVE_US + (SHEET_US - VALVE_US) * slower, abs=1.0
    )
    seen_us = VALVE_US + (SHEET_US + 3_000.0 - VALVE_US) * slower
    for _ in range(400):
        delays.learn(MainGear.SECOND, seen_us)
    assert delays.delay_us(MainGear.SECOND) == pytest.approx(seen_us, abs=200.0)
    delays.supply_pa = full_pa
    assert delays.delay_us(MainGear.SECOND) == pytest.approx(SHEET_US + 3_000.0, abs=200.0)


def test_what_was_seen_is_kept_and_nothing_else() -> None:
    delays = SleeveDelays(SHEET)
    for error_us in (1_000.0, 3_000.0, -500.0):
        delays.learn(MainGear.CRAWL, SHEET_US + error_us)
    records = delays.records()
    kept = [gear for gear in MAIN_GEARS if records.of(gear) is not None]
    assert kept == [MainGear.CRAWL]
    another = SleeveDelays(SHEET)
    another.restore(records)
    assert another.delay_us(MainGear.CRAWL) == delays.delay_us(MainGear.CRAWL)
    assert another.delay_sd_s(MainGear.CRAWL) == pytest.approx(delays.delay_sd_s(MainGear.CRAWL))
    assert another.samples(MainGear.CRAWL) == 3


ERRORS_MS = (2.0, -1.0, 3.5, 0.5, -2.5, 1.0)


@pytest.mark.parametrize("count", [0, 1, 2, 6])
def test_contacts_and_the_sheet_make_the_law_of_an_unknown_mean_and_scatter(count: int) -> None:
    """The textbook's normal-gamma law, by the samples' mean and sum of squares: of the mean the
    sheet counts as half a contact, of the scatter, 60 % of its own in one gear, as four."""
    delays, gear, sleeve = SleeveDelays(SHEET), MainGear.SECOND, SHEET.sleeve
    seen_s = sleeve.delay_s + 1e-3 * np.array(ERRORS_MS[:count])
    for each in seen_s:
        delays.learn(gear, 1e6 * each)
    weight, freedom = PRIOR_SAMPLES + count, 4.0 + count
    mean = (PRIOR_SAMPLES * sleeve.delay_s + seen_s.sum()) / weight
    squares = 4.0 * (0.6 * sleeve.delay_sd_s) ** 2
    if count:
        squares += ((seen_s - seen_s.mean()) ** 2).sum()
        squares += PRIOR_SAMPLES * count / weight * (seen_s.mean() - sleeve.delay_s) ** 2
    assert delays.delay_us(gear) == pytest.approx(1e6 * mean, abs=0.51)
    assert delays.delay_sd_s(gear) == pytest.approx(math.sqrt(squares / freedom * (1 + 1 / weight)))
    assert (delays.samples(gear), delays.scatter_samples(gear)) == (count, freedom)


def test_old_contacts_fade_once_they_weigh_as_sixty() -> None:
    """A sleeve that becomes slower is known as such after some tens of contacts."""
    delays, gear = SleeveDelays(SHEET), MainGear.SECOND
    for error_us in [0.0] * 500 + [4_000.0] * 120:
        delays.learn(gear, SHEET_US + error_us)
    left = (60.0 / 61.0) ** 120
    assert delays.delay_us(gear) == pytest.approx(SHEET_US + 4_000.0 * (1.0 - left), abs=1.0)
