"""Whole turns of the layshaft that were not counted: one set of hypotheses for all gears.

After a restart the tooth numbers of both sensor wheels can be recovered, whole turns cannot. A
gear's phase is i theta_layshaft - theta_main less its reference, i = z1 / z2, modulo the pitch of d
dog teeth:

- Turns of the main shaft do not enter: 2 pi is d pitches.
- N turns of the layshaft move the phase by N d z1 / z2 pitches, which is whole again after
  n = z2 / gcd(z2, d z1) turns. So a gear has n candidates, one pitch / n apart.

N is one number for all gears on the layshaft, so the hypotheses are N modulo lcm(n). They need not
be listed: gear g shares with the others no more than c_g = gcd(n_g, lcm of the other n), and by the
Chinese remainder theorem the joint set is exactly

    { N : N modulo C is in `turns`, N modulo n_g is in `residues[g]` for each g },  C = lcm(c_g).

Each prime power of C divides two of the n, so C^2 divides their product at most: 40,000 hypotheses
for four gears of 200 teeth, 1 for coprime n. Where the turns are bounded, because a wheel's edges
were counted on, N itself is listed: then all n share all, c_g = n_g.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import NamedTuple

from meshpoint.gearbox import GearboxSheet, MainGear


class TurnSet(NamedTuple):
    """All N that are still possible; gears are those whose reference is remembered."""

    moduli: Mapping[MainGear, int]
    """The modulus n of each gear."""
    shared: Mapping[MainGear, int]
    """The modulus c of each gear: `turns` determines its residue modulo c."""
    turns: frozenset[int]
    """N modulo the lcm of `shared`, or N itself where it is bounded."""
    residues: Mapping[MainGear, frozenset[int]]
    """N modulo n of each gear: the residues that the gear's own measurements allow."""

    def candidates(self, gear: MainGear) -> frozenset[int]:
        """N modulo n of a gear that are still possible, one phase each; empty for a gear to which
        turns do not matter."""
        if gear not in self.moduli:
            return frozenset()
        c = self.shared[gear]
        possible = {turn % c for turn in self.turns}
        return frozenset(r for r in self.residues[gear] if r % c in possible)

    @property
    def empty(self) -> bool:
        """Whether every hypothesis is excluded: what was remembered is wrong."""
        return not self.turns


def turn_candidates(sheet: GearboxSheet, gear: MainGear) -> int:
    """After how many turns of the layshaft a gear's phase is the same again (n above)."""
    mesh = sheet.main_mesh(gear)
    return mesh.driven // math.gcd(mesh.driven, mesh.driving * sheet.dog.teeth)


def all_turns(moduli: Mapping[MainGear, int], bounded: Iterable[int] | None = None) -> TurnSet:
    """The set with nothing excluded; `bounded`: the only possible N, where these are known."""
    residues = {gear: frozenset(range(n)) for gear, n in moduli.items()}
    if bounded is not None:
        return TurnSet(moduli, moduli, frozenset(bounded), residues)
    shared = {}
    for gear, n in moduli.items():
        others = math.lcm(*(m for other, m in moduli.items() if other is not gear))
        shared[gear] = math.gcd(n, others)
    return TurnSet(moduli, shared, frozenset(range(math.lcm(*shared.values()))), residues)


def narrowed(turns: TurnSet, gear: MainGear, agrees: Callable[[int], bool]) -> TurnSet:
    """The hypotheses that agree with a measurement of `gear`.

    agrees: whether a residue N modulo n of the gear agrees with it."""
    left = frozenset(r for r in turns.candidates(gear) if agrees(r))
    possible = {r % turns.shared[gear] for r in left}
    kept = frozenset(turn for turn in turns.turns if turn % turns.shared[gear] in possible)
    return turns._replace(turns=kept, residues={**turns.residues, gear: left})


def without(turns: TurnSet, gears: Collection[MainGear]) -> TurnSet:
    """The set without these gears; what they have excluded stays excluded."""
    return TurnSet(
        {gear: n for gear, n in turns.moduli.items() if gear not in gears},
        {gear: c for gear, c in turns.shared.items() if gear not in gears},
        turns.turns,
        {gear: left for gear, left in turns.residues.items() if gear not in gears},
    )


def any_one(turns: TurnSet) -> dict[MainGear, int]:
    """N modulo n of each gear, for one possible N."""
    turn = min(turns.turns)
    return {
        gear: min(r for r in residues if (r - turn) % turns.shared[gear] == 0)
        for gear, residues in turns.residues.items()
    }
