"""The record of one shift, and the states and transitions of the sequence that makes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, auto
from typing import Final

from meshpoint.controller.plan.strategist import Plan
from meshpoint.dbc.messages import ControllerState as State
from meshpoint.dbc.messages import Engagement, FaultCode, ReferenceSource, ShiftResult, Strategy
from meshpoint.gearbox import DriveGear, Range, Split
from meshpoint.gearbox.gears import DRIVE_GEARS


class Trigger(IntEnum):
    """Why the sequence changes its state."""

    FOUND_IN_GEAR = auto()
    FOUND_IN_NEUTRAL = auto()
    REQUESTED = auto()
    CLUTCH_OPEN = auto()
    MAIN_BOX_STAYS = auto()
    """Only the splitter moves: the main box stays in its gear."""
    MAIN_BOX_NEUTRAL = auto()
    LEFT_NEUTRAL = auto()
    """A sleeve that was to rest in neutral does not."""
    STEPS_IN = auto()
    """Splitter and range are in the steps of the new gear and synchronised."""
    TOO_SLOW = auto()
    """The gear turns slower than its sleeve: only the engine can bring it up."""
    TOO_FAST = auto()
    """Drag would take too long to bring the gear down: the brake helps once more."""
    RAISED = auto()
    BRAKE_RELEASED = auto()
    FIRED = auto()
    ENGAGED = auto()
    BLOCKED = auto()
    """The sleeve has to go back: it rests on a tooth, or would meet one."""
    ABORTED = auto()
    """The sleeve would meet a tooth: it is stopped short of the teeth."""
    LEG_DONE = auto()
    """One of two changes is made, of the main box or of a splitter with dog teeth."""
    RETRACTED = auto()
    GAVE_UP = auto()
    GEAR_UNKNOWN = auto()
    """The positions are lost, or a sleeve stands between neutral and a gear."""


_S, _T = State, Trigger
TRANSITIONS: Final[dict[tuple[State, Trigger], State]] = {
    (_S.STARTING, _T.FOUND_IN_GEAR): _S.IN_GEAR,
    (_S.STARTING, _T.FOUND_IN_NEUTRAL): _S.NEUTRAL,
    (_S.IN_GEAR, _T.FOUND_IN_NEUTRAL): _S.NEUTRAL,
    (_S.NEUTRAL, _T.FOUND_IN_GEAR): _S.IN_GEAR,
    (_S.IN_GEAR, _T.REQUESTED): _S.CLUTCH_OPENING,
    (_S.NEUTRAL, _T.REQUESTED): _S.CLUTCH_OPENING,
    (_S.CLUTCH_OPENING, _T.CLUTCH_OPEN): _S.DISENGAGING,
    (_S.DISENGAGING, _T.MAIN_BOX_STAYS): _S.SPLITTER_CHANGING,
    (_S.DISENGAGING, _T.MAIN_BOX_NEUTRAL): _S.STEPS_CHANGING,
    (_S.STEPS_CHANGING, _T.STEPS_IN): _S.SYNCHRONISING,
    (_S.SPLITTER_CHANGING, _T.ENGAGED): _S.CLUTCH_CLOSING,
    (_S.SYNCHRONISING, _T.BRAKE_RELEASED): _S.COASTING,
    (_S.SYNCHRONISING, _T.FIRED): _S.ENGAGING,
    (_S.SYNCHRONISING, _T.TOO_SLOW): _S.SPEED_RAISING,
    (_S.SPEED_RAISING, _T.RAISED): _S.CLUTCH_PARTING,
    (_S.CLUTCH_PARTING, _T.CLUTCH_OPEN): _S.SYNCHRONISING,
    (_S.COASTING, _T.FIRED): _S.ENGAGING,
    (_S.COASTING, _T.TOO_SLOW): _S.SPEED_RAISING,
    (_S.COASTING, _T.TOO_FAST): _S.SYNCHRONISING,
    (_S.ENGAGING, _T.ENGAGED): _S.CLUTCH_CLOSING,
    (_S.ENGAGING, _T.BLOCKED): _S.RETRACTING,
    (_S.ENGAGING, _T.ABORTED): _S.HALTED,
    (_S.HALTED, _T.FIRED): _S.ENGAGING,
    (_S.HALTED, _T.BLOCKED): _S.RETRACTING,
    (_S.HALTED, _T.ENGAGED): _S.CLUTCH_CLOSING,
    (_S.RETRACTING, _T.RETRACTED): _S.COASTING,
    (_S.RETRACTING, _T.ENGAGED): _S.CLUTCH_CLOSING,
    (_S.CLUTCH_CLOSING, _T.FOUND_IN_GEAR): _S.IN_GEAR,
    (_S.CLUTCH_CLOSING, _T.FOUND_IN_NEUTRAL): _S.NEUTRAL,
    (_S.CLUTCH_CLOSING, _T.GEAR_UNKNOWN): _S.FAULTED,
    (_S.FAULTED, _T.FOUND_IN_GEAR): _S.CLUTCH_CLOSING,
    (_S.FAULTED, _T.FOUND_IN_NEUTRAL): _S.CLUTCH_CLOSING,
}
"""A pair that is missing here is a programming error: KeyError."""
for _state in (_S.SPLITTER_CHANGING, _S.ENGAGING, _S.HALTED, _S.RETRACTING):
    TRANSITIONS[_state, _T.LEG_DONE] = _S.DISENGAGING

IN_SHIFT: Final = (
    _S.CLUTCH_OPENING,
    _S.DISENGAGING,
    _S.SPLITTER_CHANGING,
    _S.STEPS_CHANGING,
    _S.SYNCHRONISING,
    _S.SPEED_RAISING,
    _S.CLUTCH_PARTING,
    _S.COASTING,
    _S.ENGAGING,
    _S.HALTED,
    _S.RETRACTING,
)
"""The states of a shift that is under way; from each it can be given up."""
for _state in IN_SHIFT:
    TRANSITIONS[_state, _T.GAVE_UP] = _S.CLUTCH_CLOSING
    TRANSITIONS[_state, _T.GEAR_UNKNOWN] = _S.FAULTED

STEPS_ARE_IN: Final = (_S.SYNCHRONISING, _S.SPEED_RAISING, _S.CLUTCH_PARTING, _S.COASTING)
"""Splitter and range are in the steps of the new gear, and the main box is to stay in neutral until
its sleeve is fired."""
NEUTRAL_WANTED: Final = (_S.STEPS_CHANGING, *STEPS_ARE_IN)
"""A gear that is in mesh here was brought in by somebody else."""
for _state in NEUTRAL_WANTED:
    TRANSITIONS[_state, _T.LEFT_NEUTRAL] = _S.DISENGAGING
for _state in STEPS_ARE_IN:
    TRANSITIONS[_state, _T.ENGAGED] = _S.CLUTCH_CLOSING
    TRANSITIONS[_state, _T.LEG_DONE] = _S.DISENGAGING


@dataclass
class SplitterChange:
    """How far the change of a splitter with dog teeth has come."""

    inputs: list[tuple[int, float]] = field(default_factory=list)
    """The input shaft's speeds (us, rad/s) since it has turned alone."""
    layshafts: list[tuple[int, float]] = field(default_factory=list)
    """The layshaft's, over a swing of the driveline."""
    fire_us: int | None = None
    """When its sleeve was fired into the new step; None: it is not on its way there."""
    fired_us: int | None = None
    """The activation of the last firing."""
    attempts: int = 0
    drives: int = 0
    """How often the engine was to bring the input shaft to the new step's speed, for an attempt."""
    is_driven: bool = False
    """Whether it does so."""
    falls_rad_s2: float = 0.0
    """How fast that fell by itself before."""


