"""What measurements at a gear in mesh show of its phase, one way after the other: where its tooth
was carried, how it moved, where drag holds it, how far it floated."""

from __future__ import annotations

import math

import pytest
from test_reference import HALF_GAP, PITCH, SHEET, TEETH, Gearbox

from meshpoint.controller.phase.reference import (
    FLOATED_MEASUREMENTS,
    MOST_MEASUREMENTS,
    PULLED_MEASUREMENTS,
    STILL_MEASUREMENTS,
    UNMOVED_MEASUREMENTS,
    PhaseReferences,
)
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import MainGear
from meshpoint.units import RPM

GEAR = MainGear.SECOND
BOX = Gearbox(*TEETH[GEAR], 0.4, -0.7, 0.2)


def measurement(
    references: PhaseReferences, share: float, pulled: bool = False, tooth: int = 3
) -> bool:
    """One measurement of a tooth, at a share of half its gap."""
    return references.watch(GEAR, BOX.layshaft_at_phase(share * HALF_GAP, 5.0, tooth), 5.0, pulled)


def off_rad(references: PhaseReferences) -> float:
    """The error of the learned phase."""
    error = references.phase_rad(GEAR, 1.0, 2.0) - BOX.phase(1.0, 2.0)
    return abs(math.remainder(error, PITCH))


def locked(slip: float, straight: bool = True) -> PhaseReferences:
    references = PhaseReferences(SHEET)
    references.locked(GEAR, slip, straight)
    return references


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("slip_rpm", "learned"), [(1.8, False), (2.0, True), (8.0, True)])
def test_from_2_rpm_on_the_slip_tells_the_flank(
    sign: float, slip_rpm: float, learned: bool
) -> None:
    references = locked(sign * slip_rpm * RPM)
    measurements = [measurement(references, sign) for _ in range(UNMOVED_MEASUREMENTS + 5)]
    assert references.known(GEAR) is learned
    if learned:
        assert measurements.index(True) == UNMOVED_MEASUREMENTS - 1
        assert off_rad(references) < 1e-9
        assert references.source(GEAR) is ReferenceSource.MEASURED
    else:
        assert references.source(GEAR) is ReferenceSource.NONE


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_sleeve_that_rubbed_on_a_tooth_may_have_left_the_flank_it_was_carried_to(
    sign: float,
) -> None:
    """In a gearbox where a tooth has been seen not to move it has not."""
    references = locked(sign, straight=False)
    assert not any(measurement(references, sign) for _ in range(UNMOVED_MEASUREMENTS + 5))
    references = locked(sign)
    assert any(measurement(references, sign) for _ in range(UNMOVED_MEASUREMENTS + 5))
    references.lose_all()
    references.locked(GEAR, sign, straight=False)
    assert any(measurement(references, sign) for _ in range(UNMOVED_MEASUREMENTS + 5))


@pytest.mark.parametrize("flank", [-1.0, 1.0])
def test_a_tooth_that_crosses_its_gap_lies_where_it_went_after_some_still_measurements(
    flank: float,
) -> None:
    references = locked(flank)
    for share in (-1.0, -1.0, -1.0, 0.0):
        assert not measurement(references, flank * share)
    measurements = [measurement(references, flank) for _ in range(STILL_MEASUREMENTS)]
    assert measurements == [False] * (STILL_MEASUREMENTS - 1) + [True]
    assert off_rad(references) < 1e-9


def test_measurements_are_of_one_tooth_whichever_tooth_is_counted() -> None:
    """Whole pitches more or less are the same place in the gap."""
    references = locked(1.0)
    for k, share in enumerate((-1.0, -1.0, -1.0, 0.0, *[1.0] * STILL_MEASUREMENTS)):
        measurement(references, share, tooth=3 + 5 * k)
    assert references.known(GEAR)
    assert off_rad(references) < 1e-9


def test_drag_alone_holds_a_tooth_low_once_teeth_are_known_to_move() -> None:
    references = locked(1.0)
    for share in (-1.0, -1.0, -1.0, 0.0, *[1.0] * STILL_MEASUREMENTS):
        measurement(references, share)
    references.lose_all()
    references.locked(GEAR, 0.0)
    measurements = [measurement(references, -1.0, pulled=True) for _ in range(PULLED_MEASUREMENTS)]
    assert measurements == [False] * (PULLED_MEASUREMENTS - 1) + [True]
    assert off_rad(references) < 1e-9
    references.lose_all()
    references.locked(GEAR, 0.0)
    for k in range(3 * PULLED_MEASUREMENTS):
        assert not measurement(references, -1.0, pulled=k % PULLED_MEASUREMENTS != 0), (
            "it was held no longer"
        )


@pytest.mark.parametrize("together", [FLOATED_MEASUREMENTS - 1, FLOATED_MEASUREMENTS])
def test_a_floating_tooth_tells_its_gap_by_where_it_is_seen_some_times_in_a_row(
    together: int,
) -> None:
    """An impact disturbs single measurements."""
    references = locked(0.0, straight=False)
    for _ in range(5):
        for share in [-1.0] * together + [1.0] * together:
            measurement(references, share)
    references.released()
    assert references.known(GEAR) is (together == FLOATED_MEASUREMENTS)
    if references.known(GEAR):
        assert off_rad(references) < 1e-9


def test_what_floated_is_reported_as_the_places_it_was_seen_at() -> None:
    references = locked(0.0, straight=False)
    for share in [-0.4] * 3 + [0.5] * 3:
        measurement(references, share)
    floated = references.released()
    assert floated is not None
    assert floated.gear is GEAR
    width = floated.high_rad - floated.low_rad
    assert width == pytest.approx(0.9 * HALF_GAP)
    assert references.released() is None, "it is reported once"


def test_a_gear_is_looked_at_for_a_while_and_no_longer() -> None:
    references = locked(0.0)
    assert references.watches(GEAR)
    assert not references.watches(MainGear.THIRD)
    for k in range(MOST_MEASUREMENTS):
        assert references.watches(GEAR)
        measurement(references, 0.3 * math.sin(k))
    assert not references.watches(GEAR)


def test_a_constant_that_was_found_without_the_gear_in_mesh_is_kept_with_its_source() -> None:
    references = PhaseReferences(SHEET)
    references.adopt(GEAR, 0.02, ReferenceSource.RESTORED)
    assert references.known(GEAR)
    assert references.source(GEAR) is ReferenceSource.RESTORED
    assert references.offsets_rad == {GEAR: 0.02}
    references.lose(GEAR)
    assert not references.known(GEAR)
    assert references.source(GEAR) is ReferenceSource.NONE
    references.adopt(GEAR, 0.02, ReferenceSource.RESTORED)
    references.locked(GEAR, 1.0)
    for share in (-1.0, -1.0, -1.0, 0.0, *[1.0] * STILL_MEASUREMENTS):
        measurement(references, share)
    assert references.source(GEAR) is ReferenceSource.MEASURED
    assert off_rad(references) < 1e-9
