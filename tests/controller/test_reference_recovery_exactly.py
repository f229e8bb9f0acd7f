"""How references come back with the tooth numbers, at each limit; on the made gearbox of
`recall_bench`, whose true turn and angles are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recall_bench import THESIS, TIED, TRUCK12, WHOLE, Bench

from meshpoint.controller.estimation.tooth_match import ToothPattern, turned
from meshpoint.controller.phase.reference import Floated
from meshpoint.controller.phase.reference_recovery import SavedReferences
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.sheet import Mesh
from meshpoint.units import DEG

CRAWL, FIRST, SECOND, THIRD = MAIN_GEARS
NEARLY = replace(THESIS, main=replace(THESIS.main, crawl=Mesh(22, 151)))
"""A turn of the layshaft moves crawl by 22 x 48 / 151 pitches: 7 less a 151st, 0.0497 deg."""


def all_known(sheet: GearboxSheet) -> Bench:
    """Teeth shown, and every gear learned since."""
    bench = Bench(sheet)
    bench.find()
    for gear in MAIN_GEARS:
        bench.learn(gear)
    return bench


def restored(sheet: GearboxSheet, *gears: MainGear) -> Bench:
    """After a restart, the teeth found again."""
    bench = Bench(sheet)
    bench.restore(*(gears or MAIN_GEARS))
    bench.find()
    return bench


def test_what_is_found_again_is_said_and_how() -> None:
    bench = Bench(TIED)
    bench.restore(FIRST, SECOND)
    bench.count_from(7, 3, 11)
    bench.find()
    assert bench.events == [
        "layshaft teeth found again: tooth 0 was 7",
        "main shaft teeth found again: tooth 0 was 3",
    ]
    bench.learn(FIRST)
    assert bench.events[2:] == ["phase reference of second found again (by the gears in mesh)"]
    bench = Bench(WHOLE)
    bench.restore(SECOND)
    bench.find()
    assert bench.events[2:] == ["phase reference of second found again (with the tooth numbers)"]
    assert bench.references.source(SECOND) is ReferenceSource.RESTORED
    bench.recovery.look(bench.events, bench.renumbered)
    assert len(bench.events) == 3, "it is said once"


@pytest.mark.parametrize(
    ("off_deg", "sd_deg", "agrees"),
    [(0.39, 0.0, True), (0.41, 0.0, False), (-0.39, 0.0, True), (-0.41, 0.0, False),
     (0.55, 0.1, True), (0.58, 0.1, False), (1.18, 0.28, True), (1.2, 0.28, False)],
)  # fmt: skip
def test_a_gear_agrees_with_what_is_remembered_within_four_deviations(
    off_deg: float, sd_deg: float, agrees: bool
) -> None:
    """Of 0.1 deg and the measurement's own: 0.4 deg, 0.566 with one of 0.1, 1.19 with 0.28."""
    bench = restored(WHOLE)
    bench.learn(SECOND, off_deg * DEG, sd_deg * DEG)
    assert (set(bench.references.offsets_rad) == set(MAIN_GEARS)) is agrees
    assert any("do not agree" in line for line in bench.events) is not agrees


def test_what_does_not_agree_is_forgotten_and_the_other_measured_ones_are_kept() -> None:
    bench = restored(WHOLE, FIRST, SECOND)
    bench.learn(FIRST)
    bench.learn(THIRD)
    bench.learn(SECOND, 1.0 * DEG)
    assert set(bench.references.offsets_rad) == {FIRST, SECOND, THIRD}
    assert bench.events[-1] == (
        "remembered phase references do not agree with second in mesh: forgotten (first)"
    )
    assert bench.recovery.candidates(CRAWL) == 0
    alone = restored(WHOLE, SECOND)
    alone.learn(SECOND, 1.0 * DEG)
    assert alone.events[-1].endswith("forgotten (no other)")


def floated(bench: Bench, gear: MainGear, off: float, width: float) -> None:
    """A tooth in the gap whose middle would be off by this, seen over this width; in rad."""
    middle = bench.box.offset(gear) + off
    bench.recovery.floated(Floated(gear, middle - width / 2.0, middle + width / 2.0), bench.events)


