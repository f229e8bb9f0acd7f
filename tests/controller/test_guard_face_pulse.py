"""Row 5 where a sleeve stands on a tooth: a pulse of the brake may move the tooth on. Second gear
of `truck12`, whose longest pulse is 32.4 ms."""

from __future__ import annotations

import dataclasses
import math

import pytest
from guard_cases import LIMITS, SETTINGS, SHEET, place, ready
from guard_sleeve_cases import (
    BRAKE,
    CRAWL,
    FIRST,
    OFF_AT,
    ON_AT,
    ON_NOW,
    SECOND,
    THIRD,
    Order,
    at,
    row,
)

from meshpoint.controller.guard.limits import (
    BRAKE_PRESSED_PA,
    CLEAR_M,
    LEAVING_M_S,
    SLIP_MARGIN_RAD_S,
    GuardLimits,
    guard_limits,
)
from meshpoint.controller.guard.rules import Guard
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.units import RPM

FACE_MM = 5.0
PRESSED: dict[int, Order] = {SECOND: (ON_NOW, 0.0)}
PULSED = PRESSED | {BRAKE: (ON_AT, 74.0)}


def standing(ms: float, way_mm: float = FACE_MM, **other: float) -> GuardInputs:
    """The sleeve has met a tooth, and its gear turns with it."""
    return at(ms, way_mm, **({"slip_rpm": 0.0} | other))


def on_a_tooth(limits: GuardLimits = LIMITS) -> Guard:
    """Second gear fired from neutral; at 60 ms its sleeve stands on a tooth."""
    guard = ready(limits)
    for ms, orders in ((0.0, {SECOND: (ON_AT, 4.0)}), (10.0, {SECOND: (ON_AT, 4.0)})):
        assert row(guard, at(ms), orders) is None
    assert row(guard, standing(60.0), PRESSED) is None
    return guard


def pulse(guard: Guard, lasts_ms: float, seen: GuardInputs | None = None) -> int | None:
    """On from 74 ms, and its end commanded as it begins."""
    assert row(guard, standing(70.0), PULSED) is None
    ends = PRESSED | {BRAKE: (OFF_AT, 74.0 + lasts_ms)}
    return row(guard, standing(74.0) if seen is None else seen, ends)


def test_a_tooth_that_stands_on_a_tooth_may_be_moved_on_by_a_pulse() -> None:
    guard = on_a_tooth()
    assert pulse(guard, 25.0) is None
    ends = PRESSED | {BRAKE: (OFF_AT, 99.0)}
    # Once the air is in, the gear turns.
    for ms, slip_rpm in ((80.0, 0.0), (90.0, -12.0), (98.0, -30.0)):
        assert row(guard, standing(ms, slip_rpm=slip_rpm), ends) is None


def test_no_pulse_is_longer_than_what_leaves_the_slip_in_its_window() -> None:
    assert pulse(on_a_tooth(), 32.39) is None
    assert pulse(on_a_tooth(), 32.41) == 5
    whole = dataclasses.replace(LIMITS, face_pulse_us={SECOND: 32_000.0})
    assert pulse(on_a_tooth(whole), 32.0) is None
    assert pulse(on_a_tooth(whole), 32.001) == 5


def test_the_gear_may_turn_once_the_quickest_valve_may_have_let_air_in() -> None:
    """That takes 10.2 ms: a gear that turns earlier is turned by something else."""
    for ms, forbidden in ((84.2, 5), (84.201, None)):
        guard = on_a_tooth()
        assert pulse(guard, 25.0) is None
        ends = PRESSED | {BRAKE: (OFF_AT, 99.0)}
        assert row(guard, standing(ms, slip_rpm=-12.0), ends) == forbidden


def test_a_pulse_without_an_end_is_judged_as_if_the_next_command_ended_it() -> None:
    """15 ms from now on: no later than 17.4 ms after it began."""
    for ms, forbidden in ((91.3, None), (91.5, 5)):
        guard = on_a_tooth()
        assert row(guard, standing(70.0), PULSED) is None
        assert row(guard, standing(ms), PULSED) == forbidden


@pytest.mark.parametrize(
    ("seen", "forbidden"),
    [
        (standing(70.0, 4.51), None),
        (standing(70.0, 5.49), None),
        (standing(70.0, 5.51), 5),  # its teeth are past the faces
        (standing(70.0, 4.49), 5),  # it is on its way still
        (standing(70.0, slip_rpm=9.5), None),
        (standing(70.0, slip_rpm=9.6), 5),  # it does not stand
        (standing(70.0, slip_rpm=-9.6), 5),
        (standing(70.0, speed_m_s=0.049), None),
        (standing(70.0, speed_m_s=LEAVING_M_S), 5),
        (standing(70.0, speed_m_s=0.051), 5),
        (standing(70.0)._replace(brake_pa=LIMITS.atmosphere_pa + 0.99e5), None),
        (standing(70.0)._replace(brake_pa=LIMITS.atmosphere_pa + 1.01e5), 5),
        (standing(70.0)._replace(clutch_closed=0.31), 5),  # the plates touch
        (place(standing(70.0), 1, 0.012), 2),  # the other sleeve is in a gear
    ],
)
def test_where_a_pulse_may_begin(seen: GuardInputs, forbidden: int | None) -> None:
    assert row(on_a_tooth(), seen, PULSED) == forbidden


