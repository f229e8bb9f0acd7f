"""Which model of the main shaft in neutral predicts it better: a linear swing or the backlash."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.kernels.records import Vector

AHEAD_US: Final = 45_000.0
"""A sleeve takes this long to its gear, so predictions are compared so far ahead."""
EACH_US: Final = 18_000.0
"""Every second step asks for a prediction: those of nearer ones overlap the more."""
LUCK: Final = 0.05
"""A prediction is never taken for quite wrong."""
FORGET: Final = 0.8
"""Weight of earlier windows against a new one."""
BELIEVED: Final = 5.0
"""Backlash is believed once its score is above this: it is then likelier by e to half of this."""
DROPPED: Final = 0.0
"""Backlash that is believed is dropped when its score falls to this: it is then no likelier than
the linear swing."""
LEAST_WINDOWS: Final = 3
"""Least number of windows before backlash is believed: in the first ones the linear swing has
little but its priors."""
MOST_A_WINDOW: Final = 8.0
"""One window, in which a model lost the driveline, counts for no more than this."""
REJECTED: Final = -4.0
"""At this score or below, backlash is so unlikely that it is no longer tried."""
RETRIED: Final = -3.0
"""Backlash that was rejected is tried again above this score: the windows that spoke against it are
then forgotten so far."""
LOWEST: Final = -6.0
"""The score falls no lower, however many windows speak against backlash, so that it is tried again
after the fourth: a cloud that loses its driveline twice speaks as strongly against a backlash as a
driveline that has none."""


class Prediction(NamedTuple):
    """An angle predicted, and its standard deviation."""

    angle_rad: float
    sd_rad: float


class LashRivals:
    """Scores of both models in one step of the range, over the windows seen."""

    def __init__(self) -> None:
        self._for_lash = 0.0
        self._windows = 0
        """How many have ended."""
        self._tried = True
        self._believed = False
        self._window = 0.0
        self._open: list[tuple[float, Prediction, Prediction]] = []
        self._newest: tuple[float, float] | None = None

    @property
    def believes_lash(self) -> bool:
        """Whether the backlash has predicted better so far."""
        return self._believed

    @property
    def tries_lash(self) -> bool:
        """Whether the backlash is worth a try."""
        return self._tried

    def restore(self, has_lash: bool) -> None:
        """Starts from what an earlier run believed."""
        self._for_lash = 2.0 * BELIEVED if has_lash else 0.0
        self._windows = LEAST_WINDOWS if has_lash else 0
        self._believed = has_lash

    def begin(self) -> None:
        """A window begins."""
        self._window, self._newest = 0.0, None
        self._open.clear()

    def wants(self, from_us: float) -> bool:
        """Whether the next predictions are due."""
        return not self._open or from_us + AHEAD_US >= self._open[-1][0] + EACH_US

    def predict(self, from_us: float, swing: Prediction, lash: Prediction) -> None:
        """Both predictions of the angle `AHEAD_US` after a time."""
        self._open.append((from_us + AHEAD_US, swing, lash))

    def judge(self, edges: Vector, within_rad: float) -> None:
        """Compares the predictions whose time has come with the edges, (2, n): how probable each
        made it that the angle is so near."""
        if not edges.shape[1]:
            return
        if self._newest is not None:
            edges = np.concatenate((np.array(self._newest)[:, np.newaxis], edges), axis=1)
        self._newest = (float(edges[0, -1]), float(edges[1, -1]))
        while self._open and self._open[0][0] <= edges[0, -1]:
            time_us, swing, lash = self._open.pop(0)
            angle = float(np.interp(time_us, edges[0], edges[1]))
            self._window += _deviance(swing, angle, within_rad) - _deviance(lash, angle, within_rad)

    def end(self) -> None:
        """The window is over. Predictions overlap: those of one horizon count as one."""
        self._windows += 1
        shown = min(max(self._window * STEP_SHARE, -MOST_A_WINDOW), MOST_A_WINDOW)
        self._for_lash = max(LOWEST, FORGET * self._for_lash + shown)
        self._tried = self._for_lash > (REJECTED if self._tried else RETRIED)
        enough = self._for_lash > (DROPPED if self._believed else BELIEVED)
        self._believed = self._windows >= LEAST_WINDOWS and enough


STEP_SHARE: Final = 20_000.0 / AHEAD_US
"""Time from one prediction to the next over the horizon."""


def _deviance(predicted: Prediction, angle_rad: float, within_rad: float) -> float:
    """Minus twice the logarithm of the probability given to the angle within half a gap."""
    scale = 1.0 / (math.sqrt(2.0) * predicted.sd_rad)
    off = angle_rad - predicted.angle_rad
    share = math.erf((off + within_rad) * scale) - math.erf((off - within_rad) * scale)
    return -2.0 * math.log(LUCK + (1.0 - LUCK) * 0.5 * share)
