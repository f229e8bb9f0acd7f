"""Engagements tried on the truck rig's dog teeth alone: jobs of `shiftability` and `target`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from benchmarks.studies.jobs import AsBuilt, linear_with_teeth
from benchmarks.studies.trials import Trials
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.units import DEG

GEAR: Final = MainGear.SECOND


class Tried(NamedTuple):
    """One engagement: phase at contact in deg, and what came of it."""

    phase_deg: float
    gap: bool
    clean: bool
    """Into a gap at first contact, and no flank before the overlap held."""
    locked: bool
    impact_j: float
    face_ms: float
    ratchets: int


@dataclass(frozen=True)
class Engagements:
    """A job: engagements at every slip, phases evenly over a pitch; on a gearbox that is linear but
    for its dog teeth, the layshaft without drag so that the slip at contact is the one named."""

    sheet: GearboxSheet
    changed: AsBuilt
    slips_rad_s: tuple[float, ...]
    phases: int
    patience_us: float

    def run(self) -> dict[float, list[Tried]]:
        """Outcomes by slip."""
        sheet = replace(self.sheet, shafts=replace(self.sheet.shafts, friction_nms=0.0))
        trials = Trials(sheet, dict(teeth_alone()) | dict(self.changed), GEAR)
        half = trials.pitch_rad / 2.0
        phases = np.linspace(-half, half, self.phases, endpoint=False) + half / self.phases
        return {
            slip: [_try(trials, phase, slip, self.patience_us) for phase in phases.tolist()]
            for slip in self.slips_rad_s
        }


def _try(trials: Trials, phase_rad: float, slip_rad_s: float, patience_us: float) -> Tried:
    outcome = trials.engage(phase_rad, slip_rad_s, patience_us)
    tally = trials.engagement.tally(trials.sleeve)
    if outcome.locked is not None:
        tally = outcome.locked.tally
    return Tried(
        phase_rad / DEG,
        outcome.in_gap and outcome.passed is None,
        outcome.clean,
        outcome.locked is not None,
        tally.impact_j,
        tally.face_us / 1e3,
        tally.ratchets,
    )


@cache
def teeth_alone() -> AsBuilt:
    """The thesis's linear gearbox with the truck's dog teeth at their defaults, without chance in
    the sleeve's delay."""
    return (*linear_with_teeth(), ("sleeve.noise_sd_ms", 0.0))
