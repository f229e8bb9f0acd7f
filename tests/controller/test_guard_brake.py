"""Rows 5 and 6 of the guard: when the brake may be on, and for how long. Each by itself, its limit
from both sides."""

from __future__ import annotations

import pytest
from guard_cases import (
    FOREVER,
    LIMITS,
    NEUTRAL,
    NOW,
    blocked_row,
    braking,
    encoded,
    kept,
    payload,
    place,
    ready,
    speeds,
)

from meshpoint.controller.guard.case import NO_SPANS, Span
from meshpoint.controller.guard.view import GuardInputs
from meshpoint.controller.settings.valve_name import ValveName
from meshpoint.dbc.messages import ValveAction, ValveCommand
from meshpoint.units import RPM


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("sleeve", [0, 1])
def test_row_5_the_brake_with_a_gear_in_mesh(sleeve: int, side: float) -> None:
    """A sleeve that stands before the teeth, at 5 mm, touches none."""
    assert blocked_row(place(NEUTRAL, sleeve, side * 4.7e-3), ValveName.BRAKE) is None
    assert blocked_row(place(NEUTRAL, sleeve, side * 4.9e-3), ValveName.BRAKE) == 5


def test_row_5_the_brake_against_the_engine() -> None:
    assert blocked_row(NEUTRAL._replace(clutch_closed=0.30), ValveName.BRAKE) is None
    assert blocked_row(NEUTRAL._replace(clutch_closed=0.31), ValveName.BRAKE) == 5


@pytest.mark.parametrize(
    ("closed", "per_s", "row"),
    [
        (0.50, -10.0, None),  # 32 ms after the sample, as the air comes in: 0.18
        (0.63, -10.0, 5),  # 0.31
        (0.50, 0.0, 5),
        (0.28, 5.0, 5),  # closing: 0.44
    ],
)
def test_row_5_the_clutch_as_it_will_be_when_the_air_comes_in(
    closed: float, per_s: float, row: int | None
) -> None:
    seen = NEUTRAL._replace(clutch_closed=closed, clutch_per_s=per_s, clutch_us=NOW)
    assert blocked_row(seen, ValveName.BRAKE) == row


def leaving(position_mm: float, speed_m_s: float, side: int = 1) -> GuardInputs:
    """The sleeve of first and second on its way out of second (side 1) or first, as of now."""
    seen = place(NEUTRAL, 0, side * position_mm * 1e-3)
    return seen._replace(
        positions_us=NOW, speeds_m_s=(speed := -side * speed_m_s, 0.0), means_m_s=(speed, 0.0)
    )


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(
    ("position_mm", "speed_m_s", "on_us", "row"),
    [
        (10.3, 0.25, 5_000, None),  # clear of the teeth 13 ms on; air comes in 17 ms on
        (10.3, 0.25, 0, 5),  # 12 ms on
        (10.3, 0.0, 5_000, 5),
        (10.3, -0.25, 5_000, 5),  # on its way back in
        (11.8, 0.04, 5_000, 5),  # too slow to tell from noise
        (4.4, 0.5, 0, None),  # clear already
        (4.6, 0.0, 0, None),  # it stands, apart from the teeth
        (4.6, -0.06, 0, 5),  # it goes back in
        (4.9, 0.0, 0, 5),
    ],
)
def test_row_5_a_gear_on_its_way_out_by_the_time_the_air_comes_in(
    side: int, position_mm: float, speed_m_s: float, on_us: int, row: int | None
) -> None:
    pull = ValveName.MAIN_FIRST if side > 0 else ValveName.MAIN_SECOND
    guard, seen = ready(), leaving(position_mm, speed_m_s, side)
    assert guard.passes(payload(pull, at_us=NOW - 20_000), place(NEUTRAL, 0, side * 0.012))
    both = payload(pull, ValveName.BRAKE, at_us=NOW + on_us)
    guard.passes(both, seen)
    assert guard.blocked_row == row


def test_row_5_a_gear_that_no_valve_pulls_is_out_only_where_it_is_measured_to_be() -> None:
    """Its pulse is over, and it runs on: 4.4 mm is clear of the teeth, 4.6 mm is not yet."""
    assert blocked_row(leaving(4.6, 0.5), ValveName.BRAKE) == 5
    assert blocked_row(leaving(4.4, 0.5), ValveName.BRAKE) is None


