"""When the valve that pulls the old gear out is sent: against the closed form of a clutch that
opens evenly."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from shift_box import SHEET, Box

from meshpoint.controller.measure.gearbox_view import ClutchTrack
from meshpoint.controller.settings.valve_name import ValveName

TRAVEL_US = 100_000
SET_OFF_US = 1_000_000
VALVE_US, OUT_US = 12_000, 12_000 + 12_500
"""From the current until the sleeve moves; until its teeth are out at the sheet's 0.4 m/s over
7 mm, less the 5 ms by which a stroke may be early."""
SENSED = 0.005


def opening(now_us: int) -> ClutchTrack:
    """A clutch that has opened evenly since it set off, sampled each 10 ms until now."""
    track = ClutchTrack()
    for time_us in range(SET_OFF_US, now_us + 1, 10_000):
        track.take(time_us, 1.0 - (time_us - SET_OFF_US) / TRAVEL_US)
    return track


def sent_us(now_us: int, earliest_us: int) -> Any:
    snapshot: Any = SimpleNamespace(
        view=SimpleNamespace(clutch=opening(now_us)), earliest_us=earliest_us
    )
    return Box().sequence.unloaded_us(snapshot, ValveName.MAIN_CRAWL)


def test_a_gear_is_pulled_as_the_plates_part_and_is_out_no_sooner_than_they_surely_have() -> None:
    """(1 - share) of the travel after the clutch set off, less what the sleeve takes: likely parted
    at 32.5 % for its first movement, surely at 30 % less the sensor's error for its teeth."""
    clutch = SHEET.clutch
    likely_us = SET_OFF_US + TRAVEL_US * (1.0 - clutch.likely_open_share) - VALVE_US
    surely_us = SET_OFF_US + TRAVEL_US * (1.0 - clutch.surely_open_share + SENSED) - OUT_US
    assert (clutch.likely_open_share, clutch.surely_open_share) == pytest.approx((0.325, 0.3))
    found_us = sent_us(SET_OFF_US + 40_000, SET_OFF_US + 44_000)
    assert found_us == pytest.approx(max(likely_us, surely_us), abs=1.0)
    assert found_us == pytest.approx(SET_OFF_US + 55_500, abs=1.0)


def test_it_is_sent_at_once_where_the_plates_have_parted_already() -> None:
    assert sent_us(SET_OFF_US + 90_000, SET_OFF_US + 94_000) == SET_OFF_US + 94_000


def test_nothing_is_sent_while_the_clutch_does_not_open() -> None:
    assert sent_us(SET_OFF_US, SET_OFF_US + 4_000) is None
