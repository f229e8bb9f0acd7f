"""Phase references that come back with the tooth patterns of their wheels.

The gearbox here is made: its true turn and angles are known (`recall_bench`).
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recall_bench import THESIS, TIED, TRUCK12, WHOLE, Bench

from meshpoint.controller.estimate.reference import turn_candidates
from meshpoint.controller.estimate.teeth import ToothPattern
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.units import DEG

DOCUMENT = (Path(__file__).parents[2] / "docs/calibration.md").read_text(encoding="utf-8")


AT = st.tuples(st.integers(0, 42), st.integers(0, 44), st.integers(0, 10_000))


@settings(max_examples=30, deadline=None)
@given(at=AT)
def test_gears_that_turns_move_by_whole_teeth_are_known_at_once(at: tuple[int, int, int]) -> None:
    """As soon as both wheels were found, wherever counting began and however often they turned."""
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.count_from(*at)
    bench.find(main=False)
    assert bench.known() == set()
    bench.find()
    assert bench.known() == set(MAIN_GEARS)


@settings(max_examples=30, deadline=None)
@given(at=AT)
def test_first_tells_second_where_their_turns_have_a_common_factor(
    at: tuple[int, int, int],
) -> None:
    """Of the thesis's box, first stands as before after 25 turns, second after 5, third after 31:
    first or second says nothing of third."""
    assert [turn_candidates(THESIS, gear) for gear in MAIN_GEARS] == [17, 25, 5, 31]
    bench = Bench(THESIS)
    bench.restore(*MAIN_GEARS)
    bench.count_from(*at)
    bench.find()
    assert bench.known() == set()
    assert bench.recovery.candidates(MainGear.SECOND) == 5
    bench.learn(MainGear.SECOND)
    assert bench.known() == {MainGear.SECOND}
    assert bench.recovery.candidates(MainGear.FIRST) == 5
    assert bench.recovery.candidates(MainGear.THIRD) == 31
    # 25 candidates are closer than two learnings agree, but those left are not.
    bench.learn(MainGear.FIRST)
    assert bench.known() == {MainGear.FIRST, MainGear.SECOND}


def test_coprime_gears_tell_nothing_of_each_other() -> None:
    """All of truck12: hunting teeth keep each gear's phase to itself."""
    bench = Bench(TRUCK12)
    bench.restore(*MAIN_GEARS)
    bench.count_from(3, 7, 11)
    bench.find()
    assert bench.known() == set()
    for known, gear in enumerate(MAIN_GEARS[:3], 1):
        bench.learn(gear)
        assert len(bench.known()) == known


@pytest.mark.parametrize("sheet", [THESIS, TRUCK12], ids=lambda sheet: sheet.name)
def test_a_main_shaft_that_stood_costs_no_reference(sheet: GearboxSheet) -> None:
    """The layshaft has been counted all along, so the main shaft's pattern is enough: at every
    stop of the truck with the engine running."""
    bench = Bench(sheet)
    bench.find()
    for gear in MAIN_GEARS:
        bench.learn(gear)
    # Once more from the new numbering, and twice before the teeth were found.
    for moved in ((13,), (40,), (3, 25)):
        for teeth in moved:
            bench.lose(None, teeth)
            assert bench.known() == set()
        bench.find()
        assert bench.known() == set(MAIN_GEARS)


def test_numbers_lost_again_before_they_were_found_are_still_found() -> None:
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.count_from(5, 6, 7)
    bench.find(main=False)
    bench.lose(8, None, 9)
    bench.find()
    assert bench.known() == set(MAIN_GEARS)


def test_references_that_do_not_agree_with_a_gear_in_mesh_are_forgotten() -> None:
    """Somebody took the gearbox apart: the one that was looked at is right, the others go."""
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.find()
    bench.box.mounted_rad += 0.02
    bench.learn(MainGear.SECOND)
    assert bench.known() == {MainGear.SECOND}
    assert any("do not agree" in line for line in bench.events)


def test_a_wheel_that_was_exchanged_ends_the_wait_for_its_references() -> None:
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.find(main=False)
    bench.main.forget()
    bench.recovery.measure(bench.events, bench.renumbered)
    bench.main.memory = ToothPattern(bench.patterns[1], 1e-4, 1)
    bench.find()
    assert bench.known() == set()


def test_what_was_not_found_yet_is_kept_as_it_was() -> None:
    """A run too short to find the teeth must not cost what earlier ones have learned."""
    bench = Bench(THESIS)
    bench.restore(*MAIN_GEARS)
    offsets = dict(bench.recovery.saved().offsets_rad)
    assert set(offsets) == set(MAIN_GEARS)
    bench.count_from(7, 3)
    bench.find(main=False)
    saved = bench.recovery.saved()
    assert saved.offsets_rad == offsets
    assert saved.layshaft is not None
    assert (saved.layshaft.error_rad == bench.patterns[0]).all(), "in the remembered numbering"


