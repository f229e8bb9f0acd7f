"""How a driveline swings while the gearbox is in neutral, learned from the ringing of every shift.

Two modes (`motion/swing_kernels`): the main shaft against the wheels, and both on the tyres. Their
frequencies, damping, and how far they swing when a gear comes out, differ between the steps of the
range. The figures are learned by the likelihood of a shift's edges (`likelihood`). A driveline that
rattles in its backlash is none of these (`lash_cloud`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.calibration.learned import SwingRecord
from meshpoint.controller.estimation.crossing_filter import CrossingFilter, Pressures
from meshpoint.controller.estimation.figure import Figure, prior
from meshpoint.controller.estimation.lash import LashFigures
from meshpoint.controller.estimation.likelihood import Search
from meshpoint.controller.estimation.swing_filter import MAIN_FILTER
from meshpoint.controller.motion.swing import ModeRates, SwingMotion
from meshpoint.controller.motion.swing_kernels import FIRST_MODE, MODES, STEADY
from meshpoint.controller.settings import CrossingFilterTuning
from meshpoint.kernels.records import Integers, Vector
from meshpoint.units import TURN

NATURAL, DAMPING, SPEED, NOISE = range(4)
"""Figures of a mode: natural frequency (rad/s), damping over critical damping, standard deviation
of its speed when a gear comes out (rad/s), density of the noise that drives it (rad2/s3)."""
OF_A_MODE: Final = 4
WHITE: Final = OF_A_MODE * MODES
HILL: Final = WHITE + 1
EDGE_TIME: Final = HILL + 1
"""Density of the white noise of the shaft's acceleration, standard deviation of the steady
acceleration when a gear comes out (rad/s2), standard deviation of an edge's time (s)."""
LEAST_EDGES: Final = 60
"""A window with fewer edges is not learned from."""
MOST_SD: Final = 2.5
"""A frequency is looked for within this many standard deviations."""
START_SHARE: Final = 1.5
"""A gear comes out under another torque each time: how far the shaft swings then is taken to be so
much more than what was learned."""
DAMPED_BY: Final = 0.9
"""Most damping over critical: a mode beyond that does not swing."""


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
        noise = prior(tuning.swing_noise_rad2_s3, 8.0, (1e-6, 1e5), 0.2)
        modes = [
            figure
            for hertz, factor, reach, speed in (
                (
                    tuning.near_hz,
                    tuning.near_factor,
                    tuning.near_factor**MOST_SD,
                    tuning.near_rad_s,
                ),
                (tuning.far_hz, tuning.far_factor, tuning.far_factor**MOST_SD, tuning.far_rad_s),
            )
            for figure in (
                prior(TURN * hertz, factor, (TURN * hertz / reach, TURN * hertz * reach), 0.005),
                prior(tuning.swing_damping, 2.0, (1e-3, DAMPED_BY), 0.05),
                prior(speed, 4.0, (1e-3, 50.0), 0.3),
                noise,
            )
        ]
        hill = prior(tuning.main_start_rad_s2, 4.0, (1e-2, 1e3), 0.3)
        self._figures = [*modes, noise, hill]
        self.shifts = 0
        """From how many shifts it was learned."""
        self.motion = self._doubting()

    def record(self, lash: LashFigures, has_lash: bool) -> SwingRecord | None:
        """What a calibration file keeps, with what is known of the backlash; None before the first
        shift it was learned from."""
        if self.shifts == 0:
            return None
        modes = [self._figures[4 * m : 4 * m + 4] for m in range(MODES)]
        by_kind = [tuple(mode[kind] for mode in modes) for kind in range(OF_A_MODE)]
        natural, damping, speed, noise = by_kind
        noise = (*noise, self._figures[WHITE])
        hill = self._figures[HILL]
        return SwingRecord(
            self.shifts,
            *_parts(natural),
            *_parts(damping),
            *_parts(speed),
            *_parts(noise),
            hill.value,
            hill.sd,
            has_lash,
            lash.half.value,
            lash.half.sd,
        )

    def restore(self, record: SwingRecord) -> None:
        """Starts from a record."""
        self.shifts = record.shifts
        given = [
            (record.natural_rad_s, record.natural_sd),
            (record.damping, record.damping_sd),
            (record.speed_rad_s, record.speed_sd),
            (record.noise_rad2_s3, record.noise_sd),
        ]
        figures = list(self._figures)
        for kind, (values, sds) in enumerate(given):
            for m in range(MODES):
                k = OF_A_MODE * m + kind
                figures[k] = figures[k].restored(values[m], sds[m])
        figures[WHITE] = figures[WHITE].restored(record.noise_rad2_s3[-1], record.noise_sd[-1])
        figures[HILL] = figures[HILL].restored(record.hill_rad_s2, record.hill_sd)
        self._figures = figures
        self.motion = self._doubting()

    def _doubting(self) -> SwingMotion:
        """The model with what is not known of its figures as noise. A mode that is off by a share e
        of its frequency, or by d of its decay, accelerates otherwise than was thought by 2 e w or
        2 d times its speed, for about 1 / w at a time."""
        motion = self._motion([one.log for one in self._figures])
        modes = motion.part("modes")
        for m in range(MODES):
            natural, damping, speed = self._figures[4 * m : 4 * m + 3]
            rate = damping.value * natural.value * damping.sd
            doubt = natural.sd**2 * natural.value + rate * rate / natural.value
            modes["noise_rad2_s3"][m] += 4.0 * doubt * speed.value**2
        return motion

    def _motion(self, logs: Sequence[float]) -> SwingMotion:
        modes = []
        for m in range(MODES):
            natural, damping, _, noise = (math.exp(log) for log in logs[m * 4 : m * 4 + 4])
            modes.append(ModeRates(natural, min(damping, DAMPED_BY) * natural, noise))
        walk = self._tuning.main_walk_rad_s2**2
        return SwingMotion(math.exp(logs[WHITE]), walk, modes)

    def start(self, x: Vector, p: Vector, logs: Sequence[float] | None = None) -> None:
        """A gear has come out: what is known of angle and speed is kept, the rest of state and
        covariance is what it may be then."""
        share = START_SHARE if logs is None else 1.0
        logs = [one.log for one in self._figures] if logs is None else logs
        x[2:], p[2:, :], p[:, 2:] = 0.0, 0.0, 0.0
        p[STEADY, STEADY] = (share * math.exp(logs[HILL])) ** 2
        for m in range(MODES):
            natural = math.exp(logs[4 * m + NATURAL])
            speed = share * math.exp(logs[4 * m + SPEED])
            i = FIRST_MODE + 2 * m
            p[i, i], p[i + 1, i + 1] = (speed / natural) ** 2, speed * speed

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


def _parts(figures: tuple[Figure, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return tuple(one.value for one in figures), tuple(one.sd for one in figures)


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
