"""What the controller expected of both shafts when it planned each firing, beyond what its
prediction frame says; from the controller itself, as it runs or as its log is repeated."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.core.core import ControllerCore
from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.layout import CODECS
from meshpoint.dbc.link import read_alone
from meshpoint.dbc.messages import ShiftDecision, ShiftPrediction
from meshpoint.dbc.sensor_time import unwrap
from meshpoint.kernels.records import Vector
from meshpoint.units import DEG

PREDICTION: Final = CODECS[ShiftPrediction.__name__]
STEP_US: Final = 2_000
BEYOND_US: Final = 60_000
"""What was believed is kept up to so long after the predicted contact."""
SAME_RAD: Final = 0.02 * DEG
"""A prediction made again from what the controller knows after its step differs by less."""


class Belief(NamedTuple):
    """Both shafts from the time of the estimates on."""

    before_contact_us: float
    """How long before the predicted contact that was."""
    phase_rad: float
    """Of the gear's tooth from the middle of a gap, then."""
    layshaft_rad: Vector
    """By how much the layshaft will turn the gear from then on, every `STEP_US`."""
    main_rad: Vector
    """The same of the main shaft, and the sleeve."""

    def moved_rad(self, after_us: float) -> tuple[float, float]:
        """By how much the layshaft turns the gear, and the main shaft itself, within this time."""
        at_us = np.arange(self.layshaft_rad.size) * float(STEP_US)
        layshaft, main = (np.interp(after_us, at_us, w) for w in (self.layshaft_rad, self.main_rad))
        return float(layshaft), float(main)


class Beliefs:
    """Kept of every firing that is planned."""

    def __init__(self) -> None:
        self.of: dict[int, Belief] = {}
        """By the contact times of their predictions, as these have them (32-bit sensor time)."""

    def look(self, core: ControllerCore, sent: Iterable[Frame]) -> None:
        """After a step of the controller, and what it has sent in it."""
        for frame in sent:
            if frame.can_id == PREDICTION.spec.can_id:
                message = read_alone(PREDICTION, frame)
                if isinstance(message, ShiftPrediction) and message.decision is ShiftDecision.FIRE:
                    self._keep(core, message)

    def _keep(self, core: ControllerCore, planned: ShiftPrediction) -> None:
        snapshot, shift = core.snapshot, core.running_shift
        if snapshot is None or snapshot.main is None or shift is None or not snapshot.layshaft.free:
            return
        sequence, gear, layshaft = core.sequence, shift.target.main, snapshot.layshaft.latest()
        if not (layshaft.is_finite and sequence.references.known(gear)):
            return
        predictor = GearPredictor(
            gear, sequence.sheet.main_mesh(gear).ratio, layshaft, snapshot.main, sequence.brake,
            snapshot.layshaft.model, sequence.references, 0, 0.0, 0, 0.0,
        )  # fmt: skip
        contact_us = unwrap(planned.contact_time_us, round(layshaft.time_us))
        phase, _ = predictor.phase_and_slip(contact_us)
        off = math.remainder(phase - planned.phase_rad, sequence.sheet.dog.pitch_rad)
        if abs(off) < SAME_RAD:  # else it was planned with something that has changed since
            self.of[planned.contact_time_us] = _belief(predictor, contact_us)


def _belief(predictor: GearPredictor, contact_us: float) -> Belief:
    layshaft, main = predictor.layshaft, predictor.main
    start_us = layshaft.time_us
    phase, _ = predictor.phase_and_slip(start_us)
    times_us = np.arange(start_us, contact_us + BEYOND_US, STEP_US)
    turned = [predictor.layshaft_at(at, None).theta_rad for at in times_us.tolist()]
    turned_main = [main.theta_at(at) for at in times_us.tolist()]
    return Belief(
        contact_us - start_us,
        phase,
        predictor.i_gear * (np.array(turned) - turned[0]),
        np.array(turned_main) - turned_main[0],
    )
