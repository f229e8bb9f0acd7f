"""The Hall sensors of the truck: as-built wheels, and the content of a 10 ms read.

The sensor's voltage is u = A sin(n theta') + 0, an edge where it passes the threshold u_0 (thesis
4.5, 3.3): theta' = asin(u_0 / A) / n on the way up and (pi - asin(u_0 / A)) / n on the way down,
less the duty's share. theta' is the angle on a wheel with pitch errors and an eccentricity e, which
shifts tooth k by (e / R) sin(theta_k + eta) and its air gap by e cos(theta_k + eta); the amplitude
falls exponentially with the gap and linearly with temperature. So a threshold off the middle moves
both edges of a tooth apart or together, tooth by tooth. `tests/rig_sim/analog.py` has the
same without a formula.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from meshpoint.gearbox.sheet import GearboxSheet
from meshpoint.gearbox.wheels import Wheel
from meshpoint.kernels.structures import Floats, RecordArray
from meshpoint.rig_sim.parts.drag import WARM_K
from meshpoint.rig_sim.shared.angle_kernels import TAU
from meshpoint.rig_sim.shared.capture_records import CHANNELS, WHEELS
from meshpoint.rig_sim.shared.edge_ring import (
    ENCODER_MODULUS,
    ENCODER_SAMPLES_S,
    ENCODER_STEPS_PER_TURN,
    EdgeRead,
    RingReader,
)
from meshpoint.rig_sim.shared.sensor_clock import SensorClock
from meshpoint.rig_sim.truck import layout as at
from meshpoint.rig_sim.truck.as_built import AsBuilt
from meshpoint.rig_sim.truck.constants import CELSIUS
from meshpoint.rig_sim.truck.layout import Rig

WEAKEST: Final = 0.05
LOAD_DIRECTION: Final = 7.3
CROSSING_LIMIT: Final = 0.98
"""Largest threshold over amplitude: above it the edge would be lost, which the sensor's own
threshold control prevents."""


class WheelAsMade:
    """One sensor wheel: the angles of its teeth, and the signal's amplitude at each."""

    def __init__(self, rng: np.random.Generator, wheel: Wheel, built: AsBuilt) -> None:
        n = wheel.teeth
        self.pitches = n
        self.present = np.array([k for k in range(n) if k not in wheel.missing])
        self.teeth = len(self.present)
        largest = math.radians(built["hall.pitch_error_deg"])
        errors = largest * rng.uniform(-1.0, 1.0, n)
        self.eccentric_rad = float(rng.uniform(0.0, TAU))
        angles = TAU / n * np.arange(n)
        ripple = built["hall.runout_mm"] / built["hall.wheel_radius_mm"]
        self.errors_rad: Floats = errors + ripple * np.sin(angles + self.eccentric_rad)
        self.gap_mm: Floats = built["hall.runout_mm"] * np.cos(angles + self.eccentric_rad)
        self.duty = wheel.duty_share + built["hall.duty_percent"] / 100.0
        self.amplitude: Floats = self._amplitude(built)
        self.threshold = built["hall.threshold_share"]
        self._load_ripple = built["hall.load_runout_mm"] / built["hall.wheel_radius_mm"]
        # not drawn by itself, which would move the draws after it
        self._load_rad = self.eccentric_rad * LOAD_DIRECTION

    def _amplitude(self, built: AsBuilt) -> Floats:
        warmer_k = built["oil.temperature_c"] + CELSIUS - WARM_K
        weaker = max(1.0 - built["hall.weaker_per_k"] * warmer_k, WEAKEST)
        amplitude: Floats = weaker * np.exp(-built["hall.weaker_per_mm"] * self.gap_mm)
        return amplitude

    def warm(self, built: AsBuilt) -> None:
        """Another oil temperature."""
        self.amplitude = self._amplitude(built)

    def drifts_rad(self) -> Floats:
        """How far full load moves the edges of each tooth that is not missing: the shaft bends
        aside, which adds an eccentricity of its own direction."""
        angles = TAU / self.pitches * np.arange(self.pitches)
        drifts: Floats = (self._load_ripple * np.sin(angles + self._load_rad))[self.present]
        return drifts

    def edges_rad(self) -> tuple[Floats, Floats]:
        """Wheel angles (rad) of the rising and the falling edge of each tooth that is not
        missing."""
        n = self.pitches
        share = np.clip(self.threshold / self.amplitude, -CROSSING_LIMIT, CROSSING_LIMIT)
        later = np.arcsin(share) / n
        middle = TAU / n * np.arange(n) + self.errors_rad
        there = self.present
        return (middle + later)[there], (middle + self.duty * TAU / n - later)[there]


