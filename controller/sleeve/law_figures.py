"""What is known of a sleeve's law, as figures, each with its deviation."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from meshpoint.controller.estimation.figure import Estimate
from meshpoint.controller.sleeve.cylinder import DETENT, DETENT_UNIT_N, OFF, ON
from meshpoint.controller.sleeve.driven import DrivenSleeve, valve_towards
from meshpoint.controller.sleeve.motion import Switch
from meshpoint.controller.sleeve.stopping import stopping_m
from meshpoint.controller.sleeve.stroke import contact_sd_s, contacts_us, to_contact
from meshpoint.kernels.records import Vector
from meshpoint.units import BAR, US

ABOUT_PA: Final = 0.5 * BAR
"""By so much more and less air it is seen what a bar does to the delay."""


class LawFigures(NamedTuple):
    """Of a sleeve on its way to one gear, at the data sheet's supply pressure."""

    movements: int
    """From how many movements of the sleeve the law was learned."""
    on_delay_s: Estimate
    """Of the valve that pushes there: from its current to its spool's movement."""
    off_delay_s: Estimate
    contact_s: Estimate
    """From the valve's current to contact, from neutral."""
    contact_s_per_pa: Estimate
    """By how much that grows with the supply pressure."""
    detent_n: Estimate
    stopping_m: Estimate | None
    """How far a sleeve still goes that is stopped as late as it can be; None where it cannot."""


def law_figures(sleeve: DrivenSleeve, direction: int, movements: int) -> LawFigures:
    """Of a sleeve that rests in neutral."""
    valve, (mean, covariance) = valve_towards(direction), sleeve.known

    def of(place: int, unit: float = 1.0) -> Estimate:
        return Estimate(unit * float(mean[place]), unit * math.sqrt(covariance[place, place]))

    fired, sheet_pa = [Switch(0, valve, True)], sleeve.law.sheet_pa
    sleeve.supply_pa = sheet_pa
    stops = stopping_m(sleeve, direction)
    sleeve.switch_sd_s = [0.0, 0.0]  # from here on the chance of a stroke is no part of it
    contact_us = to_contact(sleeve, direction, fired).crossed_us or 0.0

    def by_air_s_per_pa(unknowns: Vector) -> Vector:
        times_us = []
        for sleeve.supply_pa in (sheet_pa - ABOUT_PA, sheet_pa + ABOUT_PA):
            times_us.append(np.nan_to_num(contacts_us(sleeve, direction, fired, unknowns)))
        sleeve.supply_pa = sheet_pa
        return (times_us[1] - times_us[0]) * US / (2.0 * ABOUT_PA)

    by_air = float(by_air_s_per_pa(sleeve.unknowns(fired)[np.newaxis])[0])
    return LawFigures(
        movements,
        of(ON + valve),
        of(OFF + valve),
        Estimate(contact_us * US, contact_sd_s(sleeve, direction, fired, contact_us)),
        Estimate(by_air, sleeve.sd(by_air_s_per_pa, fired, by_air)),
        of(DETENT, DETENT_UNIT_N),
        None if stops is None else Estimate(*stops),
    )
