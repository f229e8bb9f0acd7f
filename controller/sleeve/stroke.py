"""A sleeve's way to a gear's teeth: when it meets them, and how sure that is."""

from __future__ import annotations

from typing import Final

from meshpoint.controller.records import Vector
from meshpoint.controller.sleeve.driven import DrivenSleeve
from meshpoint.controller.sleeve.motion import Switch, Way
from meshpoint.units import US

LONGEST_US: Final = 500_000
"""No sleeve takes longer to its gear."""


def to_contact(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector | None = None
) -> Way:
    """Until it meets the teeth."""
    last_us = max((one.time_us for one in switches), default=sleeve.start.time_us)
    level_m = direction * sleeve.law.face_m
    return sleeve.to_level(direction, level_m, last_us + LONGEST_US, switches, unknowns)


def contact_sd_s(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], contact_us: float
) -> float:
    """Deviation of that contact."""

    def crossed_s(unknowns: Vector) -> float:
        crossed_us = to_contact(sleeve, direction, switches, unknowns).crossed_us
        return 0.0 if crossed_us is None else (crossed_us - contact_us) * US

    return sleeve.sd(crossed_s, switches, 0.0)
