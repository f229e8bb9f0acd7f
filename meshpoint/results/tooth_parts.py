"""A wheel's edge errors taken apart, for people: duty bias, eccentricity, pitch errors.

Edge 2 k rises with tooth k, edge 2 k + 1 falls. With the mean error zero

    e = -+ d/2 + a cos(k pitch - at) + rest

where d is by how much a tooth is wider than drawn (minus where it rises, plus where it falls), a
the ripple once a turn of a wheel that runs off its centre, and the rest each edge's own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class ToothParts(NamedTuple):
    """Angles in rad."""

    wider_rad: float
    """A tooth's width less that of the drawing."""
    eccentricity_rad: float
    """Amplitude of the ripple once a turn: e/R of a wheel e off its centre."""
    eccentric_tooth: int
    """The tooth at which the ripple is largest."""
    pitch_rms_rad: float
    pitch_worst_rad: float
    """What is left of an edge's error, in the mean and at most."""


def take_apart(error_rad: Sequence[float]) -> ToothParts:
    """The parts of a wheel's errors, two edges a tooth; least squares."""
    edges = np.asarray(error_rad, float)
    teeth = edges.size // 2
    angle = np.repeat(np.arange(teeth) * 2.0 * math.pi / teeth, 2)
    side = np.tile([-0.5, 0.5], teeth)
    parts = np.column_stack((side, np.cos(angle), np.sin(angle)))
    # The columns are orthogonal on a whole turn of three teeth or more.
    wider, cosine, sine = (parts.T @ edges) / (parts**2).sum(axis=0)
    rest = edges - parts @ (wider, cosine, sine)
    at = math.atan2(sine, cosine) % (2.0 * math.pi)
    return ToothParts(
        float(wider),
        math.hypot(cosine, sine),
        round(at / (2.0 * math.pi) * teeth) % teeth,
        float(np.sqrt(np.mean(rest**2))),
        float(np.abs(rest).max()),
    )
