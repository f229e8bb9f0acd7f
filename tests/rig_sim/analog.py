"""The analog route of thesis 4.5, kept as a slow reference: a sine for every tooth, sampled at
1 MHz, edges where it passes the threshold. It knows the wheel, not the formula for its edges."""

from __future__ import annotations

import math

import numpy as np

from meshpoint.kernels.structures import Floats
from meshpoint.rig_sim.truck.edges import WheelAsMade

TAU = 2.0 * math.pi
SAMPLE_S = 1e-6


def edges_of_sine(
    wheel: WheelAsMade, start_rad: float, omega_rad_s: float, duration_s: float
) -> tuple[list[int], list[int]]:
    """Sample numbers of the rising and the falling edges at constant speed."""
    samples = np.arange(round(duration_s / SAMPLE_S))
    return edges_of_angles(wheel, start_rad + omega_rad_s * samples * SAMPLE_S)


def edges_of_angles(wheel: WheelAsMade, theta: Floats) -> tuple[list[int], list[int]]:
    """Sample numbers of the rising and the falling edges of a wheel at these angles. Each tooth's
    sine has the tooth's own place and amplitude; duty 50 %."""
    n = wheel.pitches
    pitch = TAU / n
    # which tooth is under the sensor: from a quarter pitch before its middle rise, all around
    tooth = np.floor(theta / pitch + 0.25).astype(int) % n
    local = (theta - wheel.errors_rad[tooth]) * n
    above = wheel.amplitude[tooth] * np.sin(local) > wheel.threshold
    change = np.flatnonzero(above[1:] != above[:-1])
    rises = [int(i) for i in change if above[i + 1]]
    falls = [int(i) for i in change if not above[i + 1]]
    return rises, falls
