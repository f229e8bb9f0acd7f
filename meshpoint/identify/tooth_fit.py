"""The places of a sensor wheel's edges: least squares over all runs, motion a polynomial in each.

A tooth's error comes back every turn and motion does not: in spans of about two turns each, the
angle is a polynomial of time plus the error of the edge. Their mean cannot be seen. A brake whose
torque changes once and twice a turn moves the shaft in step with its teeth, but by p / (k w)^2: it
is fitted beside them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from meshpoint.identify.brake_fit import BrakeFit, whitening
from meshpoint.identify.brake_trajectory import (
    GRID_S,
    BrakeTrajectories,
    Trajectory,
    angles_at,
)
from meshpoint.identify.jackknife import jackknife_sd, student
from meshpoint.identify.log_reader import Wheel
from meshpoint.kernels.records import Vector
from meshpoint.units import TURN, US

SPAN_TURNS: Final = 2.0
ORDER: Final = 5
"""Of the polynomial: a brake that comes on or goes off within a span bends the speed."""
LEAST_EDGES: Final = 60
PRIOR_RAD: Final = 0.02
EDGE_RAD: Final = 3e-4
"""Of an edge's angle beside its tooth's error; it weighs the prior alone."""
MOST_ODD: Final = 4.0
"""A span with more left of it than this many times what is usual was not smooth: a sleeve
struck."""
JITTER_RAD: Final = 5e-4
"""Of an edge's angle, by its time's jitter."""
JUDDER: Final = 4
JUDDER_RAD_S: Final = 100.0
JUDDER_PA: Final = 8.5e5
"""Speed and pressure at which the brake's amplitudes are reported."""
GROUPS: Final = 20
"""Groups of runs that are left out in turn."""


@dataclass(frozen=True)
class ToothFit:
    """Errors of 2 z edges, and without each group of runs."""

    error_rad: Vector
    """Of each of the wheel's edges, (2 z,)."""
    without: Vector
    """The same without each group of runs, (groups, 2 z)."""
    judder: Vector
    """Amplitudes of what the brake adds, at 100 rad/s and full pressure: cosine and sine once a
    turn, then twice (rad)."""
    held_out_rad: float = 0.0
    """RMS of the angles' errors in groups of runs, by what the others say of the teeth."""
    nominal_rad: float = 0.0
    """RMS of the same errors by a perfect wheel."""
    spans: int = 0
    """In how many parts of runs these errors were taken."""

    @property
    def sd_rad(self) -> Vector:
        """Standard deviation of each edge's error."""
        return jackknife_sd(self.without)

    @property
    def half_rad(self) -> Vector:
        """Half the 95 % interval of each edge's error."""
        return student(self.without.shape[0] - 1) * self.sd_rad


def tooth_fit(
    wheels: Sequence[Wheel], teeth: int, pressures: Sequence[Vector] | None = None
) -> ToothFit | None:
    """None where the runs do not show every edge. pressures: of the brake beside each wheel that it
    brakes, samples (2, n) of time (us) and gauge pressure (Pa)."""
    edges = 2 * teeth
    groups = min(GROUPS, len(wheels))
    if groups < 2:
        return None
    spans = [
        (number % groups, span)
        for number, wheel in enumerate(wheels)
        for span in _spans(wheel, edges, None if pressures is None else pressures[number])
    ]
    found = _fit_spans(spans, groups, edges)
    if found is None:
        return None
    rest = np.array([span.rest(found.error_rad, found.judder) for _, span in spans])
    smooth = rest <= MOST_ODD * np.median(rest)
    kept = [one for one, keep in zip(spans, smooth, strict=True) if keep]
    found = _fit_spans(kept, groups, edges)
    if found is None:
        return None
    known = [span.rest(found.without[group], found.judder) for group, span in kept]
    nothing, still = np.zeros(edges), np.zeros(JUDDER)
    nominal = [span.rest(nothing, still) for _, span in kept]
    rms = [float(np.sqrt(np.mean(one))) for one in (known, nominal)]
    return replace(found, held_out_rad=rms[0], nominal_rad=rms[1], spans=len(kept))


def teeth_by_model(
    first: ToothFit, trajectories: Sequence[Trajectory], model: BrakeTrajectories, best: BrakeFit
) -> ToothFit | None:
    """The layshaft's teeth once more, with motion as the brake's model has it, and a torque of
    chance beside it, instead of polynomials: these cannot tell a short run's motion from an
    eccentric wheel. trajectories: those that the model was fitted to, of the same order."""
    edges = first.error_rad.size
    groups = min(GROUPS, len(trajectories))
    angles, speeds, felts = model.run(best.parameters[None], best.omega_rad_s)
    spans = []
    for number, trajectory in enumerate(trajectories):
        motion = angles_at(trajectory.nodes_of_edges, angles[:, 0, number], speeds[:, 0, number])
        node = trajectory.nodes_of_edges.astype(np.int64)
        share = felts[node, 0, number] / JUDDER_PA
        speed = speeds[node, 0, number]
        shape = _judder_shape(share, speed, trajectory.place, edges)
        spans.append((number % groups, _ModelSpan(trajectory, motion, shape, edges)))
    found = _fit_spans(spans, groups, edges, PRIOR_RAD**-2.0)
    if found is None:
        return None
    return replace(
        found,
        held_out_rad=first.held_out_rad,
        nominal_rad=first.nominal_rad,
        spans=first.spans,
    )


