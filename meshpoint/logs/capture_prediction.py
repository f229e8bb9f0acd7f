"""When the tooth edge ten edges ahead comes: by constant speed, by the turn before, by learned
patterns, and by whichever of these has been best so far.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from meshpoint.kernels.records import Integers, Vector
from meshpoint.logs.capture_files import FoundWheel
from meshpoint.logs.cycle_pattern import CyclePattern

EDGES_AHEAD: Final = 10
CYCLES: Final = (1, 2)
"""Turns after which a pattern may come back: of a wheel, of a four-stroke engine's crank."""
LEARNED_CYCLES: Final = 2
SCORE_SHARE: Final = 0.05
"""What the newest error counts for where predictors are compared."""


@dataclass(frozen=True)
class Predicted:
    """RMS errors in us over the same edges; None: too few turns."""

    constant_us: float | None
    """By constant speed over the last edges."""
    turn_ago_us: float | None
    """By the same edges one turn ago, scaled by the speed now over the speed then."""
    in_use_us: float | None
    """By what has been best so far of these two, of the same two turns ago, and of the learned
    patterns of one turn and of two."""


class Contest:
    """Predictors side by side; each time the one speaks whose errors were least so far."""

    def __init__(self, count: int) -> None:
        self._square_us2 = np.zeros(count)
        self._pending: deque[list[float]] = deque()

    def said(self, predictions: list[float], time_us: float) -> float:
        """Takes what all say of the edge AHEAD edges ahead, and the edge that has just come."""
        if len(self._pending) == EDGES_AHEAD:
            square = (np.array(self._pending.popleft()) - time_us) ** 2
            self._square_us2 += SCORE_SHARE * (square - self._square_us2)
        self._pending.append(predictions)
        return predictions[int(np.argmin(self._square_us2))]

    def restart(self) -> None:
        """Edges were lost: predictions of before say nothing."""
        self._pending.clear()


def predict(wheel: FoundWheel, tooth: Integers, time_us: Integers, part: Integers) -> Predicted:
    """How far off the time of the tooth edge EDGES_AHEAD edges ahead is predicted, from when
    LEARNED_CYCLES cycles of two turns are learned.

    tooth, time_us, part: of the edges that teeth begin with; teeth were lost between two parts."""
    present = np.array([k for k in range(wheel.teeth) if k not in wheel.missing])
    place = np.searchsorted(present, tooth % wheel.teeth)
    follows = np.r_[False, (np.diff(part) == 0) & (np.diff(place) % present.size == 1)]
    run = _length_of_run(follows)
    patterns = [CyclePattern(_places(present, wheel.teeth, turns)) for turns in CYCLES]
    slots = [place + present.size * (tooth // wheel.teeth % turns) for turns in CYCLES]
    contest, errors = Contest(1 + 2 * len(CYCLES)), []
    for k in range(tooth.size):
        for pattern, slot in zip(patterns, slots, strict=True):
            if not follows[k]:
                pattern.restart()
            pattern.edge(int(slot[k]), float(time_us[k]))
        to = k + EDGES_AHEAD
        if run[k] < EDGES_AHEAD or to >= tooth.size or run[to] != run[k] + EDGES_AHEAD:
            contest.restart()
            continue
        straight = constant_us(tooth, time_us, k)
        ago = [
            turn_ago_us(time_us, k, present.size * turns)
            if run[k] >= present.size * turns + EDGES_AHEAD
            else straight
            for turns in CYCLES
        ]
        said = [straight, *ago, *(p.ahead_us(EDGES_AHEAD) for p in patterns)]
        best = contest.said(said, float(time_us[k]))
        if patterns[-1].cycles >= LEARNED_CYCLES:
            true_us = float(time_us[to])
            errors.append((straight - true_us, ago[0] - true_us, best - true_us))
    if not errors:
        return Predicted(None, None, None)
    return Predicted(*np.sqrt(np.mean(np.square(errors), axis=0)).tolist())


def constant_us(tooth: Integers, time_us: Integers, k: int) -> float:
    """By the mean speed since EDGES_AHEAD edges ago."""
    us_a_pitch = (time_us[k] - time_us[k - EDGES_AHEAD]) / (tooth[k] - tooth[k - EDGES_AHEAD])
    return float(time_us[k] + us_a_pitch * (tooth[k + EDGES_AHEAD] - tooth[k]))


def turn_ago_us(time_us: Integers, k: int, edges: int) -> float:
    """By what came as many edges ago, scaled by the speed over the last EDGES_AHEAD edges now and
    then."""
    then = k - edges
    scale = (time_us[k] - time_us[k - EDGES_AHEAD]) / (time_us[then] - time_us[then - EDGES_AHEAD])
    return float(time_us[k] + scale * (time_us[then + EDGES_AHEAD] - time_us[then]))


def _length_of_run(follows: Integers) -> Integers:
    """For each edge, how many before it follow one another without a loss."""
    at = np.arange(follows.size)
    return np.asarray(at - np.maximum.accumulate(np.where(follows, 0, at)))


def _places(present: Integers, teeth: int, turns: int) -> Vector:
    """Where in a cycle of this many turns the edges of the drawing lie, as shares."""
    return np.concatenate([present + turn * teeth for turn in range(turns)]) / (turns * teeth)
