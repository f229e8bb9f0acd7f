"""Phase references: the angle between gear teeth and sleeve teeth, learned when a gear locks.

The sensor wheels count teeth but do not measure absolute angles (thesis 8.2). In mesh a tooth lies
in its gap, so the constant between counted angles and phase follows from where it is seen while the
gear is in mesh (`gap_posterior`). An observation of the phase of a gear in mesh is called a
measurement. Counting teeth keeps the reference exact; it is lost when the count of either wheel is
lost. A gear that has been in mesh has a reference from then on, with a standard deviation that says
how well it is known; plans price it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from meshpoint.controller.estimate.phase.gap_posterior import GapPosterior, log_densities
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear
from meshpoint.gearbox.kinematics import raw_phase_rad, wrap_to_pitch

MOST_MEASUREMENTS: Final = 60
"""A gear in mesh is looked at no further: 0.6 s, in which a driveline swings several times."""
FLANK_SLIP_RAD_S: Final = 0.2
"""Below this slip (2 rpm) at contact it is not certain which flank the tooth was carried to."""
CARRIED_MEASUREMENTS: Final = 2
"""The first ones of a gear that has just locked are of a tooth where the slip has carried it: 20
ms."""
LEARNED_SD_RAD: Final = math.radians(0.1)
"""Standard deviation of the difference of two references learned of one gear at different times
(docs/calibration.md), beyond what the measurements in mesh say."""
OTHER_SHARE: Final = 0.3
"""A constant that differs by so much, in backlashes, is another one: a flank was taken for the
other. One known no better than this may be that one."""


@dataclass
class Watched:
    """A gear that has locked and is watched."""

    gear: MainGear
    flank: int
    """+1 or -1, to which the slip at contact carried the tooth; 0: that is not certain."""
    measurements: int = 0
    counted: int = 0
    """Of these, the ones that were not too vague."""


class PhaseReferences:
    """The learned phase reference of each main gear: a constant in rad, or none."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._other_rad = OTHER_SHARE * sheet.dog.backlash_rad
        self._offset_rad: dict[MainGear, float] = {}
        self._sd_rad: dict[MainGear, float] = {}
        self._adopted: dict[MainGear, ReferenceSource] = {}
        """Source of each constant that was not measured with the gear in mesh."""
        self._gaps: dict[MainGear, GapPosterior] = {}
        """What all measurements at a gear show of where its gap is."""
        self._unseen: set[MainGear] = set()
        """Gears that have been in mesh without a measurement that counted."""
        self.watched: Watched | None = None
        """The gear in mesh that is watched; the same object as long as it is the same lock."""
        # Now, not in the step of the first lock.
        log_densities(sheet.dog.pitch_rad, sheet.dog.backlash_rad)

    def known(self, gear: MainGear) -> bool:
        """Whether this gear's reference is known, and so its phase."""
        return gear in self._offset_rad

    def sd_rad(self, gear: MainGear) -> float:
        """Standard deviation (rad) of a gear's constant, by the measurements it was learned from; 0
        where it was learned in another way."""
        return 0.0 if gear in self._adopted else self._sd_rad.get(gear, 0.0)

    def certain(self, gear: MainGear) -> bool:
        """Whether it is known, and at which flank the tooth was seen: enough to be remembered."""
        return self.known(gear) and self.sd_rad(gear) < self._other_rad

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped: wrap it to the pitch to see where in the gap it is.

        KeyError while the reference is unknown."""
        ratio = self._sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._offset_rad[gear]

    def locked(self, gear: MainGear, slip_rad_s: float) -> None:
        """The gear has just locked after its tooth met a flank at this slip, 0 if that is not
        known: begin to watch it."""
        certain = abs(slip_rad_s) >= FLANK_SLIP_RAD_S
        self.watched = Watched(gear, int(math.copysign(certain, slip_rad_s)))

    def watches(self, gear: MainGear) -> bool:
        """Whether measurements of this gear are wanted."""
        watched = self.watched
        return (
            watched is not None
            and watched.gear is gear
            and watched.measurements < MOST_MEASUREMENTS
        )

    def measure(
        self, gear: MainGear, theta_layshaft: float, theta_main: float, sd_rad: float
    ) -> None:
        """One measurement at the gear that is watched, however vague: it counts by its standard
        deviation."""
        watched, dog = self.watched, self._sheet.dog
        if watched is None or watched.gear is not gear:
            return
        flank = watched.flank if watched.counted < CARRIED_MEASUREMENTS else 0
        watched.measurements += 1
        ratio = self._sheet.main_mesh(gear).ratio
        gap = self._gaps.setdefault(gear, GapPosterior(dog.pitch_rad, dog.backlash_rad))
        raw_rad = raw_phase_rad(ratio, theta_layshaft, theta_main)
        watched.counted += gap.measure(raw_rad, sd_rad, flank)

    def settle(self, gear: MainGear) -> bool:
        """Takes over what the measurements show; true where that is a reference, or another one
        than before."""
        gap = self._gaps.get(gear)
        middle = None if gap is None else gap.middle()
        if middle is None:
            return False
        if gear in self._adopted and middle.sd_rad > self._other_rad:
            return False
        is_new = self.source(gear) is not ReferenceSource.MEASURED
        moved_rad = self._offset_rad.get(gear, 0.0) - middle.raw_rad
        off = wrap_to_pitch(moved_rad, self._sheet.dog.pitch_rad)
        self._offset_rad[gear], self._sd_rad[gear] = middle
        self._adopted.pop(gear, None)
        return is_new or abs(off) > self._other_rad

    def released(self) -> MainGear | None:
        """The gear leaves the mesh. Returns it where it was watched."""
        watched, self.watched = self.watched, None
        if watched is None:
            return None
        if watched.counted == 0:
            self._unseen.add(watched.gear)
        return watched.gear

    @property
    def offsets_rad(self) -> dict[MainGear, float]:
        """The constants by gear that are certain."""
        return {gear: at for gear, at in self._offset_rad.items() if self.certain(gear)}

    def adopt(self, gear: MainGear, offset_rad: float, source: ReferenceSource) -> None:
        """Takes a constant (rad) that was derived without the gear in mesh."""
        self._offset_rad[gear] = offset_rad
        self._adopted[gear] = source

    def source(self, gear: MainGear) -> ReferenceSource:
        """Where a gear's constant came from; while it is unknown, why."""
        if gear in self._offset_rad:
            return self._adopted.get(gear, ReferenceSource.MEASURED)
        return ReferenceSource.UNSEEN if gear in self._unseen else ReferenceSource.NONE

    def lose(self, gear: MainGear) -> None:
        """Drops one gear's constant, because it was wrong."""
        self._offset_rad.pop(gear, None)
        self._adopted.pop(gear, None)
        self._gaps.pop(gear, None)

    def lose_all(self) -> None:
        """Drops all constants, because a wheel's count was lost."""
        self._offset_rad.clear()
        self._adopted.clear()
        self._gaps.clear()
        self._unseen.clear()
        self.watched = None

    @property
    def mask(self) -> int:
        """Bit 0 crawl, 1 first, 2 second, 3 third, as the status frame reports them."""
        return sum(1 << (gear - 1) for gear in self._offset_rad)
