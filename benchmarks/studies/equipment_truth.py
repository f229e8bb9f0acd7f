"""Equipment that the product has no code for, made of the rig's truth for study `hardware` alone.

Each takes the controller's predictor and gives back what it would be with that equipment
(`meshpoint.controller.shift.context.PredictorSource`). All else stays the controller's own.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np

from meshpoint.controller.estimate.main_tracker import MainTracker
from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.models.backlash import WHEELS, LashTrajectory
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.shift.sequence import ShiftSequence
from meshpoint.dbc.messages import ControllerState
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.gears import SLEEVE_OF_MAIN
from meshpoint.gearbox.tables import count, quantity
from meshpoint.rig_sim.shared.engagement import VALVE_OF_MAIN
from meshpoint.rig_sim.truck.driven_engagement import DrivenEngagement
from meshpoint.rig_sim.truck.driven_sleeve import DrivenSleeve
from meshpoint.rig_sim.truck.truth import TruckTruth
from meshpoint.units import MM, SECOND_US, TURN

PARK_STREAM = 0x9A4C
RING_STREAM = 0x216
"""Keep these draws apart from those of the rig of the same seed."""
IN_NEUTRAL_M = 1.5e-3
STEP_S = 0.01
"""The rings are read as often as the controller steps."""


@dataclass(frozen=True)
class Parking:
    """Where a sleeve stands before its second stroke."""

    before_teeth_m: float = quantity("before_teeth_mm", 0.3, 3.0, MM)
    scatter_m: float = quantity("scatter_mm", 0.0, 1.0, MM)
    """Standard deviation of that place."""
    least_m: float = quantity("least_mm", 0.1, 3.0, MM)
    """It never stands nearer to the teeth."""


@dataclass(frozen=True)
class WheelRingTeeth:
    """The rings of the two driven wheels and their Hall sensors."""

    teeth: int = count("teeth", 20, 200)
    error_percent_of_pitch: float = quantity("error_percent_of_pitch", 0.0, 5.0)
    """Standard deviation of an edge's angle, once the teeth are learned."""
    final_drive: float = quantity("final_drive", 1.0, 10.0)
    """Turns of the propeller shaft a turn of the wheels."""


class ParkedSleeve:
    """A sleeve that is fired from a place before the teeth.

    As the controller commits a firing from neutral, the sleeve is put at the place to which a first
    stroke would have taken it during the braking: there, at rest, both chambers vented. How long
    the second stroke takes from there the controller has from the rig, but not its chance."""

    def __init__(
        self,
        sheet: GearboxSheet,
        truth: TruckTruth,
        sequence: ShiftSequence,
        parking: Parking,
        seed: int,
    ) -> None:
        self._sheet, self._truth, self._sequence = sheet, truth, sequence
        self._parking = parking
        self._rng = np.random.Generator(np.random.PCG64([seed, PARK_STREAM]))
        self._place_m = self._drawn_m()
        engagement = truth._world.engagement
        if not isinstance(engagement, DrivenEngagement):
            raise TypeError("a sleeve is parked only between two chambers: sleeve.model = 1")
        self._engagement = engagement

    def __call__(self, predictor: GearPredictor) -> GearPredictor:
        """The predictor of a sleeve that is fired from there."""
        where = SLEEVE_OF_MAIN[predictor.gear]
        sleeve = self._engagement.sleeves[where.sleeve]
        if abs(sleeve.position_m(self._truth.time_us)) > IN_NEUTRAL_M:
            return predictor
        if self._sequence.state is ControllerState.ENGAGING:
            self._park(sleeve, where.direction)
            self._place_m = self._drawn_m()
            return predictor
        delay_s, sd_s = self._delay_s(predictor.gear)
        delay_us = round(delay_s * SECOND_US)
        stop_us = min(predictor.stop_us, delay_us)
        return replace(predictor, delay_us=delay_us, delay_sd_s=sd_s, stop_us=stop_us)

    def _drawn_m(self) -> float:
        parking, to_contact_m = self._parking, self._sheet.sleeve.to_contact_m
        drawn_m = parking.before_teeth_m + parking.scatter_m * float(self._rng.standard_normal())
        return to_contact_m - max(drawn_m, parking.least_m)

    def _park(self, sleeve: DrivenSleeve, direction: int) -> None:
        time_us, y = self._truth.time_us, sleeve.cylinder.y
        sleeve.motion.cut(time_us)
        sleeve.motion.stop()
        y.x_m = direction * self._place_m
        y.a_pa = y.b_pa = sleeve.cylinder.atmosphere_pa
        sleeve.go_on(time_us)

    def _delay_s(self, gear: MainGear) -> tuple[float, float]:
        """From the coil to contact, mean and standard deviation, if it were fired now."""
        direction = SLEEVE_OF_MAIN[gear].direction
        engagement, time_us = self._engagement, self._truth.time_us
        mean_s, sd_s = engagement.valves.expected_s(VALVE_OF_MAIN[gear], time_us)
        parked = copy.deepcopy(engagement.sleeves[SLEEVE_OF_MAIN[gear].sleeve])
        parked.spools.clear()
        self._park(parked, direction)
        spool_us = time_us + mean_s * SECOND_US
        return (engagement._alone_us(parked, direction, spool_us) - time_us) / SECOND_US, sd_s


class WheelRings:
    """The speed of the driven wheels, by edges of their rings.

    The particles of the driveline's filter get the wheels' speed at its newest edges of the main
    shaft: the true one, off by what the rings' teeth and the time from step to step leave."""

    def __init__(
        self,
        sheet: GearboxSheet,
        truth: TruckTruth,
        observer: Observer,
        rings: WheelRingTeeth,
        seed: int,
    ) -> None:
        self._sheet, self._truth, self._observer = sheet, truth, observer
        self._rng = np.random.Generator(np.random.PCG64([seed, RING_STREAM]))
        edge_rad = rings.error_percent_of_pitch / 100.0 * TURN / rings.teeth
        angle_sd_rad = rings.final_drive * edge_rad / math.sqrt(2.0)  # the mean of two wheels
        self._speed_sd_rad_s = math.sqrt(2.0) * angle_sd_rad / STEP_S
        self._read: list[tuple[float, float]] = []
        """Sensor times (us) and speeds (rad/s) of the wheels, at the propeller shaft."""

    def __call__(self, predictor: GearPredictor) -> GearPredictor:
        """The predictor whose main shaft hangs on wheels that are seen."""
        tracker, range_ = self._observer._main, self._observer.view.range_
        by_cloud = isinstance(predictor.main.swing, LashTrajectory)
        if not (isinstance(tracker, MainTracker) and by_cloud):
            return predictor
        cloud = tracker._cloud
        if cloud is None or range_ is None:
            return predictor
        propeller_rad_s = self._wheels_rad_s(cloud.time_us)
        cloud._x[WHEELS] = propeller_rad_s / self._sheet.range_mesh(range_).ratio
        tracker._trajectory = (cloud.time_us, cloud.trajectory(tracker._half_gap_rad))
        main = tracker.at(predictor.main.time_us)
        return predictor if main is None else replace(predictor, main=main)

    def _wheels_rad_s(self, time_us: float) -> float:
        """The wheels' speed, as it was read, at the propeller shaft."""
        truth = self._truth
        off_rad_s = self._speed_sd_rad_s * float(self._rng.standard_normal())
        speed_rad_s = truth.plant.y.wheels_rad_s + off_rad_s
        self._read = [*self._read[-1:], (truth.time_us + truth.clock_start_us, speed_rad_s)]
        times, speeds = zip(*self._read, strict=True)
        return float(np.interp(time_us, times, speeds))
