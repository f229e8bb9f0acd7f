"""Which shafts turn together: what splitter and range changes wait for.

A sleeve's position shows that a step is in mesh, but its synchroniser may still be slipping; the
speeds show when it has finished.
"""

from __future__ import annotations

from typing import Final

from meshpoint.controller.measure.edge_speed import EdgeSpeed
from meshpoint.controller.measure.step_inputs import StepInputs
from meshpoint.dbc.messages import (
    EdgesInputRise,
    EdgesLayshaftRise,
    EdgesMainRise,
    EdgesPropellerRise,
)
from meshpoint.gearbox import GearboxSheet, MainGear, Range, Split

TOGETHER_SHARE: Final = 0.01
"""Shafts whose speeds differ by less turn together: pitch errors of a wheel are half of it."""


class ShaftSpeeds:
    """Speeds of the four shafts from their newest frames, rad/s."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        wheels = sheet.wheels
        self._now_us = 0
        self._shafts: dict[type, EdgeSpeed] = {
            EdgesInputRise: EdgeSpeed(wheels.input_.teeth),
            EdgesLayshaftRise: EdgeSpeed(wheels.layshaft.teeth),
            EdgesMainRise: EdgeSpeed(wheels.main.teeth),
            EdgesPropellerRise: EdgeSpeed(wheels.propeller.teeth),
        }

    def take(self, inputs: StepInputs, now_us: int) -> None:
        """One step's frames at a sensor time."""
        self._now_us = now_us
        for kind, shaft in self._shafts.items():
            for frame in inputs.edges[kind]:
                shaft.take(frame, now_us)

    def _of(self, kind: type) -> float | None:
        speed = self._shafts[kind].at(self._now_us)
        return None if speed is None else speed.omega_rad_s

    @property
    def layshaft(self) -> float | None:
        """Layshaft speed (rad/s); None if it is stale or invalid, as for the other shafts."""
        return self._of(EdgesLayshaftRise)

    @property
    def main(self) -> float | None:
        """Main shaft speed."""
        return self._of(EdgesMainRise)

    @property
    def propeller(self) -> float | None:
        """Propeller shaft speed."""
        return self._of(EdgesPropellerRise)

    def slip_rad_s(self, gear: MainGear) -> float | None:
        """Slip of a gear."""
        layshaft, main = self.layshaft, self.main
        if layshaft is None or main is None:
            return None
        return self._sheet.main_mesh(gear).ratio * layshaft - main

    def split_turns_together(self, split: Split) -> bool:
        """Whether input shaft and layshaft have the ratio of this step."""
        return _together(
            self._of(EdgesInputRise), self.layshaft, self._sheet.split_mesh(split).ratio
        )

    def range_turns_together(self, range_: Range) -> bool:
        """Whether main and propeller shaft have the ratio of this step."""
        return _together(self.main, self.propeller, self._sheet.range_mesh(range_).ratio)


def _together(driving: float | None, driven: float | None, ratio: float) -> bool:
    if driving is None or driven is None:
        return False
    return abs(driving * ratio - driven) <= TOGETHER_SHARE * driven
