"""Which gearboxes a set is made of, and which of them are held out.

A gearbox makes LEARNED shifts of one gear change, in which its controller learns. Then each of
MOMENTS requests is answered twice from the same state: with phase control (`target_phase`), and
with the speed window of today (`speed_window`), which meets any phase. Every third gearbox of a
kind is held out: it is in the split `test`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from meshpoint.campaigns.draw import upshifts
from meshpoint.campaigns.spec import SEEDS_APART

Pairs = tuple[tuple[int, int], ...]
SHEET: Final = "truck12"
PROFILE: Final = "typical"
UPSHIFT, DOWNSHIFT = "upshift", "downshift"
PAIRS: Final[dict[str, Pairs]] = {
    UPSHIFT: upshifts(),
    DOWNSHIFT: ((3, 1), (4, 2), (5, 3), (6, 4), (9, 7), (10, 8), (11, 9), (12, 10)),
}
FIRST_SEED: Final = {UPSHIFT: 0, DOWNSHIFT: SEEDS_APART // 2}
"""Of a kind, beside those of the set: no two kinds share a draw."""
LEARNED: Final = 6
MOMENTS: Final = 2
STRATEGIES: Final = ("target_phase", "speed_window")
"""The first one is also that which the gearbox learns by and goes on by."""
HELD_OUT: Final = 3
"""One gearbox of this number."""
TRAIN, TEST = "train", "test"
AHEAD_US: Final = 45_000
"""From the end of what is known to the contact."""


class Gearbox(NamedTuple):
    """One draw of a truck and its gear change."""

    kind: str
    number: int
    """Within its kind, from 0."""
    seed: int
    learned: int

    @property
    def split(self) -> str:
        """Whether it is held out."""
        return TEST if self.number % HELD_OUT == HELD_OUT - 1 else TRAIN

    def shift_id(self, moment: int, strategy: str) -> str:
        """As all tables name the shift: `up-007-1-aimed`."""
        how = "aimed" if strategy == STRATEGIES[0] else "chance"
        return f"{self.kind.removesuffix('shift')}-{self.number:03d}-{moment}-{how}"


@dataclass(frozen=True)
class Plan:
    """A set as it is asked for."""

    upshifts: int = 200
    downshifts: int = 100
    seed: int = 7
    learned: int = LEARNED

    @property
    def wanted(self) -> dict[str, int]:
        """Shifts of each kind."""
        return {UPSHIFT: self.upshifts, DOWNSHIFT: self.downshifts}

    @property
    def arguments(self) -> str:
        """As the command takes it."""
        shifts = f"--upshifts {self.upshifts} --downshifts {self.downshifts}"
        return f"{shifts} --seed {self.seed} --learn {self.learned}"

    def gearboxes(self, kind: str) -> Iterator[Gearbox]:
        """All there are of a kind, one after the other."""
        first = SEEDS_APART * self.seed + FIRST_SEED[kind]
        for number in range(SEEDS_APART // 2):
            yield Gearbox(kind, number, first + number, self.learned)