@pytest.mark.parametrize(
    ("width", "off_deg", "agrees"),
    [(0.5, 0.93, True), (0.5, 0.95, False), (0.5, -0.93, True), (0.5, -0.95, False),
     (0.0, 1.30, True), (0.0, 1.33, False), (1.0, 0.56, True), (1.0, 0.57, False),
     (1.09, 0.51, False), (1.11, 3.0, True)],
)  # fmt: skip
def test_a_tooth_that_floated_leaves_half_its_free_play_and_four_deviations(
    width: float, off_deg: float, agrees: bool
) -> None:
    """A gap of 1.5 deg; 4 x 0.1 x the root of two is 0.566. Half of it seen leaves 0.375 more,
    nothing of it 0.75; seen wider by more than a tenth, the looks were wrong and tell nothing."""
    bench = restored(WHOLE)
    gap = WHOLE.dog.backlash_rad
    assert gap == pytest.approx(1.5 * DEG)
    floated(bench, SECOND, off_deg * DEG, width * gap)
    assert any("do not agree" in line for line in bench.events) is not agrees


def test_a_tooth_that_floated_before_the_teeth_are_found_or_of_another_gear_tells_nothing() -> None:
    bench = Bench(WHOLE)
    bench.restore(FIRST)
    floated(bench, FIRST, 3.0 * DEG, 0.0)
    bench.learn(SECOND, 3.0 * DEG)
    bench.find()
    floated(bench, SECOND, 3.0 * DEG, 0.0)
    assert bench.references.source(FIRST) is ReferenceSource.RESTORED
    assert not any("do not agree" in line for line in bench.events)


@pytest.mark.parametrize(("behind", "known"), [(0, True), (45, True), (90, True), (135, False)])
def test_turns_that_move_a_gear_by_less_than_two_learnings_differ_need_not_be_known(
    behind: int, known: bool
) -> None:
    """Two or three possible turns are 0.05 or 0.1 deg apart, and the middle is taken; four are too
    far apart."""
    bench = all_known(NEARLY)
    bench.lose(4, None, 2)
    bench.sensor_says(0, behind)
    bench.find()
    possible = behind // 45 + 1
    assert bench.references.known(CRAWL) is known
    if known:
        off = bench.references.offsets_rad[CRAWL] - bench.box.offset(CRAWL)
        pitch = NEARLY.dog.pitch_rad
        off -= pitch * round(off / pitch)
        assert abs(off) == pytest.approx((possible - 1) / 2.0 * pitch / 151, abs=1e-9)
        assert bench.recovery.candidates(CRAWL) == 1
    else:
        assert bench.recovery.candidates(CRAWL) == possible


@pytest.mark.parametrize(("behind", "bounded"), [(43 * 999, True), (43 * 1000, False)])
def test_a_count_that_leaves_more_than_a_thousand_turns_is_no_bound(
    behind: int, bounded: bool
) -> None:
    """With hunting teeth a gear in mesh tells of the others only where the turns are counted."""
    bench = all_known(TRUCK12)
    bench.lose(0, None, 0)
    bench.sensor_says(0, behind)
    bench.find()
    before = bench.recovery.candidates(CRAWL)
    for gear in (FIRST, SECOND, THIRD):
        bench.learn(gear)
    after = bench.recovery.candidates(CRAWL)
    assert (after < before) is bounded


def test_a_count_that_agrees_with_no_tooth_that_was_found_is_no_bound() -> None:
    """The sensor says by 1 tooth, the pattern by 4: of whole turns none fits."""
    bench = all_known(TRUCK12)
    bench.lose(4, None, 0)
    bench.counted = 1
    bench.sensor_says(0, 1)
    bench.find()
    assert bench.recovery.candidates(THIRD) == 35


