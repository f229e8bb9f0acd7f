"""What the shift sequence sees at one step."""

from __future__ import annotations

from dataclasses import dataclass

from meshpoint.controller.estimation.cruise import ShaftState
from meshpoint.controller.estimation.layshaft import LayshaftTracker
from meshpoint.controller.sensing.gearbox_view import GearboxView
from meshpoint.controller.sensing.shaft_speeds import ShaftSpeeds
from meshpoint.dbc.messages import FaultCode


@dataclass(frozen=True)
class StepSnapshot:
    """What the sequence sees at one step, all in the sensor clock."""

    now_us: int
    earliest_us: int
    """The earliest activation that can still arrive in time."""
    view: GearboxView
    layshaft: LayshaftTracker
    main: ShaftState | None
    speeds: ShaftSpeeds
    lost: FaultCode
    """What a shift cannot go on without and has been lost: SPEED_STALE, POSITION_STALE or
    VALVE_LINK_LOST; else NONE."""
    brake_driven: bool
    """The valve side reports the brake valve driven or about to be."""
    supply_pa: float
    """Absolute supply pressure; infinite before the first frame."""
