"""What a board says of its analogue inputs was so at the time that it gives."""

from __future__ import annotations

from typing import Any

import pytest
from timed_board import sent, timed_board

from meshpoint.dbc.messages import GearboxSensors, SleevesAux, SleevesMain
from meshpoint.firmware.cortex_m4.emulated_board import (
    HIGHEST,
    LOWEST,
    SLEEVES,
    SLOW,
    EmulatedBoard,
)

RAMP_US = 80_000
"""All inputs go through their range in this time: a sleeve at 0.5 m/s."""
STEP_US, READ_BY_US = 2, 24_000
SLEEVE_WITHIN_US = 30
SLOW_WITHIN_US = 150
SAMPLE_US = 1_000
STROKE_M, BAR_10_PA, DEGREES_260_K = 0.04, 1e6, 260.0


@pytest.fixture(scope="module")
def read() -> dict[str, Any]:
    """The last read on a ramp that began at 0 us, by the names of its messages."""
    board = timed_board()
    sent(board)
    found: dict[str, Any] = {}
    for _ in range(READ_BY_US // STEP_US):
        follow(board)
        found |= {type(each).__name__: each for each in sent(board)}
    return found


def follow(board: EmulatedBoard) -> None:
    """The inputs as they are now, for a step."""
    share = board.sensor_us / RAMP_US
    for pin in (*SLEEVES, *SLOW):
        board.voltages[pin] = round(LOWEST + share * (HIGHEST - LOWEST))
    board.advance(STEP_US)


def us(share: float) -> float:
    """When the ramp was there."""
    return share * RAMP_US


def test_each_sample_of_a_sleeve_is_that_of_its_time(read: dict[str, Any]) -> None:
    main: SleevesMain = read["SleevesMain"]
    aux: SleevesAux = read["SleevesAux"]
    for message, sleeves in (
        (main, (main.sleeve_first_second_m, main.sleeve_crawl_third_m)),
        (aux, (aux.sleeve_splitter_m, aux.sleeve_range_m)),
    ):
        for positions_m in sleeves:
            for age, position_m in enumerate(positions_m):
                sampled_us = us((position_m + STROKE_M / 2) / STROKE_M)
                stamped_us = message.sample_time_us - age * SAMPLE_US
                assert abs(sampled_us - stamped_us) < SLEEVE_WITHIN_US


def test_edges_are_read_as_the_sleeves_are(read: dict[str, Any]) -> None:
    """A receiver takes both for one read."""
    times = {read[name].read_time_us for name in read if name.startswith("Edges")}
    assert times == {read["SleevesMain"].sample_time_us} == {read["SleevesAux"].sample_time_us}


def test_pressures_oil_and_clutch_are_hardly_older_than_they_say(read: dict[str, Any]) -> None:
    sensors: GearboxSensors = read["GearboxSensors"]
    shares = {
        "brake": sensors.brake_pressure_pa / BAR_10_PA,
        "supply": sensors.supply_pressure_pa / BAR_10_PA,
        "oil": (sensors.oil_temperature_k - 213.15) / DEGREES_260_K,
        "clutch": sensors.clutch_position_fraction,
    }
    ages_us = {name: sensors.sample_time_us - us(share) for name, share in shares.items()}
    assert all(0 < age_us < SLOW_WITHIN_US for age_us in ages_us.values()), ages_us