@pytest.mark.parametrize(
    ("out_m_s", "row"), [(0.05, None), (0.0, None), (-0.049, None), (-0.05, 5)]
)
def test_row_5_a_sleeve_that_has_just_come_to_stand_clear_of_the_teeth(
    out_m_s: float, row: int | None
) -> None:
    """Its pulse fell short. By its mean speed it still moves; back to the teeth it must not."""
    seen = leaving(4.4, out_m_s)._replace(means_m_s=(-0.3, 0.0))
    assert blocked_row(seen, ValveName.BRAKE) == row


def test_row_5_the_brake_while_a_gear_is_being_engaged() -> None:
    assert blocked_row(NEUTRAL, ValveName.BRAKE, ValveName.MAIN_SECOND) == 5


def test_row_5_a_release_still_to_come_counts_as_driven_until_then() -> None:
    """The sleeve meets its gear 40 ms after its activation at the earliest."""
    contact_us = NOW + 30_000 + 40_000
    for until_us, row in ((contact_us - 1, None), (contact_us + 1, 5)):
        guard, command = braking(until_us)
        guard.passes(encoded(command), NEUTRAL)
        assert guard.blocked_row == row
    guard, _ = braking(0)
    release_in_gear = ValveCommand(
        brake_action=ValveAction.OFF_AT, brake_time_us=(NOW + 10_000) & 0xFFFF_FFFF
    )
    guard.passes(encoded(release_in_gear), place(NEUTRAL, 0, 0.012))
    assert guard.blocked_row == 5


def test_row_6_the_brake_for_too_long() -> None:
    guard, on = ready(), payload(ValveName.BRAKE, how=ValveAction.ON_NOW)
    assert guard.passes(on, NEUTRAL)
    limit_us = LIMITS.brake_on_us
    for later_us, row in ((limit_us, None), (limit_us + 1, 6)):
        later = NEUTRAL._replace(
            now_us=NOW + later_us,
            speeds=tuple(s._replace(time_us=NOW + later_us) for s in speeds(1400)),
        )
        guard.passes(on, later)
        assert guard.blocked_row == row


def test_row_6_the_brake_for_too_much_energy() -> None:
    """15 kJ: 100 Nm at 2,000 rpm for 716 ms; a pause begins anew."""
    hot = NEUTRAL._replace(brake_pa=1.013e5 + 8.5e5)
    power_w = 100.0 * 2000.0 * RPM
    for energy_j, row in ((14_900.0, None), (15_100.0, 6)):
        guard, on = ready(), payload(ValveName.BRAKE, how=ValveAction.ON_NOW)
        duration_us = round(energy_j / power_w * 1e6)
        for now_us in (NOW, NOW + duration_us):
            turning = tuple(s._replace(time_us=now_us) for s in speeds(2000))
            guard.passes(on, hot._replace(now_us=now_us, speeds=turning))
        assert guard.blocked_row == row
        again = hot._replace(now_us=NOW + duration_us, brake_pa=1.013e5, speeds=turning)
        for _ in range(2):
            assert guard.passes(payload(), again)
        assert guard.passes(on, again)


def test_row_6_the_brake_at_too_low_a_speed() -> None:
    """100 rpm, and the 302 that the brake could take before it is off; never on a lost speed."""
    for layshaft_rpm, row in ((410.0, None), (395.0, 6)):
        guard = ready()
        kept(guard).spans = (Span(NOW - 200_000, FOREVER), *NO_SPANS[1:])
        seen = NEUTRAL._replace(speeds=speeds(layshaft_rpm))
        guard.passes(payload(ValveName.BRAKE), seen)
        assert guard.blocked_row == row
    at_rest = NEUTRAL._replace(speeds=speeds(105.0))
    assert blocked_row(at_rest, ValveName.BRAKE, at_us=NOW + 90_000) is None
    assert (
        blocked_row(at_rest._replace(speeds=speeds(95.0)), ValveName.BRAKE, at_us=NOW + 90_000) == 6
    )
    a, _, c, d = speeds()
    assert blocked_row(NEUTRAL._replace(speeds=(a, None, c, d)), ValveName.BRAKE) == 6
