"""Where the time of a shift goes, from the moments the rig reports; and the bound beside it."""

from __future__ import annotations

import math

import pytest

from meshpoint.dbc.messages import EngagementEvent as E
from meshpoint.dbc.messages import MainGear, ReferenceEngagement
from meshpoint.gearbox import load_sheet
from meshpoint.results.kinematic_bound import kinematic_bound_ms
from meshpoint.results.shift_parts import DURING, closing_since_us, parts_of

TRUCK12 = load_sheet("truck12")
MAIN_RAD_S = 1400.0 * math.pi / 30.0 * TRUCK12.main_mesh(MainGear.FIRST).ratio
WRAP_US = 1 << 32
UP = (
    (E.CLUTCH_OPENS, 10.0), (E.PLATES_PARTED, 75.0), (E.RELEASED, 130.0), (E.BRAKE_FILLS, 150.0),
    (E.BRAKE_EMPTIES, 300.0), (E.GAP_CONTACT, 340.0), (E.LOCKED, 352.0),
)  # fmt: skip


def reported(moments: tuple[tuple[E, float], ...], start_us: int = 0) -> list[ReferenceEngagement]:
    return [
        ReferenceEngagement((start_us + round(1000 * at_ms)) % WRAP_US, event)
        for event, at_ms in moments
    ]


def phases(moments: tuple[tuple[E, float], ...], end_ms: float, start_us: int = 0) -> dict:
    found = parts_of(
        reported(moments, start_us), start_us, (start_us + round(1e3 * end_ms)) % WRAP_US
    )
    return {name: value for name, value in vars(found).items() if value is not None}


@pytest.mark.parametrize("start_us", [0, WRAP_US - 200_000], ids=["early", "over the wrap"])
def test_an_upshift_and_its_sum(start_us: int) -> None:
    found = phases(UP, 368.0, start_us)
    assert found == {
        "ramp_ms": 10.0, "parting_ms": 65.0, "pull_out_ms": 55.0, "brake_on_ms": 20.0,
        "braking_ms": 150.0, "release_ms": 40.0, "entry_ms": 12.0, "seen_ms": 16.0,
    }  # fmt: skip
    assert sum(found[name] for name in DURING if name in found) == pytest.approx(368.0)


def test_what_came_before_the_request_does_not_count() -> None:
    assert phases(((E.PLATES_PARTED, -50.0), (E.BRAKE_FILLS, -20.0), *UP), 368.0) == phases(
        UP, 368.0
    )


def test_a_downshift_raises_and_has_no_brake() -> None:
    moments = (
        (E.CLUTCH_OPENS, 5.0), (E.PLATES_PARTED, 70.0), (E.RELEASED, 110.0),
        (E.CLUTCH_CLOSES, 130.0), (E.PLATES_MET, 200.0), (E.CLUTCH_OPENS, 900.0),
        (E.PLATES_PARTED, 965.0), (E.TOOTH_CONTACT, 1100.0), (E.LOCKED, 1130.0),
    )  # fmt: skip
    found = phases(moments, 1140.0)
    assert found["raising_ms"] == 855.0
    assert found["release_ms"] == 135.0
    assert "braking_ms" not in found
    assert sum(found.values()) == 1140.0


def test_a_release_that_is_heard_after_the_contact_leaves_no_time_between() -> None:
    late = tuple((e, 345.0 if e is E.BRAKE_EMPTIES else at) for e, at in UP)
    found = phases(late, 368.0)
    assert found["release_ms"] == 0.0
    assert sum(found.values()) == 368.0


def test_a_lock_that_is_heard_after_the_end_is_not_of_the_shift() -> None:
    """The sleeve is measured in before the tooth has met a flank."""
    found = phases(UP, 348.0)
    assert "entry_ms" not in found
    assert found["seen_ms"] == 8.0
    assert sum(found.values()) == pytest.approx(348.0)


def test_a_shift_without_any_moment_is_all_waiting() -> None:
    assert phases((), 500.0) == {"seen_ms": 500.0}


def test_the_clutch_closes_from_the_lock_on_or_from_the_end() -> None:
    assert closing_since_us(reported(UP), 368_000) == 352_000
    assert closing_since_us([], 368_000) == 368_000


def test_the_bound_is_parting_braking_and_entry() -> None:
    """Without drag it is the momentum over the torque: 100 Nm on 1.0 and 0.39 of 1400 rpm."""
    built = {
        "sheet": {"friction_factor": 0.0},
        "drag": {"constant_nm": 0.0},
        "clutch": {"kiss": 0.35},
        "air": {"supply_offset_bar": 0.0},
    }
    old = MAIN_RAD_S / TRUCK12.main_mesh(MainGear.FIRST).ratio
    new = MAIN_RAD_S / TRUCK12.main_mesh(MainGear.SECOND).ratio
    inertia = 0.24 + 0.11 * (37 / 35) ** 2
    braking_ms = 1e3 * inertia * (old - new) / 100.0
    found = kinematic_bound_ms(TRUCK12, built, (8, 10), MAIN_RAD_S)
    assert found == pytest.approx(65.0 + braking_ms + 7.0 / 0.4, rel=1e-9)
    dragged = kinematic_bound_ms(
        TRUCK12, built | {"drag": {"constant_nm": 25.0}}, (8, 10), MAIN_RAD_S
    )
    assert dragged == pytest.approx(65.0 + braking_ms / 1.25 + 17.5, rel=1e-9)


@pytest.mark.parametrize(("gears", "main_rad_s"), [((10, 8), MAIN_RAD_S), ((7, 8), MAIN_RAD_S)])
def test_no_bound_where_the_brake_does_not_do_it(gears: tuple[int, int], main_rad_s: float) -> None:
    assert kinematic_bound_ms(TRUCK12, {}, gears, main_rad_s) is None
