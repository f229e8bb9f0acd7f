"""A job of study `counterfactual`: shifts of one truck, and the truth of the other strategy.

At each request the very same bench is copied, and the copy goes on with the other strategy: what
becomes of it is the truth. The recorded bus is then replayed in open loop like any log.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from meshpoint.base.version import product_version
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.controller.settings.header import new_header
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.gearbox import GearboxSheet
from meshpoint.replays.open_loop import OpenLoop
from meshpoint.replays.replay import LogReplay
from meshpoint.replays.session import Verification
from meshpoint.report.judged import Judged
from meshpoint.results.rows import ShiftRow
from meshpoint.rig_sim.settings import Preset, Profile
from meshpoint.units import DEG


class Compared(NamedTuple):
    """One shift: what was worked out from the log, beside the branched bench."""

    why: str
    """Why nothing was worked out; empty where something was."""
    is_same: bool
    """Whether the other strategy commanded what was recorded."""
    error_deg: float
    """True phase less the middle of the interval, wrapped to the pitch."""
    half_deg: float
    """Half the interval."""
    probability: float
    """Of a gap, as worked out."""
    in_gap: bool
    """What it truly met."""

    @property
    def covered(self) -> bool:
        """Whether the truth lies in the interval."""
        return abs(self.error_deg) <= self.half_deg


@dataclass(frozen=True)
class CounterfactualRun:
    """The job: `learning` shifts, then `shifts` that are compared."""

    sheet: GearboxSheet
    seed: int
    learning: int
    shifts: int
    recorded: str
    asked: str
    profile: Profile

    def run(self) -> list[Compared]:
        """Records, branches and replays."""
        settings = replace(ControllerSettings(), strategy_name=self.recorded)
        count = self.learning + self.shifts
        drawn = draw(self.seed, self.sheet, Preset.TRUCK, upshifts(), count + 1, {}, self.profile)
        loop = ClosedLoop(self.sheet, settings, Preset.TRUCK, drawn, log=[])
        truth: dict[int, ShiftRow] = {}
        for number in range(count):
            loop.prepare()
            branch = loop.fork() if number >= self.learning else None
            recorded = loop.shift()
            if branch is None or recorded is None:
                continue
            branch.log = None
            branch.use(replace(settings, strategy_name=self.asked), knows_all=False)
            row = branch.shift()
            if row is not None and row.phase_error_deg is not None:
                truth[recorded.request_us] = row
        loop.prepare()
        frames = [] if loop.log is None else [frame for _, frame in loop.log]
        judged = self._replayed(settings, frames)
        return [
            self._compared(settings, shift, truth[shift.request_us])
            for shift in judged
            if shift.request_us in truth
        ]

    def _replayed(self, settings: ControllerSettings, frames: list[Frame]) -> list[Judged]:
        open_loop = OpenLoop(
            lambda header: replace(header, settings=header.settings.with_strategy(self.asked))
        )
        with tempfile.TemporaryDirectory() as folder:
            new_header(product_version(), self.sheet, settings).save(Path(folder))
            (session,) = LogReplay(Path(folder), verify=True, onlooker=open_loop).run(frames)
        if session.verdict is not Verification.IDENTICAL:
            raise RuntimeError(f"seed {self.seed}: the recorded run is {session}")
        return list(open_loop.judged.values())

    def _compared(self, settings: ControllerSettings, shift: Judged, true: ShiftRow) -> Compared:
        found = shift.counterfactual
        in_gap = true.contact == "gap"
        if found is None or not found.decidable or true.phase_error_deg is None:
            why = "" if found is None else found.why
            return Compared(why, shift.parted is None, math.nan, math.nan, math.nan, in_gap)
        low, high = found.phase_low_deg or 0.0, found.phase_high_deg or 0.0
        target_deg = settings.aim.target_rad(self.sheet.dog.backlash_rad) / DEG
        error = true.phase_error_deg + target_deg - (low + high) / 2.0
        error -= true.pitch_deg * math.floor(error / true.pitch_deg + 0.5)
        probability = found.contact_probability or 0.0
        return Compared("", False, error, (high - low) / 2.0, probability, in_gap)
