"""Phase references: the angle between gear teeth and sleeve teeth, learned when a gear locks.

The sensor wheels count teeth but know no angle (thesis 8.2). In mesh a tooth lies on one flank of
its gap or the other, so the phase is + or - b/2 and the constant between counted angles and phase
is known once the flank is. Which one: impact and torque carry the tooth through the gap, and one
that has come from above, within the gap's width, lies on the lower flank. A tooth that has not
moved lies where the slip at contact carried it, if the sleeve went straight in; or, in a gearbox
where teeth have been seen to move, where the layshaft's drag pulls it. Where next to no torque lets
the tooth float, its looks from lock to release bound the gap: it is as wide as they are apart, or
a little wider. Tooth counts keep the reference exact; it is lost when either count is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from meshpoint.controller.motion.kinematics import raw_phase_rad, wrap_to_pitch
from meshpoint.dbc.messages import ReferenceSource
from meshpoint.gearbox import GearboxSheet, MainGear

STILL_LOOKS = 5
"""Looks over which a tooth must lie still, one every 10 ms, if it has come from the other flank."""
STILL_SHARE = 0.05
"""Standard deviation of a still tooth's looks, in backlashes."""
CROSSED_SHARE = 0.85
MOVED_SHARE = 0.3
STAYED_SHARE = 0.2
"""A tooth that was this share of the backlash away has crossed, has moved; less, it has not."""
NEAR_SHARE = 0.1
"""Looks so near to a still tooth, in backlashes, are of it lying there."""
GAP_SHARE = 1.25
"""No tooth in its gap can have been farther away: the look was a wrong one."""
MOVED_LOOKS = 16
"""Still looks of a tooth that has come from within the gap: it may turn round there, too."""
UNMOVED_LOOKS = 20
"""After so many looks without a move the tooth lies where the slip at contact carried it."""
PULLED_LOOKS = 6
"""So many still looks under drag alone are longer than a tooth needs to turn round in its gap."""
FLOATED_LOOKS = 3
"""Looks in a row that make one of a floating tooth,"""
FLOATED_SHARE = 0.2
"""no further apart than this, in backlashes: an impact leads single ones astray."""
LEAST_SPAN, MOST_SPAN = 0.8, 1.1
"""How far apart, in backlashes, a floating tooth has been seen for its gap to be told from it: the
middle is then off by a tenth at most."""
FLANK_SLIP_RAD_S = 0.2
"""Below this slip (2 rpm) at contact the flank cannot be told from it."""


class Floated(NamedTuple):
    """Lowest and highest raw phase at which the tooth of a gear has been in its gap."""

    gear: MainGear
    low_rad: float
    high_rad: float


