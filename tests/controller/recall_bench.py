"""A made gearbox whose wheels lose their numbers and find them again; its true turn and angles are
known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from meshpoint.controller.estimate.reference import PhaseReferences
from meshpoint.controller.estimate.reference_recovery import ReferenceRecovery, SavedReferences
from meshpoint.controller.estimate.teeth import PatternMatch, ToothPattern, WheelTeeth, turned
from meshpoint.controller.measure.wheel_edges import Renumbered
from meshpoint.controller.settings.filters import CrossingFilterTuning
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear, load_sheet
from meshpoint.gearbox.kinematics import raw_phase_rad, wrap_to_pitch
from meshpoint.gearbox.wheels import Mesh

TURN = 2.0 * math.pi
THESIS, TRUCK12 = load_sheet("thesis"), load_sheet("truck12")
WHOLE = replace(
    THESIS, main=replace(THESIS.main, crawl=Mesh(13, 48), first=Mesh(22, 48), second=Mesh(37, 48),
                         third=Mesh(62, 48)),
)  # fmt: skip
"""Gears with as many teeth as their dog teeth: a turn of the layshaft moves them by whole ones."""
TIED = replace(
    TRUCK12, main=replace(TRUCK12.main, crawl=Mesh(17, 56), first=Mesh(18, 42), second=Mesh(29, 42))
)
"""Wheels of a common factor of seven, each ratio within 1.8 % of truck12's."""


@dataclass
class Box:
    """True angles = counted ones + where counting began; whole turns of the layshaft count."""

    sheet: GearboxSheet
    layshaft_rad: float = 0.0
    main_rad: float = 0.0
    mounted_rad: float = 1.234

    def offset(self, gear: MainGear) -> float:
        """The reference of a gear in the present counting."""
        ratio = self.sheet.main_mesh(gear).ratio
        own = self.mounted_rad * (1.0 + gear)
        return -raw_phase_rad(ratio, self.layshaft_rad, self.main_rad) - own


class Bench:
    """A reference recovery with its wheels; a wheel whose numbers are lost is counted anew."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self.sheet, self.box = sheet, Box(sheet)
        rng = np.random.default_rng(0)
        self.patterns = [rng.normal(size=2 * size) for size in self._sizes]
        self.at = [0, 0]
        """Tooth of layshaft and main wheel that counting began at."""
        self.counted = 0
        """By how many teeth the layshaft was renumbered since power-up."""
        self.events: list[str] = []
        self.power_up(None)

    def power_up(self, saved: SavedReferences | None) -> None:
        """Another controller, with what an earlier one has left."""
        tuning, (layshaft, main) = CrossingFilterTuning(), self._sizes
        self.references = PhaseReferences(self.sheet)
        self.layshaft, self.main = WheelTeeth(layshaft, tuning), WheelTeeth(main, tuning)
        self.recovery = ReferenceRecovery(self.sheet, self.references, self.layshaft, self.main)
        self.renumbered = Renumbered()
        if saved is not None:
            self.recovery.restore(saved)

    def restore(self, *gears: MainGear) -> None:
        """As after a restart: all of these were known."""
        memory = [ToothPattern(pattern, 1e-4, 1) for pattern in self.patterns]
        offsets = {gear: self.box.offset(gear) for gear in gears}
        self.recovery.restore(SavedReferences(memory[0], memory[1], offsets))

    @property
    def _sizes(self) -> tuple[int, int]:
        wheels = self.sheet.wheels
        return wheels.layshaft.teeth, wheels.main.teeth

    def count_from(self, layshaft: int, main: int, turns: int = 0) -> None:
        """Present tooth 0 is this many teeth and turns further on."""
        sizes = self._sizes
        self.box.layshaft_rad += layshaft * TURN / sizes[0] + turns * TURN
        self.box.main_rad += main * TURN / sizes[1]
        self.at = [self.at[0] + layshaft, self.at[1] + main]
        self.counted = layshaft + turns * sizes[0]

    def lose(self, layshaft: int | None, main: int | None, turns: int = 0) -> None:
        """Wheels that are counted from another tooth on; None: counted on."""
        self.recovery.lost(layshaft is not None, main is not None)
        for teeth, moved in ((self.layshaft, layshaft), (self.main, main)):
            if moved is not None:
                teeth.lose_numbers()
        self.count_from(layshaft or 0, main or 0, turns)

    def sensor_says(self, before: int, behind: int) -> None:
        """It has counted what the layshaft was renumbered by, give or take this many teeth."""
        least, most = self.counted - before, self.counted + behind
        old = self.renumbered
        self.renumbered = Renumbered(old.least + least, old.most + most, old.uncounted)

    def find(self, layshaft: bool = True, main: bool = True) -> None:
        """The wheels show their patterns; what is remembered of them is found in those."""
        wheels = ((self.layshaft, layshaft), (self.main, main))
        for k, (teeth, shows) in enumerate(wheels):
            if not shows or teeth.learned:
                continue
            size, memory = self._sizes[k], teeth.memory
            present = turned(self.patterns[k], self.at[k] % size)
            if memory is not None:
                found = [j for j in range(size) if (turned(memory.error_rad, j) == present).all()]
                teeth.found, teeth.memory = PatternMatch(found[0], 99.0, 1.0), None
            teeth.error_rad, teeth.learned = present, True
        self.recovery.measure(self.events, self.renumbered)

    def learn(self, gear: MainGear, error_rad: float = 0.0, sd_rad: float = 0.0) -> None:
        self.references.adopt(gear, self.box.offset(gear) + error_rad, ReferenceSource.MEASURED)
        self.recovery.learned(gear, sd_rad, self.events)

    def known(self, within_rad: float = 1e-9) -> set[MainGear]:
        """The known gears; each of them must be right."""
        known = self.references.offsets_rad
        for gear, offset in known.items():
            error = wrap_to_pitch(offset - self.box.offset(gear), self.sheet.dog.pitch_rad)
            assert abs(error) < within_rad, gear
        return set(known)
