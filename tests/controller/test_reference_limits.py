"""What measurements at a gear in mesh come to, by hand: phases in backlashes, measurements one by
one."""

from __future__ import annotations

import math

import pytest

from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import MainGear, load_sheet

SHEET = load_sheet("thesis")
GAP, PITCH = SHEET.dog.backlash_rad, SHEET.dog.pitch_rad
GEAR, OTHER = MainGear.SECOND, MainGear.THIRD


def theta(share: float, gear: MainGear = GEAR, pitches: int = 0) -> float:
    """The layshaft's angle at which the raw phase is this many backlashes; the main shaft's is
    0."""
    return (share * GAP + pitches * PITCH) / SHEET.main_mesh(gear).ratio


def locked(slip: float = 0.0, straight: bool = True, gear: MainGear = GEAR) -> PhaseReferences:
    references = PhaseReferences(SHEET)
    references.locked(gear, slip, straight)
    return references


def measurement(
    references: PhaseReferences, *shares: float, gear: MainGear = GEAR, pulled: bool = False,
    pitches: int = 0,
) -> int | None:  # fmt: skip
    """Measurements at these places. Returns at the how many-th a reference was stored."""
    stored = None
    for k, share in enumerate(shares, 1):
        if references.watch(gear, theta(share, gear, pitches), 0.0, pulled):
            assert stored is None, "it is stored once"
            stored = k
    return stored


def offset(references: PhaseReferences, gear: MainGear = GEAR) -> float:
    """The reference in backlashes."""
    return references.offsets_rad[gear] / GAP


CROSSED = (0.0, 0.0, 0.0, 0.5)
"""The begin of a way through the gap, to 1."""


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("way", "stored"), [(0.86, 5), (0.84, 16), (0.31, 16), (0.29, None), (1.24, 5), (1.3, None)]
)
def test_a_tooth_that_went_far_enough_lies_on_the_flank_to_which_it_went(
    side: float, way: float, stored: int | None
) -> None:
    """Beyond 0.85 backlashes it has crossed; beyond 0.3 it may have, and must lie still for longer;
    less says nothing, and what is beyond 1.25 was no measurement of this gap."""
    references = locked()
    assert measurement(references, *[0.0] * 4) is None
    assert measurement(references, *[side * way] * 30) == stored
    if stored is not None:
        assert offset(references) == pytest.approx(side * (way - 0.5))
        assert references.sd_rad(GEAR) == pytest.approx(0.0, abs=1e-12)


def test_a_tooth_that_was_seen_on_both_sides_lies_nowhere() -> None:
    """By at least 0.2 backlashes: else the one side is noise."""
    assert measurement(locked(), *[-0.9] * 3, *[0.21] * 3, *[0.0] * 30) is None
    assert measurement(locked(), *[0.9] * 3, *[-0.21] * 3, *[0.0] * 30) is None
    assert measurement(locked(), *[-0.9] * 3, *[0.19] * 3, *[0.0] * 30) == 11
    assert measurement(locked(), *[0.9] * 3, *[-0.19] * 3, *[0.0] * 30) == 11


@pytest.mark.parametrize(
    ("slip", "flank"), [(1.0, 1), (-1.0, -1), (0.21, 1), (-0.21, -1), (0.19, 0), (-0.19, 0)]
)
def test_a_tooth_that_has_not_moved_for_twenty_looks_lies_where_slip_carried_it(
    slip: float, flank: int
) -> None:
    """From 2 rpm on."""
    references = locked(slip)
    assert measurement(references, *[0.3] * 30) == (20 if flank else None)
    if flank:
        assert offset(references) == pytest.approx(0.3 - flank * 0.5)
    for begin, stored in ((0.19, 20), (0.21, None)):
        references = locked(slip)
        assert measurement(references, *[begin] * 10, *[0.0] * 20) == (stored if flank else None)


