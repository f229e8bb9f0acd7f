"""Watches a gear that has just locked until its phase reference is known.

A measurement is both shafts' angles at the newest edge: there nothing is extrapolated, so an impact
causes the least error.
"""

from __future__ import annotations

import math
from typing import Final

from meshpoint.controller.estimate.phase.reference import PhaseReferences
from meshpoint.controller.estimate.phase.reference_recovery import ReferenceRecovery
from meshpoint.controller.models.models import LayshaftState
from meshpoint.controller.models.swing import ShaftState
from meshpoint.gearbox import GearboxSheet, MainGear

LOOKED_AT_US: Final = 185_000
"""Before it has been looked at for so long, 0.2 s but for the time from an edge to its read,
nothing is concluded of a gear that stays in mesh: its tooth may still be on its way to a flank."""


class LockedGear:
    """What is seen of a gear in mesh whose phase is looked for."""

    def __init__(
        self,
        sheet: GearboxSheet,
        references: PhaseReferences,
        recovery: ReferenceRecovery | None,
    ) -> None:
        """recovery: what outlives lost tooth numbers; None for estimators that know no teeth."""
        self._sheet = sheet
        self._references = references
        self._recovery = recovery
        self._looked_us = 0.0
        """The newest edge at the latest measurement."""
        self._since_us = 0.0
        """The same at the first measurement of the gear that is watched."""

    def is_due(self, newest_us: float) -> bool:
        """Whether there are edges since the latest measurement: a step between two reads has
        none."""
        is_new, self._looked_us = newest_us != self._looked_us, newest_us
        return is_new

    def measure(
        self, gear: MainGear, layshaft: LayshaftState, main: ShaftState, events: list[str]
    ) -> None:
        """One measurement."""
        ratio = self._sheet.main_mesh(gear).ratio
        sd_rad = math.hypot(ratio * layshaft.theta_sd_rad, main.theta_sd_rad)
        references = self._references
        references.measure(gear, layshaft.theta_rad, main.theta_rad, sd_rad)
        watched = references.watched
        if watched is not None and watched.measurements == 1:
            self._since_us = layshaft.time_us
        if watched is not None and layshaft.time_us - self._since_us >= LOOKED_AT_US:
            self._settle(gear, events)

    def released(self, events: list[str]) -> None:
        """No gear is in mesh any more."""
        gear = self._references.released()
        if gear is None or self._settle(gear, events) or self._references.known(gear):
            return
        name = gear.name.lower()
        events.append(f"phase reference of {name} not learned: its tooth was not seen in mesh")

    def _settle(self, gear: MainGear, events: list[str]) -> bool:
        """Whether the gear's reference has just been learned."""
        if not self._references.settle(gear):
            return False
        events.append(f"phase reference of {gear.name.lower()} learned")
        if self._recovery is not None:
            self._recovery.learned(gear, self._references.sd_rad(gear), events)
        return True