class _ModelSpan:
    """A whole run, the model's motion taken out and its errors made independent."""

    def __init__(self, trajectory: Trajectory, motion: Vector, judder: Vector, edges: int) -> None:
        seconds = (trajectory.nodes_of_edges - trajectory.first_node) * GRID_S
        white = whitening(seconds, np.full(seconds.size, JITTER_RAD**2))
        own, _ = np.linalg.qr(white @ np.stack((np.ones(seconds.size), seconds), axis=1))
        picked = np.zeros((seconds.size, edges + JUDDER))
        picked[np.arange(seconds.size), trajectory.place.astype(np.int64)] = -1.0
        picked[:, edges:] = judder
        left = white @ (trajectory.theta_rad - motion)
        self.left = left - own @ (own.T @ left)
        self.picked = white @ picked
        self.coupled = own.T @ self.picked


def _fit_spans(
    spans: Sequence[tuple[int, _Span | _ModelSpan]],
    groups: int,
    edges: int,
    weight: float = (EDGE_RAD / PRIOR_RAD) ** 2,
) -> ToothFit | None:
    """weight: of the prior, one over its variance in units of the spans' errors."""
    size = edges + JUDDER
    normal, right = np.zeros((groups, size, size)), np.zeros((groups, size))
    for group, span in spans:
        normal[group] += span.picked.T @ span.picked - span.coupled.T @ span.coupled
        right[group] += span.picked.T @ span.left
    whole: Vector = normal.sum(axis=0)
    all_right: Vector = right.sum(axis=0)
    if np.any(np.diag(whole)[:edges] == 0.0):
        return None
    weak = weight * np.eye(size)
    error = _solved(whole + weak, all_right)
    without = np.array(
        [_solved(whole - normal[g] + weak, all_right - right[g]) for g in range(groups)]
    )
    return ToothFit(error[:edges], without[:, :edges], error[edges:])


def _solved(normal: Vector, right: Vector) -> Vector:
    error: Vector = np.linalg.solve(normal, right).astype(np.float64)
    error[:-JUDDER] -= error[:-JUDDER].mean()
    return error


class _Span:
    """A part of a run, its motion taken out."""

    def __init__(
        self, time: Vector, theta: Vector, place: Vector, edges: int, pressure: Vector | None
    ) -> None:
        scaled = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
        basis, _ = np.linalg.qr(np.polynomial.legendre.legvander(scaled, ORDER))
        self._basis = basis
        left = theta - theta[0]
        self.left = left - basis @ (basis.T @ left)
        """What a polynomial of time does not explain (rad)."""
        self.picked = np.zeros((place.size, edges + JUDDER))
        # A true angle is the nominal one plus the edge's error: what is left is its negative.
        self.picked[np.arange(place.size), place.astype(np.int64)] = -1.0
        if pressure is not None and pressure.shape[1] > 1:
            self.picked[:, edges:] = _judder(time, theta, place, edges, pressure)
        self.coupled = basis.T @ self.picked

    def rest(self, error_rad: Vector, judder: Vector) -> float:
        """Mean square of what the edges' errors leave."""
        own = (
            self.picked[:, : error_rad.size] @ error_rad + self.picked[:, error_rad.size :] @ judder
        )
        rest = self.left - own + self._basis @ (self._basis.T @ own)
        return float(np.mean(rest**2))


def _judder(time: Vector, theta: Vector, place: Vector, edges: int, pressure: Vector) -> Vector:
    """What amplitudes of one would add to the angles, (n, JUDDER); the place on the wheel is that
    on the disc."""
    seconds = (time - time[0]) * US
    speed = np.polyval(np.polyder(np.polyfit(seconds, theta - theta[0], 3)), seconds)
    share = np.interp(time, pressure[0], pressure[1]) / JUDDER_PA
    return _judder_shape(share, speed, place, edges)


def _judder_shape(share: Vector, speed: Vector, place: Vector, edges: int) -> Vector:
    """share: of the full pressure; speed: rad/s."""
    share = np.maximum(share, 0.0) * (JUDDER_RAD_S / np.maximum(speed, 10.0)) ** 2
    once = TURN / edges * place
    parts = (np.cos(once), np.sin(once), np.cos(2.0 * once) / 4.0, np.sin(2.0 * once) / 4.0)
    return np.stack([share * part for part in parts], axis=1)


def _spans(wheel: Wheel, edges: int, pressure: Vector | None) -> list[_Span]:
    """Parts of a run that turn the wheel by about `SPAN_TURNS` each."""
    theta = wheel.theta_rad
    if theta.size < LEAST_EDGES:
        return []
    count = max(1, int((theta[-1] - theta[0]) / (SPAN_TURNS * TURN)))
    cuts = np.linspace(0, theta.size, count + 1).astype(int)
    return [
        _Span(wheel.time_us[a:b], theta[a:b], wheel.place[a:b], edges, pressure)
        for a, b in itertools.pairwise(cuts.tolist())
        if b - a >= LEAST_EDGES
    ]


@dataclass(frozen=True)
class WheelFigures:
    """What people ask of a wheel."""

    duty_share: float
    """From rising to falling edge, over the pitch."""
    eccentricity_rad: float
    """Amplitude once a turn, of the teeth's middles."""
    pitch_rms_rad: float
    """Of the teeth's places, eccentricity taken out."""


def wheel_figures(error_rad: Vector, duty_share: float) -> WheelFigures:
    """From the errors of all edges. duty_share: of the data sheet."""
    rise, fall = error_rad[::2], error_rad[1::2]
    teeth = rise.size
    middle = 0.5 * (rise + fall)
    middle = middle - middle.mean()
    angles = TURN * np.arange(teeth) / teeth
    once = 2.0 / teeth * complex(np.sum(middle * np.exp(-1j * angles)))
    rest = middle - np.real(once * np.exp(1j * angles))
    return WheelFigures(
        duty_share + float((fall - rise).mean()) * teeth / TURN,
        abs(once),
        float(np.sqrt(np.mean(rest**2))),
    )