def moving(gear: MainGear = OTHER) -> PhaseReferences:
    """A gearbox of which a tooth was seen to cross its gap."""
    references = locked(gear=gear)
    assert measurement(references, *CROSSED, *[1.0] * 5, gear=gear) == 9
    references.released()
    return references


def test_where_teeth_are_known_to_move_slip_tells_nothing_and_drag_does() -> None:
    """After six measurements in a row that drag alone pulls; it lies at the lower flank."""
    references = moving()
    references.locked(GEAR, 1.0)
    assert measurement(references, *[0.0] * 30) is None
    references.locked(GEAR, 1.0)
    assert measurement(references, *[0.7] * 8, pulled=True) == 6
    assert offset(references) == pytest.approx(0.7 + 0.5)
    references.locked(OTHER, 1.0)
    assert measurement(references, *[0.1, 0.2] * 2, *[0.7] * 6, gear=OTHER, pulled=True) == 10
    assert offset(references, OTHER) == pytest.approx(1.2), "of the last six alone"
    fresh = locked(0.0)
    assert measurement(fresh, *[0.7] * 30, pulled=True) is None, (
        "in a box whose teeth have not moved"
    )


def test_a_stay_that_proves_nothing_yet_counts_once_another_tooth_has_stayed() -> None:
    """Both lay unmoved, the first behind a sleeve that had rubbed."""
    references = locked(1.0, straight=False)
    measurement(references, *[0.3] * 20)
    references.released()
    assert not references.known(GEAR)
    references.locked(OTHER, -1.0)
    assert measurement(references, *[0.0] * 20, gear=OTHER) == 20
    assert offset(references) == pytest.approx(0.3 - 0.5)
    assert offset(references, OTHER) == pytest.approx(0.5)


def test_a_likely_reference_is_used_once_and_never_against_a_known_one() -> None:
    references = locked(1.0, straight=False)
    measurement(references, *[0.3] * 20)
    references.released()
    references.adopt(GEAR, 0.01, ReferenceSource.RESTORED)
    references.locked(OTHER, 1.0)
    measurement(references, *[0.0] * 20, gear=OTHER)
    assert references.offsets_rad[GEAR] == 0.01
    references.lose(GEAR)
    references.locked(OTHER, 1.0)
    measurement(references, *[0.0] * 20, gear=OTHER)
    assert not references.known(GEAR), "it was used up"
    assert references.source(OTHER) is ReferenceSource.MEASURED


def floats(references: PhaseReferences, low: float, high: float, pitches: int = 0) -> None:
    """In mesh once, between these places, without ever lying still."""
    references.locked(GEAR, 0.0, straight=False)
    assert measurement(references, *[low] * 3, *[high] * 3, pitches=pitches) is None
    references.released()


@pytest.mark.parametrize(
    ("span", "known"), [(0.79, False), (0.81, True), (1.0, True), (1.09, True), (1.11, False)]
)
def test_a_tooth_that_floated_through_about_a_gap_tells_its_middle(
    span: float, known: bool
) -> None:
    references = PhaseReferences(SHEET)
    floats(references, 0.3, 0.3 + span)
    assert references.known(GEAR) is known
    if known:
        assert offset(references) == pytest.approx(0.3 + span / 2.0)
        assert references.source(GEAR) is ReferenceSource.MEASURED


def test_what_floated_is_reported_once_as_the_places_it_was_seen_at() -> None:
    """Of three looks in a row at least: an impact disturbs single ones."""
    for together, floated in ((3, (-0.2, 0.25)), (2, None)):
        references = locked(straight=False)
        for _ in range(5):
            measurement(references, *[-0.2] * together, *[0.25] * together)
        found = references.released()
        assert (found is None) is (floated is None)
        if found is not None and floated is not None:
            assert found.gear is GEAR
            assert found.high_rad - found.low_rad == pytest.approx(0.45 * GAP)
        assert references.released() is None


def test_a_gear_is_looked_at_for_a_while_and_no_longer() -> None:
    references, looks = locked(), 0
    assert not references.watches(OTHER)
    while references.watches(GEAR):
        measurement(references, 0.15 * math.sin(looks))
        looks += 1
    assert looks == 60


