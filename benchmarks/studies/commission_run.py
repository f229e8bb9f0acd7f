"""A job of study `commission`: one drawn gearbox whose sheet is withheld, commissioned on a stand;
and where nothing is miswired, its first contacts with the sheet that came of it beside those with
the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from meshpoint.base.version import product_version
from meshpoint.campaigns.draw import draw, upshifts
from meshpoint.campaigns.loop import ClosedLoop
from meshpoint.commission.drawn import draw_sheet, withheld
from meshpoint.commission.finding import Verdict
from meshpoint.commission.measured import commissioned
from meshpoint.commission.rehearsal import draw_miswiring, rehearse_turned
from meshpoint.controller.settings.learned import Calibration
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.gears import MAIN_GEARS, Range, Split
from meshpoint.rig_sim.settings import Preset, Profile


class Box(NamedTuple):
    """What came of one gearbox."""

    wrong: str
    """What is wrong with its wires, in words."""
    is_miswired: bool
    is_right: bool
    """Whether what is wrong, and nothing else, was named."""
    said: tuple[str, ...]
    """What was found bad."""
    reported: int
    """How many of 12 tooth counts and ratios were reported."""
    mistaken: int
    """How many of these are wrong."""
    true_gaps: tuple[bool, ...]
    """Of each judged shift, whether its first contact was in the gap, with the true sheet."""
    gaps: tuple[bool, ...]
    """The same, with the measured sheet and its calibration."""
    simulated_s: float


@dataclass(frozen=True)
class CommissionRun:
    """The job."""

    sheet: GearboxSheet
    seed: int
    share: float
    """Of boxes that are miswired."""
    learning: int
    shifts: int
    profile: Profile

    def run(self) -> Box:
        """Draws, commissions and compares."""
        sheet, wrong = draw_sheet(self.sheet, self.seed), draw_miswiring(self.seed, self.share)
        turned = rehearse_turned(sheet, self.seed, wrong, self.profile)
        bad = [one for one in turned.findings if one.verdict is Verdict.BAD]
        said = tuple(f"{one.subject}: {one.text}" for one in bad)
        reported = mistaken = 0
        true_gaps: tuple[bool, ...] = ()
        gaps: tuple[bool, ...] = ()
        if not bad and not wrong.is_any:
            found = commissioned(turned.core, withheld(sheet), product_version(), "study")
            reported, mistaken = _compared(
                sheet, found.sheet, {one.subject for one in found.findings}
            )
            true_gaps = self._gaps(sheet, None)
            gaps = self._gaps(sheet, (found.sheet, found.calibration))
        return Box(
            str(wrong), wrong.is_any, turned.is_right, said, reported, mistaken, true_gaps, gaps,
            turned.simulated_s,
        )  # fmt: skip

    def _gaps(
        self, sheet: GearboxSheet, known: tuple[GearboxSheet, Calibration | None] | None
    ) -> tuple[bool, ...]:
        """The same box, the same shifts: first contacts of those after the learning ones."""
        count = self.learning + self.shifts
        drawn = draw(self.seed, sheet, Preset.TRUCK, upshifts(), count, {}, self.profile)
        loop = ClosedLoop(sheet, ControllerSettings(), Preset.TRUCK, drawn, known=known)
        met: list[bool] = []
        try:
            for _ in range(count):
                row = loop.shift()
                met.append(row is not None and row.contact == "gap")
        except TimeoutError:
            met.extend([False] * (count - len(met)))
        return tuple(met[self.learning :])


def _compared(true: GearboxSheet, found: GearboxSheet, unknown: set[str]) -> tuple[int, int]:
    """Tooth counts of sensor wheels and exact ratios: how many were reported, and how many of these
    are not the true ones."""
    right = {
        f"{name} wheel": wheel.teeth == found.wheels.rows[name].teeth
        for name, wheel in true.wheels.rows.items()
    }
    for split in Split:
        same = true.split_mesh(split).exact == found.split_mesh(split).exact
        right[f"splitter.{split.name.lower()}"] = same
    for gear in MAIN_GEARS:
        same = true.main_mesh(gear).exact == found.main_mesh(gear).exact
        right[f"main.{gear.name.lower()}"] = same
    for range_ in Range:
        same = true.range_mesh(range_).exact == found.range_mesh(range_).exact
        right[f"range.{range_.name.lower()}"] = same
    reported = [is_right for name, is_right in right.items() if name not in unknown]
    return len(reported), reported.count(False)