def test_a_gear_of_which_nothing_is_remembered_has_no_candidates() -> None:
    bench = restored(TIED, FIRST)
    assert bench.recovery.candidates(SECOND) == 0
    assert bench.recovery.candidates(FIRST) == 7
    bench.learn(FIRST)
    assert bench.recovery.candidates(FIRST) == 1
    unfound = Bench(TIED)
    unfound.restore(FIRST)
    assert unfound.recovery.candidates(FIRST) == 0


def test_the_reference_of_another_numbering_is_moved_by_both_wheels_teeth() -> None:
    """Less i times the layshaft's teeth and turns, plus the main shaft's: here of one tooth each
    way, by hand."""
    for layshaft, main in ((1, 0), (0, 1), (5, 7)):
        bench = Bench(WHOLE)
        bench.restore(SECOND)
        before = bench.box.offset(SECOND)
        bench.count_from(layshaft, main)
        bench.find()
        ratio = WHOLE.main_mesh(SECOND).ratio
        moved = -ratio * layshaft * 2.0 * math.pi / 45 + main * 2.0 * math.pi / 45
        assert bench.references.offsets_rad[SECOND] == pytest.approx(before + moved)


def pattern_at(bench: Bench, wheel: int, tooth: int) -> list[float]:
    found: list[float] = turned(bench.patterns[wheel], tooth).tolist()
    return found


def test_what_is_kept_before_the_teeth_are_found_is_what_was_restored() -> None:
    bench = Bench(THESIS)
    bench.restore(FIRST, THIRD)
    offsets = {gear: bench.box.offset(gear) for gear in (FIRST, THIRD)}
    saved = bench.recovery.saved()
    assert saved.offsets_rad == offsets
    for wheel, each in enumerate((saved.layshaft, saved.main)):
        assert each is not None
        assert each.error_rad.tolist() == bench.patterns[wheel].tolist()
        assert (each.sd_rad, each.edges) == (1e-4, 1)


def test_what_is_kept_while_one_wheel_is_found_is_in_the_old_numbering() -> None:
    """The one that shows its teeth is turned back; how well they are known is told of now."""
    bench = Bench(THESIS)
    bench.restore(FIRST, THIRD)
    bench.count_from(7, 3)
    bench.find(main=False)
    bench.layshaft.sd_rad, bench.layshaft.edges_seen = 2e-4, 77
    saved = bench.recovery.saved()
    assert saved.layshaft is not None
    assert saved.main is not None
    assert saved.layshaft.error_rad.tolist() == bench.patterns[0].tolist()
    assert (saved.layshaft.sd_rad, saved.layshaft.edges) == (2e-4, 77)
    assert saved.main.error_rad.tolist() == bench.patterns[1].tolist()
    assert set(saved.offsets_rad) == {FIRST, THIRD}


def test_what_is_kept_once_all_is_found_is_in_the_new_numbering() -> None:
    bench = restored(WHOLE)
    bench.lose(7, 3, 2)
    bench.find()
    for teeth, edges in ((bench.layshaft, 55), (bench.main, 66)):
        teeth.edges_seen, teeth.sd_rad = edges, edges * 1e-6
    saved = bench.recovery.saved()
    assert saved.layshaft is not None
    assert saved.main is not None
    assert saved.layshaft.error_rad.tolist() == pattern_at(bench, 0, 7)
    assert saved.main.error_rad.tolist() == pattern_at(bench, 1, 3)
    assert (saved.layshaft.edges, saved.main.edges) == (55, 66)
    assert (saved.layshaft.sd_rad, saved.main.sd_rad) == pytest.approx((55e-6, 66e-6))
    assert saved.offsets_rad == bench.references.offsets_rad


def test_without_both_patterns_no_reference_is_kept() -> None:
    """A constant between counted angles is of no use where a wheel's teeth cannot be found."""
    bench = Bench(WHOLE)
    bench.layshaft.learned = True
    bench.learn(SECOND)
    saved = bench.recovery.saved()
    assert saved.offsets_rad == {}
    assert saved.layshaft is not None
    assert saved.main is None
    bench.main.learned = True
    assert set(bench.recovery.saved().offsets_rad) == {SECOND}