def test_places_too_far_apart_are_all_forgotten() -> None:
    """Another gap's, or wrong ones: what comes after is taken by itself."""
    references = PhaseReferences(SHEET)
    floats(references, 0.0, 0.5)
    floats(references, 1.0, 1.2)
    assert not references.known(GEAR)
    floats(references, 0.9, 1.2)
    assert not references.known(GEAR)
    floats(references, 0.35, 0.6)
    assert offset(references) == pytest.approx(0.775)


@pytest.mark.parametrize(("off", "kept"), [(0.29, True), (-0.29, True), (0.31, False),
                                           (-0.31, False)])  # fmt: skip
def test_a_known_reference_is_put_right_where_it_is_wrong_by_half_a_flank(
    off: float, kept: bool
) -> None:
    """By a third of the gap about, whole pitches aside."""
    for pitches in (0, 4):
        references = PhaseReferences(SHEET)
        adopted = (0.5 + off) * GAP + pitches * PITCH
        references.adopt(GEAR, adopted, ReferenceSource.NARROWED)
        floats(references, 0.0, 1.0)
        if kept:
            assert references.offsets_rad[GEAR] == adopted
            assert references.source(GEAR) is ReferenceSource.NARROWED
        else:
            assert offset(references) == pytest.approx(0.5)
            assert references.source(GEAR) is ReferenceSource.MEASURED


def seen_at_both_flanks(references: PhaseReferences, middle: float) -> None:
    """Sixty sharp measurements at the ends of the gap."""
    for k in range(60):
        share = middle + (0.5 if k % 2 else -0.5)
        references.see(GEAR, theta(share), 0.0, 0.12 * GAP)
    references.locked(GEAR, 0.0, straight=False)
    references.released()


def test_measurements_at_both_flanks_tell_the_middle_and_how_sure_it_is() -> None:
    references = PhaseReferences(SHEET)
    seen_at_both_flanks(references, 0.8)
    assert offset(references) == pytest.approx(0.8, abs=0.02)
    assert 0.0 < references.sd_rad(GEAR) < 0.1 * GAP
    assert references.source(GEAR) is ReferenceSource.MEASURED


def test_a_reference_that_was_wrong_is_dropped_with_what_its_looks_reported() -> None:
    """Of that gear alone."""
    references = PhaseReferences(SHEET)
    seen_at_both_flanks(references, 0.8)
    references.adopt(OTHER, 0.01, ReferenceSource.RESTORED)
    references.lose(GEAR)
    references.lose(GEAR)
    assert references.offsets_rad == {OTHER: 0.01}
    references.locked(GEAR, 0.0)
    references.released()
    assert not references.known(GEAR)
    references.adopt(GEAR, 0.02, ReferenceSource.RESTORED)
    references.lose(GEAR)
    assert references.source(GEAR) is ReferenceSource.NONE


def test_where_a_wheel_s_count_is_lost_nothing_of_before_is_left() -> None:
    """Constants, sources, what was likely, what floated, what was seen, and the watch itself."""
    references = locked(1.0, straight=False)
    measurement(references, *[0.3] * 20)
    references.released()
    floats(references, -0.3, 0.1)
    references.adopt(OTHER, 0.01, ReferenceSource.RESTORED)
    for k in range(60):
        references.see(GEAR, theta(0.5 if k % 2 else -0.5), 0.0, 0.12 * GAP)
    references.locked(GEAR, 1.0)
    references.lose_all()
    assert references.offsets_rad == {}
    assert references.source(OTHER) is ReferenceSource.NONE
    assert references.watched is None
    floats(references, 0.3, 0.6)
    assert references.offsets_rad == {}, "neither by what floated nor by what was seen"
    references.locked(OTHER, 1.0)
    assert measurement(references, *[0.0] * 20, gear=OTHER) == 20
    assert set(references.offsets_rad) == {OTHER}, "nor by what was likely"