def test_a_found_numbering_that_nothing_was_learned_in_is_kept_too() -> None:
    """A short run after a restart: teeth are found, no gear is in mesh; then another restart."""
    bench = Bench(TIED)
    bench.restore(*MAIN_GEARS)
    for at in ((7, 3, 11), (40, 40, 5)):
        bench.count_from(*at)
        bench.find()
        assert bench.known() == set()
        bench.power_up(bench.recovery.saved())
    bench.find()
    bench.learn(MainGear.FIRST)
    assert {MainGear.CRAWL, MainGear.SECOND} < bench.known()


@settings(max_examples=30, deadline=None)
@given(at=AT, first=st.sampled_from(MAIN_GEARS[:3]))
def test_where_all_turns_count_alike_one_gear_tells_the_others(
    at: tuple[int, int, int], first: MainGear
) -> None:
    """Three gears after the same seven turns; of third, after 35, five phases are left."""
    bench = Bench(TIED)
    bench.restore(*MAIN_GEARS)
    bench.count_from(*at)
    bench.find()
    assert [bench.recovery.candidates(gear) for gear in MAIN_GEARS] == [7, 7, 7, 35]
    bench.learn(first)
    assert bench.known() == set(MAIN_GEARS[:3])
    assert bench.recovery.candidates(MainGear.THIRD) == 5
    sources = [bench.references.source(gear) for gear in MAIN_GEARS[:3]]
    assert sources.count(ReferenceSource.MEASURED) == 1
    assert sources.count(ReferenceSource.NARROWED) == 2
    # The truck stops, and what third waits for outlives it.
    bench.lose(None, 17)
    bench.find()
    assert bench.known() == set(MAIN_GEARS[:3])
    assert bench.references.source(first) is ReferenceSource.RESTORED
    assert bench.recovery.candidates(MainGear.THIRD) == 5


@settings(max_examples=30, deadline=None)
@given(
    teeth=st.integers(0, 42), turns=st.integers(-40, 1600), before=st.integers(0, 60),
    behind=st.integers(0, 60), first=st.sampled_from(MAIN_GEARS),
)  # fmt: skip
def test_a_layshaft_that_stood_costs_one_engagement_where_its_sensor_has_counted_on(
    teeth: int, turns: int, before: int, behind: int, first: MainGear
) -> None:
    """Even with hunting teeth: of the few turns that agree with the count, the first gear in mesh
    leaves one. None is needed where the count leaves one anyway."""
    bench = Bench(TRUCK12)
    bench.find()
    for gear in MAIN_GEARS:
        bench.learn(gear)
    bench.lose(teeth, 5, turns)
    bench.sensor_says(before, behind)
    bench.find()
    possible = before // 43 + behind // 43 + 1
    assert {bench.recovery.candidates(gear) for gear in MAIN_GEARS} == {possible}
    assert bench.known() == (set(MAIN_GEARS) if possible == 1 else set())
    bench.learn(first)
    assert bench.known() == set(MAIN_GEARS)


def test_a_count_that_was_in_doubt_meanwhile_tells_nothing() -> None:
    bench = Bench(TRUCK12)
    bench.find()
    bench.learn(MainGear.THIRD)
    bench.lose(4, None, 3)
    bench.sensor_says(1, 1)
    bench.renumbered = bench.renumbered._replace(uncounted=1)
    bench.find()
    assert bench.recovery.candidates(MainGear.THIRD) == 35


def test_a_wrong_count_is_noticed_when_gears_in_mesh_contradict_it() -> None:
    """First agrees by chance with a wrong number of turns, second does not: said, and dropped."""
    bench = Bench(TRUCK12)
    bench.find()
    for gear in MAIN_GEARS:
        bench.learn(gear)
    bench.lose(0, None, 53)
    bench.counted = 0
    bench.sensor_says(60, 60)
    bench.find()
    bench.learn(MainGear.FIRST)
    assert len(bench.references.offsets_rad) == 4
    bench.learn(MainGear.SECOND)
    assert bench.known() == {MainGear.FIRST, MainGear.SECOND}
    assert bench.events[-1] == (
        "remembered phase references do not agree with second in mesh: forgotten"
        " (crawl, first, third)"
    )
    bench.learn(MainGear.THIRD)
    assert bench.known() == {MainGear.FIRST, MainGear.SECOND, MainGear.THIRD}


def lose_as_drawn(
    bench: Bench, layshaft: int | None, main: int | None, turns: int, before: int, behind: int
) -> None:
    """A loss of one wheel or both; before < 0: the sensor has not counted the layshaft."""
    if layshaft is None and main is None:
        return
    bench.lose(layshaft, main, turns if layshaft is not None else 0)
    if layshaft is not None and before < 0:
        old = bench.renumbered
        bench.renumbered = old._replace(uncounted=old.uncounted + 1)
    elif layshaft is not None:
        bench.sensor_says(before, behind)


