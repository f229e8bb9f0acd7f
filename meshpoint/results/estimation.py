"""How well each estimator knew the layshaft: scored against the encoder, from frames alone.

Every estimator gets what the controller got, at the controller's steps, and is asked for each
encoder instant before the edges that came after it: so the score is causal, and includes the wait
for the next 10 ms read. Scored while the model holds, from neutral to first contact (thesis 5.10).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from meshpoint.controller.estimate.observer import Observer
from meshpoint.controller.measure.inputs import StepInputs
from meshpoint.controller.models.layshaft import BrakeInput, LayshaftState
from meshpoint.controller.settings.settings import ESTIMATOR_NAMES, ControllerSettings
from meshpoint.dbc.messages import (
    ControllerState,
    ControllerStatus,
    EngagementEvent,
    Estimator,
    Message,
    ReferenceEncoder,
    ReferenceEngagement,
    ValveAction,
    ValveCommand,
)
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.gearbox import GearboxSheet
from meshpoint.results.rows import CONTACT_KINDS
from meshpoint.results.traces import ENCODER_STEP_US
from meshpoint.units import DEG, RPM

SWITCHED_ON: Final = (ValveAction.ON_AT, ValveAction.ON_NOW)
SCHEDULED: Final = (ValveAction.ON_AT, ValveAction.OFF_AT)


RESTING: Final = (ControllerState.STARTING, ControllerState.IN_GEAR, ControllerState.NEUTRAL)


class Sample(NamedTuple):
    """An estimator at an encoder instant: its error and what the encoder said (rad, rad/s)."""

    estimator: str
    time_us: int
    theta_error_rad: float
    omega_error_rad_s: float
    theta_rad: float
    omega_rad_s: float


class _Score:
    """One estimator with an observer of its own, and its squared errors."""

    def __init__(
        self, sheet: GearboxSheet, settings: ControllerSettings, estimator: Estimator
    ) -> None:
        self.observer = Observer(sheet, settings, estimator)
        self._pitch_rad = sheet.wheels.layshaft.pitch_rad
        self._angle_sum = self._offset_sum = self._speed_sum = 0.0
        self._count = 0

    @property
    def heard(self) -> bool:
        """Whether it has a stamp: all count time from the first, or a wrap would part them."""
        return self.observer.clock.latest_us != 0

    def add(self, state: LayshaftState, theta_rad: float, omega_rad_s: float) -> float:
        """One encoder instant. The encoder counts from tooth 0, the wheel from any tooth.

        Returns the angle's error."""
        error = state.theta_rad - theta_rad
        error -= self._pitch_rad * math.floor(error / self._pitch_rad + 0.5)
        self._angle_sum += error * error
        self._offset_sum += error
        self._speed_sum += (state.omega_rad_s - omega_rad_s) ** 2
        self._count += 1
        return error

    def figures(self) -> dict[str, Any]:
        """RMS by thesis 5.10, the angle's about its mean; None without a scored instant.

        The mean is how far the wheel's teeth lie from the encoder's zero. No wheel can tell that of
        itself, and the phase reference takes it up."""
        if not self._count:
            return {
                "angle_rms_deg": None,
                "angle_offset_deg": None,
                "speed_rms_rpm": None,
                "samples": 0,
            }
        offset = self._offset_sum / self._count
        variance = max(0.0, self._angle_sum / self._count - offset * offset)
        return {
            "angle_rms_deg": round(math.sqrt(variance) / DEG, 6),
            "angle_offset_deg": round(offset / DEG, 6),
            "speed_rms_rpm": round(math.sqrt(self._speed_sum / self._count) / RPM, 6),
            "samples": self._count,
        }


class EstimationScore:
    """Scores every estimator over one run, fed with messages in bus order."""

    def __init__(
        self,
        sheet: GearboxSheet,
        settings: ControllerSettings,
        on_sample: Callable[[Sample], None] | None = None,
        estimators: Mapping[str, Estimator] = ESTIMATOR_NAMES,
    ) -> None:
        """`on_sample` sees every scored instant of every estimator; `crossing` must be one."""
        self._on_sample = on_sample
        self._scores = {
            name: _Score(sheet, settings, estimator) for name, estimator in estimators.items()
        }
        self._learning = self._scores["crossing"]
        """It learns teeth, so it must not lose count between shifts."""
        self._inputs = StepInputs()
        self._encoder: list[ReferenceEncoder] = []
        self._contact_us: int | None = None
        self.active = False
        """Whether a shift goes on: the baselines need edges only then. From the opening of the
        clutch there is time enough for the speeds to settle before the model begins to hold."""
        self._handlers: dict[type[Message], Callable[[Any], None]] = {
            ReferenceEncoder: self._encoder.append,
            ValveCommand: self._switch_brake,
            ReferenceEngagement: self._engagement,
            ControllerStatus: self._step,
        }

    def take(self, message: Message) -> None:
        """One message in bus order; a status frame closes a step."""
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message)
        else:
            self._inputs.take(message)

    def _engagement(self, message: ReferenceEngagement) -> None:
        if message.event in CONTACT_KINDS:
            self._contact_us = message.event_time_us
        elif message.event is EngagementEvent.READY:
            self._contact_us = None

    def _switch_brake(self, command: ValveCommand) -> None:
        now_us = self._clock_us
        time_us = now_us
        if command.brake_action in SCHEDULED:
            time_us = unwrap(command.brake_time_us, now_us)
        is_on = command.brake_action in SWITCHED_ON
        for score in self._scores.values():
            score.observer.brake_input.schedule(time_us, is_on, now_us)

    @property
    def observer(self) -> Observer:
        """That of estimator `crossing`."""
        return self._learning.observer

    @property
    def _clock_us(self) -> int:
        return self._learning.observer.clock.latest_us

    def _step(self, status: ControllerStatus) -> None:
        self.active = status.state not in RESTING
        if self._learning.observer.layshaft.free:
            for message in self._encoder:
                self._add(message)
        self._encoder.clear()
        inputs, self._inputs = self._inputs, StepInputs()
        for score in self._scores.values():
            if self.active or score is self._learning or not score.heard:
                score.observer.take(inputs, status.step_time_us, [])

    def _add(self, message: ReferenceEncoder) -> None:
        newest_us = unwrap(message.sample_time_us, self._clock_us)
        for k, theta in enumerate(message.angle_rad):
            time_us = newest_us - k * ENCODER_STEP_US
            if self.is_after_contact(time_us):
                continue
            for name, score in self._scores.items():
                tracker = score.observer.layshaft
                state = tracker.at(time_us)
                if state is None or not tracker.free:
                    continue
                omega = message.speed_rad_s[k]
                error = score.add(state, theta, omega)
                if self._on_sample is not None:
                    omega_error = state.omega_rad_s - omega
                    self._on_sample(Sample(name, time_us, error, omega_error, theta, omega))

    def is_after_contact(self, time_us: int) -> bool:
        """Whether a sensor time lies after the present shift's first contact."""
        if self._contact_us is None:
            return False
        return time_us >= unwrap(self._contact_us, time_us)

    @property
    def brake(self) -> BrakeInput:
        """The brake valve's switches as commanded."""
        return self.observer.brake_input

    def figures(self) -> dict[str, Any]:
        """Figures by estimator."""
        return {name: score.figures() for name, score in self._scores.items()}
