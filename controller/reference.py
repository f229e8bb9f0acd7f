"""Phase references: the angle between gear teeth and sleeve teeth, learned when a gear locks.

The sensor wheels count teeth but know no angle (thesis 8.2). In mesh a tooth lies on one flank of
its gap or the other, so the phase is + or - b/2 and the constant between counted angles and phase
is known once the flank is. Which one: impact and torque carry the tooth through the gap, and one
that has come from above, within the gap's width, lies on the lower flank. A tooth that has not
moved lies where the slip at contact carried it. Tooth counts keep the reference exact; it is lost when either count is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from controller.kinematics import raw_phase_rad, wrap_to_pitch
from gearbox import GearboxSheet, MainGear

STILL_LOOKS = 10
"""Looks over which a tooth must lie still to be at a flank: 100 ms, more than it takes to turn round within it."""
STILL_SHARE = 0.05
"""Standard deviation of a still tooth's looks, in backlashes."""
MOVED_SHARE = 0.3
STAYED_SHARE = 0.15
"""A tooth that was this share of the backlash away has moved to where it lies; less, it has not."""
GAP_SHARE = 1.25
"""No tooth in its gap can have been farther away: the look was a wrong one."""
UNMOVED_LOOKS = 20
"""After so many looks without a move the tooth lies where the slip at contact carried it."""
FLANK_SLIP_RAD_S = 0.2
"""Below this slip (2 rpm) at contact the flank cannot be told from it."""


@dataclass
class _Learning:
    """A gear being watched: the flank its slip carried it to, 0 if not certain, and the looks."""

    gear: MainGear
    flank: int
    seen: list[float] = field(default_factory=list)

    def add(self, raw_rad: float, pitch_rad: float) -> None:
        """One look, unwrapped beside the first."""
        first = self.seen[0] if self.seen else raw_rad
        self.seen.append(first + wrap_to_pitch(raw_rad - first, pitch_rad))

    def lies(self, backlash_rad: float) -> tuple[int, float] | None:
        """Flank and raw phase of a tooth that lies still; None while that cannot be told."""
        if len(self.seen) < STILL_LOOKS:
            return None
        still = self.seen[-STILL_LOOKS:]
        mean = sum(still) / STILL_LOOKS
        variance = sum((look - mean) ** 2 for look in still) / STILL_LOOKS
        if variance > (STILL_SHARE * backlash_rad) ** 2:
            return None
        away = [(look - mean) / backlash_rad for look in self.seen]
        possible = [share for share in away if abs(share) < GAP_SHARE]
        above, below = max(possible), -min(possible)
        if above > MOVED_SHARE and below < STAYED_SHARE:
            return -1, mean
        if below > MOVED_SHARE and above < STAYED_SHARE:
            return 1, mean
        unmoved = max(above, below) < STAYED_SHARE
        if unmoved and self.flank != 0 and len(self.seen) >= UNMOVED_LOOKS:
            return self.flank, mean
        return None


class PhaseReferences:
    """One learned constant a gear, or none."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._offset_rad: dict[MainGear, float] = {}
        self._learning: _Learning | None = None

    def known(self, gear: MainGear) -> bool:
        """Whether this gear's phase can be told."""
        return gear in self._offset_rad

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped: wrap it to the pitch to see where in the gap it is.

        KeyError while the reference is unknown."""
        ratio = self._sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._offset_rad[gear]

    def locked(self, gear: MainGear, slip_rad_s: float) -> None:
        """The gear has just locked after meeting its flank at this slip: begin to watch it."""
        certain = abs(slip_rad_s) >= FLANK_SLIP_RAD_S
        self._learning = _Learning(gear, int(math.copysign(certain, slip_rad_s)))

    def watch(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> bool:
        """One look at the gear in mesh. True when its reference has just been stored."""
        learning = self._learning
        if learning is None or learning.gear is not gear:
            return False
        mesh, dog = self._sheet.main_mesh(gear), self._sheet.dog
        learning.add(raw_phase_rad(mesh.ratio, theta_layshaft, theta_main), dog.pitch_rad)
        lies = learning.lies(dog.backlash_rad)
        if lies is None:
            return False
        flank, mean = lies
        self._offset_rad[gear] = mean - flank * dog.backlash_rad / 2.0
        self._learning = None
        return True

    def released(self) -> None:
        """The gear left the mesh before it was learned."""
        self._learning = None

    @property
    def offsets_rad(self) -> dict[MainGear, float]:
        """The known constants by gear."""
        return dict(self._offset_rad)

    def adopt(self, gear: MainGear, offset_rad: float) -> None:
        """A constant that is known without a look at the gear in mesh."""
        self._offset_rad[gear] = offset_rad

    def lose(self, gear: MainGear) -> None:
        """One gear's constant was wrong."""
        self._offset_rad.pop(gear, None)

    def lose_all(self) -> None:
        """A wheel's count was lost: nothing is known any more."""
        self._offset_rad.clear()
        self._learning = None

    @property
    def mask(self) -> int:
        """Bit 0 crawl, 1 first, 2 second, 3 third, as the status frame reports them."""
        return sum(1 << (gear - 1) for gear in self._offset_rad)