def test_where_a_pulse_may_begin_exactly() -> None:
    seen = standing(70.0)
    before, layshaft, main, after = seen.speeds
    assert layshaft is not None
    assert main is not None
    gear_rad_s = LIMITS.main[SECOND].ratio * layshaft.omega_rad_s
    slower = main._replace(omega_rad_s=gear_rad_s - SLIP_MARGIN_RAD_S)
    assert gear_rad_s - slower.omega_rad_s == SLIP_MARGIN_RAD_S
    turning = seen._replace(speeds=(before, layshaft, slower, after))
    assert row(on_a_tooth(), turning, PULSED) is None

    air = dataclasses.replace(LIMITS, atmosphere_pa=1.0e5)
    pressed = seen._replace(brake_pa=air.atmosphere_pa + BRAKE_PRESSED_PA)
    assert row(on_a_tooth(air), pressed, PULSED) is None


def test_the_faces_are_as_wide_as_a_sleeve_is_clear_of_teeth() -> None:
    """Teeth 1 mm from neutral: half of that is the least way at which one may stand."""
    near = dataclasses.replace(LIMITS, contact_m=2.0 * CLEAR_M)
    for way_m, forbidden in ((CLEAR_M, None), (CLEAR_M - 1e-9, 5)):
        guard = on_a_tooth(near)
        assert row(guard, place(standing(70.0), 0, way_m), PULSED) == forbidden


def test_a_second_pulse_waits_until_the_air_of_the_first_would_show() -> None:
    """A pulse that has just ended shows no pressure yet. 13.8 ms of the valve's greatest delay and
    a time constant later it does, and is above 1 bar if it is."""
    for ms, forbidden in ((152.8, 5), (152.801, None)):
        for again in ((ON_AT, ms + 4.0), (ON_NOW, 0.0)):
            guard = on_a_tooth()
            assert pulse(guard, 20.0) is None
            assert row(guard, standing(96.0), PRESSED) is None
            assert row(guard, standing(ms), PRESSED | {BRAKE: again}) == forbidden


@pytest.mark.parametrize("shaft", [1, 2])
def test_a_pulse_begins_on_known_speeds_alone(shaft: int) -> None:
    """At the faces' far end, where row 4 takes the sleeve to be in its gear."""
    seen = standing(70.0, 5.2)
    assert row(on_a_tooth(), seen, PULSED) is None
    speeds = tuple(None if k == shaft else each for k, each in enumerate(seen.speeds))
    unknown = seen._replace(speeds=speeds)  # type: ignore[arg-type]
    assert row(on_a_tooth(), unknown, PULSED) == 5


def test_a_sleeve_that_no_valve_presses_stands_on_no_tooth() -> None:
    assert row(on_a_tooth(), standing(70.0), {BRAKE: (ON_AT, 74.0)}) == 5


def test_the_brake_is_off_once_the_sleeve_is_past_the_faces() -> None:
    guard = on_a_tooth()
    ends = PRESSED | {BRAKE: (OFF_AT, 99.0)}
    assert pulse(guard, 25.0) is None
    assert row(guard, standing(90.0, 5.6), ends) == 5
    guard = on_a_tooth()
    assert pulse(guard, 25.0) is None
    assert row(guard, standing(90.0, 5.6), PRESSED) is None


def test_the_longest_pulses_are_as_worked_out_by_hand() -> None:
    """Third: (6.28 + 1)^2 - 1 rad2/s2 over the 6 degrees of a face are 249 rad/s2. The full brake
    takes 140 Nm / 0.363 kgm2 x 37/35 = 408 rad/s2, so it may have 61 % of its pressure, of which
    1 bar may be left from before. At 0.8 x 45 ms that takes 29.3 ms, less 3.6 ms of the valve's
    scatter. The other gears may have so much that the 36 ms are the less."""
    share = ((60.0 * RPM + 1.0) ** 2 - 1.0) / (2.0 * math.radians(6.0))
    share /= 140.0 / 0.362930612244898 * 37.0 / 35.0
    third_us = 36_000.0 * math.log((1.0 - 1.0 / 8.5) / (1.0 - share)) - 3_600.0
    others_us = 36_000.0 - 3_600.0
    by_hand = {FIRST: others_us, SECOND: others_us, CRAWL: others_us, THIRD: third_us}
    assert guard_limits(SHEET, SETTINGS).face_pulse_us == pytest.approx(by_hand)


@pytest.mark.parametrize(
    ("time_constant_s", "max_torque_nm"),
    [
        (0.004, 100.0),  # filled after 3.2 ms, within the 3.6 ms of the valve's scatter
        (0.045, 1000.0),  # 6 % of its pressure is all it may have, and 1 of 8.5 bar may be left
    ],
)
def test_a_brake_that_is_too_quick_or_too_strong_moves_no_tooth_on(
    time_constant_s: float, max_torque_nm: float
) -> None:
    brake = dataclasses.replace(
        SHEET.brake, time_constant_s=time_constant_s, max_torque_nm=max_torque_nm
    )
    limits = guard_limits(dataclasses.replace(SHEET, brake=brake), SETTINGS)
    assert limits.face_pulse_us[THIRD] == 0.0
