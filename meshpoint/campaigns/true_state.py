"""`true_state`: target_phase that is given the rig's true state and parameters, and no future
chance.

It shows what physics leaves to be had: the scatter of the sleeve's delay stays unknown to it. In
the preset thesis the controller's own model is exact, so the true state is all that it needs; in
the preset truck predictions come from a copy of the rig's plant that is run ahead.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from meshpoint.campaigns.forecast import Forecast
from meshpoint.controller.estimate.reference import PhaseReferences
from meshpoint.controller.models.layshaft import LayshaftState, first_order_law
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.gear_predictor import GearPredictor, Trajectory
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.kinematics import raw_phase_rad
from meshpoint.kernels.records import Vector
from meshpoint.rig_sim.shared.angles import Angle
from meshpoint.rig_sim.shared.world import Truth
from meshpoint.rig_sim.thesis.sensors import Shaft
from meshpoint.rig_sim.truck.plant import TruckPlant
from meshpoint.rig_sim.truck.truth import TruckTruth
from meshpoint.units import TURN


class TrueReferences(PhaseReferences):
    """The phase of one gear as it is: known, whatever the controller has seen."""

    def __init__(self, sheet: GearboxSheet, offset_rad: float) -> None:
        super().__init__(sheet)
        self._true_offset_rad = offset_rad
        self._true_sheet = sheet

    def known(self, gear: MainGear) -> bool:  # noqa: ARG002
        """Always."""
        return True

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped."""
        ratio = self._true_sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._true_offset_rad


@dataclass(frozen=True)
class ForecastPredictor(GearPredictor):
    """Predictions from the plant itself instead of from the controller's model."""

    forecast: Forecast

    def layshaft_at(self, time_us: float, release_us: float | None) -> LayshaftState:
        """The layshaft as it would be with the main shaft at constant speed: phase and slip are
        those of the plant, whatever the main shaft does."""
        if release_us is None:
            phase, slip = self.forecast.at(self.brake.arrays(), time_us)
        else:
            phase, slip = self.forecast.after_release(self.brake.with_release(release_us), time_us)
        return self._layshaft(time_us, phase, slip)

    def trajectory(
        self, first_us: float, step_us: float, count: int, release_us: float | None = None
    ) -> Trajectory:
        """Phase and slip at `count` times from `first_us` on."""
        is_released = release_us is not None
        brake = self.brake
        switches = brake.arrays() if release_us is None else brake.with_release(release_us)
        times_us = first_us + step_us * np.arange(count, dtype=np.float64)
        return Trajectory(
            first_us, step_us, *self.forecast.trajectory(switches, times_us, is_released)
        )

    def trajectories(
        self, releases_us: Sequence[int], firsts_us: Sequence[float], step_us: float, count: int
    ) -> Vector:
        """Phase and slip after each of several releases."""
        each = zip(firsts_us, releases_us, strict=True)
        found = [self.trajectory(first, step_us, count, release) for first, release in each]
        return np.array([(one.phase_rad, one.slip_rad_s) for one in found])

    def _layshaft(self, time_us: float, phase_rad: float, slip_rad_s: float) -> LayshaftState:
        zero = self.references.phase_rad(self.gear, 0.0, 0.0)
        theta = (phase_rad - zero + self.main.theta_at(time_us)) / self.i_gear
        omega = (slip_rad_s + self.main.omega_at(time_us)) / self.i_gear
        return LayshaftState(time_us, theta, omega, 0.0)


class TrueState:
    """Makes a true predictor of an estimated one
    (`meshpoint.controller.shift.sequence.PredictorSource`)."""

    def __init__(self, sheet: GearboxSheet, truth: Truth) -> None:
        self._sheet = sheet
        self._truth = truth
        self._law = first_order_law(1.0 / sheet.brake.time_constant_s, sheet.air.supply_gauge_pa)
        self._forecast: Forecast | None = None
        self._ahead: TruckPlant | None = None
        """A copy of the plant that is run ahead."""

    def __call__(self, predictor: GearPredictor) -> GearPredictor:
        """The predictor with the truth of this instant in place of the estimates."""
        truth, gear = self._truth, predictor.gear
        time_us = truth.time_us + truth.clock_start_us
        theta, omega = truth.angles, truth.speeds_rad_s
        layshaft_rad, main_rad = _angle_rad(theta[Shaft.LAYSHAFT]), _angle_rad(theta[Shaft.MAIN])
        offset = raw_phase_rad(predictor.i_gear, layshaft_rad, main_rad) - truth.phase_rad(gear)
        mean_s, sd_s = truth.delay_s(gear)
        known = replace(
            predictor,
            layshaft=LayshaftState(
                time_us, layshaft_rad, omega[Shaft.LAYSHAFT], truth.brake_gauge_pa
            ),
            main=ShaftState(time_us, main_rad, omega[Shaft.MAIN], 0.0, 0.0),
            brake=predictor.brake.seen_through(round(truth.brake_valve_delay_s * 1e6)),
            model=predictor.model.changed(segments=self._law),
            references=TrueReferences(self._sheet, offset),
            delay_us=round(mean_s * 1e6),
            delay_sd_s=sd_s,
        )
        self._renew(known, time_us)
        if self._forecast is None:
            return known
        return ForecastPredictor(**vars(known), forecast=self._forecast)

    def _renew(self, known: GearPredictor, time_us: float) -> None:
        """A forecast holds until the gearbox does something else than was forecast."""
        truth = self._truth
        forecast = self._forecast
        gear, switches = known.gear, known.brake.arrays()
        if forecast is not None and forecast.holds(gear, switches, time_us, truth.phase_rad(gear)):
            return
        if not isinstance(truth, TruckTruth):
            # The controller's own model is the thesis's gearbox: there is nothing to run ahead.
            return
        live = truth.plant
        if self._ahead is None:
            self._ahead = copy.deepcopy(live)
            self._ahead.without_chance()
        pitch_rad, start_us = self._sheet.dog.pitch_rad, truth.clock_start_us
        self._forecast = Forecast(self._ahead, live.snapshot(), gear, pitch_rad, start_us)


def _angle_rad(angle: Angle) -> float:
    turns, rest = angle
    return TURN * turns + rest