@pytest.mark.parametrize("first", MAIN_GEARS)
@pytest.mark.parametrize("how", ["counted", "not counted", "restarted"])
@settings(max_examples=8, deadline=None)
@given(
    turns=st.integers(0, 34), main_first=st.booleans(), at=AT, order=st.permutations(MAIN_GEARS)
)  # fmt: skip
def test_a_gear_that_waits_for_earlier_turns_is_not_told_by_later_ones(
    first: MainGear, how: str, turns: int, main_first: bool, at: tuple[int, int, int],
    order: list[MainGear],
) -> None:  # fmt: skip
    """A restart, one gear in mesh, others have more than one candidate: then the layshaft's turns
    are lost a second time."""
    bench = Bench(TIED)
    bench.restore(*MAIN_GEARS)
    bench.count_from(3, 4, turns)
    bench.find()
    bench.learn(first)
    if main_first:
        bench.lose(None, 9)
    if how == "restarted":
        bench.power_up(bench.recovery.saved())
        bench.count_from(*at)
    else:
        lose_as_drawn(bench, *at, before=3 if how == "counted" else -1, behind=3)
    bench.find()
    for gear in order:
        bench.known()
        bench.learn(gear)
    assert bench.known() == set(MAIN_GEARS)
    assert not any("agree" in line for line in bench.events)


@pytest.mark.parametrize(("off_deg", "agrees"), [(0.3, True), (0.5, False)])
def test_two_learnings_of_a_gear_may_differ_by_four_standard_deviations(
    off_deg: float, agrees: bool
) -> None:
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.find()
    bench.learn(MainGear.SECOND, off_deg * DEG)
    assert bench.references.source(MainGear.SECOND) is ReferenceSource.MEASURED
    assert (len(bench.references.offsets_rad) == 4) is agrees
    # A measurement that is itself poorly known excludes less.
    bench = Bench(WHOLE)
    bench.restore(*MAIN_GEARS)
    bench.find()
    bench.learn(MainGear.SECOND, off_deg * DEG, sd_rad=0.1 * DEG)
    assert len(bench.references.offsets_rad) == 4


TEETH_ON = st.one_of(st.none(), st.integers(0, 44))
TURNS, NEAR = st.integers(-3, 300), st.integers(-1, 120)
LOSS = st.tuples(st.just("lose"), TEETH_ON, TEETH_ON, TURNS, NEAR, st.integers(0, 120))
LEARN = st.tuples(st.just("learn"), st.sampled_from(MAIN_GEARS), st.floats(-0.05, 0.05))
FIND = st.tuples(st.just("find"), st.booleans(), st.booleans())
LIFE = st.lists(st.one_of(LOSS, LEARN, LEARN, FIND, FIND, st.just(("restart",))), max_size=14)


@settings(max_examples=60, deadline=None)
@given(sheet=st.sampled_from([THESIS, TRUCK12, TIED, WHOLE]), life=LIFE)
def test_whatever_is_lost_and_learned_in_whatever_order_what_is_known_is_true(
    sheet: GearboxSheet, life: list[tuple[Any, ...]]
) -> None:
    """References are learned within 0.05 deg; none that is known is ever off by 0.2, and none is
    dropped for contradicting the gearbox."""
    bench = Bench(sheet)
    bench.find()
    for gear in MAIN_GEARS:
        bench.learn(gear)
    for what, *values in life:
        if what == "lose":
            lose_as_drawn(bench, *values)
        elif what == "learn":
            bench.learn(values[0], values[1] * DEG)
        elif what == "find":
            bench.find(*values)
        else:
            bench.power_up(bench.recovery.saved())
            bench.count_from(11, 22, 33)
        bench.known(within_rad=0.2 * DEG)
    assert not any("agree" in line for line in bench.events)


def left(sheet: GearboxSheet, *in_mesh: MainGear) -> str:
    """Candidates of each gear after a restart and with these gears having been in mesh since."""
    bench = Bench(sheet)
    bench.restore(*MAIN_GEARS)
    bench.count_from(3, 4, 1236)
    bench.find()
    for gear in in_mesh:
        bench.learn(gear)
    return ", ".join(str(bench.recovery.candidates(gear)) for gear in MAIN_GEARS)


@pytest.mark.parametrize(
    ("name", "sheet"),
    [
        ("`thesis`", THESIS),
        ("`truck12`", TRUCK12),
        ("crawl 17/56, first 18/42, second 29/42, third 37/35", TIED),
    ],
)
def test_the_documented_table_says_what_a_restart_costs(name: str, sheet: GearboxSheet) -> None:
    """How many phases are left, and the least number of engagements until all are known."""
    orders = [gears for size in range(5) for gears in combinations(MAIN_GEARS, size)]
    fewest = next(len(gears) for gears in orders if left(sheet, *gears) == "1, 1, 1, 1")
    cells = [name, left(sheet), *(left(sheet, gear) for gear in MAIN_GEARS), str(fewest)]
    assert f"| {' | '.join(cells)} |" in DOCUMENT
