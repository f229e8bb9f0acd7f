"""The record of one shift, and the states and transitions of the sequence that makes it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, auto
from typing import Final

from controller.strategy import Plan
from dbc.messages import ControllerState as State
from dbc.messages import FaultCode, ShiftResult, Strategy
from gearbox import DriveGear


class Trigger(IntEnum):
    """What makes the sequence go on."""

    FOUND_IN_GEAR = auto()
    FOUND_IN_NEUTRAL = auto()
    REQUESTED = auto()
    CLUTCH_OPEN = auto()
    MAIN_BOX_NEUTRAL = auto()
    BRAKE_RELEASED = auto()
    FIRED = auto()
    ENGAGED = auto()
    BLOCKED = auto()
    RETRACTED = auto()
    GAVE_UP = auto()


TRANSITIONS: Final[dict[tuple[State, Trigger], State]] = {
    (State.STARTING, Trigger.FOUND_IN_GEAR): State.IN_GEAR,
    (State.STARTING, Trigger.FOUND_IN_NEUTRAL): State.NEUTRAL,
    (State.IN_GEAR, Trigger.FOUND_IN_NEUTRAL): State.NEUTRAL,
    (State.NEUTRAL, Trigger.FOUND_IN_GEAR): State.IN_GEAR,
    (State.IN_GEAR, Trigger.REQUESTED): State.CLUTCH_OPENING,
    (State.NEUTRAL, Trigger.REQUESTED): State.CLUTCH_OPENING,
    (State.CLUTCH_OPENING, Trigger.CLUTCH_OPEN): State.DISENGAGING,
    (State.CLUTCH_OPENING, Trigger.GAVE_UP): State.CLUTCH_CLOSING,
    (State.DISENGAGING, Trigger.MAIN_BOX_NEUTRAL): State.SYNCHRONISING,
    (State.DISENGAGING, Trigger.GAVE_UP): State.CLUTCH_CLOSING,
    (State.SYNCHRONISING, Trigger.BRAKE_RELEASED): State.COASTING,
    (State.SYNCHRONISING, Trigger.GAVE_UP): State.CLUTCH_CLOSING,
    (State.COASTING, Trigger.FIRED): State.ENGAGING,
    (State.COASTING, Trigger.GAVE_UP): State.CLUTCH_CLOSING,
    (State.ENGAGING, Trigger.ENGAGED): State.CLUTCH_CLOSING,
    (State.ENGAGING, Trigger.BLOCKED): State.RETRACTING,
    (State.RETRACTING, Trigger.RETRACTED): State.COASTING,
    (State.RETRACTING, Trigger.GAVE_UP): State.CLUTCH_CLOSING,
    (State.CLUTCH_CLOSING, Trigger.FOUND_IN_GEAR): State.IN_GEAR,
    (State.CLUTCH_CLOSING, Trigger.FOUND_IN_NEUTRAL): State.NEUTRAL,
}
"""A missing entry is an error: a trigger that a state does not expect."""


@dataclass
class ShiftRecord:
    """One shift from request to outcome; what the outcome frame reports."""

    from_number: int
    to_number: int
    """The gear asked for; -1 where there is no such gear, and `target` then means nothing."""
    target: DriveGear
    request_us: int
    strategy: Strategy
    """The strategy that acts: the fallback while the reference is unknown."""
    reference_known: bool = False
    attempts: int = 0
    release_us: int | None = None
    plan: Plan | None = None
    measured_contact_us: int | None = None
    estimated_phase_rad: float = 0.0
    result: ShiftResult = ShiftResult.NONE
    fault: FaultCode = FaultCode.NONE
    end_us: int | None = None

    @property
    def over(self) -> bool:
        """Whether it has ended, well or not."""
        return self.result is not ShiftResult.NONE