def test_a_wheel_lost_before_it_showed_its_teeth_loses_the_references() -> None:
    bench = Bench(WHOLE)
    bench.learn(SECOND)
    bench.lose(None, 5)
    assert bench.references.offsets_rad == {}
    bench.find()
    assert bench.references.offsets_rad == {}
    assert bench.recovery.saved().offsets_rad == {}
    pattern = ToothPattern(np.zeros(90), 1e-4, 1)
    for layshaft, main in ((pattern, None), (None, pattern)):
        fresh = Bench(WHOLE)
        fresh.recovery.restore(SavedReferences(layshaft, main, {SECOND: 0.1}))
        assert fresh.recovery.saved().offsets_rad == {}, "one of the patterns is missing"


def test_a_main_shaft_lost_twice_is_told_by_the_sum_of_both() -> None:
    """Found in between or not; what is kept meanwhile is in the first numbering."""
    for found in (True, False):
        bench = all_known(WHOLE)
        bench.lose(None, 13)
        if found:
            bench.find()
            assert bench.known() == set(MAIN_GEARS)
        bench.lose(None, 8)
        saved = bench.recovery.saved()
        assert saved.main is not None
        assert saved.main.error_rad.tolist() == pattern_at(bench, 1, 13 if found else 0)
        bench.find()
        assert bench.known() == set(MAIN_GEARS)


def test_a_wheel_lost_again_while_the_other_is_sought_keeps_its_first_numbering() -> None:
    """The layshaft shows its teeth, is lost once more, and is found; then the main shaft is."""
    bench = all_known(WHOLE)
    bench.lose(5, 6, 7)
    bench.find(main=False)
    bench.lose(8, None, 9)
    saved = bench.recovery.saved()
    assert saved.layshaft is not None
    assert saved.layshaft.error_rad.tolist() == pattern_at(bench, 0, 0)
    assert set(saved.offsets_rad) == set(MAIN_GEARS)
    bench.find(main=False)
    assert bench.known() == set()
    bench.find()
    assert bench.known() == set(MAIN_GEARS)


def test_gears_that_wait_for_turns_are_not_kept_when_more_turns_are_lost() -> None:
    """First and the others of the tied box wait for the same turns; none is in mesh before the
    layshaft is lost again: one arbitrary turn is as good as any for all of them together."""
    bench = restored(TIED)
    assert bench.recovery.candidates(THIRD) == 35
    saved = bench.recovery.saved()
    assert set(saved.offsets_rad) == set(MAIN_GEARS)
    bench.lose(3, None, 5)
    bench.find()
    assert bench.recovery.candidates(THIRD) == 35
    bench.learn(FIRST)
    assert {CRAWL, FIRST, SECOND} <= bench.known()


def test_a_wheel_that_was_exchanged_leaves_nothing_to_wait_for() -> None:
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.layshaft.forget()
    bench.recovery.look(bench.events, bench.renumbered)
    bench.find()
    assert bench.references.offsets_rad == {}
    bench.learn(SECOND)
    bench.lose(None, 4)
    bench.find()
    assert bench.known() == {SECOND}


OTHER_WAY = replace(THESIS, main=replace(THESIS.main, third=Mesh(280, 151)))
"""A turn moves third by 89 pitches and a 151st."""


@pytest.mark.parametrize(("sheet", "gear"), [(NEARLY, CRAWL), (OTHER_WAY, THIRD)])
def test_of_turns_either_side_of_the_true_one_the_middle_is_right(
    sheet: GearboxSheet, gear: MainGear
) -> None:
    """Whether a turn moves the gear a 151st of a pitch back or forth."""
    bench = all_known(sheet)
    bench.lose(4, None, 2)
    bench.sensor_says(45, 45)
    bench.find()
    assert bench.recovery.candidates(FIRST) == 3
    assert bench.known() == {gear}
    assert set(bench.recovery.saved().offsets_rad) == {gear}, "the others go with one turn alone"


