"""Turns of the layshaft that nobody counted: what engaged gears tell of them, and of each other.

The joint set is held against the plain list of all N modulo the lcm, which it never makes.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.controller.estimate.reference import (
    TurnSet,
    all_turns,
    any_one,
    narrowed,
    turn_candidates,
    without,
)
from meshpoint.gearbox import GearboxSheet, MainGear, load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS
from meshpoint.gearbox.wheels import Mesh

THESIS, TRUCK12 = load_sheet("thesis"), load_sheet("truck12")
MODULI = st.dictionaries(st.sampled_from(MAIN_GEARS), st.integers(1, 40), min_size=1).filter(
    lambda moduli: math.lcm(*moduli.values()) < 50_000
)
MESH = st.builds(Mesh, st.integers(8, 200), st.integers(8, 200))
MESHES = st.lists(MESH, min_size=4, max_size=4, unique_by=lambda mesh: mesh.ratio).map(
    lambda meshes: sorted(meshes, key=lambda mesh: mesh.ratio)
)
Engagements = list[tuple[MainGear, frozenset[int]]]


ENGAGEMENTS = st.lists(
    st.tuples(st.sampled_from(MAIN_GEARS), st.frozensets(st.integers(0, 39), max_size=6)),
    max_size=5,
)
"""Gears that were in mesh, and what could not be excluded then beside the truth."""


def looked_at(
    moduli: dict[MainGear, int], true: int, seen: Engagements
) -> tuple[TurnSet, set[int]]:
    """The joint set and the plain list after the same engagements."""
    turns = all_turns(moduli)
    plain = set(range(math.lcm(*moduli.values())))
    for gear, also in seen:
        if gear not in moduli:
            continue
        n = moduli[gear]
        agree = {true % n} | {residue % n for residue in also}
        turns = narrowed(turns, gear, lambda turn, agree=agree: turn in agree)
        plain = {turn for turn in plain if turn % n in agree}
    return turns, plain


@settings(max_examples=60, deadline=None)
@given(moduli=MODULI, true=st.integers(0, 10**6), seen=ENGAGEMENTS)
def test_the_joint_set_is_exactly_the_list_of_all_turns_that_agree(
    moduli: dict[MainGear, int], true: int, seen: Engagements
) -> None:
    """No more, no less: the truth is never excluded, and what can be excluded is."""
    turns, plain = looked_at(moduli, true, seen)
    for gear, n in moduli.items():
        assert turns.candidates(gear) == {turn % n for turn in plain}
        assert true % n in turns.candidates(gear)
    one = any_one(turns)
    assert any(all(turn % moduli[gear] == one[gear] for gear in moduli) for turn in plain)
    first = next(iter(moduli))
    for gear in without(turns, [first]).moduli:
        assert without(turns, [first]).candidates(gear) == turns.candidates(gear)


@settings(max_examples=60, deadline=None)
@given(
    moduli=MODULI, low=st.integers(-500, 500), size=st.integers(1, 60), at=st.integers(0, 59),
    seen=ENGAGEMENTS,
)  # fmt: skip
def test_counted_turns_leave_no_more_than_were_counted(
    moduli: dict[MainGear, int], low: int, size: int, at: int,
    seen: Engagements,
) -> None:  # fmt: skip
    true, turns = low + at % size, all_turns(moduli, range(low, low + size))
    plain = set(range(low, low + size))
    for gear, also in seen:
        if gear in moduli:
            agree = {turn % moduli[gear] for turn in also | {true}}
            turns = narrowed(turns, gear, lambda turn, agree=agree: turn in agree)
            plain = {turn for turn in plain if turn % moduli[gear] in agree}
    for gear, n in moduli.items():
        assert turns.candidates(gear) == {turn % n for turn in plain}


@settings(max_examples=60, deadline=None)
@given(meshes=MESHES, dog=st.integers(8, 96))
def test_of_any_data_sheet_no_more_than_40_000_hypotheses_are_listed(
    meshes: list[Mesh], dog: int
) -> None:
    """C^2 divides the product of the n."""
    sheet = with_gears(*meshes, dog=dog)
    moduli = {gear: turn_candidates(sheet, gear) for gear in MAIN_GEARS}
    turns = all_turns(moduli)
    assert math.prod(moduli.values()) % len(turns.turns) ** 2 == 0
    assert len(turns.turns) <= 40_000
    for gear, mesh in zip(MAIN_GEARS, meshes, strict=True):
        moved = [(k * dog * mesh.driving) % mesh.driven for k in range(moduli[gear] + 1)]
        assert moved[0] == moved[-1] == 0, "after n turns all stands as before"
        assert len(set(moved)) == moduli[gear], "and never in between"


def with_gears(*meshes: Mesh, dog: int = 48) -> GearboxSheet:
    main = dict(zip(("crawl", "first", "second", "third"), meshes, strict=True))
    return replace(THESIS, main=replace(THESIS.main, **main), dog=replace(THESIS.dog, teeth=dog))


def test_an_engagement_that_contradicts_all_leaves_nothing() -> None:
    turns = all_turns({MainGear.FIRST: 25, MainGear.SECOND: 5})
    turns = narrowed(turns, MainGear.SECOND, lambda turn: turn == 3)
    assert not turns.empty
    assert narrowed(turns, MainGear.FIRST, lambda turn: turn == 4).empty


def test_a_gear_to_which_turns_do_not_matter_has_none_to_choose_from() -> None:
    assert all_turns({MainGear.FIRST: 25}).candidates(MainGear.SECOND) == frozenset()
    assert all_turns({}).candidates(MainGear.FIRST) == frozenset()
