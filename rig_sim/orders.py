"""What the bench and the engine controller ask of a gearbox."""

from __future__ import annotations

from typing import NamedTuple


class EngineRequest(NamedTuple):
    """A TSC1 request: speed (rad/s) or torque (Nm share 0..1 of the highest); both None: none."""

    speed_rad_s: float | None
    torque_share: float | None


class FaultOrder(NamedTuple):
    """A fault from the bench or a scenario: kind and target by number, value in the kind's unit,
    duration 0 for until further notice."""

    kind: int
    target: int
    value: float
    duration_us: int


class ScheduledFault(NamedTuple):
    """A fault of a scenario, at a time since power-up."""

    at_us: int
    order: FaultOrder
