"""Whether a row has fallen by more than chance: pairs of the same draw, before and after a change.

Each figure is summed over the shifts of a gearbox, and the sums before and after are set against
each other. Without a change either could be the other, so the signs of the differences are as good
as any: the share of all signs under which their sum is as large as it is or larger is the
probability of so much by chance (Fisher's randomisation test, Design of Experiments 1935, ch. 3).
A table has many rows, so one of some forty is beyond 2.5 % by chance alone: a row has `fallen`
where its probability is below `CHANCE` with the number of rows counted (Holm 1979); below
`DOUBTFUL` by itself it is `doubtful`, and more draws of this row alone decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from meshpoint.base.errors import CommandError
from meshpoint.campaigns.baseline import DRAWN
from meshpoint.campaigns.record import GAP
from meshpoint.campaigns.stored import read_columns
from meshpoint.kernels.records import Vector
from meshpoint.results.shift_figures import REFUSED

CHANCE: Final = 0.05
DOUBTFUL: Final = 0.01
EXACT: Final = 14
"""Up to this many gearboxes that differ, all signs are counted; of more, `SIGNS` by chance."""
SIGNS: Final = 50_000
SEED: Final = 0xE57
FIGURES: Final = ("missed", "not_engaged", "duration_ms", "impact_j")
"""What is judged; more is worse."""
FELL, DOUBT, SAME, ROSE = "fell", "doubtful", "same", "rose"
WORDS: Final = {
    FELL: "fell",
    DOUBT: "doubtful",
    SAME: "same",
    ROSE: "rose",
}


class Pairs(NamedTuple):
    """A row before and after: by figure, what each gearbox has more now than before."""

    shifts: int
    more: Mapping[str, Vector]
    before: Mapping[str, float]
    """The figure's mean, or share, over the pairs."""
    after: Mapping[str, float]


def pairs(before: Path, after: Path, strategy: str) -> Pairs:
    """Of two tables of judged shifts. CommandError where they are not of the same draws."""
    was, now = _shifts(before, strategy), _shifts(after, strategy)
    both = sorted(was.keys() & now.keys())
    for key in both:
        if was[key].drawn != now[key].drawn:
            raise CommandError(
                f"{after}: shift {key[1]} of run {key[0]} was not drawn as in {before}: "
                f"{was[key].drawn}, {now[key].drawn}"
            )
    kept = [key for key in both if not (was[key].is_refused and now[key].is_refused)]
    if not kept:
        raise CommandError(f"{after}: no shift that is in {before} too")
    runs = np.unique([seed for seed, _ in kept], return_inverse=True)[1]
    figures = {}
    for place, figure in enumerate(FIGURES):
        values = np.array([(was[key].figures[place], now[key].figures[place]) for key in kept])
        values[np.isnan(values).any(axis=1)] = 0.0  # no outcome once: no pair of times
        figures[figure] = values
    return Pairs(
        len(kept),
        {name: np.bincount(runs, each[:, 1] - each[:, 0]) for name, each in figures.items()},
        {name: float(each[:, 0].mean()) for name, each in figures.items()},
        {name: float(each[:, 1].mean()) for name, each in figures.items()},
    )


class _Shift(NamedTuple):
    figures: tuple[float, ...]
    is_refused: bool
    drawn: tuple[Any, ...]


def _shifts(table: Path, strategy: str) -> dict[tuple[int, int], _Shift]:
    names = ("strategy", "seed", "shift", "contact", "result", "duration_ms", "impact_j", *DRAWN)
    found = {}
    for by, seed, shift, contact, result, time_ms, impact_j, *drawn in zip(
        *read_columns(table, names), strict=True
    ):
        if by == strategy:
            missed, left = contact != GAP, result != "engaged"
            figures = (float(missed), float(left), np.nan if time_ms is None else time_ms, impact_j)
            found[seed, shift] = _Shift(figures, result == REFUSED, tuple(drawn))
    return found


def chance(more: Vector) -> float:
    """The probability that, without a change, the sum is as large as it is or larger."""
    differing = more[more != 0.0]
    count = differing.size
    if count == 0:
        return 1.0
    least = differing.sum() - 1e-9 * np.abs(differing).sum()
    if count <= EXACT:
        bits = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
        return float(((2.0 * bits - 1.0) @ differing >= least).mean())
    rng = np.random.Generator(np.random.PCG64(SEED))
    signs = rng.integers(0, 2, (SIGNS, count), dtype=np.int8)
    beyond = int(((2.0 * signs - 1.0) @ differing >= least).sum())
    return (1 + beyond) / (1 + SIGNS)


def holm(found: Sequence[float]) -> list[float]:
    """Probabilities with their number counted, so that one of them all is below a level by chance
    no more often than the level says (Holm, Scand. J. Statist. 6, 1979)."""
    adjusted, highest = [1.0] * len(found), 0.0
    for place, which in enumerate(np.argsort(found, kind="stable")):
        highest = max(highest, min(1.0, (len(found) - place) * found[which]))
        adjusted[which] = highest
    return adjusted


def verdicts(rows: Mapping[str, Pairs]) -> dict[str, dict[str, Any]]:
    """Of each row: what became of it, and what that rests on."""
    worse = {figure: [chance(row.more[figure]) for row in rows.values()] for figure in FIGURES}
    better = holm([chance(-row.more["missed"]) for row in rows.values()])
    counted = {figure: holm(each) for figure, each in worse.items()}
    found = {}
    for place, (name, row) in enumerate(rows.items()):
        fallen = [figure for figure in FIGURES if counted[figure][place] <= CHANCE]
        doubtful = [figure for figure in FIGURES if worse[figure][place] <= DOUBTFUL]
        rose = better[place] <= CHANCE
        found[name] = {
            "verdict": FELL if fallen else DOUBT if doubtful else ROSE if rose else SAME,
            "in": fallen or doubtful,
            "shifts": row.shifts,
            "figures": {
                figure: {
                    "before": round(row.before[figure], 6),
                    "after": round(row.after[figure], 6),
                    "chance": round(worse[figure][place], 6),
                    "chance_of_all_rows": round(counted[figure][place], 6),
                }
                for figure in FIGURES
            },
        }
    return found
