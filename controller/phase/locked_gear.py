"""Watches a gear that has just locked until its phase reference is known.

A measurement is both shafts' angles at the newest edge: there nothing is extrapolated, so an impact
causes the least error. Whether drag alone holds the gear's tooth at its lower flank is known from
the speeds of the latest measurements.
"""

from __future__ import annotations

import math
from collections import deque

from meshpoint.controller.motion.models import LayshaftState
from meshpoint.controller.motion.swing import ShaftState
from meshpoint.controller.phase.reference import PhaseReferences
from meshpoint.controller.phase.reference_recovery import ReferenceRecovery
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.units import US

PULL_RAD_S2 = 5.0
"""Deceleration by drag above which it pulls a tooth across a gap of 1.5 deg within 0.1 s."""
MEASUREMENT_US = 10_000
"""Time from one measurement to the next."""
MEASUREMENTS_PULLED = 8
"""Number of newest measurements over which the main shaft's acceleration is watched."""
MEASUREMENT_SHARE = 0.15
"""Largest standard deviation of a measurement at a gear in mesh, in backlashes, for which the two
flanks can be distinguished."""


class LockedGear:
    """What is seen of a gear in mesh whose flank is looked for."""

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
        self._main_speeds: deque[tuple[float, float]] = deque(maxlen=MEASUREMENTS_PULLED)
        """Times (us) and speeds (rad/s) of the main shaft at the latest measurements."""
        self._looked_us = 0.0
        """The newest edge at the latest measurement."""

    def is_due(self, newest_us: float) -> bool:
        """Whether there are edges since the latest measurement: a step between two reads has
        none."""
        is_new, self._looked_us = newest_us != self._looked_us, newest_us
        return is_new

    def measure(
        self,
        gear: MainGear,
        layshaft: LayshaftState,
        main: ShaftState,
        coasting_rad_s2: float | None,
        events: list[str],
    ) -> None:
        """One measurement. coasting_rad_s2: by how much the layshaft's drag slows it down; None
        where the clutch bites."""
        references, recovery = self._references, self._recovery
        sd_rad = self._phase_sd_rad(gear, layshaft, main)
        references.see(gear, layshaft.theta_rad, main.theta_rad, sd_rad)
        if sd_rad >= MEASUREMENT_SHARE * self._sheet.dog.backlash_rad:
            return
        pulled = self._drag_pulls(gear, main, coasting_rad_s2)
        if references.watch(gear, layshaft.theta_rad, main.theta_rad, pulled):
            events.append(f"phase reference of {gear.name.lower()} learned")
            if recovery is not None:
                recovery.learned(gear, sd_rad, events)

    def released(self, events: list[str]) -> None:
        """No gear is in mesh any more."""
        floated = self._references.released()
        if floated is not None and self._recovery is not None:
            self._recovery.floated(floated, events)

    def _phase_sd_rad(self, gear: MainGear, layshaft: LayshaftState, main: ShaftState) -> float:
        ratio = self._sheet.main_mesh(gear).ratio
        return math.hypot(ratio * layshaft.theta_sd_rad, main.theta_sd_rad)

    def _drag_pulls(self, gear: MainGear, main: ShaftState, coasting_rad_s2: float | None) -> bool:
        """Whether drag alone turns the layshaft, and holds the gear's tooth at its lower flank."""
        self._main_speeds.append((main.time_us, main.omega_rad_s))
        if coasting_rad_s2 is None:
            return False
        ratio = self._sheet.main_mesh(gear).ratio
        return ratio * coasting_rad_s2 - self._slowest_rad_s2(main) < -PULL_RAD_S2

    def _slowest_rad_s2(self, main: ShaftState) -> float:
        """The lowest acceleration of the main shaft during the latest measurements, over two
        measurements each. On a driveline that swings it is far below that of the vehicle: then drag
        does not hold the tooth at one flank."""
        measurements = [
            measurement
            for measurement in self._main_speeds
            if main.time_us - measurement[0] < MEASUREMENTS_PULLED * MEASUREMENT_US
        ]
        rates = [
            (after[1] - before[1]) / ((after[0] - before[0]) * US)
            for before, after in zip(measurements, measurements[2:], strict=False)
            if after[0] > before[0]
        ]
        return min([main.acceleration_rad_s2, *rates])
