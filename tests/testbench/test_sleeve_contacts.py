"""What a sleeve's position samples say of its first contact."""

from __future__ import annotations

import numpy as np
import pytest

from meshpoint.dbc.messages import SleevesMain
from meshpoint.gearbox import MainGear, load_sheet
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN
from meshpoint.logs.sleeve_contacts import SeenContact, SleeveContacts
from meshpoint.units import MM

SHEET = load_sheet("truck12")
FACE_M = SHEET.sleeve.to_contact_m
STEP_M = 0.25 * MM
"""A sleeve's way in a millisecond."""
WRAP_US = 1 << 32
PER_FRAME = 10


def contacts(begin_us: int, stands_ms: int) -> list[SeenContact]:
    """Of a sleeve that leaves neutral, stands at the teeth of second for so long, and goes in."""
    free_m = np.arange(-2.0 * MM, FACE_M, STEP_M).clip(0.0)
    way_m = [*free_m, *[FACE_M] * stands_ms, *np.arange(FACE_M, FACE_M + 3.0 * MM, STEP_M)]
    seen, direction = SleeveContacts(SHEET), SLEEVE_OF_MAIN[MainGear.SECOND].direction
    found = []
    for first in range(0, len(way_m) - PER_FRAME + 1, PER_FRAME):
        newest_first = [direction * m for m in reversed(way_m[first : first + PER_FRAME])]
        time_us = (begin_us + (first + PER_FRAME - 1) * 1000) % WRAP_US
        found += seen.take(
            SleevesMain(sample_time_us=time_us, sleeve_first_second_m=tuple(newest_first))
        )
    return found


@pytest.mark.parametrize("begin_us", [1_000_000, WRAP_US - 25_000, WRAP_US - 45_000])
@pytest.mark.parametrize(("stands_ms", "kind"), [(0, "gap"), (30, "tooth")])
def test_a_sleeve_that_stands_at_the_teeth_has_met_a_tooth_also_as_the_clock_wraps(
    begin_us: int, stands_ms: int, kind: str
) -> None:
    (contact,) = contacts(begin_us, stands_ms)
    assert contact.contact == kind
    assert contact.gear is MainGear.SECOND


@pytest.mark.parametrize("ms", range(15, 40))
def test_a_contact_has_a_time_of_the_sensor_clock_also_as_that_wraps(ms: int) -> None:
    """Its time of 32 bits, wherever between two samples or in a frame the clock begins anew."""
    begin_us = WRAP_US - 1000 * ms - 500
    (there,), (contact,) = contacts(1_000_000, 0), contacts(begin_us, 0)
    assert contact.time_us == (there.time_us - 1_000_000 + begin_us) % WRAP_US
