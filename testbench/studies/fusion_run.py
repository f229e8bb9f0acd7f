"""A job of study `fusion`: angle and speed of the shafts with further sensors and without.

Two observers hear the same frames at the controller's own steps, one of them with the input shaft's
and the propeller shaft's edges fused; neither of them is the one that shifts. Scored is as for
every estimator (`testbench/estimation.py`): the layshaft against its encoder, the main shaft
against the rig's truth, from neutral to contact, the wait for the next read included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from controller.clock import unwrap
from controller.kinematics import wrap_to_pitch
from controller.settings import ControllerSettings
from dbc.frame import Frame
from dbc.link import Receiver
from dbc.messages import ControllerStatus, Estimator, Message, ReferencePhase
from dbc.node import Node
from gearbox import GearboxSheet
from rig_sim.settings import Preset
from testbench.estimation import EstimationScore, Sample
from testbench.rows import ShiftRow
from testbench.simulate import Setup, simulate
from testbench.studies.jobs import AsBuilt, Squares

LAYSHAFT, WITH_INPUT = "layshaft alone", "layshaft and input"
MAIN, WITH_PROPELLER = "main alone", "main and propeller"
CROSSING: Final = {"crossing": Estimator.CROSSING}
Fused = dict[str, Squares]


@dataclass(frozen=True)
class FusionRun:
    """The job: shifts of one truck; errors by variant over those after the learning ones."""

    sheet: GearboxSheet
    seed: int
    learning_shifts: int
    shifts: int
    as_built: AsBuilt

    def run(self) -> Fused:
        """Simulates, and scores every variant."""
        settings = ControllerSettings()
        tuning = replace(settings.crossing_filter, fuse_input=True, fuse_propeller=True)
        fused = replace(settings, crossing_filter=tuning)
        listeners = (
            _Listener(self.sheet, settings, LAYSHAFT, MAIN),
            _Listener(self.sheet, fused, WITH_INPUT, WITH_PROPELLER),
        )
        receiver, ended = Receiver(*Node), 0

        def take(_time_us: int, frame: Frame) -> None:
            message = receiver.receive(frame).message
            if message is not None:
                for listener in listeners:
                    listener.take(message)

        def count(_row: ShiftRow) -> None:
            nonlocal ended
            ended += 1
            for listener in listeners:
                listener.counts = ended >= self.learning_shifts

        shifts = self.learning_shifts + self.shifts
        setup = Setup(
            self.sheet, settings, Preset.TRUCK, self.seed, shifts, as_built=dict(self.as_built)
        )
        simulate(setup, take, count)
        return listeners[0].squares | listeners[1].squares


class _Listener:
    """An observer that hears the bus, and its errors."""

    def __init__(
        self, sheet: GearboxSheet, settings: ControllerSettings, layshaft: str, main: str
    ) -> None:
        self._score = EstimationScore(sheet, settings, self._add, CROSSING)
        self._observer = self._score.observer
        self._pitch_rad = sheet.wheels.main.pitch_rad
        self._truth: list[ReferencePhase] = []
        self._layshaft, self._main = Squares(), Squares()
        self.squares = {layshaft: self._layshaft, main: self._main}
        self.counts = False
        """Whether errors count yet."""

    def take(self, message: Message) -> None:
        """One message in bus order; a status frame closes a step."""
        if isinstance(message, ReferencePhase):
            self._truth.append(message)
        elif isinstance(message, ControllerStatus):
            if self.counts and self._observer.layshaft.free:
                self._add_main()
            self._truth.clear()
        self._score.take(message)

    def _add(self, sample: Sample) -> None:
        if self.counts:
            self._layshaft.add(sample)

    def _add_main(self) -> None:
        for truth in self._truth:
            time_us = unwrap(truth.sample_time_us, self._observer.clock.latest_us)
            state = self._observer.main_at(time_us)
            if state is None or self._score.is_after_contact(time_us):
                continue
            error = wrap_to_pitch(state.theta_rad - truth.main_angle_rad, self._pitch_rad)
            self._main.samples += 1
            self._main.angle_rad += error
            self._main.angle_rad2 += error * error
            self._main.speed_rad2_s2 += (state.omega_rad_s - truth.main_speed_rad_s) ** 2