@dataclass
class _Learning:
    """A gear being watched: the flank its slip carried it to, 0 if not certain, and the looks."""

    gear: MainGear
    flank: int
    straight: bool
    """The sleeve went straight in, so that the tooth has had no time to leave its flank."""
    seen: list[float] = field(default_factory=list)
    pulled: int = 0
    """How many of the newest looks drag alone has pulled the tooth down."""

    def add(self, raw_rad: float, pitch_rad: float, pulled: bool) -> None:
        """One look, unwrapped beside the first."""
        first = self.seen[0] if self.seen else raw_rad
        self.pulled = self.pulled + 1 if pulled else 0
        self.seen.append(first + wrap_to_pitch(raw_rad - first, pitch_rad))

    def lies(self, backlash_rad: float, moves: bool, stays: bool) -> tuple[int, float] | None:
        """Flank and raw phase of a tooth that lies still; None while that cannot be told.

        moves, stays: whether teeth have been seen to move in their gaps, or one not to, before."""
        if moves and self.pulled >= PULLED_LOOKS and self._still(PULLED_LOOKS, backlash_rad):
            return -1, _mean(self.seen[-PULLED_LOOKS:])
        if not self._still(STILL_LOOKS, backlash_rad):
            return None
        mean = _mean(self.seen[-STILL_LOOKS:])
        moved = self.moved_share(mean, backlash_rad)
        if moved is None:
            return None
        if abs(moved) > CROSSED_SHARE or (moved and self._still(MOVED_LOOKS, backlash_rad)):
            return int(math.copysign(1.0, moved)), mean
        certain = self.straight or stays
        if moves or not certain or self.flank == 0 or not self.stayed(backlash_rad):
            return None
        return self.flank, mean

    def stayed(self, backlash_rad: float) -> bool:
        """Whether the tooth has not moved for long, not even in a single look."""
        near = STAYED_SHARE * backlash_rad
        return len(self.seen) >= UNMOVED_LOOKS and max(self.seen) - min(self.seen) < 2.0 * near

    def moved_share(self, mean: float, backlash_rad: float) -> float | None:
        """How far the tooth has come to where it lies, in backlashes, up or down; 0 where it has
        not moved, None where it has been on both sides. Single looks do not count: an impact leads
        the estimate astray for one."""
        away = [(look - mean) / backlash_rad for look in self.seen]
        smooth = [sorted(away[k - 1 : k + 2])[1] for k in range(1, len(away) - 1)]
        possible = [share for share in smooth if abs(share) < GAP_SHARE]
        above, below = max(possible, default=0.0), -min(possible, default=0.0)
        if max(above, below) < STAYED_SHARE:
            return 0.0
        if above > MOVED_SHARE and below < STAYED_SHARE:
            return -above
        if below > MOVED_SHARE and above < STAYED_SHARE:
            return below
        return None

    def floated(self, backlash_rad: float) -> tuple[float, float] | None:
        """The lowest and the highest place at which the tooth has been; None without a look."""
        runs = [self.seen[k : k + FLOATED_LOOKS] for k in range(len(self.seen) - FLOATED_LOOKS + 1)]
        quiet = [sorted(run) for run in runs if max(run) - min(run) < FLOATED_SHARE * backlash_rad]
        if not quiet:
            return None
        middle = [run[FLOATED_LOOKS // 2] for run in quiet]
        return min(middle), max(middle)

    def _still(self, looks: int, backlash_rad: float) -> bool:
        if len(self.seen) < looks:
            return False
        still = self.seen[-looks:]
        mean = _mean(still)
        variance = sum((look - mean) ** 2 for look in still) / looks
        return variance <= (STILL_SHARE * backlash_rad) ** 2


def _mean(looks: list[float]) -> float:
    return sum(looks) / len(looks)


class PhaseReferences:
    """One learned constant a gear, or none."""

    def __init__(self, sheet: GearboxSheet) -> None:
        self._sheet = sheet
        self._offset_rad: dict[MainGear, float] = {}
        self._adopted: dict[MainGear, ReferenceSource] = {}
        """Where constants came from that were not seen in mesh."""
        self._learning: _Learning | None = None
        self._moves = False
        """Whether teeth have been seen to move in their gaps."""
        self._stays = False
        """Whether one has been seen that did not."""
        self._floated_rad: dict[MainGear, tuple[float, float]] = {}
        """Between where teeth have been seen that came to lie nowhere, by gear."""
        self._likely_rad: dict[MainGear, float] = {}
        """Constants that hold if teeth lie where the slip carried them in this gearbox."""

    def known(self, gear: MainGear) -> bool:
        """Whether this gear's phase can be told."""
        return gear in self._offset_rad

    def phase_rad(self, gear: MainGear, theta_layshaft: float, theta_main: float) -> float:
        """Phase of the gear, unwrapped: wrap it to the pitch to see where in the gap it is.

        KeyError while the reference is unknown."""
        ratio = self._sheet.main_mesh(gear).ratio
        return raw_phase_rad(ratio, theta_layshaft, theta_main) - self._offset_rad[gear]

    def locked(self, gear: MainGear, slip_rad_s: float, straight: bool = True) -> None:
        """The gear has just locked after meeting its flank at this slip: begin to watch it.

        straight: the sleeve went in without having rubbed on a tooth, or waited in the gap."""
        certain = abs(slip_rad_s) >= FLANK_SLIP_RAD_S
        flank = int(math.copysign(certain, slip_rad_s))
        self._learning = _Learning(gear, flank, straight)

    def watches(self, gear: MainGear) -> bool:
        """Whether a look at this gear in mesh is wanted."""
        return self._learning is not None and self._learning.gear is gear

    def watch(
        self, gear: MainGear, theta_layshaft: float, theta_main: float, pulled: bool = False
    ) -> bool:
        """One look at the gear in mesh; `pulled`: drag alone pulls its teeth, hard enough to cross
        the gap within a few looks. True when its reference has just been stored."""
        learning = self._learning
        if learning is None or learning.gear is not gear:
            return False
        mesh, dog = self._sheet.main_mesh(gear), self._sheet.dog
        raw = raw_phase_rad(mesh.ratio, theta_layshaft, theta_main)
        learning.add(raw, dog.pitch_rad, pulled)
        lies = learning.lies(dog.backlash_rad, self._moves, self._stays)
        if lies is None:
            return False
        flank, mean = lies
        # earlier looks that lie there too take out noise
        mean = _mean(
            [look for look in learning.seen if abs(look - mean) < NEAR_SHARE * dog.backlash_rad]
        )
        share = learning.moved_share(mean, dog.backlash_rad)
        self._moves = self._moves or (share is not None and abs(share) > CROSSED_SHARE)
        self._stays = self._stays or share == 0.0
        if not self._moves:
            self._offset_rad = self._likely_rad | self._offset_rad
        self._likely_rad.clear()
        self._offset_rad[gear] = mean - flank * dog.backlash_rad / 2.0
        self._adopted.pop(gear, None)
        self._learning = None
        return True

    def released(self) -> Floated | None:
        """The gear left the mesh; where its tooth has been, if that was before it was learned."""
        learning, backlash_rad = self._learning, self._sheet.dog.backlash_rad
        self._learning = None
        if learning is None:
            return None
        floated = learning.floated(backlash_rad)
        if floated is not None and not self.known(learning.gear):
            self._bound(learning.gear, *floated)
        if learning.stayed(backlash_rad):
            self._stays = True
            if learning.flank != 0:
                mean = _mean(learning.seen)
                self._likely_rad[learning.gear] = mean - learning.flank * backlash_rad / 2.0
        return None if floated is None else Floated(learning.gear, *floated)

    def _bound(self, gear: MainGear, low: float, high: float) -> None:
        """A gear that has left the mesh with its flank untold: what its looks say of the gap, with
        those of earlier times."""
        dog = self._sheet.dog
        if gear in self._floated_rad:
            before_low, before_high = self._floated_rad[gear]
            turned = low - before_low - wrap_to_pitch(low - before_low, dog.pitch_rad)
            low, high = min(low - turned, before_low), max(high - turned, before_high)
        self._floated_rad[gear] = low, high
        span = (high - low) / dog.backlash_rad
        if span > MOST_SPAN:
            del self._floated_rad[gear]
        elif span > LEAST_SPAN:
            self._offset_rad[gear] = 0.5 * (low + high)

    @property
    def offsets_rad(self) -> dict[MainGear, float]:
        """The known constants by gear."""
        return dict(self._offset_rad)

    def adopt(self, gear: MainGear, offset_rad: float, source: ReferenceSource) -> None:
        """A constant that is known without a look at the gear in mesh."""
        self._offset_rad[gear] = offset_rad
        self._adopted[gear] = source

    def source(self, gear: MainGear) -> ReferenceSource:
        """Where a gear's constant came from; NONE while it is unknown."""
        known = ReferenceSource.MEASURED if gear in self._offset_rad else ReferenceSource.NONE
        return self._adopted.get(gear, known)

    def lose(self, gear: MainGear) -> None:
        """One gear's constant was wrong."""
        self._offset_rad.pop(gear, None)
        self._adopted.pop(gear, None)

    def lose_all(self) -> None:
        """A wheel's count was lost: nothing is known any more."""
        self._offset_rad.clear()
        self._adopted.clear()
        self._likely_rad.clear()
        self._floated_rad.clear()
        self._learning = None

    @property
    def mask(self) -> int:
        """Bit 0 crawl, 1 first, 2 second, 3 third, as the status frame reports them."""
        return sum(1 << (gear - 1) for gear in self._offset_rad)
