"""What is known of a sleeve's law, as figures, each with its deviation."""

from __future__ import annotations

import math
from typing import NamedTuple

from meshpoint.controller.estimate.figure import Estimate
from meshpoint.controller.sleeve.cylinder import OFF, ON
from meshpoint.controller.sleeve.driven import DrivenSleeve, valve_towards
from meshpoint.controller.sleeve.motion import Switch
from meshpoint.controller.sleeve.stroke import contact_sd_s, to_contact
from meshpoint.units import US


class LawFigures(NamedTuple):
    """Of a sleeve on its way to one gear, at the data sheet's supply pressure. Deviations are by
    the law itself: they do not hold what it leaves out."""

    movements: int
    """From how many movements of the sleeve the law was learned."""
    on_delay_s: Estimate
    """Of the valve that pushes there: from its current to its spool's movement."""
    off_delay_s: Estimate
    contact_s: Estimate
    """From the valve's current to contact, from neutral."""


def law_figures(sleeve: DrivenSleeve, direction: int, movements: int) -> LawFigures:
    """Of a sleeve that rests in neutral."""
    valve, (mean, covariance) = valve_towards(direction), sleeve.known

    def of(place: int) -> Estimate:
        return Estimate(float(mean[place]), math.sqrt(covariance[place, place]))

    fired = [Switch(0, valve, True)]
    sleeve.supply_pa = sleeve.law.sheet_pa
    sleeve.switch_sd_s = [0.0, 0.0]  # the chance of a stroke is no part of it
    contact_us = to_contact(sleeve, direction, fired).crossed_us or 0.0
    contact = Estimate(contact_us * US, contact_sd_s(sleeve, direction, fired, contact_us))
    return LawFigures(movements, of(ON + valve), of(OFF + valve), contact)
