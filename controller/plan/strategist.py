"""The strategies by name, and which of them acts: what it chooses, and what is predicted of that.

A new strategy: a file in this folder, and a line here. Its name is a value of the DBC's value table
`Strategy`, in lower case, so that the frames can tell which strategy acted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from meshpoint.controller.plan.gear_predictor import GearPredictor
from meshpoint.controller.plan.own_strategy import OwnStrategy
from meshpoint.controller.plan.speed_window import SpeedWindow, SpeedWindowAnticipating
from meshpoint.controller.plan.strategy import EngagementStrategy
from meshpoint.controller.plan.target_phase import TargetPhase
from meshpoint.controller.settings.settings import STRATEGY_NAMES, ControllerSettings
from meshpoint.dbc.messages import ShiftDecision, Strategy
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.kinematics import wrap_to_pitch

STRATEGIES: Final[Mapping[str, type[SpeedWindow | TargetPhase]]] = {
    "speed_window": SpeedWindow,
    "speed_window_anticipating": SpeedWindowAnticipating,
    "target_phase": TargetPhase,
}
AIMING: Final = frozenset(name for name in STRATEGY_NAMES if STRATEGIES[name].aims)
"""Those that aim at a phase."""


def make_strategy(sheet: GearboxSheet, settings: ControllerSettings) -> EngagementStrategy:
    """The strategy that the settings ask for. StrategyError where a user's own cannot be made."""
    if settings.strategy_file is not None:
        return OwnStrategy(settings.strategy_file, sheet, settings)
    return STRATEGIES[settings.strategy_name](sheet, settings)


class Plan(NamedTuple):
    """A decision about firing: activation time, contact time (us), and what is predicted for
    contact."""

    decision: ShiftDecision
    fire_us: int
    contact_us: int
    phase_rad: float
    phase_sd_rad: float
    slip_rad_s: float
    misses: bool = False
    """The predicted phase lies outside the gap: an aimed contact like that is planned only where no
    better one is within reach."""


class Strategist:
    """The strategy asked for, and the one that acts while the phase is unknown."""

    def __init__(self, sheet: GearboxSheet, settings: ControllerSettings) -> None:
        self._pitch_rad = sheet.dog.pitch_rad
        self._half_gap_rad = sheet.dog.backlash_rad / 2.0
        self._asked = make_strategy(sheet, settings)
        self._asked_wire = settings.strategy
        self._unaimed = SpeedWindow(sheet, settings)

    def acting(self, reference_known: bool) -> EngagementStrategy:
        """The strategy asked for; `speed_window` if that one aims and the phase is unknown."""
        return self._unaimed if self._asked.aims and not reference_known else self._asked

    def wire(self, acting: EngagementStrategy) -> Strategy:
        """The DBC value of the strategy that acts."""
        return self._asked_wire if acting is self._asked else Strategy.SPEED_WINDOW

    def plan_at(self, predictor: GearPredictor, contact_us: int, decision: ShiftDecision) -> Plan:
        """The plan for a contact at that time; phase and its sd are 0 while the reference is
        unknown."""
        if predictor.references.known(predictor.gear):
            raw, slip = predictor.phase_and_slip(contact_us)
            phase = wrap_to_pitch(raw, self._pitch_rad)
            phase_sd = predictor.phase_sd_rad(contact_us)
        else:
            phase, phase_sd, slip = 0.0, 0.0, predictor.slip_rad_s(contact_us)
        fire_us = contact_us - predictor.delay_us
        misses = abs(phase) > self._half_gap_rad
        return Plan(decision, fire_us, contact_us, phase, phase_sd, slip, misses)
