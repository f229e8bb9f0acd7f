"""How well each estimator knew the layshaft: scored against the reference encoder, from frames alone.

Every estimator gets what the controller got, at the controller's steps, and is asked for each
encoder instant before the edges that came after it: so the score is causal, and includes the wait
for the next 10 ms read. Scored while the model holds, from neutral to first contact (thesis 5.10).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

from controller.brake_input import BrakeInput
from controller.clock import unwrap
from controller.inputs import StepInputs
from controller.observer import Observer
from controller.settings import ESTIMATOR_NAMES, ControllerSettings
from dbc.messages import (
    ControllerStatus,
    EngagementEvent,
    Message,
    ReferenceEngagement,
    ReferenceEncoder,
    ValveAction,
    ValveCommand,
)
from gearbox import GearboxSheet
from testbench.rows import CONTACTS, DEG, RPM

ENCODER_STEP_US: Final = 2_000
SWITCHED_ON: Final = (ValveAction.ON_AT, ValveAction.ON_NOW)
SCHEDULED: Final = (ValveAction.ON_AT, ValveAction.OFF_AT)


class _Shadow:
    """One estimator run beside the controller, and its squared errors."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings, name: str) -> None:
        chosen = dataclasses.replace(settings, estimator_name=name)
        self.brake = BrakeInput(round(sheet.brake.valve_delay_s * 1e6))
        self.observer = Observer(sheet, chosen, self.brake)
        self._pitch_rad = sheet.wheels.layshaft.pitch_rad
        self._angle_sum = self._speed_sum = 0.0
        self._count = 0

    def score(self, time_us: float, theta_rad: float, omega_rad_s: float) -> None:
        """One encoder instant. The encoder counts from tooth 0, the wheel from any tooth."""
        state = self.observer.layshaft_at(time_us)
        if state is None:
            return
        error = state.theta_rad - theta_rad
        error -= self._pitch_rad * math.floor(error / self._pitch_rad + 0.5)
        self._angle_sum += error * error
        self._speed_sum += (state.omega_rad_s - omega_rad_s) ** 2
        self._count += 1

    def figures(self) -> dict[str, Any]:
        """RMS by thesis 5.10; None without a scored instant."""
        if not self._count:
            return {"angle_rms_deg": None, "speed_rms_rpm": None, "samples": 0}
        return {
            "angle_rms_deg": round(math.sqrt(self._angle_sum / self._count) / DEG, 6),
            "speed_rms_rpm": round(math.sqrt(self._speed_sum / self._count) / RPM, 6),
            "samples": self._count,
        }


class EstimationScore:
    """Scores every estimator over one run, fed with messages in bus order."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        self._shadows = {name: _Shadow(sheet, settings, name) for name in ESTIMATOR_NAMES}
        self._inputs = StepInputs()
        self._encoder: list[ReferenceEncoder] = []
        self._contact_us: int | None = None
        self._was_free = False

    def take(self, message: Message) -> None:
        """One message in bus order; a status frame closes a step."""
        if isinstance(message, ReferenceEncoder):
            self._encoder.append(message)
        elif isinstance(message, ValveCommand):
            self._brake(message)
        elif isinstance(message, ReferenceEngagement):
            if message.event in CONTACTS:
                self._contact_us = message.event_time_us
            elif message.event is EngagementEvent.READY:
                self._contact_us = None
        elif isinstance(message, ControllerStatus):
            self._step(message.step_time_us)
        else:
            self._inputs.take(message)

    def _brake(self, command: ValveCommand) -> None:
        for shadow in self._shadows.values():
            now_us = shadow.observer.clock.latest_us
            on = command.brake_action in SWITCHED_ON
            time_us = now_us
            if command.brake_action in SCHEDULED:
                time_us = unwrap(command.brake_time_us, now_us)
            shadow.brake.schedule(time_us, on, now_us)

    def _step(self, now_us: int) -> None:
        for message in self._encoder:
            self._score(message)
        self._encoder.clear()
        inputs, self._inputs = self._inputs, StepInputs()
        for shadow in self._shadows.values():
            shadow.observer.take(inputs, now_us, [])

    def _score(self, message: ReferenceEncoder) -> None:
        for shadow in self._shadows.values():
            if not shadow.observer.layshaft.free:
                continue
            newest_us = unwrap(message.sample_time_us, shadow.observer.clock.latest_us)
            for k, (theta, omega) in enumerate(
                zip(message.angle_rad, message.speed_rad_s, strict=True)
            ):
                time_us = newest_us - k * ENCODER_STEP_US
                if not self._after_contact(time_us):
                    shadow.score(time_us, theta, omega)

    def _after_contact(self, time_us: int) -> bool:
        if self._contact_us is None:
            return False
        return time_us >= unwrap(self._contact_us, time_us)

    def figures(self) -> dict[str, Any]:
        """Figures by estimator."""
        return {name: shadow.figures() for name, shadow in self._shadows.items()}
