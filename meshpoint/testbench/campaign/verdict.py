"""Whether a change has made shifts worse: pairs of the same draw, before and after.

A sequential probability ratio test (Wald 1945) on each pair: worse (a gap before, none after),
better (the other way round), or alike. Without a change in quality, worse and better are equally
likely, and each at most as likely as a miss of the baseline: that is so when the two are
independent. With a change that matters, worse is at least as likely as the `margin` by which the
share of gaps falls: that is so when the two go together. Pairs of one run share a gearbox, so the
evidence of a run is divided by its design effect. `meshpoint study campaign_statistics` measures
how often the verdict is wrong, and after how many pairs it comes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple

from meshpoint.testbench.campaign.record import JudgedShift

WORSE_FROM: Final = 2.2
NOT_WORSE_FROM: Final = -4.0
"""Evidence from which a verdict is given. Wald's bounds for errors of 5 % are +-2.94. The first may
be lower, because no change is as likely as assumed to make a shift worse; the second has to be
further away, because a change may be less likely than assumed to do so."""
ICC: Final = 0.12
"""How much the misses of one run go together, as measured in campaigns (docs/campaign.md)."""
LEAST_MISSES: Final = 0.005
"""A baseline without a miss is not one that never misses."""


class Verdict(Enum):
    """What the pairs so far say."""

    WORSE = "worse"
    NOT_WORSE = "not worse"
    OPEN = "open"
    """More pairs are needed."""


@dataclass
class Comparison:
    """The evidence so far; fed with the pairs of whole runs in order of their seeds.

    base_misses: share of the baseline's shifts whose first contact was not in a gap.
    margin: by how much the share of gaps must fall to matter.
    """

    base_misses: float
    margin: float
    pairs: int = 0
    worse: int = 0
    better: int = 0
    evidence: float = 0.0
    """Logarithm of the likelihood of a change by `margin` over that of none."""
    verdict: Verdict = Verdict.OPEN

    def take(self, worse: int, better: int, pairs: int) -> Verdict:
        """The pairs of one more run. After a verdict nothing changes any more."""
        if self.verdict is not Verdict.OPEN or pairs == 0:
            return self.verdict
        harmless = max(self.base_misses, LEAST_MISSES)
        harmful = self.margin if self.margin > 1.5 * harmless else self.margin + harmless
        alike = pairs - worse - better
        found = worse * math.log(harmful / harmless)
        found += alike * math.log((1.0 - harmful - harmless) / (1.0 - 2.0 * harmless))
        self.evidence += found / (1.0 + (pairs - 1) * ICC)
        self.pairs, self.worse, self.better = (
            self.pairs + pairs, self.worse + worse, self.better + better,
        )  # fmt: skip
        if self.evidence >= WORSE_FROM:
            self.verdict = Verdict.WORSE
        elif self.evidence <= NOT_WORSE_FROM:
            self.verdict = Verdict.NOT_WORSE
        return self.verdict

    def to_json(self) -> dict[str, Any]:
        """By name."""
        return {
            "verdict": self.verdict.value,
            "pairs": self.pairs,
            "worse": self.worse,
            "better": self.better,
            "evidence": round(self.evidence, 6),
            "base_misses": round(self.base_misses, 6),
            "margin": self.margin,
        }


class PairedRun(NamedTuple):
    """The pairs of one run."""

    seed: int
    worse: int
    better: int
    pairs: int


def compare_runs(
    before: Iterable[JudgedShift], after: Iterable[JudgedShift], strategy: str
) -> list[PairedRun]:
    """Each run that both have, in order of the seeds."""
    was = {(r.seed, r.shift): r.contact == "gap" for r in before if r.strategy == strategy}
    runs: dict[int, list[int]] = {}
    for record in after:
        gap = was.get((record.seed, record.shift)) if record.strategy == strategy else None
        if gap is None:
            continue
        counts = runs.setdefault(record.seed, [0, 0, 0])
        now = record.contact == "gap"
        counts[0] += gap and not now
        counts[1] += now and not gap
        counts[2] += 1
    return [PairedRun(seed, *counts) for seed, counts in sorted(runs.items())]
