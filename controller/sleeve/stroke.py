"""A sleeve's way to a gear's teeth: when it meets them, and how sure that is."""

from __future__ import annotations

from typing import Final

import numpy as np

from meshpoint.controller.sleeve.cylinder import TO_LEVEL
from meshpoint.controller.sleeve.driven import DrivenSleeve
from meshpoint.controller.sleeve.motion import Switch, Way, Ways, single
from meshpoint.kernels.records import Vector
from meshpoint.units import SECOND_US, US

LONGEST_US: Final = 500_000
"""No sleeve takes longer to its gear."""


def to_contact(sleeve: DrivenSleeve, direction: int, switches: list[Switch]) -> Way:
    """Until it meets the teeth."""
    ways = _ways(sleeve, direction, switches, sleeve.unknowns(switches)[np.newaxis])
    return single(ways, sleeve.start)


def contacts_us(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector
) -> Vector:
    """When it meets them for each row of unknowns; nan where it does not."""
    crossed_s = _ways(sleeve, direction, switches, unknowns).of("crossed_s")
    return np.where(crossed_s < 0.0, np.nan, sleeve.start.time_us + SECOND_US * crossed_s)


def contact_sd_s(
    sleeve: DrivenSleeve, direction: int, switches: list[Switch], contact_us: float
) -> float:
    """Deviation of that contact."""

    def late_s(unknowns: Vector) -> Vector:
        late_us = contacts_us(sleeve, direction, switches, unknowns) - contact_us
        return np.nan_to_num(US * late_us)

    return sleeve.sd(late_s, switches, 0.0)


def _ways(sleeve: DrivenSleeve, direction: int, switches: list[Switch], unknowns: Vector) -> Ways:
    last_us = max((one.time_us for one in switches), default=sleeve.start.time_us)
    return sleeve.ways(
        unknowns,
        switches,
        ending=TO_LEVEL,
        until_us=last_us + LONGEST_US,
        level_m=direction * sleeve.law.face_m,
        direction=float(direction),
    )
