"""The inputs of the shift sequence at one step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from meshpoint.controller.estimate.layshaft_tracker import LayshaftTracker
from meshpoint.controller.estimate.loaded_driveline import LoadedDriveline
from meshpoint.controller.measure.gearbox_view import GearboxView
from meshpoint.controller.measure.inputs import ShaftSpeeds
from meshpoint.controller.models.swing import ShaftState
from meshpoint.controller.plan.strategy import BUS_US
from meshpoint.controller.settings.valve_name import Driven
from meshpoint.dbc.messages import FaultCode

MISSING: Final = (FaultCode.SPEED_STALE, FaultCode.POSITION_STALE, FaultCode.VALVE_LINK_LOST)
"""Inputs that a shift needs and that are not there."""
WHEEL_FAULTS: Final = (
    FaultCode.INPUT_WHEEL_WRONG,
    FaultCode.LAYSHAFT_WHEEL_WRONG,
    FaultCode.MAIN_WHEEL_WRONG,
    FaultCode.PROPELLER_WHEEL_WRONG,
)
"""By the number of the shaft whose speed wheel reads wrong."""


@dataclass(frozen=True)
class StepSnapshot:
    """The inputs of the shift sequence at one step. Times are in us of the sensor clock."""

    now_us: int
    earliest_us: int
    """The earliest activation time that a command sent now can still meet."""
    view: GearboxView
    layshaft: LayshaftTracker
    main: ShaftState | None
    speeds: ShaftSpeeds
    lost: FaultCode
    """The input that a shift needs and that is missing (`MISSING`) or contradicted (`WHEEL_FAULTS`,
    or WHEELS_DISAGREE where it may be one of several); NONE if all are there."""
    driven: Driven
    """Of each valve, whether the valve side reports it driven, or its activation pending."""
    supply_pa: float
    """Absolute supply pressure; infinite before the first frame."""
    engine_rad_s: float | None = None
    """The engine's speed in this step's newest frame; None without one."""
    engine_torque_share: float | None = None
    """Its torque there, as a share of its reference torque; None without one."""
    engine_torque_step: float = 0.01
    """The step in which that torque is reported."""
    is_self_tested: bool = True
    """Whether the guard's self-test is passed: before that it lets no valve be driven."""
    more_lead_us: int = 0
    """By how much more than set an activation is sent ahead, since one was refused."""
    loaded: LoadedDriveline | None = None
    """The driveline with a gear in mesh; None: nobody follows it."""

    @property
    def at_once_us(self) -> int:
        """When a valve can be switched against a sleeve's motion, which waits for no lead."""
        return self.now_us + BUS_US + self.more_lead_us