def test_a_gear_that_was_measured_before_the_teeth_were_found_tells_the_others_then() -> None:
    bench = Bench(TIED)
    bench.restore(*MAIN_GEARS)
    bench.count_from(3, 4, 11)
    bench.learn(FIRST)
    assert bench.known() == {FIRST}
    bench.find()
    assert bench.known() == {CRAWL, FIRST, SECOND}
    assert bench.recovery.candidates(THIRD) == 5


def test_a_second_loss_is_counted_from_the_first() -> None:
    bench = all_known(TRUCK12)
    for teeth, turns in ((4, 3), (7, 2), (40, 9)):
        bench.lose(teeth, 5, turns)
        bench.sensor_says(0, 0)
        bench.find()
        assert bench.known() == set(MAIN_GEARS)


def test_where_all_turns_were_counted_a_gear_in_mesh_is_compared_with_none_missed() -> None:
    bench = all_known(THESIS)
    bench.lose(None, 5)
    assert {bench.recovery.candidates(gear) for gear in MAIN_GEARS} == {0}, "while it is sought"
    bench.find()
    bench.learn(FIRST)
    assert bench.known() == set(MAIN_GEARS)
    assert not any("do not agree" in line for line in bench.events)


def test_what_was_dropped_is_remembered_no_more() -> None:
    bench = restored(WHOLE, CRAWL, FIRST, SECOND)
    bench.learn(SECOND, 1.0 * DEG)
    assert set(bench.references.offsets_rad) == {SECOND}
    assert bench.recovery.candidates(CRAWL) == 0
    bench.lose(None, 3)
    bench.find()
    assert set(bench.references.offsets_rad) == {SECOND}


def test_a_gear_that_still_waits_for_turns_is_kept_for_one_that_is_possible() -> None:
    """Third has five phases left; whichever of them is kept, the next run counts from there."""
    bench = restored(TIED)
    bench.learn(FIRST)
    saved = bench.recovery.saved()
    assert set(saved.offsets_rad) == set(MAIN_GEARS)
    pitch = TIED.dog.pitch_rad
    off = (saved.offsets_rad[THIRD] - bench.box.offset(THIRD)) / pitch * 5
    assert off == pytest.approx(round(off), abs=1e-6)


def test_a_gear_that_waits_for_turns_waits_for_the_same_after_the_main_shaft_stood() -> None:
    """Turns go on being counted; what is measured then is not taken for a contradiction."""
    bench = Bench(TIED)
    bench.restore(*MAIN_GEARS)
    bench.count_from(3, 4, 11)
    bench.find()
    bench.learn(FIRST)
    bench.lose(None, 17)
    bench.find()
    assert bench.recovery.candidates(THIRD) == 5
    bench.learn(THIRD)
    assert bench.known() == set(MAIN_GEARS)
    assert not any("do not agree" in line for line in bench.events)


def test_a_pattern_whose_place_in_the_old_numbering_was_never_found_leads_nowhere() -> None:
    """Learned anew and lost, before the remembered one was recognised in it."""
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.count_from(0, 7)
    bench.find(main=False)
    bench.main.error_rad, bench.main.learned = turned(bench.patterns[1], 7), True
    bench.lose(None, 5)
    bench.find()
    assert bench.known() == set()


def test_what_is_restored_later_is_not_bounded_by_what_was_counted_before() -> None:
    bench = all_known(TRUCK12)
    bench.lose(0, None, 0)
    bench.restore(*MAIN_GEARS)
    bench.layshaft.learned = bench.main.learned = False
    bench.count_from(0, 0, 3)
    bench.find()
    assert bench.recovery.candidates(THIRD) == 35


def test_a_pattern_that_was_not_found_yet_is_kept_where_the_other_wheel_is_another() -> None:
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.main.forget()
    bench.recovery.look(bench.events, bench.renumbered)
    saved = bench.recovery.saved()
    assert saved.layshaft is not None
    assert saved.layshaft.error_rad.tolist() == bench.patterns[0].tolist()
    assert saved.main is None
    assert saved.offsets_rad == {}
