"""What the sequence sees of the driveline from step to step, and learns from shift to shift."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from meshpoint.controller.shift.ringing import DrivelineRings
from meshpoint.controller.shift.step_snapshot import StepSnapshot
from meshpoint.controller.shift.swing_fit import EngineTrajectory, Known, SwingFit, fit_swing
from meshpoint.controller.shift.unloading import DISTINCT_SDS, GearedBodies
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.gearbox import GearboxSheet
from meshpoint.units import US

ENGINE_MEASUREMENTS: Final = 6
"""The engine's acceleration is that of its last 50 ms."""
MOST_MEASUREMENTS: Final = 400
LEAST_MEASUREMENTS: Final = 25
"""Fewer say nothing of a swing."""
LOADED_SHARE: Final = 0.5
"""Between two shifts a trailer may have been coupled or a load taken up: 1 / J_2 changes by this
share of what the sheet leaves open."""
TYRES_SHARE: Final = 0.05
"""So much the stiffness changes with them from shift to shift."""


class DrivelineMeasurement:
    """Speed and torque of the engine in gear; whether and how far shafts twist; the vehicle."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        driveline = sheet.driveline
        least, most = driveline.vehicle_kgm2
        self._open_sd = max(1.0 / least - 1.0 / most, 1e-3 / most) / math.sqrt(12.0)
        self._inverses = (1.0 / most, 1.0 / least)
        self.rings = DrivelineRings()
        self.known = Known(
            driveline.stiffness_nm_rad,
            driveline.stiffness_tolerance / math.sqrt(3.0),
            0.5 * (1.0 / least + 1.0 / most),
            self._open_sd,
        )
        self.learned = self.known
        """What is known of the driveline after the ramp under way."""
        self.pressed_nm = 0.0
        """About what the ramp under way leaves in the shafts, at the propeller shaft: above 0 at
        the flank of drive, below at that of coast; 0 where it could not be distinguished from
        none."""
        self._gear: int | None = None
        self._torque_share: float | None = None
        self.torque_step = 0.01
        """EEC1 says the torque in steps of this share of the reference torque."""
        self._asked_share: float | None = None
        self._measurements: deque[tuple[int, float, float]] = deque(maxlen=MOST_MEASUREMENTS)
        """Times, the engine's speed, and its torque as a share, with one gear in mesh."""

    @property
    def twists(self) -> bool:
        """Whether shafts between engine and road are known to twist: seen to, and by how much the
        sheet says."""
        return self.rings.twists and self._sheet.driveline.stiffness_nm_rad > 0.0

    @property
    def engine_rad_s2(self) -> float:
        """The engine's acceleration; 0 before it was seen for long enough."""
        measurements = list(self._measurements)[-ENGINE_MEASUREMENTS:]
        if len(measurements) < ENGINE_MEASUREMENTS:
            return 0.0
        return (measurements[-1][1] - measurements[0][1]) / (
            (measurements[-1][0] - measurements[0][0]) * US
        )

    def measure(self, state: State, snapshot: StepSnapshot) -> None:
        """One step."""
        self.rings.measure(state, snapshot)
        if snapshot.engine_torque_share is not None:
            self._torque_share = snapshot.engine_torque_share
            self.torque_step = snapshot.engine_torque_step
        gear, speed = snapshot.view.gear_number, snapshot.engine_rad_s
        opening = state is State.CLUTCH_OPENING
        if state is State.IN_GEAR:
            self.pressed_nm = 0.0
        if not opening:
            self._asked_share = None
        if (state is not State.IN_GEAR and not opening) or gear != self._gear:
            self._measurements.clear()
            self._gear = gear
        elif speed is not None and self._torque_share is not None:
            self._measurements.append((snapshot.now_us, speed, self._torque_now(snapshot.now_us)))

    def _torque_now(self, now_us: int) -> float:
        """The engine's torque: as it says, or within its steps as it follows what is asked."""
        said = self._torque_share or 0.0
        if self._asked_share is None or not self._measurements:
            return said
        before_us, _, share = self._measurements[-1]
        follows = -math.expm1(-(now_us - before_us) * US / self._sheet.engine.lag_s)
        share += follows * (self._asked_share - share)
        half_step = 0.5 * self.torque_step
        return min(max(share, said - half_step), said + half_step)

    def ask(self, share: float) -> None:
        """The torque asked for from this step on."""
        self._asked_share = share

    def loaded(self) -> None:
        """Another shift: the vehicle may weigh more or less than in the last one, with effect on
        its tyres."""
        self.known = self.learned
        stiffness_sd = min(
            math.hypot(self.known.stiffness_sd, TYRES_SHARE),
            self._sheet.driveline.stiffness_tolerance / math.sqrt(3.0),
        )
        sd = min(math.hypot(self.known.vehicle_sd, LOADED_SHARE * self._open_sd), self._open_sd)
        self.known = self.known._replace(vehicle_sd=sd, stiffness_sd=stiffness_sd)
        self.learned = self.known

    def press(self, pulled_nm: float, doubt_nm: float, harmless_nm: float) -> None:
        """What the shafts carry as a ramp begins, and its error: they show the flank. What the
        ramp leaves there is what may be left, and what cannot be distinguished from none."""
        is_pressed = abs(pulled_nm) > DISTINCT_SDS * doubt_nm
        left_nm = math.hypot(harmless_nm, doubt_nm) if is_pressed else 0.0
        self.pressed_nm = math.copysign(left_nm, pulled_nm)

    def torque_sd_nm(self, engine_rad_s2: float) -> float:
        """Error of the torque by which the engine is commanded to load the shafts, at the
        crankshaft: of its steps, and of its inertia at this acceleration."""
        engine = self._sheet.engine
        own_nm = engine.inertia_tolerance * engine.inertia_kgm2 * engine_rad_s2
        read_nm = 0.5 * self.torque_step * engine.reference_nm
        return math.hypot(own_nm, read_nm) / math.sqrt(3.0)

    def mean_share(self, period_us: float) -> float | None:
        """The engine's torque over the last period; None before it was seen."""
        if len(self._measurements) < LEAST_MEASUREMENTS:
            return None
        since_us = self._measurements[-1][0] - period_us
        shares = [share for time_us, _, share in self._measurements if time_us >= since_us]
        return sum(shares) / len(shares)

    def fit(self, bodies: GearedBodies, since_us: float) -> tuple[SwingFit, float] | None:
        """What engine and vehicle have done since a time, and the torque (Nm at the crankshaft)
        that the fit's acceleration is with; None where too little was seen."""
        measurements = np.array(
            [measurement for measurement in self._measurements if measurement[0] >= since_us]
        )
        if len(measurements) < LEAST_MEASUREMENTS:
            return None
        reference_nm = self._sheet.engine.reference_nm
        trajectory = EngineTrajectory(
            measurements[:, 0] * US,
            measurements[:, 1] / bodies.ratio,
            measurements[:, 2] * reference_nm * bodies.ratio,
        )
        found = fit_swing(trajectory, bodies.ratio, bodies.engine_kgm2, self.known)
        return found._replace(known=self._within(found.known)), float(
            measurements[0, 2]
        ) * reference_nm

    def _within(self, known: Known) -> Known:
        """The same within the sheet's tolerances."""
        driveline, (least, most) = self._sheet.driveline, self._inverses
        mean, share = driveline.stiffness_nm_rad, driveline.stiffness_tolerance
        stiffness = min(max(known.stiffness_nm_rad, (1.0 - share) * mean), (1.0 + share) * mean)
        inverse = min(max(known.vehicle_inverse, least), most)
        return known._replace(stiffness_nm_rad=stiffness, vehicle_inverse=inverse)
