"""Whether the driveline rings once a gear is out: shafts and tyres that twist, or rigid ones."""

from __future__ import annotations

from typing import Final

import numpy as np

from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import GearboxSheet, MainGear

RINGS_RAD_S: Final = 0.25
"""Standard deviation of the main shaft's speed about a straight line above which it rings (2.4 rpm,
7 rpm from peak to peak): that moves a gear's tooth against its sleeve by half a gap within 45 ms.
Errors of the sensor wheel's teeth are 0.1 rad/s."""
LEAST_MEASUREMENTS: Final = 6
"""Measurements, one a read of the sensors, from which a line can be distinguished from a swing."""
FREE_STATES: Final = frozenset({State.SYNCHRONISING, State.COASTING})


class DrivelineRings:
    """Learned from the main shaft's speed in neutral, from when the old gear is out until the
    sleeve is fired for the new one."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self.twists = False
        """Whether shafts between engine and road are known to twist: seen to ring, and by how much
        the sheet says. What once did twists for good."""
        self._is_told = sheet.driveline.stiffness_nm_rad > 0.0
        self._measurements: list[tuple[int, float]] = []

    def measure(self, state: State, snapshot: StepSnapshot) -> None:
        """One step: one without a new speed shows nothing."""
        main = snapshot.speeds.main
        is_free = state in FREE_STATES and snapshot.view.main_gear is MainGear.NEUTRAL
        if is_free and main is not None:
            if not self._measurements or main != self._measurements[-1][1]:
                self._measurements.append((snapshot.now_us, main))
            return
        if len(self._measurements) >= LEAST_MEASUREMENTS and not self.twists:
            self.twists = self._is_told and self._swing_rad_s() > RINGS_RAD_S
        self._measurements.clear()

    def _swing_rad_s(self) -> float:
        """Standard deviation about the straight line that suits the measurements best."""
        time_us, speed = np.array(self._measurements).T
        time_s = 1e-6 * (time_us - time_us[0])
        line = np.column_stack((np.ones_like(time_s), time_s))
        _, squares, _, _ = np.linalg.lstsq(line, speed, rcond=None)
        return float(np.sqrt(squares.sum() / (len(speed) - line.shape[1])))
