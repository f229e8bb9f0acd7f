"""A job of study `fusion`: angle and speed of the shafts with further sensors and without.

Two observers hear the same frames at the controller's own steps, one of them with the input shaft's
and the propeller shaft's edges fused; neither of them is the one that shifts. Scored is as for
every estimator (`meshpoint/testbench/results/estimation.py`): the layshaft against its encoder, the
main shaft against the rig's truth, from neutral to contact, the wait for the next read included.
And what was predicted: the layshaft 45 ms ahead where the brake's commands have not changed since,
the main shaft 35 to 45 ms ahead, as its truth comes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from meshpoint.controller.motion.brake_input import BrakeInput
from meshpoint.controller.motion.kinematics import wrap_to_pitch
from meshpoint.controller.motion.models import LayshaftState, predict
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.sensing.sensor_clock import unwrap
from meshpoint.controller.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import (
    ControllerStatus,
    Estimator,
    Message,
    ReferenceEncoder,
    ReferencePhase,
)
from meshpoint.dbc.node import Node
from meshpoint.gearbox import GearboxSheet
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.testbench.loop.setup import Setup
from meshpoint.testbench.loop.simulate import simulate
from meshpoint.testbench.results.estimation import EstimationScore, Sample
from meshpoint.testbench.results.rows import ShiftRow
from meshpoint.testbench.results.traces import ENCODER_STEP_US
from meshpoint.testbench.studies.jobs import AsBuilt, ShiftErrors
from meshpoint.units import US

LAYSHAFT, WITH_INPUT = "layshaft alone", "layshaft and input"
MAIN, WITH_PROPELLER = "main alone", "main and propeller"
AHEAD_SUFFIX: Final = ", 45 ms ahead"
"""After a variant's name."""
AHEAD_US: Final = 45_000
READ_US: Final = 10_000
CROSSING: Final = {"crossing": Estimator.CROSSING}
Fused = dict[str, ShiftErrors]


@dataclass(frozen=True)
class FusionRun:
    """The job: shifts of one truck; errors by variant over those after the learning ones."""

    sheet: GearboxSheet
    seed: int
    learning_shifts: int
    shifts: int
    as_built: AsBuilt
    profile: Profile

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
            self.sheet,
            settings,
            Preset.TRUCK,
            self.seed,
            shifts,
            as_built=dict(self.as_built),
            profile=self.profile,
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
        self._layshaft_pitch_rad = sheet.wheels.layshaft.pitch_rad
        self._layshaft, self._main = ShiftErrors(), ShiftErrors()
        self._layshaft_ahead, self._main_ahead = ShiftErrors(), ShiftErrors()
        self.squares = {
            layshaft: self._layshaft,
            main: self._main,
            layshaft + AHEAD_SUFFIX: self._layshaft_ahead,
            main + AHEAD_SUFFIX: self._main_ahead,
        }
        self._predicted: list[_Predicted] = []
        self.counts = False
        """Whether errors count yet."""

    def take(self, message: Message) -> None:
        """One message in bus order; a status frame closes a step."""
        scored = self.counts and self._observer.layshaft.free
        if isinstance(message, ReferencePhase):
            self._truth.append(message)
        elif isinstance(message, ReferenceEncoder) and scored:
            self._add_layshaft_ahead(message)
        elif isinstance(message, ControllerStatus):
            if scored:
                self._add_main()
            self._truth.clear()
        self._score.take(message)
        if isinstance(message, ControllerStatus):
            self._predict(message.step_time_us)

    def _predict(self, now_us: int) -> None:
        """Both shafts 45 ms from now, as a strategy would have it."""
        observer, brake = self._observer, self._score.brake
        layshaft, at_us = observer.layshaft, observer.clock.now_us(now_us)
        main = observer.main_at(at_us)
        if not self.counts or not layshaft.free or main is None:
            self._predicted.clear()
            return
        time_us = at_us + AHEAD_US
        ahead = predict(layshaft.latest(), time_us, brake.arrays(), layshaft.model)
        self._predicted.append(_Predicted(time_us, ahead, main, _switched(brake, time_us)))

    def _add_layshaft_ahead(self, truth: ReferenceEncoder) -> None:
        """The samples of a frame are 2 ms apart: between them, and before the first for as long,
        the angle goes on at its speed."""
        newest_us = unwrap(truth.sample_time_us, self._observer.clock.latest_us)
        due = [each for each in self._predicted if each.time_us <= newest_us]
        self._predicted = [each for each in self._predicted if each.time_us > newest_us]
        for each in due:
            k = round((newest_us - each.time_us) / ENCODER_STEP_US)
            unforeseen = each.switched != _switched(self._score.brake, each.time_us)
            if unforeseen or k > len(truth.angle_rad) or self._score.is_after_contact(newest_us):
                continue
            k = min(k, len(truth.angle_rad) - 1)
            since_s = (each.time_us - newest_us + k * ENCODER_STEP_US) * US
            omega = truth.speed_rad_s[k]
            theta = truth.angle_rad[k] + omega * since_s
            error = wrap_to_pitch(each.layshaft.theta_rad - theta, self._layshaft_pitch_rad)
            self._layshaft_ahead.put(error, each.layshaft.omega_rad_s - omega)

    def _add(self, sample: Sample) -> None:
        if self.counts:
            self._layshaft.add(sample)

    def _add_main(self) -> None:
        for truth in self._truth:
            time_us = unwrap(truth.sample_time_us, self._observer.clock.latest_us)
            if self._score.is_after_contact(time_us):
                continue
            state = self._observer.main_at(time_us)
            if state is not None:
                self._put_main(self._main, state, truth, time_us)
            for each in self._predicted:
                if 0 <= each.time_us - time_us < READ_US:
                    self._put_main(self._main_ahead, each.main, truth, time_us)

    def _put_main(
        self, squares: ShiftErrors, state: ShaftState, truth: ReferencePhase, time_us: int
    ) -> None:
        error = wrap_to_pitch(state.theta_at(time_us) - truth.main_angle_rad, self._pitch_rad)
        squares.put(error, state.omega_at(time_us) - truth.main_speed_rad_s)


class _Predicted(NamedTuple):
    """What was predicted for a time, and the brake's switches until then as commanded."""

    time_us: float
    layshaft: LayshaftState
    main: ShaftState
    """When it was predicted."""
    switched: list[tuple[float, float]]


def _switched(brake: BrakeInput, until_us: float) -> list[tuple[float, float]]:
    times, states = brake.commands
    return [(t, u) for t, u in zip(times.tolist(), states.tolist(), strict=True) if t <= until_us]