class TruckEdges:
    """The capture channels and the reference encoder; `advance` writes the rig's memory."""

    def __init__(self, sheet: GearboxSheet, built: AsBuilt, rig: Rig) -> None:
        rng = np.random.Generator(np.random.PCG64(built.teeth_seed))
        self.wheels = [WheelAsMade(rng, wheel, built) for wheel in sheet.wheels.rows.values()]
        self._rig = rig
        rig.wheel_rate[:] = [1.0] * WHEELS
        self._load_edges()
        wrong = int(built["hall.first_wrong_edges"])
        largest = math.radians(built["hall.first_wrong_deg"])
        errors_rad = largest * rng.uniform(-1.0, 1.0, (CHANNELS, wrong))
        for hall, first_rad in zip(rig.hall, errors_rad.tolist(), strict=True):
            hall.first_rad[:wrong] = first_rad
        jitter = np.clip(rng.standard_normal(at.JITTERS), -4.0, 4.0)
        rig.jitter_s[:] = (jitter * built["hall.jitter_us"] * 1e-6).tolist()
        for past in rig.history:
            past.turns = rig.laps[at.LAYSHAFT]
            past.rest_rad = rig.y.angle_rad[at.LAYSHAFT]
        self._captured = RecordArray(rig.captured)
        self._reader = RingReader()
        self._on_us = 0.0
        for edge in range(CHANNELS):
            self._point(edge)

    def warm(self, built: AsBuilt) -> None:
        """Another oil temperature: where a signal is weaker, its edges lie elsewhere."""
        for made in self.wheels:
            made.warm(built)
        self._load_edges()

    def _load_edges(self) -> None:
        for wheel, made in enumerate(self.wheels):
            for row, edges_rad in enumerate(made.edges_rad()):
                hall = self._rig.hall[2 * wheel + row]
                hall.teeth = made.teeth
                hall.edges_rad[: made.teeth] = edges_rad.tolist()
                hall.drift_rad[: made.teeth] = made.drifts_rad().tolist()

    def _point(self, edge: int) -> None:
        """Sets a channel's pointer to its next edge in forward rotation."""
        rig, hall, channel = self._rig, self._rig.hall[edge], self._rig.captured.channels[edge]
        body = at.BODY_OF_WHEEL[edge // 2]
        rest = rig.y.angle_rad[body]
        if body == at.INPUT:
            rest += rig.y.input_lash_rad
        channel.lap = rig.laps[body] - 1
        while True:
            angle = hall.edges_rad[channel.tooth] + hall.first_rad[0]
            if angle + TAU * (channel.lap - rig.laps[body]) > rest:
                return
            channel.tooth += 1
            if channel.tooth == hall.teeth:
                channel.tooth = 0
                channel.lap += 1

    def read(self, now_us: int, clock: SensorClock) -> list[EdgeRead]:
        """The read of all channels now, in the order of the wire contract. An extra edge that is
        still to come is not in it."""
        return self._reader.read(now_us, self._on_us, clock, self._captured)

    def power_up(self, time_us: float) -> None:
        """Restarts the sensors: counts begin at zero, and the first edges are misplaced again."""
        self._on_us = time_us
        for channel in self._rig.captured.channels:
            channel.count = 0

    def encoder(
        self, now_us: int, omega_rad_s: float
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Layshaft angles (rad modulo 256 turns, in encoder steps) and speeds, newest first."""
        history = self._rig.history
        angles, speeds = [], []
        for back_s in ENCODER_SAMPLES_S:
            time_us = now_us - round(back_s * 1e6)
            past = history[time_us // at.HISTORY_STEP_US % at.HISTORY if time_us > 0 else 0]
            rest, speed = past.rest_rad, past.speed_rad_s
            if time_us <= 0:
                speed = omega_rad_s if now_us == 0 else speed
                rest += speed * time_us * 1e-6
            whole = past.turns * ENCODER_STEPS_PER_TURN
            steps = whole + round(rest / TAU * ENCODER_STEPS_PER_TURN)
            angles.append(steps % ENCODER_MODULUS * (TAU / ENCODER_STEPS_PER_TURN))
            speeds.append(speed)
        return tuple(angles), tuple(speeds)