@dataclass
class ShiftRecord:
    """One shift from request to outcome; what the outcome frame reports."""

    from_number: int
    to_number: int
    """The drive gear asked for; -1 if there is no such gear, and `target` is then meaningless."""
    target: DriveGear
    """The gear that the shift goes to now."""
    request_us: int
    strategy: Strategy
    """The strategy that acts: the fallback while the reference is unknown."""
    after: DriveGear | None = None
    """The gear asked for, where dog teeth of splitter and main box change one after the other and
    the target is the gear in between; else None."""
    splitter: SplitterChange = field(default_factory=SplitterChange)
    engagement: Engagement = Engagement.MAIN_GEAR
    """Whose dog teeth the outcome reports: the splitter's where it alone is to change."""
    aimed: bool = False
    """Whether the acting strategy aims at a phase; then the contact shows the error of its
    prediction."""
    reference_known: bool = False
    reference_source: ReferenceSource = ReferenceSource.NONE
    attempts: int = 0
    calls: int = 0
    """How often a sleeve was recalled before it had moved."""
    aborts: int = 0
    """How often a sleeve on its way was stopped short of the teeth."""
    halt_m: float = 0.0
    """Where the sleeve stood after the last abort, from neutral."""
    first_fire_us: int | None = None
    """The activation of the first firing."""
    raises: int = 0
    """How often the engine was asked to bring the layshaft up."""
    beyond_us: int | None = None
    """Since when the new gear would turn the input shaft faster than it may."""
    pulses: int = 0
    """How often the brake was used, since the engine last raised the gear."""
    steps_before: tuple[Split | None, Range | None] | None = None
    """Where splitter and range stood when their change began."""
    blocks: int = 0
    """How often the guard has blocked what was commanded."""
    own_nm: float | None = None
    """The engine's torque before it was taken away as a plan says; None: it was not."""
    own_us: int = 0
    """Since then some of it is taken away."""
    unloads_in: int | None = None
    """The steps of a plan until the plates part, as planned last."""
    owed_share: float = 0.0
    """What rounding has left out of the torque asked for."""
    grinds: bool = False
    """Whether a sleeve has come to a gear that turns against it outside the guard's window."""
    pulls: int = 0
    """How often the old gear was pulled."""
    pushed_us: int | None = None
    """When a valve last went off that pushed a sleeve on to neutral, or braked it there."""
    is_braked: bool = False
    """Whether the guard takes it to have braked the sleeve."""
    flies: bool = False
    """Whether the sleeve moved as it was pushed: it may come back to the gear that it came from."""
    returns: int = 0
    """How often a sleeve that had left neutral was brought back."""
    pull_again_us: int = 0
    """A gear that has not come out is not pulled again before."""
    clutch_us: int | None = None
    """When the clutch set off to open."""
    release_us: int | None = None
    plan: Plan | None = None
    measured_contact_us: int | None = None
    moves: int = 0
    """How often a tooth that stood on a tooth was moved on."""
    moved_us: int = 0
    """When the last pulse of the brake ends that does so."""
    estimated_phase_rad: float = 0.0
    result: ShiftResult = ShiftResult.NONE
    fault: FaultCode = FaultCode.NONE
    end_us: int | None = None

    @property
    def changes_range(self) -> bool:
        """Whether the range box changes, too: it leaves the main shaft swinging."""
        before = DRIVE_GEARS.get(self.from_number)
        return before is not None and before.range_ is not self.target.range_

    @property
    def firings(self) -> int:
        """How often the sleeve was fired that the outcome reports."""
        reports_splitter = self.engagement is Engagement.SPLITTER
        return self.splitter.attempts if reports_splitter else self.attempts

    @property
    def fired_us(self) -> int:
        """When it was fired last; 0 if it was not."""
        if self.engagement is Engagement.SPLITTER:
            return self.splitter.fired_us or 0
        return self.plan.fire_us if self.plan else self.first_fire_us or 0
