"""How a driveline swings while the gearbox is in neutral, learned from the ringing of every shift.

The main shaft swings against the wheels (`models/swing`). Frequency, damping, and how far
it swings when a gear comes out, differ between the steps of the range. The figures are learned by
the likelihood of a shift's edges (`figures`). A driveline that rattles in its backlash moves
otherwise (`lash_cloud`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimate.crossing_filter import MAIN_FILTER, CrossingFilter, Pressures
from meshpoint.controller.estimate.figures import Figure, Search, prior
from meshpoint.controller.estimate.lash import LashFigures
from meshpoint.controller.models.swing import RATE, STEADY, SWING, SwingMotion, SwingRates
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.controller.settings.learned import SwingRecord
from meshpoint.kernels.records import Integers, Vector
from meshpoint.units import TURN

NATURAL, DAMPING, SPEED, NOISE, WHITE, HILL, EDGE_TIME = range(7)
"""Figures: natural frequency (rad/s), damping over critical damping, standard deviation of the
swing's speed when a gear comes out (rad/s), density of the noise that drives the swing, density of
the white noise of the shaft's acceleration (rad2/s3), standard deviation of the steady acceleration
when a gear comes out (rad/s2), standard deviation of an edge's time (s)."""
LEAST_EDGES: Final = 60
"""A window with fewer edges is not learned from."""
MOST_SD: Final = 2.5
"""A frequency is looked for within this many standard deviations."""
START_SHARE: Final = 1.5
"""A gear comes out under another torque each time: how far the shaft swings then is taken to be so
much more than what was learned."""
DAMPED_BY: Final = 0.9
"""Most damping over critical: beyond that nothing swings."""


class MainWindow(NamedTuple):
    """The edges of one interval in neutral: times (us), angles (rad), and the state it began in."""

    edges: Vector
    time_us: float
    x: Vector
    p: Vector
    tooth_rad: float
    """Standard deviation of an edge's angle."""


class DrivelineSwing:
    """What is known of the swing in one step of the range."""

    def __init__(self, tuning: CrossingFilterTuning) -> None:
        self._tuning = tuning
        natural, reach = TURN * tuning.swing_hz, tuning.swing_factor**MOST_SD
        noise = prior(tuning.swing_noise_rad2_s3, 8.0, (1e-6, 1e5), 0.2)
        self._figures = [
            prior(natural, tuning.swing_factor, (natural / reach, natural * reach), 0.005),
            prior(tuning.swing_damping, 2.0, (1e-3, DAMPED_BY), 0.05),
            prior(tuning.swing_rad_s, 4.0, (1e-3, 50.0), 0.3),
            noise,
            noise,
            prior(tuning.main_start_rad_s2, 4.0, (1e-2, 1e3), 0.3),
        ]
        self.shifts = 0
        """From how many shifts it was learned."""
        self.motion = self._doubting()

    def record(self, lash: LashFigures, has_lash: bool) -> SwingRecord | None:
        """What a calibration file keeps, with what is known of the backlash; None before the first
        shift it was learned from."""
        if self.shifts == 0:
            return None
        return SwingRecord.of(*self._figures, lash.half, shifts=self.shifts, has_lash=has_lash)

    def restore(self, record: SwingRecord) -> None:
        """Starts from a record."""
        self.shifts = record.shifts
        swings = record.figures[: len(self._figures)]
        self._figures = [
            one.restored(*kept) for one, kept in zip(self._figures, swings, strict=True)
        ]
        self.motion = self._doubting()

    def _doubting(self) -> SwingMotion:
        """The model with what is not known of its figures as noise. A swing that is off by a share
        e of its frequency, or by d of its decay, accelerates otherwise than was thought by 2 e w or
        2 d times its speed, for about 1 / w at a time."""
        motion = self._motion([one.log for one in self._figures])
        natural, damping, speed = self._figures[:NOISE]
        rate = damping.value * natural.value * damping.sd
        doubt = natural.sd**2 * natural.value + rate * rate / natural.value
        motion.part("noise_rad2_s3")[0] += 4.0 * doubt * speed.value**2
        return motion

    def _motion(self, logs: Sequence[float]) -> SwingMotion:
        natural, damping, _, noise, white = (math.exp(log) for log in logs[:HILL])
        rates = SwingRates(natural, min(damping, DAMPED_BY) * natural, noise)
        return SwingMotion(white, self._tuning.main_walk_rad_s2**2, rates)

    def start(self, x: Vector, p: Vector, logs: Sequence[float] | None = None) -> None:
        """A gear has come out: what is known of angle and speed is kept, the rest of state and
        covariance is what it may be then."""
        share = START_SHARE if logs is None else 1.0
        logs = [one.log for one in self._figures] if logs is None else logs
        x[2:], p[2:, :], p[:, 2:] = 0.0, 0.0, 0.0
        p[STEADY, STEADY] = (share * math.exp(logs[HILL])) ** 2
        natural, speed = math.exp(logs[NATURAL]), share * math.exp(logs[SPEED])
        p[SWING, SWING], p[RATE, RATE] = (speed / natural) ** 2, speed * speed

    def search(self, window: MainWindow, edge_time: Figure, teeth_known: bool) -> Search:
        """Looks for the figures in a window, and for an edge's time where the teeth are known."""
        none, switches = Pressures(np.empty(0), np.empty(0)), np.empty((2, 0))
        run, count = CrossingFilter(self._tuning, MAIN_FILTER), window.edges.shape[1]

        def deviance(logs: Sequence[float]) -> float:
            run.set_edge_time(math.exp(logs[EDGE_TIME]))
            x, p = window.x.copy(), window.p.copy()
            self.start(x, p, logs)
            run.begin(window.time_us, x, p)
            run.take(window.edges, window.tooth_rad, none, switches, self._motion(logs))
            return run.deviance(count)

        held = () if teeth_known else (EDGE_TIME,)
        return Search([*self._figures, edge_time], deviance, (NATURAL,), held)

    def take(self, found: Sequence[Figure]) -> Figure:
        """Takes over what was found in one more window; returns what is known of an edge's time."""
        self._figures = list(found[:EDGE_TIME])
        self.motion = self._doubting()
        self.shifts += 1
        return found[EDGE_TIME]


class EdgeRun:
    """The edges of a wheel since its shaft became free, to go through them again."""

    def __init__(self) -> None:
        self._edges: list[Vector] = []
        self._places: list[Integers] = []

    def begin(self) -> None:
        """A window begins."""
        self._edges.clear()
        self._places.clear()

    def add(self, time_us: Vector, theta_rad: Vector, places: Integers) -> None:
        """New edges: times, nominal angles, and which of the wheel's edges each is."""
        self._edges.append(np.array((time_us, theta_rad)))
        self._places.append(places)

    @property
    def edges(self) -> Vector:
        """Times (us) and nominal angles (rad), (2, n)."""
        return np.concatenate(self._edges, axis=1) if self._edges else np.empty((2, 0))

    @property
    def places(self) -> Integers:
        """Which of the wheel's edges each is."""
        return np.concatenate(self._places) if self._places else np.empty(0, dtype=np.int64)
