"""Records name flat memory: where each field lies, of what kind it is, and what is no record."""

from __future__ import annotations

import copy
from typing import Annotated, Any

import numpy as np
import pytest

from meshpoint.controller.records import (
    WORD_BYTES,
    Integers,
    Over,
    RecordMemory,
    Records,
    Vector,
    filled,
    layout_of,
)


class Inner:
    """Two numbers, the second an integer."""

    way_m: float
    count: int


class Outer:
    """A field of each kind, and two names over others."""

    first: int
    own: Inner
    three: Annotated[Vector, 3]
    grid: Annotated[Integers, 2, 2]
    many: Annotated[Records[Inner], 2]
    last_s: float
    middle: Annotated[Vector, Over("three"), 3]
    end_s: Annotated[float, Over("last_s")]


LAYOUT: Any = layout_of(Outer)
OFFSETS = {
    "first": 0, "own": 1, "three": 3, "grid": 6, "many": 10, "last_s": 14, "middle": 3, "end_s": 14
}  # fmt: skip
"""In words; a name over another takes none."""


def test_fields_lie_one_behind_the_other_in_words() -> None:
    assert WORD_BYTES == 8
    assert LAYOUT.names == tuple(OFFSETS)
    assert {name: LAYOUT.fields[name][1] for name in OFFSETS} == {
        name: 8 * word for name, word in OFFSETS.items()
    }
    assert LAYOUT.itemsize == 8 * 15
    assert LAYOUT.type is np.record
    assert LAYOUT.isalignedstruct


def test_a_field_has_its_number_s_kind_and_its_array_s_shape() -> None:
    kinds = {name: LAYOUT.fields[name][0] for name in OFFSETS}
    assert (kinds["first"], kinds["last_s"], kinds["end_s"]) == (np.int64, np.float64, np.float64)
    assert (kinds["three"].base, kinds["three"].shape) == (np.float64, (3,))
    assert (kinds["grid"].base, kinds["grid"].shape) == (np.int64, (2, 2))
    assert (kinds["many"].base, kinds["many"].shape) == (layout_of(Inner), (2,))
    assert kinds["own"] == layout_of(Inner)
    assert kinds["own"].fields["count"][0] == np.int64
    assert kinds["own"].fields["way_m"][0] == np.float64


def test_memory_is_empty_at_first_and_its_parts_are_views() -> None:
    """A single number's has one element, an array's those of the array."""
    memory = RecordMemory(LAYOUT)
    assert memory.flat.tolist() == [0.0] * 15
    memory.part("three")[:] = 1.0, 2.0, 3.0
    memory.part("last_s")[0] = 7.0
    memory.part("grid")[1, 0] = 5
    assert memory.flat[3:6].tolist() == [1.0, 2.0, 3.0]
    assert memory.part("middle").tolist() == [1.0, 2.0, 3.0]
    assert memory.part("end_s").tolist() == [7.0]
    assert memory.flat.view(np.int64)[8] == 5
    assert [memory.part(name).shape for name in ("first", "three", "grid", "many")] == [
        (1,), (3,), (2, 2), (2,)
    ]  # fmt: skip


class Named(RecordMemory):
    """A memory with a view of its own."""

    def _name_parts(self) -> None:
        self.three = self.part("three")


def test_a_copy_has_its_own_memory_and_its_own_views_of_it() -> None:
    memory = Named(LAYOUT)
    memory.three[1] = 4.0
    other = copy.deepcopy(memory)
    other.three[2] = 6.0
    assert type(other) is Named
    assert other.flat[3:6].tolist() == [0.0, 4.0, 6.0]
    assert memory.flat[3:6].tolist() == [0.0, 4.0, 0.0]
    assert other.part("three").tolist() == [0.0, 4.0, 6.0]


class Floats:
    """Two real numbers."""

    a_m: float
    b_m: float


def test_a_record_of_floats_is_filled_by_its_names_in_their_order() -> None:
    layout = layout_of(Floats)
    found = filled(layout, a_m=1, b_m=2.5)
    assert found.tolist() == [1.0, 2.5]
    assert found.dtype == np.dtype(np.float64)
    with pytest.raises(KeyError, match=r"a_m.*b_m.*not.*b_m.*a_m"):
        filled(layout, b_m=1.0, a_m=2.0)
